"""Runways in one image: found, aligned, and each with the numbers that speak for or against it."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cached_property
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.approach.appearance import FEATURES, Scene, describe, profile
from mvuav_ros.vision.approach.attitude import Derotation
from mvuav_ros.vision.approach.edges import Strip
from mvuav_ros.vision.approach.evidence import EvidenceMap, gather_evidence, halved
from mvuav_ros.vision.approach.search import Strips, align, around, distinct, fan, fan_jobs
from mvuav_ros.vision.approach.strips import surrounding_box
from mvuav_ros.vision.approach.tuning import SEARCH


class Candidates(NamedTuple):
    """Strips (n, 6) on the levelled working image, and their (n, features) as in `FEATURES`."""

    strips: Strips
    features: NDArray[np.float64]


NO_CANDIDATES = Candidates(np.empty((0, 6)), np.empty((0, len(FEATURES))))


def skyline_of(brightness: NDArray[np.float32]) -> NDArray[np.float64]:
    """The row in each column where it gets darker downwards most; of steps alike the upper one."""
    height = brightness.shape[0]
    narrow = cv2.blur(brightness, (7, 1))
    total = np.zeros((height + 1, brightness.shape[1]), np.float32)
    np.cumsum(narrow, axis=0, out=total[1:])
    middle = total[SEARCH.sky_step : -SEARCH.sky_step]
    step = (
        2 * middle - total[: -2 * SEARCH.sky_step] - total[2 * SEARCH.sky_step :]
    ) / SEARCH.sky_step
    row = step[: int(0.8 * height)].argmax(axis=0).astype(np.float32) + SEARCH.sky_step
    reach = SEARCH.sky_smoothing // 2
    padded = np.pad(row, reach, mode='edge')
    windows = np.lib.stride_tricks.sliding_window_view(padded, SEARCH.sky_smoothing)
    result: NDArray[np.float64] = np.median(windows, axis=1).astype(np.float64)
    return result


class LevelledImage:
    """A levelled working image and what is known of it, each part computed when it is asked for.

    Attributes:
        size: height and width, px.
        level: by which it is turned; not at all if none is given.
    """

    def __init__(
        self,
        pixels: NDArray[Any],
        level: Derotation | None = None,
        scene: Scene | None = None,
        overlaid: NDArray[np.uint8] | None = None,
    ) -> None:
        """Begin with pixels of 256 grey levels.

        The scene of a frame just before, and where something is laid over the view (not 0), may be
        known.
        """
        height, width = self.size = pixels.shape[:2]
        self._given = pixels
        self.level = level or Derotation(width, height, 1, 0.0)
        self._pixels: list[NDArray[Any]] = []
        self._given_scene = scene
        self._overlaid = overlaid
        self._hidden: NDArray[np.bool_] | None = None
        self._maps: dict[int, EvidenceMap] = {}
        self._packed: dict[int, tuple[NDArray[np.int32], NDArray[np.int32]]] = {}

    def at_slope(self, slope: float) -> LevelledImage:
        """The same image, levelled by another angle, rad."""
        if slope == self.level.slope:
            return self
        level = replace(self.level, slope=slope)
        return LevelledImage(self._given, level, overlaid=self._overlaid)

    @property
    def used(self) -> bool:
        """Whether anything was asked of it."""
        return bool(self._pixels)

    def pixels(self, level: int) -> NDArray[Any]:
        """The image of a level of the pyramid."""
        if not self._pixels:
            self._pixels.append(self.level.turned(self._given))
        while len(self._pixels) <= level:
            self._pixels.append(halved(self._pixels[-1]))
        return self._pixels[level]

    def hidden(self, level: int) -> NDArray[np.bool_] | None:
        """Where something is laid over the image of a level of the pyramid."""
        if self._overlaid is None:
            return None
        if self._hidden is None:
            self._hidden = self.level.turned(self._overlaid) > 0
        height, width = self.pixels(level).shape[:2]
        return self._hidden[:: 2**level, :: 2**level][:height, :width]

    def map(self, level: int) -> EvidenceMap:
        """Evidence of a level of the pyramid."""
        if level not in self._maps:
            self._maps[level] = gather_evidence(self.pixels(level), self.hidden(level))
        return self._maps[level]

    @cached_property
    def whole_scene(self) -> Scene:
        """What the image is like, at full scale."""
        if self._given_scene is not None:
            return self._given_scene
        pixels = self.pixels(0)
        gray = pixels if pixels.ndim == 2 else cv2.cvtColor(pixels, cv2.COLOR_BGR2GRAY)
        levels = gray[::4, ::4]
        darkest, brightest = (float(value) for value in np.percentile(levels, (10, 95)))
        skyline = skyline_of(gray.astype(np.float32))
        return Scene(float(gray.shape[1]), darkest, brightest, skyline)

    def scene(self, level: int, column: int = 0, row: int = 0) -> Scene:
        """What the image is like, in the coordinates of a part of a level of the pyramid."""
        scene, factor = self.whole_scene, 2**level
        skyline = (scene.skyline[::factor] + 0.5) / factor - 0.5
        skyline = skyline[min(column, skyline.size - 1) :] - row
        return Scene(scene.width / factor, scene.darkest, scene.brightest, skyline, column)

    def search(self, level: int, depth: int, row: float) -> NDArray[np.float64]:
        """Strips whose vanishing points lie on a row of a level, as `Fan.find`."""
        of = self.map(level)
        if level not in self._packed:
            self._packed[level] = of.packed()
        return fan(depth, of.width).find(*self._packed[level], of.height, row)

    def weigh(self, found: NDArray[np.float64], level: int, most: int) -> Candidates:
        """Align the best of what a search of a level found, and describe what still are strips."""
        best = distinct(found, most)
        if not len(best):
            return NO_CANDIDATES
        aligned, valid = align(self.map(level), best[:, :6])
        if not valid.any():
            return NO_CANDIDATES
        features, strips = describe(self.map(level), aligned[valid], self.scene(level), level)
        return Candidates(_to_finest(strips, level), features)

    def part_around(self, strips: Strips) -> Part | None:
        """The part of the image that is needed to describe strips, on the first one's level."""
        # Of the pyramid, on which a strip's near end is neither too deep nor too shallow.
        level = max(0, math.ceil(math.log2(max(float(strips[0, 5]), 1.0) / SEARCH.max_level_depth)))
        pixels, known = self.pixels(level), _to_level(strips, level)
        box = surrounding_box(known)
        height, width = pixels.shape[:2]
        left, top = max(0, int(box[0])), max(0, int(box[1]))
        right, bottom = min(width, int(box[2]) + 1), min(height, int(box[3]) + 1)
        if right - left < SEARCH.min_part or bottom - top < SEARCH.min_part:
            return None
        known[:, :2] -= (left, top)
        part, hidden = np.s_[top:bottom, left:right], self.hidden(level)
        image = gather_evidence(pixels[part], None if hidden is None else hidden[part])
        return Part(image, known, level, (left, top))

    def share_hidden(self, strip: Strip) -> float:
        """Share of a strip's edges over which something is laid."""
        if self._overlaid is None:
            return 0.0
        x, y, left, right, far, near = (float(value) for value in strip)
        depth = np.linspace(far, near, 12)
        slopes = np.array([[left], [right]])
        frame = replace(self.level, factor=1)
        columns, rows = frame.to_frame(x + slopes * depth, np.broadcast_to(y + depth, (2, 12)))
        height, width = self._overlaid.shape
        inside = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
        if not inside.any():
            return 1.0
        at = rows[inside].astype(np.intp), columns[inside].astype(np.intp)
        return float((self._overlaid[at] > 0).mean())


class Part(NamedTuple):
    """A part of an image.

    Attributes:
        map: its evidence.
        strips: (n, 6) on the map.
        level: of the pyramid.
        place: its first column and row on the level's image, px.
    """

    map: EvidenceMap
    strips: Strips
    level: int
    place: tuple[int, int]


def describe_around(
    working: LevelledImage, strip: Strip, expected: Strips, most: int
) -> tuple[Strips, NDArray[np.float64], NDArray[np.bool_]] | None:
    """Align and describe expected strips, and at most so many others around one of them.

    Returns:
        (m, 6) the strips as they are in the image, the expected ones first, (m, features), and
        (m,) which of them are strips; None where none is in the image.
    """
    part = working.part_around(np.concatenate([strip[None], expected]))
    if part is None:
        return None
    strips = np.concatenate([part.strips[1:], around(part.map, part.strips[0], most)])
    measured, valid = align(part.map, strips)
    if not valid.any():
        return None
    measured[~valid] = strips[~valid]
    features = np.zeros((len(strips), len(FEATURES)))
    scene = working.scene(part.level, *part.place)
    features[valid], measured[valid] = describe(part.map, measured[valid], scene, part.level)
    measured = _to_finest(measured, part.level)
    measured[:, :2] += np.array(part.place) * 2**part.level
    return measured, features, valid


def ends_of(working: LevelledImage, strip: Strip) -> NDArray[np.float64] | None:
    """(2,) rows from a strip's vanishing point to its far and its near end, if it is in sight."""
    part = working.part_around(strip[None])
    if part is None:
        return None
    ends: NDArray[np.float64] = profile(part.map, part.strips).strips[0, 4:6] * 2**part.level
    return ends


def _to_finest(strips: Strips, level: int) -> Strips:
    """Strips of a level's image on the finest one."""
    factor = 2**level
    finest = strips.copy()
    finest[:, :2] = (strips[:, :2] + 0.5) * factor - 0.5
    finest[:, 4:] *= factor
    return finest


def _to_level(strips: Strips, level: int) -> Strips:
    """Strips of the finest image on a level's one."""
    factor = 2**level
    coarse = strips.copy()
    coarse[:, :2] = (strips[:, :2] + 0.5) / factor - 0.5
    coarse[:, 4:] /= factor
    return coarse


def find_candidates(image: LevelledImage, first: float, last: float) -> Candidates:
    """All runways whose edges may meet between two rows of a levelled image, px."""
    parts = [NO_CANDIDATES]
    for level in range(SEARCH.levels):
        factor = 2**level
        found = [
            image.search(level, depth, row)
            for depth, rows in fan_jobs(first / factor, last / factor, level)
            for row in rows
        ]
        if found:
            most = SEARCH.candidates if level == 0 else SEARCH.candidates // 2
            parts.append(image.weigh(np.concatenate(found), level, most))
    return Candidates(*(np.concatenate(each) for each in zip(*parts, strict=True)))
