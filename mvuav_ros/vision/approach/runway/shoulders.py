"""Pavement that goes on beyond a runway's edges, so that there are two edges on each side.

Paved shoulders lie outside the side stripes. From near by they can be seen as strips of their own,
and whether they belong to the runway the image does not say.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.approach.channels import opponent_channels
from mvuav_ros.vision.approach.edges import LevelledFrame, Strip, rows_of

_ROWS, _FIRST_ROW = 32, 0.3
"""Sampled, from this share of the way between the far and the near end on: farther away a shoulder
is too narrow."""
_STEP, _INSIDE, _BEYOND = 0.01, 0.02, 0.3
"""Widths of the runway: between samples, and how far inside and outside of the edge they are."""
_WINDOW = 2.0
"""Px, in the middle row, of the means whose difference is a step: the blur of run 3."""
_LEAST_STEP = 0.034
"""Of the mean brightness, however long the exposure was: a step that is an edge. Run 3."""
_LEAST_CLEARNESS = 0.0064
"""Of the mean brightness: by how much it must stand out from what is between. Run 3."""


def shows_shoulders(frame: LevelledFrame, strip: Strip) -> bool | None:
    """Whether another edge runs along a strip's on both sides, outside of it.

    It must do so for more than half of the runway's length, with something even in between.

    Returns:
        None if too little beside the runway is on the frame, or it is too narrow.
    """
    rows, edges, outwards = rows_of(strip, np.linspace(_FIRST_ROW, 1.0, _ROWS))
    across = np.arange(-_INSIDE, _BEYOND, _STEP)
    columns = edges[:, :, None] + outwards[:, :, None] * across
    pixels, on_x, on_y = frame.at(columns, rows[:, None])
    height, width = frame.image.shape[:2]
    on_frame = (on_x >= 0) & (on_x < width) & (on_y >= 0) & (on_y < height)
    seen = on_frame.all(axis=(0, 2))
    if 2 * np.count_nonzero(seen) < _ROWS:
        return None
    window = max(2, round(_WINDOW / (float(np.median(outwards[1])) * _STEP)))
    if window >= across.size // 2:
        return None
    channels = opponent_channels(pixels)
    unit = max(float(channels[0].mean()), 1.0)
    steps = np.stack([_steps(channel, window, seen) for channel in channels]) / unit
    sizes = np.linalg.norm(steps, axis=0)
    place = across[:-window] + 0.5 * window * _STEP
    return min(_clearness(size, place, window * _STEP) for size in sizes) >= _LEAST_CLEARNESS


def _steps(
    channel: NDArray[np.float32], window: int, seen: NDArray[np.bool_]
) -> NDArray[np.floating[Any]]:
    """(2, places) median over the rows of the rise towards outside."""
    smooth = cv2.blur(channel, (window, 1))
    rise = (smooth[:, window:] - smooth[:, :-window]).reshape(2, _ROWS, -1)
    median: NDArray[np.floating[Any]] = np.median(rise[:, seen], axis=1)
    return median


def _clearness(size: NDArray[np.floating[Any]], place: NDArray[np.float64], first: float) -> float:
    """By how much a step beyond the edge's own stands out from what is between the two."""
    own = np.nonzero(np.abs(place) <= first)[0]
    beyond = size[int(own[size[own].argmax()]) :]
    clear = beyond - np.minimum.accumulate(beyond)
    return float(np.where(beyond >= _LEAST_STEP, clear, 0.0).max())
