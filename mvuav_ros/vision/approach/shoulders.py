"""Pavement that goes on beyond a runway's edges, so that there are two edges on each side.

Paved shoulders lie outside the side stripes. From near by they can be seen as strips of their own,
and whether they belong to the runway the image does not say.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.approach.edges import LevelledFrame, Strip, rows_of
from mvuav_ros.vision.approach.evidence import opponent_channels
from mvuav_ros.vision.approach.tuning import SHOULDERS


def shows_shoulders(frame: LevelledFrame, strip: Strip) -> bool | None:
    """Whether another edge runs along a strip's on both sides, outside of it.

    It must do so for more than half of the runway's length, with something even in between.

    Returns:
        None if too little beside the runway is on the frame, or it is too narrow.
    """
    rows, edges, outwards = rows_of(strip, np.linspace(SHOULDERS.first_row, 1.0, SHOULDERS.rows))
    across = np.arange(-SHOULDERS.inside, SHOULDERS.beyond, SHOULDERS.step)
    columns = edges[:, :, None] + outwards[:, :, None] * across
    pixels, on_x, on_y = frame.at(columns, rows[:, None])
    height, width = frame.image.shape[:2]
    on_frame = (on_x >= 0) & (on_x < width) & (on_y >= 0) & (on_y < height)
    seen = on_frame.all(axis=(0, 2))
    if 2 * np.count_nonzero(seen) < SHOULDERS.rows:
        return None
    window = max(2, round(SHOULDERS.window / (float(np.median(outwards[1])) * SHOULDERS.step)))
    if window >= across.size // 2:
        return None
    channels = opponent_channels(pixels)
    unit = max(float(channels[0].mean()), 1.0)
    steps = np.stack([_steps(channel, window, seen) for channel in channels]) / unit
    sizes = np.linalg.norm(steps, axis=0)
    place = across[:-window] + 0.5 * window * SHOULDERS.step
    return (
        min(_clearness(size, place, window * SHOULDERS.step) for size in sizes)
        >= SHOULDERS.min_clearness
    )


def _steps(
    channel: NDArray[np.float32], window: int, seen: NDArray[np.bool_]
) -> NDArray[np.floating[Any]]:
    """(2, places) median over the rows of the rise towards outside."""
    smooth = cv2.blur(channel, (window, 1))
    rise = (smooth[:, window:] - smooth[:, :-window]).reshape(2, SHOULDERS.rows, -1)
    median: NDArray[np.floating[Any]] = np.median(rise[:, seen], axis=1)
    return median


def _clearness(size: NDArray[np.floating[Any]], place: NDArray[np.float64], first: float) -> float:
    """By how much a step beyond the edge's own stands out from what is between the two."""
    own = np.nonzero(np.abs(place) <= first)[0]
    beyond = size[int(own[size[own].argmax()]) :]
    clear = beyond - np.minimum.accumulate(beyond)
    return float(np.where(beyond >= SHOULDERS.min_step, clear, 0.0).max())
