"""One light's place to a few hundredths of a pixel, and those of hundreds at once."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.image import Image
from mvuav_ros.vision.point_operations import Pixels, full_scale, threshold

Cut = Callable[[int, int, int, int], Pixels]
"""Takes x0, x1, y0, y1 (inclusive px, within the frame) and gives the intensity there."""
Bounds = tuple[int, int, int, int]
"""x0, x1, y0, y1 of a window, inclusive px, within the frame; empty where an end is before its
start."""
Pull = tuple[float, float]
"""Of the background on a light, px."""

FLOOR = 0.9
"""Weights count from this part of the threshold up: above any background that the threshold
keeps out, and half-way up the edge of a light that saturates, where its place shows best."""
BACKGROUND_SHARE = 0.35
"""Part of the background's pull that is taken out. An edge pixel shows about half of the
background behind it (0.5) where that reaches up to the light, as the wing does on the reference
frames; nothing where the lens's glare evens it out."""
MAX_PULL = 0.12
"""px; a stronger one is another light in the ring, not background."""
_RING = (2.5, 4.5)
"""The background is looked at this far outside of the light's edge, px."""


class Detection(NamedTuple):
    """A measured light.

    Attributes:
        x: px.
        y: px.
        area: pixels above the threshold.
        spread: second moment over that of a disc of this area: 1 for a disc, more for anything
            long, torn or accompanied.
    """

    x: float
    y: float
    area: int
    spread: float

    @property
    def radius(self) -> float:
        """Of a disc of this area, px."""
        return math.sqrt(self.area / math.pi)


def cutter(image: Image) -> Cut:
    """How to look at parts of an image at the cost of those parts alone."""
    if image.is_gray:
        pixels = image.gray()
        return lambda x0, x1, y0, y1: pixels[y0 : y1 + 1, x0 : x1 + 1]
    return lambda x0, x1, y0, y1: image.gray_window(slice(y0, y1 + 1), slice(x0, x1 + 1))


class CentroidMeter:
    """Measures the lights in windows; built once per frame or kept as long as nothing changes.

    Binary: the mean of the pixels above the threshold (thesis). Weighted: the mean of all pixels
    above `FLOOR`, weighted by what they exceed it by, less the pull of an uneven background: what
    shines through the light's soft edge on one side moves the mean to that side, and a ring
    around the light shows how much.

    Attributes:
        level: threshold, fraction of full scale.
        weighted: or binary.
    """

    def __init__(self, level: float, weighted: bool) -> None:
        """Set the threshold.

        Args:
            level: fraction of full scale.
            weighted: or binary.
        """
        self.level = level
        self.weighted = weighted

    def measure(self, cut: Cut, window: Bounds, size: tuple[int, int]) -> Detection | None:
        """The light in a window; None where no pixel is above the threshold.

        Args:
            cut: gives the frame's intensity.
            window: where to look.
            size: the frame's width and height, px.
        """
        found = self.measure_all(cut, [window], size, [None])[0]
        return found[0] if found else None

    def measure_all(
        self,
        cut: Cut,
        windows: Sequence[Bounds],
        size: tuple[int, int],
        pulls: Sequence[Pull | None],
    ) -> list[tuple[Detection, Pull] | None]:
        """The light in each window, and the pull of its background.

        Each pull is as it was found some frames ago, or None where it is to be looked for. All
        windows are measured at once, one beside the other; what they are too small for is dark.
        """
        shown = {
            row: cut(*bounds)
            for row, bounds in enumerate(windows)
            if bounds[0] <= bounds[1] and bounds[2] <= bounds[3]
        }
        if not shown:
            return [None] * len(windows)
        heights, widths = zip(*(part.shape for part in shown.values()), strict=True)
        height, width = max(heights), max(widths)
        first = next(iter(shown.values()))
        gray = np.zeros((len(windows), height, width), first.dtype)
        for row, part in shown.items():
            gray[row, : part.shape[0], : part.shape[1]] = part
        flat = gray.reshape(-1, width)
        mask = threshold(flat, self.level)
        one_row = len(windows), height * width
        areas = cv2.reduce(mask.reshape(one_row), 1, cv2.REDUCE_SUM, dtype=cv2.CV_32S)
        weights = mask
        if self.weighted:
            floor = int(FLOOR * self.level * full_scale(gray))
            weights = cv2.subtract(flat, _even(flat.shape, gray.dtype.char, floor))
        # One product instead of cv2.moments, which takes twice as long for a window.
        powers = _powers((height, width))
        sums = weights.reshape(one_row).astype(np.float32).dot(powers).tolist()
        found: list[tuple[Detection, Pull] | None] = []
        for bounds, pull, (bright,), (mass, mx, my, m2) in zip(
            windows, pulls, areas.tolist(), sums, strict=True
        ):
            area = bright // 255
            if not area:
                found.append(None)
                continue
            mx, my = mx / mass, my / mass
            spread = 2 * math.pi * (m2 / mass - mx * mx - my * my) / area
            x, y = bounds[0] + 0.5 * (width - 1) + mx, bounds[2] + 0.5 * (height - 1) + my
            if not self.weighted:
                pull = 0.0, 0.0
            elif pull is None:
                pull = self._find_pull(cut, x, y, area, mass, size)
            found.append((Detection(x - pull[0], y - pull[1], area, spread), pull))
        return found

    def _find_pull(
        self, cut: Cut, x: float, y: float, area: int, mass: float, size: tuple[int, int]
    ) -> Pull:
        moment, half, factor = background_ring(round(math.sqrt(area / math.pi)))
        column, row = math.floor(x + 0.5), math.floor(y + 0.5)
        x0, x1, y0, y1 = column - half, column + half, row - half, row + half
        if x0 < 0 or y0 < 0 or x1 >= size[0] or y1 >= size[1]:
            return 0.0, 0.0
        dx, dy = cut(x0, x1, y0, y1).ravel().astype(np.float32).dot(moment).tolist()
        factor *= area / mass
        dx, dy = factor * dx, factor * dy
        return (dx, dy) if dx * dx + dy * dy < MAX_PULL * MAX_PULL else (0.0, 0.0)


@lru_cache(maxsize=256)
def _even(shape: tuple[int, int], dtype: str, value: int) -> Pixels:
    """An image of one value."""
    return np.full(shape, value, dtype)


@lru_cache(maxsize=256)
def _powers(shape: tuple[int, int]) -> NDArray[np.float32]:
    """(pixels, 4): 1, x, y and x² + y² from the middle of a window, px."""
    height, width = shape
    y, x = np.mgrid[:height, :width]
    x, y = x - 0.5 * (width - 1), y - 0.5 * (height - 1)
    powers = np.stack((np.ones(shape), x, y, x * x + y * y), axis=-1)
    return powers.reshape(-1, 4).astype(np.float32)


@lru_cache(maxsize=64)
def background_ring(radius: int) -> tuple[NDArray[np.float32], int, float]:
    """What measures the pull of the background around a light.

    A difference of d in grey level that lies along a direction outside of the light adds
    share x d to every edge pixel, so the weighted sum gains share x (length of the edge) x
    (its width) x radius x mean(d cos): the ring's first moment gives mean(d cos).

    Returns:
        (pixels, 2): x and y inside of the ring, 0 elsewhere, px; half the side of the square
        around it, px; the factor that makes the sum a pull, but for area / mass.
    """
    inner, outer = radius + _RING[0], radius + _RING[1]
    half = math.ceil(outer)
    y, x = np.mgrid[-half : half + 1, -half : half + 1]
    distance = np.hypot(x, y)
    ring = (distance > inner) & (distance <= outer)
    moment = np.stack((x * ring, y * ring), axis=-1).reshape(-1, 2).astype(np.float32)
    factor = 2.0 * BACKGROUND_SHARE / (int(ring.sum()) * 0.5 * (inner + outer))
    return moment, half, factor


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
        (n, 4): x and y (px; NaN where nothing is bright), area (px), spread (see `Detection`).
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
    """Measure lights by their own pixels, which other lights come close to.

    Args:
        gray: (height, width).
        pixels: (m,), places in the flattened frame.
        owner: (m,), to which light each belongs.
        count: of the lights, each of which must have a pixel.
        level: threshold, fraction of full scale.
        weighted: or binary.

    Returns:
        (count, 4): as `measure_windows`.
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
    """(n, 4): every light's weighted mean place (px), its area (px) and its spread."""
    count = len(area)
    mass = np.bincount(owner, weights, count)
    mass[mass == 0.0] = 1.0
    mean_x = np.bincount(owner, weights * x, count) / mass
    mean_y = np.bincount(owner, weights * y, count) / mass
    second = np.bincount(owner, weights * (x * x + y * y), count) / mass
    spread = 2 * math.pi * (second - mean_x**2 - mean_y**2) / np.maximum(area, 1.0)
    return np.stack((mean_x, mean_y, area, spread), axis=-1)


def _pulls(gray: Pixels, measured: Array, mass: Array) -> Array:
    """How far the background pulls each light, (n, 2) px; see `CentroidMeter`."""
    pulls = np.zeros((len(measured), 2))
    bright = np.flatnonzero(measured[:, 2])
    area = measured[bright, 2]
    radii = np.round(np.sqrt(area / math.pi))
    columns, rows = np.floor(measured[bright, :2].T + 0.5).astype(np.intp)
    (height, width), share = gray.shape, (area / mass[bright])[:, None]
    to_edge = np.minimum(np.minimum(columns, width - 1 - columns), rows)
    to_edge = np.minimum(to_edge, height - 1 - rows)
    for radius in set(radii.tolist()):
        moment, half, factor = background_ring(int(radius))
        chosen = np.flatnonzero((radii == radius) & (to_edge >= half))
        around = [
            gray[row - half : row + half + 1, column - half : column + half + 1]
            for row, column in zip(rows[chosen].tolist(), columns[chosen].tolist(), strict=True)
        ]
        rings = np.array(around, np.float32).reshape(len(chosen), len(moment))
        pulls[bright[chosen]] = factor * share[chosen] * (rings @ moment)
    pulls[np.hypot(*pulls.T) >= MAX_PULL] = 0.0
    return pulls
