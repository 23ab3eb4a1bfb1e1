"""One possible runway followed from frame to frame, as several strips that may be it.

All of them are weighed anew in every few frames, and what is followed and reported is their mean,
weighted by what many frames together say of each.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.approach.alignment import align, around
from mvuav_ros.vision.approach.appearance import FEATURES, describe, profile
from mvuav_ros.vision.approach.candidates import LevelledImage, to_finest, to_level
from mvuav_ros.vision.approach.derotation import Derotation, turn_strips
from mvuav_ros.vision.approach.edges import EdgePoints
from mvuav_ros.vision.approach.hypotheses import Hypotheses
from mvuav_ros.vision.approach.probability import evidence_weights
from mvuav_ros.vision.approach.registration import Registration
from mvuav_ros.vision.approach.runway_edges import EdgeLook
from mvuav_ros.vision.approach.shape import Shape
from mvuav_ros.vision.approach.strip_search import Strips

_DEEPEST = 28.0
"""Px of a pyramid level: a near end below that is measured on the next one."""
_MOST_STRIPS = 8
"""Tried around the mean each time."""
_MEMORY = 0.15
_END_MEMORY = 0.6
_MOST_MISSES = 4
"""Weighings in a row in which nothing was seen."""
_MISSED = -4.0
"""Log odds of a weighing in which nothing is there."""
_LEAST_TOLERANCE, _TOLERANCE_SHARE = 3.0, 0.05
"""Px of the working image, and widths: strips whose corners are that near the mean agree with it.
So far from the labels a report still counts as right."""
_SIDE_MARGIN, _LEAST_MARGIN, _ABOVE, _BELOW = 1.2, 36.0, 18.0, 2.7
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
_LOCK_WIDTH, _LOCK_AGE, _LOCK_ODDS, _LOCK_AGREEMENT = 30.0, 20, 0.5, 0.4
"""Px, frames, log odds and agreement from which a runway is followed by its edges alone: near the
ground everything around it has straight edges too."""
_MOST_UNSEEN = 3
_NARROWEST = 5.0
"""Px of the near end: what is narrower shows too little to be told from specks in clouds."""
_POINTS = 12
_YOUNG = 5
"""Frames in which a track is weighed every time."""
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
        locked: it is followed by its edges alone.
        misses: weighings in a row in which it was not seen.
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
        self.agreement = 1.0
        self.points: tuple[EdgePoints, EdgePoints] | None = None
        self._found: list[NDArray[np.float64]] = [strip]
        self._look = EdgeLook()
        self._hypotheses = Hypotheses()
        self._spread = np.zeros((2, 2))
        self._clear, self._lead = False, 0.0
        self._rested = 0
        self.locked = False
        self._unseen = 0

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
        registration: Registration,
        period: int,
    ) -> None:
        """Follow it into the next frame.

        Args:
            image: the frame.
            working: its levelled working image.
            level: of the frame.
            horizon: row of the vanishing point and its standard deviation, if known, px.
            registration: of the working images.
            period: frames from one weighing to the next.
        """
        if self.age:
            self.shape.predict(*registration.shift(self.strip(), level))
        self.age += 1
        self._rested += 1
        if self._rested < period and self.age > _YOUNG:
            self._rest(image, level)
            return
        share, self._rested = float(self._rested), 0
        if self.locked and self._hold(image, working, level):
            self._found = []
            return
        seen = self._plausible(working) and self._weigh(image, working, level, share, horizon)
        self._found = []
        if not seen:
            self.misses += 1
            self.points = None
            self.log_odds += (1.0 - (1.0 - _MEMORY) ** share) * (_MISSED - self.log_odds)
            return
        self.misses = 0
        if not self._plausible(working):
            self.misses = _MOST_MISSES + 1

    def _rest(self, image: NDArray[Any], level: Derotation) -> None:
        """Follow without weighing; wide edges are measured in every frame."""
        if self.locked:
            self._edges_alone(image, level)
            return
        if self.points is None:
            return
        strip = self.strip()
        rows = strip[1] + strip[4:6]
        mean = _columns(strip[None], rows)[0]
        self.points = _points_along(mean, rows, self._spread)
        wide = float(mean[1, 1] - mean[0, 1]) >= _WIDE
        if self._clear and wide and self._rested % 2 == 0:
            exact = self._look.find(
                image, level, strip[:4], (self.far, self.near), self._lead, wide=True
            )
            if all(map(_agrees, exact, self.points)):
                self.points = exact
                self.shape.move_reference(float(0.3 * rows[0] + 0.7 * rows[1]))
                self.shape.update(*exact, None, 1.0)

    def _hold(self, image: NDArray[Any], working: LevelledImage, level: Derotation) -> bool:
        """Follow a wide runway by its edges alone, and see where it ends; whether it goes on."""
        if not self._plausible(working) or not self._edges_alone(image, level):
            self._unseen += 1
            self.locked = self._unseen <= _MOST_UNSEEN
            return self.locked
        self._unseen = 0
        frame = self.strip()
        pyramid = max(0, math.ceil(math.log2(max(float(frame[5]), 1.0) / _DEEPEST)))
        known = to_level(frame[None], pyramid)
        part, place = working.cut(pyramid, _box(known))
        if part is None:
            return True
        known[:, :2] -= place
        found = to_finest(profile(part, known).strips, pyramid)[0]
        if found[5] > 0.5 * self.near:
            self._follow_ends(frame[1] + found[4:6])
        beyond = level.to_frame(*(frame[:2] + (0.5 * (frame[2] + frame[3]) * self.near, self.near)))
        self.open_end = beyond[1] > image.shape[0] - 2 * level.factor
        return True

    def _edges_alone(self, image: NDArray[Any], level: Derotation) -> bool:
        strip = self.strip()
        exact = self._look.find(
            image, level, strip[:4], (self.far, self.near), self._lead, wide=True
        )
        if min(edge.support for edge in exact) < _LEAST_SUPPORT:
            self.points = None
            return False
        self.points = exact
        self.shape.move_reference(float(strip[1] + 0.3 * self.far + 0.7 * self.near))
        self.shape.update(*exact, None, 1.0)
        return True

    def _plausible(self, working: LevelledImage) -> bool:
        array = self.shape.as_array()
        if not np.isfinite(array).all():
            return False
        height, columns = working.size
        width = array[3] - array[2]
        return bool(
            0.05 < width < 8.0
            and width * self.near > _NARROWEST
            and abs(array[2] + array[3]) / 2 < 2.0 * width
            and -0.5 * columns < array[0] < 1.5 * columns
            and -0.3 * height < array[1] < height - 6
            and self.near > self.far
        )

    def _weigh(
        self,
        image: NDArray[Any],
        working: LevelledImage,
        level: Derotation,
        share: float,
        horizon: tuple[float, float] | None,
    ) -> bool:
        """Weigh all strips that may be the runway; whether there are any."""
        frame = self.strip()
        expected = np.concatenate([self._hypotheses.strips(frame), *(s[None] for s in self._found)])
        pyramid = max(0, math.ceil(math.log2(max(float(frame[5]), 1.0) / _DEEPEST)))
        known = to_level(np.concatenate([frame[None], expected]), pyramid)
        part, place = working.cut(pyramid, _box(known))
        if part is None:
            return False
        known[:, :2] -= place
        strips = np.concatenate([known[1:], around(part, known[0], _MOST_STRIPS)])
        measured, valid = align(part, strips)
        if not valid.any():
            return False
        measured[~valid] = strips[~valid]
        features = np.zeros((len(strips), len(FEATURES)))
        scene = working.scene_of_part(pyramid, *place)
        features[valid], measured[valid] = describe(part, measured[valid], scene, pyramid)
        measured = to_finest(measured, pyramid)
        measured[:, :2] += np.array(place) * 2**pyramid
        odds = np.where(valid, evidence_weights().log_odds(features), -np.inf)
        best = int(odds.argmax())
        now = float(odds[best]) + math.log(
            float(np.exp(odds[_apart(measured, odds)] - odds[best]).sum())
        )
        memory = max(1.0 - (1.0 - _MEMORY) ** share, 1.0 / self.age)
        self.log_odds += memory * (now - self.log_odds)
        weighed = self._hypotheses.weigh(measured, odds, valid, share, frame)
        self._lead = float(features[best, _PAINT] - features[best, _STEPS].sum())
        self._measure(image, level, weighed.strips, weighed.shares, memory, horizon)
        self.open_end = bool(features[best, _OPEN] > 0.5)
        self._hypotheses.settle(weighed.strips, self.strip())
        return True

    def _measure(
        self,
        image: NDArray[Any],
        level: Derotation,
        strips: Strips,
        shares: NDArray[np.float64],
        memory: float,
        horizon: tuple[float, float] | None,
    ) -> None:
        best = strips[int(shares.argmax())]
        rows = best[1] + best[4:6]
        corners = _columns(strips, rows)
        mean = np.tensordot(shares, corners, axes=1)
        self._spread = spread = np.sqrt(np.tensordot(shares, (corners - mean) ** 2, axes=1))
        points = _points_along(mean, rows, spread)
        width = float(mean[1, 1] - mean[0, 1])
        near_mean = np.abs(corners - mean).max(axis=(1, 2)) < max(
            _LEAST_TOLERANCE, _TOLERANCE_SHARE * width
        )
        self.agreement += memory * (float(shares[near_mean].sum()) - self.agreement)
        self._clear = bool(spread[:, 1].max() < max(_CLEAR_PX, _CLEAR_SHARE * width))
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
                self.locked = (
                    width > _LOCK_WIDTH
                    and self.age > _LOCK_AGE
                    and self.log_odds > _LOCK_ODDS
                    and self.agreement > _LOCK_AGREEMENT
                )
        shape = self.shape
        shape.move_reference(float(0.3 * rows[0] + 0.7 * rows[1]))
        row, sigma = horizon if horizon is not None else (None, 1.0)
        shape.update(*points, row, sigma)
        self.points = points
        self._follow_ends(rows)

    def _follow_ends(self, rows: NDArray[np.float64]) -> None:
        share = max(_END_MEMORY, 1.0 / self.age)
        _, y = self.shape.vanishing_point
        if not math.isfinite(y):
            return
        self.near_seen = float(rows[1]) - y
        self.near += share * (self.near_seen - self.near)
        self.far += share * (max(float(rows[0]) - y, 1.0) - self.far)
        self.near = max(self.near, self.far + 3.0)


def _apart(strips: Strips, odds: NDArray[np.float64]) -> NDArray[np.intp]:
    """Numbers of the strips that differ, best first."""
    best = strips[int(odds.argmax())]
    rows = best[1] + np.array([0.4, 1.0]) * best[5]
    columns = _columns(strips, rows)
    width = float(columns[int(odds.argmax()), 1, 1] - columns[int(odds.argmax()), 0, 1])
    kept: list[int] = []
    for index in np.argsort(-odds, kind='stable'):
        if not kept or (
            odds[index] > odds[kept[0]] - 9.0
            and np.abs(columns[kept] - columns[index]).max(axis=(1, 2)).min() > 0.08 * width + 0.5
        ):
            kept.append(int(index))
    return np.array(kept, np.intp)


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
    # The median is that low.
    return bool(2 * np.count_nonzero(apart < _AGREE) > apart.size)
