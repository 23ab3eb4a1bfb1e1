"""One light's place to a few hundredths of a pixel, and those of hundreds at once."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.image import Image, as_image
from mvuav_ros.vision.markers.marker_results import Window
from mvuav_ros.vision.point_operations import Pixels, full_scale

Array = NDArray[Any]
Pull = tuple[float, float]  # Of the background on a light, px

FLOOR = 0.9
"""Weights count from this part of the threshold up: above any background that the threshold
keeps out, and half-way up the edge of a light that saturates, where its place shows best."""
BACKGROUND_SHARE = 0.35
"""Part of the background's pull that is taken out. An edge pixel shows about half of the
background behind it (0.5) where that reaches up to the light, as the wing does on the reference
frames; nothing where the lens's glare evens it out."""
MAX_PULL = 0.12  # px; a stronger one is another light in the ring, not background
_RING = (2.5, 4.5)  # The background is looked at this far outside of the light's edge, px


class Detection(NamedTuple):
    """A measured light, px."""

    x: float
    y: float
    area: int  # pixels above the threshold
    # Second moment over that of a disc of this area: 1 for a disc, more for anything long or torn.
    spread: float

    @property
    def radius(self) -> float:
        """Of a disc of this area, px."""
        return math.sqrt(self.area / math.pi)


Measured = tuple[Detection, Pull]
Sums = tuple[int, int, float, float, float, float]


class CentroidMeter:
    """Measures the lights of an image in windows, each at the cost of that window alone.

    Binary: the mean of the pixels above the level, a fraction of full scale (thesis). Weighted: the
    mean of all pixels above `FLOOR` of it, weighted by what they exceed that by, less the pull of
    an uneven background behind the light's soft edge, which a ring around the light shows.
    """

    def __init__(self, image: Image | Pixels, level: float, weighted: bool) -> None:
        self._image = as_image(image)
        self._gray = self._image.gray() if self._image.is_gray else None
        self.size = self._image.width, self._image.height
        self._level, self._weighted = level, weighted

    def cut(self, window: Window) -> Pixels:
        """The intensity in a window that is not empty."""
        x0, x1, y0, y1 = window
        if self._gray is not None:
            return self._gray[y0 : y1 + 1, x0 : x1 + 1]
        return self._image.gray_window(slice(y0, y1 + 1), slice(x0, x1 + 1))

    def measure(self, window: Window) -> Detection | None:
        """The light in a window; None where no pixel is above the threshold."""
        found = self.measure_all([window], [None])[0]
        return found[0] if found else None

    def measure_all(
        self, windows: Sequence[Window], pulls: Sequence[Pull | None]
    ) -> list[Measured | None]:
        """The light in each window, and the pull of its background.

        Each pull is as it was found some frames ago, or None where it is to be looked for.
        """
        shown = {
            row: self.cut(window)
            for row, window in enumerate(windows)
            if window.x0 <= window.x1 and window.y0 <= window.y1
        }
        found: list[Measured | None] = [None] * len(windows)
        for row, area, mass, x, y, spread in self._sums(shown, windows):
            pull = pulls[row] if self._weighted else (0.0, 0.0)
            if pull is None:
                pull = self._find_pull(x, y, area, mass)
            found[row] = Detection(x - pull[0], y - pull[1], area, spread), pull
        return found

    def measure_alone(
        self, windows: Sequence[Window], areas: Iterable[float]
    ) -> list[Detection | None]:
        """The lights of so many pixels (n) in windows; None where a window shows more as well."""
        found = self.measure_all(windows, [None] * len(windows))
        pairs = zip(found, areas, strict=True)
        return [seen[0] if seen and seen[0].area == area else None for seen, area in pairs]

    def measure_own(self, patches: Sequence[Pixels], windows: Sequence[Window]) -> list[Detection]:
        """The lights that windows show without what is not theirs, nor their background."""
        sums = sorted(self._sums(dict(enumerate(patches)), windows))
        return [Detection(x, y, area, spread) for _, area, _, x, y, spread in sums]

    def windows(self, x0: Array, x1: Array, y0: Array, y1: Array) -> list[Window]:
        """Windows with these bounds (n whole px each), as much of them as lies in the image."""
        right, bottom = self.size[0] - 1, self.size[1] - 1
        x0, x1 = np.maximum(x0, 0), np.minimum(x1, right)
        y0, y1 = np.maximum(y0, 0), np.minimum(y1, bottom)
        rows = np.stack((x0, x1, y0, y1), axis=-1).astype(np.intp)
        return [Window(*row) for row in rows.tolist()]

    def _sums(self, shown: Mapping[int, Pixels], windows: Sequence[Window]) -> list[Sums]:
        """Of the windows with a light: row, area, mass, x and y of its mean, and spread."""
        found: list[Sums] = []
        for rows, gray in _stacked(shown):
            middle_x, middle_y = 0.5 * (gray.shape[2] - 1), 0.5 * (gray.shape[1] - 1)
            counts, moments = self._moments(gray)
            for row, count, (mass, mx, my, m2) in zip(rows, counts, moments, strict=True):
                if not count:
                    continue
                area, mx, my = int(count), mx / mass, my / mass
                spread = 2 * math.pi * (m2 / mass - mx * mx - my * my) / area
                x, y = windows[row][0] + middle_x + mx, windows[row][2] + middle_y + my
                found.append((row, area, mass, x, y, spread))
        return found

    def _moments(self, gray: Pixels) -> tuple[list[float], list[list[float]]]:
        """Of windows (n, height, width) the bright pixels, and the four sums (see `_powers`)."""
        count, height, width = gray.shape
        counts = _counts(self._level, self._weighted, full_scale(gray)).take(gray, axis=1)
        # One product instead of cv2.moments, which takes twice as long for a window.
        sums = counts.reshape(2 * count, -1).dot(_powers((height, width)))
        return sums[:count, 0].tolist(), sums[count:].tolist()

    def _find_pull(self, x: float, y: float, area: int, mass: float) -> Pull:
        """How far the background pulls a light, px; nothing where its ring leaves the image."""
        moment, half, factor = _background_ring(round(math.sqrt(area / math.pi)))
        column, row = math.floor(x + 0.5), math.floor(y + 0.5)
        ring = Window(column - half, column + half, row - half, row + half)
        if ring.x0 < 0 or ring.y0 < 0 or ring.x1 >= self.size[0] or ring.y1 >= self.size[1]:
            return 0.0, 0.0
        dx, dy = self.cut(ring).astype(np.float32).ravel().dot(moment).tolist()
        factor *= area / mass
        dx, dy = factor * dx, factor * dy
        return (dx, dy) if dx * dx + dy * dy < MAX_PULL * MAX_PULL else (0.0, 0.0)


def _stacked(shown: Mapping[int, Pixels]) -> Iterator[tuple[list[int], Pixels]]:
    """Windows of about one size as one array (n, height, width), dark around, with their rows."""
    if len({patch.shape for patch in shown.values()}) == 1:
        yield list(shown), np.array(list(shown.values()))
        return
    alike: dict[int, list[int]] = {}
    for row, patch in shown.items():
        alike.setdefault(max(patch.shape).bit_length(), []).append(row)
    for rows in alike.values():
        patches = [shown[row] for row in rows]
        height, width = map(max, zip(*[patch.shape for patch in patches], strict=True))
        stacked = np.zeros((len(rows), height, width), patches[0].dtype)
        for space, patch in zip(stacked, patches, strict=True):
            space[: patch.shape[0], : patch.shape[1]] = patch
        yield rows, stacked


@lru_cache(maxsize=8)
def _counts(level: float, weighted: bool, scale: int) -> NDArray[np.float32]:
    """(2, scale + 1): whether a pixel of each intensity is bright, 1 or 0, and its weight."""
    intensity = np.arange(scale + 1)
    bright = intensity > level * scale
    weights = np.maximum(intensity - int(FLOOR * level * scale), 0) if weighted else bright
    return np.array((bright, weights), np.float32)


@lru_cache(maxsize=256)
def _powers(shape: tuple[int, int]) -> NDArray[np.float32]:
    """(pixels, 4): 1, x, y and x² + y² from the middle of a window, px."""
    height, width = shape
    y, x = np.mgrid[:height, :width]
    x, y = x - 0.5 * (width - 1), y - 0.5 * (height - 1)
    powers = np.stack((np.ones(shape), x, y, x * x + y * y), axis=-1)
    return powers.reshape(-1, 4).astype(np.float32)


@lru_cache(maxsize=64)
def _background_ring(radius: int) -> tuple[NDArray[np.float32], int, float]:
    """What measures the pull of the background around a light.

    A difference of d in grey level along a direction outside of the light adds share x d to every
    edge pixel, so the weighted sum gains share x (length of the edge) x (its width) x radius x
    mean(d cos), which the ring's first moment gives. Returns x and y inside of the ring, 0
    elsewhere, (pixels, 2); half the side of the square around it, px; and the factor that makes the
    sum a pull, but for area / mass.
    """
    inner, outer = radius + _RING[0], radius + _RING[1]
    half = math.ceil(outer)
    y, x = np.mgrid[-half : half + 1, -half : half + 1]
    distance = np.hypot(x, y)
    ring = (distance > inner) & (distance <= outer)
    moment = np.stack((x * ring, y * ring), axis=-1).reshape(-1, 2).astype(np.float32)
    factor = 2.0 * BACKGROUND_SHARE / (int(ring.sum()) * 0.5 * (inner + outer))
    return moment, half, factor
