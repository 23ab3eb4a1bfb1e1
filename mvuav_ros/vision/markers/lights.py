"""The lights of a frame: measured to a few hundredths of a pixel, hundreds at once, and grouped."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from functools import cached_property, lru_cache
from itertools import compress
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.parameters.marker_tracker import MarkerTrackerParameters
from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.image import Image, as_image
from mvuav_ros.vision.markers.marker_results import NO_WINDOW, Window
from mvuav_ros.vision.point_operations import Mask, Pixels, full_scale, threshold

Array = NDArray[np.float64]
Integers = NDArray[np.intp]
Point = tuple[float, float]  # x and y, px
Numbers = NDArray[Any]
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
    # Second moment over that of a disc of this area: 1 for a disc, more for anything long or torn;
    # NaN of the thesis's groups.
    spread: float = math.nan

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

    def windows(self, x0: Numbers, x1: Numbers, y0: Numbers, y1: Numbers) -> list[Window]:
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


MAX_BRIGHT_FRACTION, MAX_BRIGHT_SMALL_FRAME = 0.05, 4096
"""Of a frame, and px, beyond which all bright pixels together are noise or glare, not lights."""


class GroupingError(ValueError):
    """The bright pixels are too many to be markers; the message says how many."""


def area_fits(area: Any, parameters: MarkerTrackerParameters) -> Any:
    """Whether a light of so many pixels (or each of an array of them) may be a marker."""
    most = parameters.max_area or math.inf
    return (parameters.min_area <= area) & (area <= most)


def max_bright(mask: Mask) -> float:
    """Px of a frame that lights may have at most."""
    return max(MAX_BRIGHT_FRACTION * mask.size, MAX_BRIGHT_SMALL_FRAME)


def brightness_problem(mask: Mask) -> str:
    """What is wrong with a mask whose bright pixels are too many to be all of lights; else ''."""
    bright = cv2.countNonZero(mask)
    if bright <= max_bright(mask):
        return ''
    return f'{100 * bright / mask.size:.0f} % of the frame is above the threshold'


MAX_BLOBS = 400  # Pieces that are measured in one frame
LONGEST = 3.0  # Sides of the box around a piece that may still be a light, one over the other
MIN_FILLED = 0.4  # Part of its box that a light fills; a disc fills 0.79


class Blobs:
    """The bright pieces of a frame, 8-connected, within the area limits.

    Unlike the thesis's groups around seeds a piece may be of any width, and two lights are two
    pieces for as long as a dark pixel lies between them.
    """

    def __init__(
        self, gray: Pixels, parameters: MarkerTrackerParameters, mask: Mask | None = None
    ) -> None:
        """Find those of a grey image, by the mask of its bright pixels if that is there."""
        self._meter = CentroidMeter(gray, parameters.threshold, parameters.weighted)
        mask = threshold(gray, parameters.threshold) if mask is None else mask
        self._labels, self._where, stats = label(mask)
        area = stats[1:, cv2.CC_STAT_AREA]
        # Of the pieces within the limits. What is larger than all lights may be is none.
        self._numbers = 1 + np.flatnonzero(area_fits(area, parameters) & (area <= max_bright(mask)))
        # (n, 5), x, y, width, height and area (px), in the order of their first pixels, row by row.
        self.stats = stats[self._numbers].astype(np.intp)
        self._compact: dict[float, Integers] = {}  # by the least area asked for

    @property
    def crowd(self) -> str:
        """What is wrong where they are more than are measured; else ''."""
        count = len(self.stats)
        return f'{count} clusters above the threshold' if count > MAX_BLOBS else ''

    def may_be_lights(self, least: float = 0.0) -> Integers:
        """The rows in `stats` of those, of an area (px) at least, that are compact enough.

        Of too many the largest: noise makes small ones.
        """
        if least not in self._compact:
            _, _, width, height, area = self.stats.T
            is_long = np.maximum(width, height) > LONGEST * np.minimum(width, height)
            is_filled = area >= np.maximum(MIN_FILLED * width * height, least)
            rows = np.flatnonzero(is_filled & ~(is_long & (area > 4)))
            if len(rows) > MAX_BLOBS:
                rows = np.sort(rows[np.argsort(-area[rows], kind='stable')[:MAX_BLOBS]])
            self._compact[least] = rows
        return self._compact[least]

    def measure(self, chosen: Integers | None = None) -> list[Detection]:
        """The lights of all pieces, or of some by their rows, without what is other pieces'."""
        chosen = np.arange(len(self.stats)) if chosen is None else chosen
        x, y, width, height, area = self.stats[chosen].T
        windows = self._meter.windows(x - 1, x + width, y - 1, y + height)
        # The window around a thin slanting line would be far larger than the line.
        compact = (width + 2) * (height + 2) <= 4 * area + 64
        looked = [windows[i] if small else NO_WINDOW for i, small in enumerate(compact.tolist())]
        alone = self._meter.measure_alone(looked, area.tolist())
        crowded = [row for row, spot in enumerate(alone) if spot is None]
        around, numbers = [windows[row] for row in crowded], self._numbers[chosen[crowded]]
        patches = [self._cut(*pair) for pair in zip(around, numbers.tolist(), strict=True)]
        own = iter(self._meter.measure_own(patches, around))
        return [spot or next(own) for spot in alone]

    def _cut(self, window: Window, number: int) -> Pixels:
        """The intensity of one piece in a window, 0 elsewhere."""
        x0, x1, y0, y1 = window
        labels = self._labels[self._where[y0 : y1 + 1], x0 : x1 + 1]
        return np.asarray(self._meter.cut(window) * (labels == number))


def label(mask: Mask) -> tuple[NDArray[np.int32], Integers, NDArray[np.int32]]:
    """The number of each pixel's 8-connected piece, 0 where it is dark, and the pieces' stats.

    Only the rows with a bright pixel are labelled, of which there are few: the numbers of the
    mask's row y are those in ``where[y]``. The stats are those of
    `cv2.connectedComponentsWithStats`, (1 + pieces, 5), except for the first row, that of the dark.
    """
    height = len(mask)
    bright = cv2.reduce(mask, 1, cv2.REDUCE_SUM, dtype=cv2.CV_32S).ravel() > 0
    # In pairs, as OpenCV numbers the pieces by the pair of rows in which they begin, each with the
    # next one: a dark pair keeps apart what is none of one piece.
    pairs = np.logical_or.reduceat(bright, np.arange(0, height, 2))
    pairs[1:] |= pairs[:-1].copy()
    is_labelled = np.repeat(pairs, 2)[:height]
    # One dark row stands for all others.
    rows = np.concatenate((np.flatnonzero(is_labelled), np.flatnonzero(~is_labelled)[:1]))
    _, numbers, stats, _ = cv2.connectedComponentsWithStats(mask[rows], connectivity=8)
    stats[1:, cv2.CC_STAT_TOP] = rows[stats[1:, cv2.CC_STAT_TOP]]
    where = np.full(height, len(rows) - 1, np.intp)
    where[rows] = np.arange(len(rows))
    return np.asarray(numbers, np.int32), where, np.asarray(stats, np.int32)


MAX_CLUSTERS = 1000
DARK_EDGE = 4.0  # px around a light that belong to its window


def group_mask(mask: Mask, grouping_distance: int) -> NDArray[np.float64]:
    """Group bright pixels around seeds: the first pixel left, with all within T of it.

    The scan goes column by column, each from the top. A group is every pixel left with x in
    [x_seed, x_seed + T] and |y - y_seed| <= T, bounds included, where T is the grouping distance,
    px. A light wider than T falls into several groups; lights closer than T share one.

    Returns:
        (n, 3): the mean of each group's pixels, x and y (px), and its area (px), in scan order.

    Raises:
        GroupingError: more than 5 % of the frame is bright, or there are more than `MAX_CLUSTERS`.
    """
    if problem := brightness_problem(mask):
        raise GroupingError(problem)
    if not cv2.countNonZero(mask):
        return np.empty((0, 3))
    reach = min(grouping_distance, max(mask.shape))
    # Column after column, as the scan goes: the search for the next seed is one over bytes. With
    # a dark edge all groups' windows are of one size.
    ones = cv2.transpose(cv2.threshold(mask, 0, 1, cv2.THRESH_BINARY)[1])
    framed = cv2.copyMakeBorder(ones, 0, reach, reach, reach, cv2.BORDER_CONSTANT, value=0)
    bright = bytearray(framed)
    height = framed.shape[1]
    left = np.frombuffer(bright, np.uint8).reshape(-1, height)
    seeds: list[int] = []
    groups: list[bytes] = []
    seed = bright.find(1)
    while seed >= 0:
        if len(seeds) == MAX_CLUSTERS:
            raise GroupingError(f'more than {MAX_CLUSTERS} clusters above the threshold')
        column, row = divmod(seed, height)
        group = left[column : column + reach + 1, row - reach : row + reach + 1]
        seeds.append(seed)
        groups.append(group.tobytes())
        group.fill(0)
        seed = bright.find(1, seed)
    pixels = np.frombuffer(b''.join(groups), np.uint8).reshape(len(groups), -1)
    powers = _group_powers(reach)
    area, across, down = pixels.astype(powers.dtype).dot(powers).astype(np.float64).T
    columns, rows = np.divmod(seeds, height)
    # The sums are whole numbers, so that the means are exactly those of the pixels.
    x, y = (columns * area + across) / area, ((rows - 2 * reach) * area + down) / area
    return np.stack((x, y, area), axis=-1)


@lru_cache(maxsize=8)
def _group_powers(reach: int) -> NDArray[np.floating]:
    """(pixels, 3): 1, x, y in a group's window, px; of a type that holds any sum exactly."""
    x, y = np.indices((reach + 1, 2 * reach + 1)).reshape(2, -1)
    powers = np.stack((np.ones(len(x)), x, y), axis=-1)
    return powers.astype(np.float32 if powers.sum(axis=0).max() < 2**24 else np.float64)


def find_lights(image: Image, parameters: MarkerTrackerParameters) -> Array:
    """Every light of the frame within the area limits, (n, 3): x and y (px), area (px).

    In scan order. A light with others around it keeps its binary centroid.

    Raises:
        GroupingError: the frame is too bright or too noisy to hold markers.
    """
    gray = image.gray()
    mask = threshold(gray, parameters.threshold)
    if parameters.by_components:
        blobs = Blobs(gray, parameters, mask)
        if blobs.crowd:
            raise GroupingError(blobs.crowd)
        spots = sorted(blobs.measure())
        if not spots and (problem := brightness_problem(mask)):
            raise GroupingError(problem)
        return np.array([spot[:3] for spot in spots], np.float64).reshape(-1, 3)
    groups = group_mask(mask, parameters.grouping_distance)
    lights: Array = groups[area_fits(groups[:, 2], parameters)]
    if not parameters.weighted or not 0 < len(lights) <= MAX_BLOBS:
        return lights
    x, y, area = lights.T
    reach = np.sqrt(area / math.pi) + DARK_EDGE
    meter = CentroidMeter(gray, parameters.threshold, weighted=True)
    windows = meter.windows(*np.round((x - reach, x + reach, y - reach, y + reach)))
    alone = meter.measure_alone(windows, area.tolist())
    rows = [spot[:3] if spot else row for spot, row in zip(alone, lights.tolist(), strict=True)]
    return np.array(rows, np.float64)


class Lens:
    """From the pixels of an image to those of a camera without distortion, and back."""

    def __init__(self, size: tuple[int, int], camera: CameraModel | None = None) -> None:
        """For images of a size (px); a camera that is not calibrated for them is not used."""
        if camera is not None and camera.objection(*size):
            camera = None
        self._camera = camera
        # px, of that camera; None where the pixels are taken as they are.
        self.focal: float | None = None
        self.centre: Array = np.array((0.5 * (size[0] - 1), 0.5 * (size[1] - 1)))  # (2,), px
        self.half_diagonal = math.hypot(*size) / 2
        self.size = size  # px, of the image
        if camera is not None:
            matrix = camera.matrix
            self.focal = math.sqrt(matrix[0, 0] * matrix[1, 1])
            self.centre = matrix[:2, 2].copy()
            if camera.is_straight and matrix[0, 0] == matrix[1, 1]:
                # Its pixels are those of a camera without distortion.
                self._camera = None

    def straightened(self, spots: Iterable[Detection]) -> list[Point]:
        """Where detections would be without distortion, px."""
        places = [spot[:2] for spot in spots]
        if self._camera is None or self.focal is None or not places:
            return places
        ideal = self._camera.undistort(np.array(places)) * self.focal + self.centre
        return [(x, y) for x, y in ideal.tolist()]

    def to_image(self, ideal: Array) -> Array:
        """(n, 2) px without distortion as px of the image."""
        camera = self._camera
        if camera is None or self.focal is None or not len(ideal):
            return ideal
        return camera.seen_at((ideal - self.centre) / self.focal)


ROUND = 1.4  # Spread of a spot that may be a light
MIN_SHARE = 0.2
"""Of the n-th largest spot's area: what is smaller is no marker of a body with n of them."""


class Light(NamedTuple):
    """A light: x and y (px) where a lens without distortion would show it, and as it is seen."""

    x: float
    y: float
    seen: Detection


class Frame:
    """One image of a time (s), and how its lights are measured; of a size, px."""

    def __init__(
        self,
        image: Image,
        time: float,
        number: int,
        parameters: MarkerTrackerParameters,
        lens: Lens,
    ) -> None:
        self.image, self.time, self.number, self.parameters = image, time, number, parameters
        self.meter = CentroidMeter(image, parameters.threshold, parameters.weighted)
        self.size = self.meter.size
        self._lens = lens
        self._lights: dict[float, list[Light]] = {}

    @cached_property
    def blobs(self) -> Blobs:
        """Its bright pieces, however often they are looked at."""
        return Blobs(self.image.gray(), self.parameters)

    def lights(self, least: float = 0.0) -> list[Light]:
        """Those of its bright pieces that may be lights, of an area (px) at least, measured.

        However often they are asked for.
        """
        if least not in self._lights:
            spots = self.blobs.measure(self.blobs.may_be_lights(least))
            places = self._lens.straightened(spots)
            self._lights[least] = [
                Light(*place, spot) for place, spot in zip(places, spots, strict=True)
            ]
        return self._lights[least]


def by_size(lights: Sequence[Light]) -> list[Light]:
    """The round ones, the largest first."""
    spots = [light for light in lights if light.seen.spread <= ROUND]
    return sorted(spots, key=lambda light: -light.seen.area)


def candidates(spots: Sequence[Light], count: int) -> Sequence[Light]:
    """Of lights by size those that could be among a body's ``count`` markers."""
    if len(spots) < count:
        return spots
    least = MIN_SHARE * spots[count - 1].seen.area
    return [light for light in spots if light.seen.area >= least]


def coordinates(lights: Sequence[Light]) -> Array:
    """(n, 2), px without distortion."""
    return np.array([light[:2] for light in lights], np.float64).reshape(-1, 2)


def places_of(found: Mapping[int, Light]) -> dict[int, Point]:
    """Where named lights are, px without distortion."""
    return {marker: (light.x, light.y) for marker, light in found.items()}


def are_close(a: Light, b: Light, distance: float) -> bool:
    """Whether two lights lie less than a distance (px) apart."""
    return (a.x - b.x) ** 2 + (a.y - b.y) ** 2 < distance * distance


def apart_from(lights: Sequence[Light], these: Collection[Light]) -> list[Light]:
    """The lights that are none of these, as measured otherwise."""
    radii = np.array([light.seen.radius for light in these])
    away = np.square(coordinates(lights)[:, None] - coordinates([*these])).sum(axis=-1)
    return [*compress(lights, (away >= radii * radii).all(axis=1))]
