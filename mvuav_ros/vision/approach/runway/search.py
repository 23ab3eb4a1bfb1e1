"""The first look for runways: pairs of straight edges that meet near the horizon."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.approach.numeric import in_common
from mvuav_ros.vision.approach.runway.evidence import CHANNELS, COARSE, UNIT
from mvuav_ros.vision.approach.runway.tuning import TUNING

Strips = NDArray[np.float64]
"""(n, 6): vanishing point's x and y, columns by which the left and the right edge move to the right
per row below it, and rows from it to the far and to the near end; px on the levelled image."""

_WEIGHTS = np.array(TUNING.weights, np.float32)
_ROUGH_WEIGHTS = np.rint(5 * _WEIGHTS).astype(np.int16)
_LEAST_SCORE, _MOST = 0.5, 4
_FIRST, _SECOND = np.triu_indices(TUNING.edges_kept, 1)


class Fan:
    """All edges through one vanishing point that reach down to about one depth."""

    def __init__(self, depth: int, width: int) -> None:
        """Lay out where to look; depth of the near end and width of the images are in px."""
        self.depth = depth
        rows = np.geomspace(TUNING.first_row * depth, depth, TUNING.samples)
        self.rows = np.unique(np.rint(rows)).astype(int)
        step = max(1.25, depth / 16) / depth
        count = int(TUNING.steepest / step)
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
        possible = (width * self.depth >= TUNING.narrowest) & (
            width <= (TUNING.widest if top >= 0 else TUNING.widest_above)
        )
        possible &= np.abs(middle) <= TUNING.farthest_aside * np.maximum(width, 0.15)
        possible &= inside[:, _FIRST] & inside[:, _SECOND]
        score[~possible] = 0.0
        return self._best(score, first, second, top)

    def _strongest(self, edges: NDArray[np.int32]) -> NDArray[np.intp]:
        total = _added(edges)
        single = np.abs(total).reshape(-1, CHANNELS).astype(np.int16) @ _ROUGH_WEIGHTS
        single = single.reshape(self.points.size, self.slopes.size)
        single[~self.inside] = 0
        kept = np.argpartition(-single, TUNING.edges_kept, axis=1)[:, : TUNING.edges_kept]
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
        for _ in range(_MOST):
            point, pair = divmod(int(score.argmax()), score.shape[1])
            value = float(score[point, pair])
            if value <= _LEAST_SCORE:
                break
            left, right = float(first[point, pair]), float(second[point, pair])
            far = TUNING.first_row * self.depth
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
    for depth in TUNING.depths if level == 0 else TUNING.depths[2:]:
        step = 0.4 * depth
        rows = np.arange(first, last + 0.5 * step, step)
        # The compared part of a strip must be in the image.
        yield depth, rows[rows > 0.5 - TUNING.first_row * depth].tolist()


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
