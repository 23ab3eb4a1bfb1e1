"""Pairs of straight edges that meet near the horizon, moved to where the evidence is."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.approach.evidence import CHANNELS, COARSE, UNIT, EvidenceMap
from mvuav_ros.vision.approach.numeric import in_common
from mvuav_ros.vision.approach.tuning import SEARCH

Strips = NDArray[np.float64]
"""(n, 6): vanishing point's x and y, columns by which the left and the right edge move to the right
per row below it, and rows from it to the far and to the near end; px on the levelled image."""

_WEIGHTS = np.array(SEARCH.weights, np.float32)
_ROUGH_WEIGHTS = np.rint(5 * _WEIGHTS).astype(np.int16)
_FIRST, _SECOND = np.triu_indices(SEARCH.edges_kept, 1)


class Fan:
    """All edges through one vanishing point that reach down to about one depth."""

    def __init__(self, depth: int, width: int) -> None:
        """Lay out where to look; depth of the near end and width of the images are in px."""
        self.depth = depth
        rows = np.geomspace(SEARCH.first_row * depth, depth, SEARCH.samples)
        self.rows = np.unique(np.rint(rows)).astype(int)
        step = max(1.25, depth / 16) / depth
        count = int(SEARCH.steepest / step)
        self.slopes = (np.arange(-count, count + 1) * step).astype(np.float32)
        apart = max(2, round(0.14 * depth))
        self.points = np.arange(-int(0.1 * width), int(1.1 * width), apart)
        columns = np.rint(self.points[:, None, None] + self.slopes[:, None] * self.rows)
        self.inside = ((columns >= 1) & (columns < width - 1)).all(axis=2)
        columns = np.clip(columns, 0, width - 1).astype(int).transpose(2, 0, 1)
        index = columns + (self.rows * width)[:, None, None]
        self._index = index.reshape(self.rows.size, -1).astype(np.int32)
        self._start = (np.arange(self.points.size) * self.slopes.size)[:, None]
        self._width = width

    def find(
        self,
        left: NDArray[np.int32],
        right: NDArray[np.int32],
        height: int,
        row: float,
    ) -> NDArray[np.float64]:
        """The best strips whose vanishing points lie on a row.

        Args:
            left: packed evidence of left edges.
            right: likewise of right edges.
            height: of the map, px.
            row: of the vanishing points.

        Returns:
            (m, 7): as `Strips`, and the score: evidence per row, in textures.
        """
        top = round(row)
        if top + self.rows[0] < 0 or top + self.rows[-1] >= height:
            return np.empty((0, 7))
        index = self._index + np.int32(top * self._width)
        edges = left.take(index)
        kept = self._strongest(edges)
        place = self._start + kept
        lefts = edges.take(place[:, _FIRST].ravel(), axis=1)
        rights = right.take(index.take(place[:, _SECOND].ravel(), axis=1))
        score = self._pair(lefts, rights).reshape(self.points.size, -1)
        slopes, inside = self.slopes[kept], self.inside.ravel().take(place)
        first, second = slopes[:, _FIRST], slopes[:, _SECOND]
        width, middle = second - first, 0.5 * (first + second)
        possible = (width * self.depth >= SEARCH.narrowest) & (
            width <= (SEARCH.widest if top >= 0 else SEARCH.widest_above)
        )
        possible &= np.abs(middle) <= SEARCH.farthest_aside * np.maximum(width, 0.15)
        possible &= inside[:, _FIRST] & inside[:, _SECOND]
        score[~possible] = 0.0
        return self._best(score, first, second, top)

    def _strongest(self, edges: NDArray[np.int32]) -> NDArray[np.intp]:
        total = _added(edges)
        single = np.abs(total).reshape(-1, CHANNELS).astype(np.int16) @ _ROUGH_WEIGHTS
        single = single.reshape(self.points.size, self.slopes.size)
        single[~self.inside] = 0
        kept = np.argpartition(-single, SEARCH.edges_kept, axis=1)[:, : SEARCH.edges_kept]
        kept.sort(axis=1)
        return kept

    def _pair(self, lefts: NDArray[np.int32], rights: NDArray[np.int32]) -> NDArray[np.float32]:
        """What both edges have in common, with the same sign in every row."""
        common = in_common(lefts.view(np.int8), rights.view(np.int8))
        total = np.abs(_added(common.view(np.int32))).reshape(-1, CHANNELS)
        return (total.astype(np.float32) @ _WEIGHTS) * (COARSE / UNIT / self.rows.size)

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
    total: NDArray[np.int8] = np.add.reduce(values, axis=0, dtype=np.int8)
    return total


@lru_cache(maxsize=64)
def fan(depth: int, width: int) -> Fan:
    """The fan for near ends at a depth on images of a width, px."""
    return Fan(depth, width)


def fan_jobs(first: float, last: float, level: int) -> Iterator[tuple[int, list[float]]]:
    """Depths, and rows between two of the image, of vanishing points to search on a level.

    Level 0 is the finest; on the others only depths that the finer one lacks are searched.
    """
    for depth in SEARCH.depths if level == 0 else SEARCH.depths[2:]:
        step = 0.4 * depth
        rows = np.arange(first, last + 0.5 * step, step)
        # The compared part of a strip must be in the image.
        yield depth, rows[rows > 0.5 - SEARCH.first_row * depth].tolist()


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


_FAR_STEPS = np.array([-1.5, -0.75, 0.0, 0.75, 1.5])
_NEAR_STEPS = np.array([-2.0, -1.0, 0.0, 1.0, 2.0])
_ALIGN_WEIGHTS = np.array(SEARCH.weights)


def align(image: EvidenceMap, strips: Strips) -> tuple[Strips, NDArray[np.bool_]]:
    """Move both edges by turns to the most evidence that they have in common.

    They are moved at `TUNING.first_row` of the near end's depth and at the near end.

    Returns:
        The strips, and which of them are still strips that can be measured.
    """
    x, y, near = strips[:, 0:1], strips[:, 1:2], strips[:, 5:6]
    rows = _rows(y, near)
    depth = rows - y
    share = (depth / near - SEARCH.first_row) / (1.0 - SEARCH.first_row)
    moves = _FAR_STEPS[:, None, None] * (1 - share) + _NEAR_STEPS[:, None, None, None] * share
    moves = moves.reshape(-1, len(strips), SEARCH.align_rows)
    edges = []
    for column, mirror in ((2, 1), (3, -1)):
        columns = x + strips[:, column : column + 1] * depth + moves
        edges.append(_signed(image, rows, columns, mirror))
    return _moved(strips, _choose(edges))


def around(image: EvidenceMap, strip: NDArray[np.float64], most: int) -> Strips:
    """Strips around, within and beside one, it first, then those with the most evidence."""
    x, y, left, right, _, near = (float(value) for value in strip)
    width = (right - left) * near
    step = max(SEARCH.min_around_shift, SEARCH.around_shift * width)
    shifts = np.arange(-SEARCH.around_shifts, SEARCH.around_shifts + 1) * step
    rows = _rows(y, near)
    lefts, rights = left + shifts / near, right + shifts / near
    one, other = (
        _signed(image, rows, x + slopes[:, None] * (rows - y), mirror)
        for slopes, mirror in ((lefts, 1), (rights, -1))
    )
    total = in_common(one[:, None], other[None]).sum(axis=2, dtype=np.int32)
    score = np.abs(total) @ _ALIGN_WEIGHTS
    widths = (rights[None] - lefts[:, None]) * near
    score[
        (widths < max(SEARCH.min_around_width * width, 2.0))
        | (widths > SEARCH.max_around_width * width)
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
    """Rows of the map in which strips are compared."""
    share = np.linspace(SEARCH.first_row, 1.0, SEARCH.align_rows)
    rows: NDArray[np.intp] = np.rint(y + share * near).astype(np.intp)
    return rows


def _signed(
    image: EvidenceMap, rows: NDArray[np.intp], columns: NDArray[Any], mirror: int
) -> NDArray[np.int16]:
    """Evidence at places, of which a right edge has the signs turned; paint has none."""
    signed = image.at(rows, columns)[0].astype(np.int16)
    signed[..., :3] *= mirror
    return signed


def _choose(edges: list[NDArray[np.int16]]) -> list[NDArray[np.intp]]:
    """For either edge the number of the move that is best for both."""
    count = edges[0].shape[1]
    cost = SEARCH.align_cost * (np.abs(_NEAR_STEPS)[:, None] + np.abs(_FAR_STEPS)).reshape(-1, 1)
    middle = cost.size // 2
    chosen = [np.full(count, middle), np.full(count, middle)]
    number = np.arange(count)
    for _ in range(SEARCH.align_rounds):
        for side in (0, 1):
            other = edges[1 - side][chosen[1 - side], number]
            total = np.abs(in_common(edges[side], other).sum(axis=2, dtype=np.int32))
            score = total @ _ALIGN_WEIGHTS / (SEARCH.align_rows * UNIT) - cost
            chosen[side] = score.argmax(axis=0)
    return chosen


def _moved(strips: Strips, chosen: list[NDArray[np.intp]]) -> tuple[Strips, NDArray[np.bool_]]:
    x, y, *_, near = strips.T
    places = []
    for column, number in zip((2, 3), chosen, strict=True):
        slope = strips[:, column]
        far_move = _FAR_STEPS[number % _FAR_STEPS.size]
        near_move = _NEAR_STEPS[number // _FAR_STEPS.size]
        at_far = x + slope * SEARCH.first_row * near + far_move
        places.append((at_far, x + slope * near + near_move))
    length = (1.0 - SEARCH.first_row) * near
    left, right = ((at_near - at_far) / length for at_far, at_near in places)
    depth = (places[1][1] - places[0][1]) / np.maximum(right - left, 0.05)
    moved = strips.copy()
    moved[:, 0] = places[0][1] - left * depth
    moved[:, 1] = y + near - depth
    moved[:, 2], moved[:, 3], moved[:, 5] = left, right, depth
    valid = (
        (right - left > SEARCH.min_slope_gap)
        & (depth > SEARCH.min_depth)
        & (depth < SEARCH.max_depth)
    )
    return moved, valid
