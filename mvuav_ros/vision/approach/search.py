"""The search: pairs of straight edges that meet near the horizon, aligned and described."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.approach.appearance import FEATURES, WEIGHTS, Scene, describe, profile
from mvuav_ros.vision.approach.attitude import Box, Derotation
from mvuav_ros.vision.approach.evidence import (
    CHANNELS,
    COARSE,
    MIRROR,
    UNIT,
    EvidenceMap,
    gather_evidence,
    in_common,
    shrunk_by,
)
from mvuav_ros.vision.approach.strip_edges import Strip, Strips
from mvuav_ros.vision.approach.strips import columns_at, level_of, strips_through
from mvuav_ros.vision.approach.tuning import SEARCH, STRIP
from mvuav_ros.vision.point_operations import intensity

_ROUGH_WEIGHTS = np.rint(5 * WEIGHTS).astype(np.int16)
_FIRST, _SECOND = np.triu_indices(SEARCH.edges_kept, 1)


BLANK = max(SEARCH.depths)
"""Rows without evidence that are put above an image: strips may meet there."""


class Fan:
    """All edges through one vanishing point that reach down to about one depth."""

    def __init__(self, depth: int, width: int) -> None:
        """Lay out where to look; depth of the near end and width of the images are in px."""
        self.depth = depth
        rows = np.geomspace(SEARCH.first_row * depth, depth, SEARCH.samples)
        self.rows = np.unique(np.rint(rows).astype(int))
        step = max(1.25, depth / 16) / depth
        count = int(SEARCH.steepest / step)
        self.slopes = (np.arange(-count, count + 1) * step).astype(np.float32)
        apart = max(2, round(0.14 * depth))
        self.points = np.arange(-int(0.1 * width), int(1.1 * width), apart)
        columns = np.rint(self.points[:, None, None] + self.slopes[:, None] * self.rows)
        inside = (columns >= 1) & (columns < width - 1)
        self.inside = inside.mean(axis=2) >= SEARCH.min_inside
        columns = np.clip(columns, 0, width - 1).astype(int).transpose(2, 0, 1)
        index = columns + ((self.rows - self.rows[0]) * width)[:, None, None]
        self._index = index.reshape(self.rows.size, -1).astype(np.int32)
        self._start = (np.arange(self.points.size) * self.slopes.size)[:, None]
        self._width = width

    def find(self, packed: NDArray[np.int32], row: float) -> NDArray[np.float64]:
        """(m, 7) the best strips whose vanishing points lie on a row, and their scores.

        A score is evidence per row, in textures. It is packed as `EvidenceMap.packed`, below
        `BLANK` rows.
        """
        top = round(row)
        first, last = top + BLANK + self.rows[0], top + BLANK + self.rows[-1]
        if first < 0 or last * self._width >= packed.size:
            return np.empty((0, 7))
        edges = packed[first * self._width :].take(self._index)
        kept = self._strongest(edges)
        place = self._start + kept
        score = self._pair(edges.take(place.T, axis=1))
        slopes, inside = self.slopes[kept], self.inside.ravel().take(place)
        first, second = slopes.take(_FIRST, axis=1), slopes.take(_SECOND, axis=1)
        width, middle = second - first, 0.5 * (first + second)
        possible = (width * self.depth >= SEARCH.narrowest) & (width <= _widest(top))
        possible &= np.abs(middle) <= SEARCH.farthest_aside * np.maximum(width, 0.15)
        possible &= inside.take(_FIRST, axis=1) & inside.take(_SECOND, axis=1)
        score *= possible
        return self._best(score, first, second, top)

    def _strongest(self, edges: NDArray[np.int32]) -> NDArray[np.intp]:
        total = _added(edges)
        single = np.abs(total).reshape(-1, CHANNELS).astype(np.int16) @ _ROUGH_WEIGHTS
        single = single.reshape(self.points.size, self.slopes.size)
        single[~self.inside] = 0
        kept = np.argpartition(-single, SEARCH.edges_kept, axis=1)[:, : SEARCH.edges_kept]
        kept.sort(axis=1)
        return kept

    def _pair(self, edges: NDArray[np.int32]) -> NDArray[np.float32]:
        """(points, pairs) what edges (rows, edges, points) have in common by pairs.

        It counts as far as it has the same sign in every row.
        """
        mirrored = (edges.view(np.int8).reshape(-1, CHANNELS) * MIRROR).view(np.int32)
        lefts = edges.take(_FIRST, axis=1)
        rights = mirrored.reshape(edges.shape).take(_SECOND, axis=1)
        common = in_common(lefts.view(np.int8), rights.view(np.int8))
        total = np.abs(_added(common.view(np.int32))).reshape(-1, CHANNELS)
        score = (total.astype(np.float32) @ WEIGHTS) * (COARSE / UNIT / self.rows.size)
        return np.ascontiguousarray(score.reshape(-1, self.points.size).T)

    def _best(
        self, score: NDArray[Any], first: NDArray[Any], second: NDArray[Any], top: int
    ) -> NDArray[np.float64]:
        found = []
        middles = self.points[:, None] + 0.5 * (first + second) * self.depth
        reach = np.maximum(2.0, 0.35 * (second - first) * self.depth)
        for _ in range(SEARCH.max_pairs):
            point, pair = divmod(int(score.argmax()), score.shape[1])
            value = float(score[point, pair])
            if value <= SEARCH.min_score:
                break
            left, right = float(first[point, pair]), float(second[point, pair])
            far = SEARCH.first_row * self.depth
            found.append((self.points[point], top, left, right, far, self.depth, value))
            # Strips whose near ends have nearly the same middle are the same strip.
            score[np.abs(middles - middles[point, pair]) < reach[point, pair]] = 0.0
        return np.array(found, np.float64).reshape(-1, 7)


def _added(packed: NDArray[np.int32]) -> NDArray[np.int8]:
    """Sum over the rows of all channels; eight of the coarse numbers fit into a byte."""
    values = packed.view(np.int8).reshape(packed.shape[0], -1)
    return np.asarray(np.add.reduce(values, axis=0, dtype=np.int8))


_fan = lru_cache(maxsize=64)(Fan)

Job = tuple[int, list[float]]
"""What is searched at a time: a depth, and rows of vanishing points."""


def fan_jobs(first: float, last: float, level: int) -> Iterator[Job]:
    """Depths, and rows between two of the image, of vanishing points to search on a level.

    Level 0 is the finest; on the others only depths that the finer one lacks are searched.
    """
    for depth in SEARCH.depths if level == 0 else SEARCH.depths[2:]:
        step = 0.4 * depth
        # Much of the compared part of a strip must be in the image.
        top = max(first, 0.5 - SEARCH.last_first_row * depth)
        # NumPy refuses the rows down to where nothing is, of a horizon far above the picture.
        rows = np.arange(top, max(top, last + 0.5 * step), step)
        yield depth, rows.tolist()


def distinct(found: NDArray[np.float64], most: int) -> NDArray[np.float64]:
    """The best of strips (n, 7), as `Fan.find` returns them, that are nearly the same."""
    found = found[np.argsort(-found[:, 6], kind='stable')]
    x, y, left, right, _, depth, _ = found.T
    width, middle, end = (right - left) * depth, x + 0.5 * (left + right) * depth, y + depth
    alive = np.ones(len(found), bool)
    kept = []
    for index in range(len(found)):
        if not alive[index]:
            continue
        kept.append(index)
        if len(kept) == most:
            break
        share = width / width[index]
        alive &= ~(
            (np.abs(middle - middle[index]) < 0.3 * width[index])
            & (np.abs(end - end[index]) < 0.3 * depth[index] + 1)
            & (share > 0.7)
            & (share < 1.4)
        )
    return found[kept]


_NEAR, _FAR = np.meshgrid(np.linspace(-2.0, 2.0, 5), np.linspace(-1.5, 1.5, 5), indexing='ij')
_MOVES = np.stack([_FAR.ravel(), _NEAR.ravel()], axis=1)
"""Px by which an edge is moved at `SEARCH.first_row` of its near end's depth, and at that end."""
_ALIGN_WEIGHTS = np.array(SEARCH.weights)


def align(image: EvidenceMap, strips: Strips) -> tuple[Strips, NDArray[np.bool_]]:
    """Move both edges by turns to the most evidence that they have in common.

    Returns:
        The strips, and which of them are still strips that can be measured.
    """
    x, y, near = strips[:, 0:1], strips[:, 1:2], strips[:, 5:6]
    rows = _rows(y, near)
    depth = rows - y
    share = (depth / near - SEARCH.first_row) / (1.0 - SEARCH.first_row)
    at_far, at_near = _MOVES.T[:, :, None, None]
    columns = x + strips.T[2:4, None, :, None] * depth + (at_far * (1 - share) + at_near * share)
    moves = _MOVES[np.array(_choose(_signed(image, rows, columns)))].swapaxes(0, 1)
    ends = y + near * (SEARCH.first_row, 1.0)
    moved = strips_through(columns_at(strips, ends) + moves, ends, y + strips[:, 4:6])
    moved[:, 4] = strips[:, 4]
    gap, deep = moved[:, 3] - moved[:, 2], moved[:, 5]
    valid = (gap > SEARCH.min_slope_gap) & (deep > SEARCH.min_depth)
    return moved, valid & (deep < np.maximum(SEARCH.max_depth, SEARCH.max_deeper * near[:, 0]))


def around(image: EvidenceMap, strip: NDArray[np.float64], most: int, widest: float) -> Strips:
    """Strips around, within and beside one, it first, then those with the most evidence.

    They are not wider than the widest (over camera height), or than that one.
    """
    x, y, left, right, _, near = (float(value) for value in strip)
    width = (right - left) * near
    step = max(SEARCH.min_around_shift, SEARCH.around_shift * width)
    shifts = np.arange(-SEARCH.around_shifts, SEARCH.around_shifts + 1) * step
    rows = _rows(y, near)
    lefts, rights = slopes = np.array([[left], [right]]) + shifts / near
    one, other = _signed(image, rows, x + slopes[..., None] * (rows - y))
    score = _agreement(one[:, :, None], other[:, None])
    widths = (rights[None] - lefts[:, None]) * near
    score[
        (widths < max(SEARCH.min_around_width * width, 2.0))
        | (widths > min(SEARCH.max_around_width * width, max(widest * near, width)))
    ] = -1.0
    found = [strip]
    while len(found) < most:
        first, second = divmod(int(score.argmax()), score.shape[1])
        if score[first, second] <= 0:
            break
        found.append(np.array([x, y, lefts[first], rights[second], *strip[4:]]))
        score[max(0, first - 1) : first + 2, max(0, second - 1) : second + 2] = -1.0
    return np.stack(found)


def _rows(y: Any, near: Any) -> NDArray[np.intp]:
    share = np.linspace(SEARCH.first_row, 1.0, SEARCH.align_rows)
    return np.asarray(np.rint(y + share * near).astype(np.intp))


def _signed(image: EvidenceMap, rows: NDArray[np.intp], columns: NDArray[Any]) -> NDArray[np.int8]:
    """(2, rows, ..., 4) evidence of edges at columns (2, ..., rows)."""
    return np.ascontiguousarray(np.moveaxis(image.at(rows, columns)[0], -2, 1))


def _agreement(one: NDArray[np.int8], other: NDArray[np.int8]) -> NDArray[np.float64]:
    """What edges (rows, ..., 4) have in common over all rows."""
    total = np.add.reduce(in_common(one, other), axis=0, dtype=np.int16)
    return np.asarray(np.abs(total) @ _ALIGN_WEIGHTS)


def _choose(edges: NDArray[np.int8]) -> list[NDArray[np.intp]]:
    """For either edge (rows, moves, n, 4) the number of the move that is best for both."""
    count = edges.shape[3]
    cost = SEARCH.align_cost * np.abs(_MOVES).sum(axis=1)[:, None]
    chosen = [np.full(count, cost.size // 2)] * 2
    number = np.arange(count)
    for _ in range(SEARCH.align_rounds):
        for side in (0, 1):
            other = edges[1 - side][:, chosen[1 - side], number]
            total = _agreement(edges[side], other[:, None])
            score = total / (SEARCH.align_rows * UNIT) - cost
            chosen[side] = score.argmax(axis=0)
    return chosen


def _widest(y: Any) -> NDArray[np.float64]:
    """Width over camera height of what is searched, by the rows of vanishing points."""
    return np.where(y >= 0, SEARCH.widest, SEARCH.widest_above)


class Candidates(NamedTuple):
    """Strips (n, 6) on the levelled working image, and their (n, features) as in `FEATURES`."""

    strips: Strips
    features: NDArray[np.float64]


NO_CANDIDATES = Candidates(np.empty((0, 6)), np.empty((0, len(FEATURES))))


class LevelledImage:
    """A levelled working image and what is known of it, each part computed when it is asked for."""

    def __init__(
        self,
        pixels: NDArray[Any],
        level: Derotation | None = None,
        scene: Scene | None = None,
        overlaid: NDArray[np.uint8] | None = None,
    ) -> None:
        """Begin with pixels of 256 grey levels, turned by a level.

        The scene of a frame just before, and where something is laid over the view (not 0), may be
        known.
        """
        height, width = self.size = pixels.shape[:2]
        self._given = pixels
        self.level = level or Derotation(width, height, 1, 0.0)
        self.whole_scene = scene  # at full scale, once it was asked for
        self._overlaid = overlaid

    def at_slope(self, slope: float) -> LevelledImage:
        """The same image, levelled by another angle, rad."""
        if slope == self.level.slope:
            return self
        level = replace(self.level, slope=slope)
        return LevelledImage(self._given, level, overlaid=self._overlaid)

    def scene(self) -> Scene:
        """What the image is like."""
        if self.whole_scene is None:
            gray = intensity(self._given[::4, ::4])
            self.whole_scene = Scene(self.size[1], *np.percentile(gray, (10, 95)).tolist())
        return self.whole_scene

    def search(self, level: int, jobs: list[Job], most: int) -> Candidates:
        """The best runways that a level of the pyramid shows, aligned and described."""
        height, width = self.size[0] >> level, self.size[1] >> level
        # Only the rows that their strips lie on.
        ends = [(rows[0], rows[-1] + STRIP.depth_below * depth) for depth, rows in jobs if rows]
        if not ends:
            return NO_CANDIDATES
        top = max(0, math.floor(min(first for first, _ in ends) - STRIP.margin_above))
        bottom = min(height, math.ceil(max(last for _, last in ends)) + 4)
        if bottom - top < SEARCH.min_part:
            return NO_CANDIDATES
        image = self._part(level, (0, top, width, bottom))
        packed = image.packed(BLANK)
        found = [_fan(depth, width).find(packed, row - top) for depth, rows in jobs for row in rows]
        best = distinct(np.concatenate([np.empty((0, 7)), *found]), most)
        aligned, valid = align(image, best[:, :6])
        # What looks wider from the first frame on is seen from a car.
        valid &= aligned[:, 3] - aligned[:, 2] <= _widest(aligned[:, 1] + top)
        if not valid.any():
            return NO_CANDIDATES
        features, strips = describe(image, aligned[valid], self.scene(), level)
        strips[:, 1] += top
        return Candidates(_scaled(strips, 2**level), features)

    def _part(self, level: int, box: Box) -> EvidenceMap:
        left, top, right, bottom = (side << level for side in box)
        pixels = self.level.turned(self._given, (left, top, right, bottom))
        for _ in range(level):
            pixels = shrunk_by(pixels, 2)
        if self._overlaid is None:
            return gather_evidence(pixels)
        overlaid = self.level.turned(self._overlaid, (left, top, right, bottom))
        return gather_evidence(pixels, shrunk_by(overlaid, 2**level) > 0)

    def part_around(self, strips: Strips, level: int | None = None) -> Part | None:
        """The part of a level of the pyramid around strips, if it is large enough.

        It is on the first one's level, unless another one is given.
        """
        level = level_of(float(strips[0, 5])) if level is None else level
        known = _scaled(strips, 0.5**level)
        x, y, left, right, _, near = known.T
        near_left, near_right = x + left * near, x + right * near
        margin = max(STRIP.side_margin * (near_right - near_left).max(), STRIP.min_side_margin)
        height, width = (side >> level for side in self.size)
        first = max(0, int(np.minimum(near_left, x).min() - margin))
        end = min(width, int(np.maximum(near_right, x).max() + margin) + 1)
        top = max(0, int(y.min() - STRIP.margin_above))
        bottom = min(height, int((y + STRIP.depth_below * near).max() + 4) + 1)
        if end - first < SEARCH.min_part or bottom - top < SEARCH.min_part:
            return None
        known[:, :2] -= (first, top)
        return Part(self._part(level, (first, top, end, bottom)), known, level, (first, top))

    def refined(self, strips: Strips, level: int) -> Strips:
        """Strips that were aligned on a level of the pyramid, aligned on the finer ones as well."""
        for finer in range(level - 1, SEARCH.finest_aligned - 1, -1):
            part = self.part_around(strips, finer)
            if part is None:
                break
            moved, valid = align(part.map, part.strips)
            strips = np.where(valid[:, None], part.whole(moved), strips)
        return strips


class Part(NamedTuple):
    """A part of an image."""

    map: EvidenceMap
    strips: Strips  # (n, 6) on the map
    level: int  # of the pyramid
    place: tuple[int, int]  # the map's first column and row on the level's image, px

    def whole(self, strips: Strips) -> Strips:
        """Strips of the map as they are on the image."""
        strips = _scaled(strips, 2**self.level)
        strips[:, :2] += np.array(self.place) * 2**self.level
        return strips


def describe_around(
    working: LevelledImage, strip: Strip, expected: Strips, most: int
) -> Candidates | None:
    """Align and describe expected strips, and at most so many others around one of them.

    Those that are strips, the expected ones first; None where none is in the image.
    """
    part = working.part_around(np.concatenate([strip[None], expected]))
    if part is None:
        return None
    widest = float(_widest(strip[1]))
    strips = np.concatenate([part.strips[1:], around(part.map, part.strips[0], most, widest)])
    aligned, valid = align(part.map, strips)
    if not valid.any():
        return None
    scene, first_column = working.scene(), part.place[0]
    features, found = describe(part.map, aligned[valid], scene, part.level, first_column)
    return Candidates(working.refined(part.whole(found), part.level), features)


def ends_of(working: LevelledImage, strip: Strip) -> NDArray[np.float64] | None:
    """(2,) rows from a strip's vanishing point to its far and its near end, if it is in sight."""
    part = working.part_around(strip[None])
    if part is None:
        return None
    return np.asarray(profile(part.map, part.strips).strips[0, 4:6] * 2**part.level)


def _scaled(strips: Strips, factor: float) -> Strips:
    scaled = strips * [1, 1, 1, 1, factor, factor]
    scaled[:, :2] = (strips[:, :2] + 0.5) * factor - 0.5
    return scaled


def find_candidates(image: LevelledImage, *ranges: tuple[float, float]) -> Candidates:
    """All runways whose edges may meet between two rows, px, or others, of a levelled image."""
    parts = []
    for (first, last), level in product(ranges, range(SEARCH.levels)):
        most = SEARCH.candidates if level == 0 else SEARCH.candidates // 2
        jobs = list(fan_jobs(first / 2**level, last / 2**level, level))
        parts.append(image.search(level, jobs, most))
    return Candidates(*(np.concatenate(each) for each in zip(*parts, strict=True)))
