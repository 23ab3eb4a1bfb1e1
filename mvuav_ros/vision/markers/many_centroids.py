"""The places of hundreds of lights at once, by the same sums as `centroid`'s."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from mvuav_ros.vision.markers.centroid import FLOOR, LARGEST_PULL, background_ring
from mvuav_ros.vision.point_operations import Pixels, full_scale

Array = NDArray[np.float64]
Integers = NDArray[np.intp]


def clipped(bounds: Iterable[NDArray[Any]], gray: Pixels) -> Integers:
    """Windows (n, 4) of x0, x1, y0, y1 (whole px), as much of them as lies within a frame."""
    (x0, x1, y0, y1), (height, width) = bounds, gray.shape
    x0, x1 = np.maximum(x0, 0), np.minimum(x1, width - 1)
    y0, y1 = np.maximum(y0, 0), np.minimum(y1, height - 1)
    return np.stack((x0, x1, y0, y1), axis=-1).astype(np.intp)


def measure_windows(gray: Pixels, windows: Integers, level: float, weighted: bool) -> Array:
    """Measure the light in every window, as `CentroidMeter.measure` does in one.

    Windows (n, 4) are x0, x1, y0, y1, inclusive px, within the frame.

    Returns:
        (n, 3): x and y (px; NaN where nothing is bright), area (px).
    """
    limit = level * full_scale(gray)
    owner, column, row, values = _look_into(gray, windows)
    bright = values > limit
    weights = np.maximum(values - int(FLOOR * limit), 0.0) if weighted else bright.astype(float)
    area: Array = np.bincount(owner, bright, len(windows)).astype(np.float64)
    measured = _places(owner, column, row, weights, area)
    x0, x1, y0, y1 = windows.T
    measured[:, 0] += 0.5 * (x0 + x1)
    measured[:, 1] += 0.5 * (y0 + y1)
    measured[area == 0, :2] = math.nan
    if weighted:
        mass: Array = np.bincount(owner, weights, len(windows)).astype(np.float64)
        measured[:, :2] -= _pulls(gray, measured, mass)
    return measured


def measure_pixels(
    gray: Pixels, pixels: Integers, owner: Integers, count: int, level: float, weighted: bool
) -> Array:
    """Measure lights by their own pixels, as `CentroidMeter.measure_part` does one.

    Args:
        gray: (height, width).
        pixels: (m,), places in the flattened frame.
        owner: (m,), to which light each belongs.
        count: of the lights, each of which must have a pixel.
        level: threshold, fraction of full scale.
        weighted: or binary.

    Returns:
        (count, 3): x and y (px), area (px).
    """
    y, x = np.divmod(pixels, gray.shape[1])
    weights = np.ones(len(pixels))
    if weighted:
        weights = gray[y, x] - FLOOR * level * full_scale(gray)
    area = np.bincount(owner, minlength=count).astype(float)
    return _places(owner, x.astype(np.float64), y.astype(np.float64), weights, area)


def _look_into(gray: Pixels, windows: Integers) -> tuple[Integers, Array, Array, Array]:
    """All windows' pixels in turn: the window, x and y from its middle (px), and value."""
    x0, x1, y0, y1 = windows.T.astype(np.int32)
    widths, heights = x1 - x0 + 1, y1 - y0 + 1
    sizes = widths * heights
    owner = np.repeat(np.arange(len(windows)), sizes)
    first = np.cumsum(sizes, dtype=np.int32) - sizes
    offset = np.arange(len(owner), dtype=np.int32) - np.repeat(first, sizes)
    width = np.repeat(widths, sizes)
    row = offset // width
    column = offset - row * width
    stride = gray.shape[1]
    corner = np.repeat(y0 * stride + x0, sizes)
    values = np.ascontiguousarray(gray).ravel()[corner + row * stride + column]
    middle_x, middle_y = np.repeat(0.5 * (widths - 1), sizes), np.repeat(0.5 * (heights - 1), sizes)
    return owner, column - middle_x, row - middle_y, values.astype(np.float64)


def _places(owner: Integers, x: Array, y: Array, weights: Array, area: Array) -> Array:
    """(n, 3): every light's weighted mean place (px) and its area (px)."""
    count = len(area)
    mass = np.bincount(owner, weights, count)
    mass[mass == 0.0] = 1.0
    mean_x = np.bincount(owner, weights * x, count) / mass
    mean_y = np.bincount(owner, weights * y, count) / mass
    return np.stack((mean_x, mean_y, area), axis=-1)


def _pulls(gray: Pixels, measured: Array, mass: Array) -> Array:
    """How far the background pulls each light, (n, 2) px; see `CentroidMeter`."""
    pulls = np.zeros((len(measured), 2))
    x, y, area = measured.T
    radii = np.round(np.sqrt(area / math.pi)).astype(np.intp)
    columns = np.floor(np.nan_to_num(x) + 0.5).astype(np.intp)
    rows = np.floor(np.nan_to_num(y) + 0.5).astype(np.intp)
    height, width = gray.shape
    for radius in np.unique(radii[area > 0]).tolist():
        moment, half, factor = background_ring(radius)
        inside = (columns >= half) & (rows >= half)
        inside &= (columns < width - half) & (rows < height - half)
        chosen = np.flatnonzero(inside & (radii == radius) & (area > 0))
        if len(chosen) == 0:
            continue
        side = 2 * half + 1
        around = sliding_window_view(gray, (side, side))[
            rows[chosen] - half, columns[chosen] - half
        ]
        pull = around.reshape(len(chosen), len(moment)).astype(np.float32) @ moment
        pulls[chosen] = factor * (area / np.where(mass > 0, mass, 1.0))[chosen, None] * pull
    pulls[np.hypot(*pulls.T) >= LARGEST_PULL] = 0.0
    return pulls
