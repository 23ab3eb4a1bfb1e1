"""Pavement that goes on beyond a runway's edges, so that there are two edges on each side.

Paved shoulders lie outside the side stripes. From near by they can be seen as strips of their own,
and whether they belong to the runway the image does not say.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.approach.derotation import Derotation
from mvuav_ros.vision.approach.edges import pixels_at, rows_of
from mvuav_ros.vision.approach.runway.evidence import opponent_channels

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


def shows_shoulders(
    image: NDArray[Any],
    level: Derotation,
    shape: NDArray[np.float64],
    span: tuple[float, float],
) -> bool | None:
    """Whether another edge runs along the runway's on both sides, outside of it.

    It must do so for more than half of the runway's length, with something even in between.

    Args:
        image: the frame, (height, width) or (height, width, 3), blue first.
        level: of the frame.
        shape: (4,) vanishing point and slopes, px of the levelled working image.
        span: rows from the vanishing point to the far and to the near end.

    Returns:
        None if too little beside the runway is on the frame.
    """
    rows, edges, outwards = rows_of(shape, span, np.linspace(_FIRST_ROW, 1.0, _ROWS))
    across = np.arange(-_INSIDE, _BEYOND, _STEP)
    columns = edges[:, :, None] + outwards[:, :, None] * across
    on_rows = np.broadcast_to(rows[:, None], columns.shape)
    pixels, on_x, on_y = pixels_at(image, level, columns, on_rows)
    on_frame = (on_x >= 0) & (on_x < image.shape[1]) & (on_y >= 0) & (on_y < image.shape[0])
    seen = on_frame.all(axis=(0, 2))
    if 2 * np.count_nonzero(seen) < _ROWS:
        return None
    window = max(2, round(_WINDOW / (float(np.median(outwards[1])) * _STEP)))
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
