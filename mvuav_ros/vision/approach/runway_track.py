"""One possible runway followed from frame to frame, as several strips that may be it.

A runway is a strip within strips: its shoulders around it, side stripes, a streak of rubber. Which
of them is the runway one frame seldom tells. So all are weighed anew in every frame, and what is
followed and reported is their mean, weighted by probability.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.approach.alignment import around
from mvuav_ros.vision.approach.appearance import FEATURES
from mvuav_ros.vision.approach.candidates import Candidates, LevelledImage, describe_part, to_level
from mvuav_ros.vision.approach.derotation import Derotation, turn_strips
from mvuav_ros.vision.approach.edges import EdgePoints
from mvuav_ros.vision.approach.probability import evidence_weights
from mvuav_ros.vision.approach.runway_edges import EdgeLook
from mvuav_ros.vision.approach.shape import Shape
from mvuav_ros.vision.approach.strip_search import Strips

_DEEPEST = 28.0
"""Px of a pyramid level: a near end below that is measured on the next one."""
_MOST_STRIPS = 12
_MEMORY = 0.15
_END_MEMORY = 0.6
_MOST_MISSES = 10
_MISSED = -4.0
"""Log odds of a frame in which nothing is there."""
_WORST = -9.0
"""Log odds under the best strip's below which a strip is given up."""
_TEMPERATURE, _WIDER = 2.5, 1.0
"""Of the mean's weights: log odds are divided by the one, as frames err alike, and widths taken to
the power of the other, as paint and rubber within a runway are seen more often than it. Runs 3, 5
in single frames."""
_LEAST_TOLERANCE, _TOLERANCE_SHARE = 3.0, 0.05
"""Px of the working image, and widths: strips whose corners are that near the mean agree with it.
So far from the labels a report still counts as right."""
_SIDE_MARGIN, _LEAST_MARGIN, _ABOVE, _BELOW = 1.2, 36.0, 18.0, 2.7
_SAME = 0.08
"""Widths, and px, between edges of strips that are the same."""
_CLEAR_PX, _CLEAR_SHARE = 1.0, 0.03
"""Standard deviation of the near end's corners, px or widths, below which the edges are measured on
the frame itself."""
_AGREE = 2.0
"""Px between such a measurement and the mean, at most."""
_WIDE, _LEAST_SUPPORT = 18.0, 0.25
"""Px of the near end from which a runway's lines are so far apart that its edges are those with the
clearest steps, and their support, 0 to 1, from which that holds. The simulator's flights."""
_SHARP_SUPPORT, _SHARP_AGREEMENT = 0.75, 0.3
"""Support of wide edges from which they count as agreed on, and that agreement at least."""
_POINTS = 12
_SURE_AGE = 10
_PAINT = FEATURES.index('paint')
_STEPS = (FEATURES.index('brightness'), FEATURES.index('colour'))
_OPEN = FEATURES.index('open_end')


class RunwayTrack:
    """The mean of strips that overlap, and how likely one of them is the runway.

    Attributes:
        log_odds: that one of the strips is the runway, averaged over the last frames.
        shape: the mean's edges, smoothed.
        far: rows from the vanishing point to the far end, px of the working image.
        near: rows from the vanishing point to the near end; smoothed.
        near_seen: the same in the newest frame alone.
        open_end: its near end is out of sight.
        age: frames.
        misses: frames in a row in which it was not seen.
        moved: frames that differed from the one before.
        agreement: probability of the strips that are where the mean is.
        points: of the left and the right edge in the newest frame, if seen.
    """

    def __init__(self, strip: NDArray[np.float64], log_odds: float) -> None:
        """Begin with a candidate, (6,) as `strip_search.Strips`."""
        self.shape = Shape(strip[:4], float(strip[5]))
        self.far, self.near = float(strip[4]), float(strip[5])
        self.near_seen = self.near
        self.open_end = False
        self.log_odds = log_odds
        self.age = 0
        self.misses = 0
        self.moved = 0
        self.agreement = 1.0
        self.points: tuple[EdgePoints, EdgePoints] | None = None
        self._found: list[NDArray[np.float64]] = [strip]
        self._look = EdgeLook()
        self._clear, self._lead = False, 0.0

    @property
    def lost(self) -> bool:
        """It has not been seen for too long."""
        return self.misses > _MOST_MISSES

    def strip(self) -> NDArray[np.float64]:
        """The mean, (6,) as `strip_search.Strips`."""
        return np.array([*self.shape.as_array(), self.far, self.near])

    def covers(self, strip: NDArray[np.float64]) -> bool:
        """Whether a strip may be the same runway: around, within or beside the mean."""
        return bool(_overlap(self.strip(), strip[None])[0])

    def add(self, strip: NDArray[np.float64]) -> None:
        """Take in what a search has found, in the next frame."""
        self._found.append(strip)

    def turn(self, old: Derotation, new: Derotation) -> None:
        """Go over to another derotation."""
        if old.slope != new.slope:
            self._found = [turn_strips(strip[None], old, new)[0] for strip in self._found]
            self.shape.turn(old, new)

    def step(
        self,
        image: NDArray[Any],
        working: LevelledImage,
        level: Derotation,
        horizon: tuple[float, float] | None,
    ) -> None:
        """Follow it into the next frame.

        Args:
            image: the frame.
            working: its levelled working image.
            level: of the frame.
            horizon: row of the vanishing point and its standard deviation, if known, px.
        """
        if self.age:
            self.shape.predict()
        self.age += 1
        if self._rests():
            self._glance(image, level)
            return
        found = self._describe(working) if self._plausible(working) else None
        self._found = []
        if found is None:
            self.misses += 1
            self.points = None
            self.log_odds += _MEMORY * (_MISSED - self.log_odds)
            return
        self.misses = 0
        self._measure(image, level, *found, horizon)
        if not self._plausible(working):
            self.misses = _MOST_MISSES + 1

    def _rests(self) -> bool:
        """Whether a frame is left out: a sure track is weighed in every second one."""
        sure = self.age > _SURE_AGE and self.log_odds > 0 and not self._found
        return sure and self.misses == 0 and self.age % 2 == 0

    def _glance(self, image: NDArray[Any], level: Derotation) -> None:
        """Measure the edges near where they are expected, without weighing anything."""
        strip = self.strip()
        rows = strip[1] + strip[4:6]
        mean = _columns(strip[None], rows)[0]
        points = _points_along(mean, rows, np.zeros((2, 2)))
        if self._clear:
            span = self.far, self.near
            wide = float(mean[1, 1] - mean[0, 1]) >= _WIDE
            exact = self._look.find(image, level, strip[:4], span, self._lead, wide=wide)
            if all(map(_agrees, exact, points)):
                points = exact
                self.shape.move_reference(float(0.3 * rows[0] + 0.7 * rows[1]))
                self.shape.update(*points, None, 1.0)
        self.points = points

    def _plausible(self, working: LevelledImage) -> bool:
        array = self.shape.as_array()
        if not np.isfinite(array).all():
            return False
        height, columns = working.size
        width = array[3] - array[2]
        return bool(
            0.05 < width < 8.0
            and abs(array[2] + array[3]) / 2 < 2.0 * width
            and -0.5 * columns < array[0] < 1.5 * columns
            and -0.3 * height < array[1] < height - 6
            and self.near > self.far
        )

    def _describe(self, working: LevelledImage) -> tuple[Candidates, NDArray[np.float64]] | None:
        """The strips that may be the runway in this frame, best first, and their log odds."""
        strip = self.strip()
        level = max(0, math.ceil(math.log2(max(float(strip[5]), 1.0) / _DEEPEST)))
        known = to_level(np.stack([strip, *self._found]), level)
        part, place = working.cut(level, _box(known))
        if part is None:
            return None
        known[:, :2] -= place
        strips = np.concatenate([around(part, known[0], _MOST_STRIPS), known[1:]])
        found = describe_part(part, strips, level, working.scene_of_part(level, *place))
        if not len(found.strips):
            return None
        found.strips[:, :2] += np.array(place) * 2**level
        odds = evidence_weights().log_odds(found.features)
        order = _distinct(found.strips, odds)
        odds = odds[order]
        now = float(odds[0]) + math.log(float(np.exp(odds - odds[0]).sum()))
        self.log_odds += max(_MEMORY, 1.0 / self.age) * (now - self.log_odds)
        return Candidates(found.strips[order], found.features[order]), odds

    def _measure(
        self,
        image: NDArray[Any],
        level: Derotation,
        seen: Candidates,
        odds: NDArray[np.float64],
        horizon: tuple[float, float] | None,
    ) -> None:
        best, features = seen.strips[0], seen.features[0]
        rows = best[1] + best[4:6]
        corners = _columns(seen.strips, rows)
        widths = np.maximum(corners[:, 1, 1] - corners[:, 0, 1], 1.0)
        weight = np.exp((odds - odds[0]) / _TEMPERATURE) * widths**_WIDER
        weight /= weight.sum()
        mean = np.tensordot(weight, corners, axes=1)
        spread = np.sqrt(np.tensordot(weight, (corners - mean) ** 2, axes=1))
        points = _points_along(mean, rows, spread)
        width = float(mean[1, 1] - mean[0, 1])
        near_mean = np.abs(corners - mean).max(axis=(1, 2)) < max(
            _LEAST_TOLERANCE, _TOLERANCE_SHARE * width
        )
        agreement = float(weight[near_mean].sum())
        self.agreement += max(_MEMORY, 1.0 / self.age) * (agreement - self.agreement)
        self._clear = bool(spread[:, 1].max() < max(_CLEAR_PX, _CLEAR_SHARE * width))
        self._lead = float(features[_PAINT] - features[_STEPS[0]] - features[_STEPS[1]])
        wide = width >= _WIDE
        if self._clear or wide:
            span = float(best[4]), float(best[5])
            through = _shape_through(mean, rows)
            exact = self._look.find(image, level, through, span, self._lead, wide=wide)
            agree = all(map(_agrees, exact, points))
            if agree or (wide and min(edge.support for edge in exact) > _LEAST_SUPPORT):
                points, self._clear = exact, True
                if min(edge.support for edge in exact) > _SHARP_SUPPORT:
                    self.agreement = max(self.agreement, _SHARP_AGREEMENT)
        shape = self.shape
        shape.move_reference(float(0.3 * rows[0] + 0.7 * rows[1]))
        row, sigma = horizon if horizon is not None else (None, 1.0)
        shape.update(*points, row, sigma)
        self.points = points
        self._follow_ends(rows, bool(features[_OPEN] > 0.5))

    def _follow_ends(self, rows: NDArray[np.float64], open_end: bool) -> None:
        share = max(_END_MEMORY, 1.0 / self.age)
        _, y = self.shape.vanishing_point
        if not math.isfinite(y):
            return
        self.near_seen = float(rows[1]) - y
        self.near += share * (self.near_seen - self.near)
        self.far += share * (max(float(rows[0]) - y, 1.0) - self.far)
        self.near = max(self.near, self.far + 3.0)
        self.open_end = open_end


def _box(strips: Strips) -> tuple[float, float, float, float]:
    """The part of an image that is needed to describe strips."""
    x, y, left, right, _, near = strips.T
    first, last = x + left * near, x + right * near
    margin = max(_SIDE_MARGIN * float((last - first).max()), _LEAST_MARGIN)
    return (
        float(np.minimum(first, x).min()) - margin,
        float(y.min()) - _ABOVE,
        float(np.maximum(last, x).max()) + margin,
        float((y + _BELOW * near).max()) + 4,
    )


def _columns(strips: Strips, rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, 2, 2) columns of the left and the right edge at the far and the near row."""
    depth = rows - strips[:, 1:2]
    edges = [strips[:, 0:1] + strips[:, column : column + 1] * depth for column in (2, 3)]
    return np.stack(edges, axis=1)


def _same(strip: NDArray[np.float64], strips: Strips) -> NDArray[np.bool_]:
    """Which strips have the same edges and nearly the same near end."""
    rows = strip[1] + np.array([0.4 * strip[5], strip[5]])
    own = _columns(strip[None], rows)
    width = float(own[0, 1, 1] - own[0, 0, 1])
    apart = np.abs(_columns(strips, rows) - own).max(axis=(1, 2))
    end = np.abs(strips[:, 1] + strips[:, 5] - strip[1] - strip[5])
    result: NDArray[np.bool_] = (apart < _SAME * width + 0.5) & (end < 0.3 * strip[5] + 2)
    return result


def _distinct(strips: Strips, odds: NDArray[np.float64]) -> NDArray[np.intp]:
    """Numbers of the strips that differ, best first, without hopeless ones."""
    kept: list[int] = []
    for index in np.argsort(-odds, kind='stable'):
        if odds[index] < odds.max() + _WORST:
            break
        if not kept or not _same(strips[index], strips[kept]).any():
            kept.append(int(index))
    return np.array(kept, np.intp)


def _overlap(strip: NDArray[np.float64], strips: Strips) -> NDArray[np.bool_]:
    """Which strips share half of the narrower one, and meet at about the same place."""
    row = np.array([strip[1] + strip[5]])
    own, others = _columns(strip[None], row)[0, :, 0], _columns(strips, row)[:, :, 0]
    width, widths = own[1] - own[0], np.maximum(others[:, 1] - others[:, 0], 1e-6)
    shared = np.minimum(others[:, 1], own[1]) - np.maximum(others[:, 0], own[0])
    apart = np.abs(strips[:, 1] - strip[1])
    result: NDArray[np.bool_] = (
        (shared > 0.5 * np.minimum(width, widths))
        & (apart < 0.6 * strip[5])
        & (widths < 3 * width)
        & (widths > width / 3)
    )
    return result


def _points_along(
    mean: NDArray[np.float64], rows: NDArray[np.float64], spread: NDArray[np.float64]
) -> tuple[EdgePoints, EdgePoints]:
    """The mean's edges as points, the fewer the less they are known."""
    share = (np.arange(_POINTS) + 0.5) / _POINTS
    at = rows[0] + share * (rows[1] - rows[0])
    edges = []
    for side in (0, 1):
        columns = mean[side, 0] + share * (mean[side, 1] - mean[side, 0])
        weight = 1.0 / (1.0 + float(spread[side].max()) ** 2)
        edges.append(EdgePoints(at, columns, np.full(_POINTS, weight), 1.0))
    left, right = edges
    return left, right


def _shape_through(corners: NDArray[np.float64], rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """(4,) vanishing point and slopes of edges through corners."""
    left, right = (corners[:, 1] - corners[:, 0]) / (rows[1] - rows[0])
    depth = (corners[1, 1] - corners[0, 1]) / max(right - left, 1e-3)
    return np.array([corners[0, 1] - left * depth, rows[1] - depth, left, right])


def _agrees(exact: EdgePoints, mean: EdgePoints) -> bool:
    """Whether points measured on the frame lie along the mean."""
    used = exact.weights > 0
    if np.count_nonzero(used) < 4:
        return False
    expected = np.interp(exact.rows[used], mean.rows, mean.columns)
    slope = (mean.columns[-1] - mean.columns[0]) / (mean.rows[-1] - mean.rows[0])
    beyond = exact.rows[used] - np.clip(exact.rows[used], mean.rows[0], mean.rows[-1])
    apart = np.abs(exact.columns[used] - expected - slope * beyond)
    return float(np.median(apart)) < _AGREE
