"""One possible runway followed from frame to frame, as several strips that may be it.

All of them are weighed anew in every few frames, and what is followed and reported is their mean,
weighted by what many frames together say of each.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.approach.derotation import Derotation, turn_strips
from mvuav_ros.vision.approach.edges import EdgePoints
from mvuav_ros.vision.approach.runway.appearance import FEATURES
from mvuav_ros.vision.approach.runway.candidates import describe_around, ends_of
from mvuav_ros.vision.approach.runway.edges import EdgeLook
from mvuav_ros.vision.approach.runway.geometry import (
    agrees,
    apart,
    columns_at,
    is_plausible,
    overlapping,
    points_along,
    shape_through,
)
from mvuav_ros.vision.approach.runway.hypotheses import Hypotheses, Weighed
from mvuav_ros.vision.approach.runway.lined_edges import LinedEdges
from mvuav_ros.vision.approach.runway.probability import evidence_weights
from mvuav_ros.vision.approach.runway.shoulders import shows_shoulders
from mvuav_ros.vision.approach.runway.view import View
from mvuav_ros.vision.approach.shape import Shape

_MOST_STRIPS = 8
"""Tried around the mean each time."""
_MEMORY, _MISS_MEMORY, _END_MEMORY = 0.06, 0.15, 0.6
"""Share of a frame in what a track remembers: of being weighed, of not being seen, of its ends."""
_MOST_MISSES = 4
"""Weighings in a row in which nothing was seen."""
_MISSED = -4.0
"""Log odds of a weighing in which nothing is there."""
_LEAST_TOLERANCE, _TOLERANCE_SHARE = 3.0, 0.05
"""Px of the working image, and widths: strips whose corners are that near the mean agree with it.
So far from the labels a report still counts as right."""
_CLEAR_PX, _CLEAR_SHARE = 1.0, 0.03
"""Standard deviation of the near end's corners, px or widths, below which the edges are measured on
the frame itself."""
_WIDE, _LEAST_SUPPORT = 18.0, 0.25
"""Px of the near end from which a runway's lines are so far apart that its edges are those with the
clearest steps, and their support, 0 to 1, from which that holds. The simulator's flights."""
_LOCK_WIDTH, _LOCK_AGE, _LOCK_ODDS = 30.0, 20, 0.5
_LOCK_AGREEMENT, _LOCK_SUPPORT = 0.4, 0.7
"""Px, frames, log odds, and agreement or support from which a runway is followed by its edges
alone: near the ground everything around it has straight edges too."""
_GROWTH_MEMORY, _MOST_GROWTH = 0.1, 0.04
_MOST_UNSEEN = 3
_SHOULDER_MEMORY, _SHOULDERS = (0.3, 0.1), (0.3, 0.6)
"""Share of a frame that shows shoulders, and of one that does not, in what is remembered of them,
and what of it makes them possible and certain. Run 3."""
_JUMP_MEMORY = 0.15
"""Share of a frame by which an edge that jumped is forgotten."""
_YOUNG = 5
"""Frames in which a track is weighed every time."""
_DISTINCT = 0.5
"""Share of the last frames with clear lines, or clear colours, from which edges are kept where
those are gone."""
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
        moved: frames that differed from the one before.
        locked: it is followed by its edges alone.
        misses: weighings in a row in which it was not seen.
        agreement: probability of the strips that are where the mean is.
        distinct: share of the last frames with clear lines along both sides, or clear colours.
        shoulders: share of the last frames in which pavement is seen to go on beyond both edges.
        points: of the left and the right edge in the newest frame, if seen.
    """

    def __init__(self, strip: NDArray[np.float64], log_odds: float) -> None:
        """Begin with a candidate, (6,) as `search.Strips`."""
        self.shape = Shape(strip[:4], float(strip[5]))
        self.far, self.near = float(strip[4]), float(strip[5])
        self.near_seen = self.near
        self.open_end = False
        self.log_odds = log_odds
        self.age = 0
        self.moved = 0
        self.misses = 0
        self.agreement = 1.0
        self.distinct = 0.0
        self.shoulders = 0.0
        self.points: tuple[EdgePoints, EdgePoints] | None = None
        self._found: list[NDArray[np.float64]] = [strip]
        self._look = EdgeLook()
        self._hypotheses = Hypotheses()
        self._spread = np.zeros((2, 2))
        self._clear, self._lead = False, 0.0
        self._rested = 0
        self._jumped = 0.0
        self._lines = LinedEdges()
        self.locked = False
        self._sharp, self._growth = 0.0, 0.0
        self._unseen = 0

    @property
    def other_edges(self) -> float:
        """Odds that an edge is elsewhere: 1, even, where the image shows two places for it.

        It is so with paved shoulders that are plain to see, and after an edge has jumped.
        """
        shoulders = float(np.interp(self.shoulders, _SHOULDERS, (0.0, 1.0)))
        return max(shoulders, self._jumped, self._lines.other)

    @property
    def shoulder_lines(self) -> float:
        """From 0 to 1, whether shoulders have lines too, on both sides and as far apart."""
        return self._lines.shoulders

    @property
    def lost(self) -> bool:
        """It has not been seen for too long."""
        return self.misses > _MOST_MISSES

    def strip(self) -> NDArray[np.float64]:
        """The mean, (6,) as `search.Strips`."""
        return np.array([*self.shape.as_array(), self.far, self.near])

    def covers(self, strip: NDArray[np.float64]) -> bool:
        """Whether a strip may be the same runway: around, within or beside the mean."""
        return bool(overlapping(self.strip(), strip[None])[0])

    def add(self, strip: NDArray[np.float64]) -> None:
        """Take in what a search has found, in the next frame."""
        self._found.append(strip)

    def turn(self, old: Derotation, new: Derotation) -> None:
        """Go over to another derotation."""
        if old.slope != new.slope:
            self._found = [turn_strips(strip[None], old, new)[0] for strip in self._found]
            self.shape.turn(old, new)

    def step(self, view: View, period: int) -> None:
        """Follow it into the next frame; ``period`` is frames from one weighing to the next."""
        if self.age:
            self.shape.grow(self._growth)
            self.shape.predict(*view.registration.shift(self.strip(), view.level))
        before = self.strip()
        self._follow(view, period)
        if not self._plausible(view):
            self.misses = _MOST_MISSES + 1
            return
        self._lines.move(before, self.shape.as_array())

    def _follow(self, view: View, period: int) -> None:
        self.age += 1
        self.moved += view.registration.moving
        self._rested += 1
        if self._rested < period and self.age > _YOUNG:
            self._rest(view)
            return
        share, self._rested = float(self._rested), 0
        if self.locked and self._hold(view):
            self._found = []
            return
        seen = self._plausible(view) and self._weigh(view, share)
        self._found = []
        if not seen:
            self.misses += 1
            self.points = None
            self.log_odds += (1.0 - (1.0 - _MISS_MEMORY) ** share) * (_MISSED - self.log_odds)
            return
        self.misses = 0

    def _rest(self, view: View) -> None:
        """Follow without weighing; wide edges are measured in every frame."""
        if self.locked:
            self._edges_alone(view)
            return
        if self.points is None:
            return
        strip = self.strip()
        rows = strip[1] + strip[4:6]
        mean = columns_at(strip[None], rows)[0]
        self.points = points_along(mean, rows, self._spread)
        lines = self._by_lines(view, strip[:4], (self.far, self.near))
        if lines is not None:
            self.points = lines
            self._take_in(lines, rows, view)
            return
        wide = float(mean[1, 1] - mean[0, 1]) >= _WIDE
        if self._clear and wide and (self._look.clear or self._rested % 2 == 0):
            exact = self._look.find(
                view.image, view.level, strip[:4], (self.far, self.near), self._lead, wide=True
            )
            if all(map(agrees, exact, self.points)):
                self.points = exact
                self.shape.move_reference(float(0.3 * rows[0] + 0.7 * rows[1]))
                self.shape.update(*exact, None, 1.0)

    def _hold(self, view: View) -> bool:
        """Follow a wide runway by its edges alone, and see where it ends; whether it goes on."""
        if not self._plausible(view) or not self._edges_alone(view):
            self._unseen += 1
            self.locked = self._unseen <= _MOST_UNSEEN
            return self.locked
        self._unseen = 0
        frame = self.strip()
        found = ends_of(view.working, frame)
        if found is None:
            return True
        if found[1] > 0.5 * self.near:
            self._follow_ends(frame[1] + found)
        middle = frame[0] + 0.5 * (frame[2] + frame[3]) * self.near
        _, last = view.level.to_frame(middle, frame[1] + self.near)
        self.open_end = bool(last > view.image.shape[0] - 2 * view.level.factor)
        return True

    def _edges_alone(self, view: View) -> bool:
        strip = self.strip()
        exact = self._look.find(
            view.image, view.level, strip[:4], (self.far, self.near), self._lead, wide=True
        )
        if min(edge.support for edge in exact) < _LEAST_SUPPORT:
            self.points = None
            return False
        # The lines' outer sides are the edges, by colour too: shoulders may lie beyond.
        if self._look.coloured:
            self._lines.expect_colour(strip, exact)
        exact = self._lines_along(view, strip[:4], (self.far, self.near)) or exact
        self.points = exact
        self.shape.move_reference(float(strip[1] + 0.3 * self.far + 0.7 * self.near))
        self.shape.update(*exact, None, 1.0)
        left, right = self.shape.slopes
        change = (right - left) / (strip[3] - strip[2]) - 1.0
        growth = self._growth + _GROWTH_MEMORY * change
        self._growth = min(max(growth, -_MOST_GROWTH), _MOST_GROWTH)
        strip = self.strip()
        shown = shows_shoulders(view.image, view.level, strip[:4], (self.far, self.near))
        if shown is not None:
            self.shoulders += _SHOULDER_MEMORY[not shown] * (float(shown) - self.shoulders)
        return True

    def _plausible(self, view: View) -> bool:
        return is_plausible(self.strip(), view.working.size)

    def _weigh(self, view: View, share: float) -> bool:
        """Weigh all strips that may be the runway; whether there are any."""
        frame = self.strip()
        expected = np.concatenate([self._hypotheses.strips(frame), *(s[None] for s in self._found)])
        seen = describe_around(view.working, frame, expected, _MOST_STRIPS)
        if seen is None:
            return False
        measured, features, valid = seen
        odds = np.where(valid, evidence_weights().log_odds(features), -np.inf)
        best = int(odds.argmax())
        now = float(odds[best]) + math.log(
            float(np.exp(odds[apart(measured, odds)] - odds[best]).sum())
        )
        memory = max(1.0 - (1.0 - _MEMORY) ** share, 1.0 / self.age)
        self.log_odds += memory * (now - self.log_odds)
        weighed = self._hypotheses.weigh(measured, odds, valid, share, frame)
        self._lead = float(features[best, _PAINT] - features[best, _STEPS].sum())
        self._measure(view, weighed, memory)
        self.open_end = bool(features[best, _OPEN] > 0.5)
        self._hypotheses.settle(weighed.strips, self.strip())
        return True

    def _measure(self, view: View, weighed: Weighed, memory: float) -> None:
        strips, shares = weighed.strips, weighed.shares
        best = strips[int(shares.argmax())]
        rows = best[1] + best[4:6]
        corners = columns_at(strips, rows)
        mean = np.tensordot(shares, corners, axes=1)
        self._spread = spread = np.sqrt(np.tensordot(shares, (corners - mean) ** 2, axes=1))
        points = points_along(mean, rows, spread)
        width = float(mean[1, 1] - mean[0, 1])
        near_mean = np.abs(corners - mean).max(axis=(1, 2)) < _tolerance(width)
        self.agreement += memory * (float(shares[near_mean].sum()) - self.agreement)
        self._clear = bool(spread[:, 1].max() < max(_CLEAR_PX, _CLEAR_SHARE * width))
        wide = width >= _WIDE
        span, through = (float(best[4]), float(best[5])), shape_through(mean, rows)
        if self._clear or wide:
            exact = self._look.find(view.image, view.level, through, span, self._lead, wide=wide)
            agree = all(map(agrees, exact, points))
            if agree or (wide and min(edge.support for edge in exact) > _LEAST_SUPPORT):
                points, self._clear = exact, True
                support = min(edge.support for edge in exact)
                self._sharp += memory * (support - self._sharp)
                self.locked = (
                    width > _LOCK_WIDTH
                    and self.age > _LOCK_AGE
                    and self.log_odds > _LOCK_ODDS
                    and (self.agreement > _LOCK_AGREEMENT or self._sharp > _LOCK_SUPPORT)
                )
        if not self._clear and self._look.coloured and self.distinct > _DISTINCT:
            points = self._held_by_colour(view, wide=wide) or points
        if not self.locked:
            self._lines.expect(self.strip(), through)
            lines = self._by_lines(view, through, self._known_span(through, span))
            if lines is None and self.distinct > _DISTINCT and not self._look.coloured:
                lines = points_along(columns_at(self.strip()[None], rows)[0], rows, spread)
            points = lines or points
        self._take_in(points, rows, view)
        self.points = points
        self._follow_ends(rows)

    def _held_by_colour(self, view: View, *, wide: bool) -> tuple[EdgePoints, EdgePoints] | None:
        """Both edges where they were followed, if colour shows them there.

        Strips that differ much have a mean that may be none of them.
        """
        exact = self._look.find(
            view.image, view.level, self.strip()[:4], (self.far, self.near), self._lead, wide=wide
        )
        if min(edge.support for edge in exact) < _LEAST_SUPPORT:
            return None
        self._clear = True
        return exact

    def _known_span(
        self, shape: NDArray[np.float64], span: tuple[float, float]
    ) -> tuple[float, float]:
        """Rows in which lines are measured: to the near end as known from earlier frames, too.

        What is measured in the far part of a runway alone is wrong at its near end.
        """
        _, y = self.shape.vanishing_point
        if self.age <= _YOUNG or not math.isfinite(y):
            return span
        down = y - float(shape[1])
        return max(self.far + down, 1.0), max(self.near + down, span[1])

    def _by_lines(
        self, view: View, shape: NDArray[np.float64], span: tuple[float, float]
    ) -> tuple[EdgePoints, EdgePoints] | None:
        coloured = self._clear and self._look.coloured
        if coloured:
            self._lines.forget()
        found = None if coloured else self._lines_along(view, shape, span)
        distinct = float(coloured or found is not None)
        self.distinct += max(_MEMORY, 1.0 / self.age) * (distinct - self.distinct)
        return found

    def _lines_along(
        self, view: View, shape: NDArray[np.float64], span: tuple[float, float]
    ) -> tuple[EdgePoints, EdgePoints] | None:
        """Both edges by the lines along them, of which each frame says more."""
        strip = self.strip()
        tolerance = _tolerance(float((strip[3] - strip[2]) * strip[5]))
        return self._lines.find(view.image, view.level, strip, shape, span, tolerance)

    def _take_in(
        self, points: tuple[EdgePoints, EdgePoints], rows: NDArray[np.float64], view: View
    ) -> None:
        self._watch(points)
        self.shape.move_reference(float(0.3 * rows[0] + 0.7 * rows[1]))
        row, sigma = view.horizon or (None, 1.0)
        self.shape.update(*points, row, sigma)

    def _watch(self, points: tuple[EdgePoints, EdgePoints]) -> None:
        """Whether an edge is farther from where it was than the tolerance."""
        x, y, *slopes = (float(value) for value in self.shape.as_array())
        width = (slopes[1] - slopes[0]) * self.near
        allowed = _tolerance(width)
        self._jumped *= 1.0 - _JUMP_MEMORY
        if self.age <= _YOUNG:
            return
        for edge, slope in zip(points, slopes, strict=True):
            near = (edge.rows - edge.rows.mean() >= 0) & (edge.weights > 0)
            if near.any():
                away = edge.columns[near] - x - slope * (edge.rows[near] - y)
                if abs(float(away.mean())) > allowed:
                    self._jumped = 1.0

    def _follow_ends(self, rows: NDArray[np.float64]) -> None:
        share = max(_END_MEMORY, 1.0 / self.age)
        _, y = self.shape.vanishing_point
        if not math.isfinite(y):
            return
        self.near_seen = float(rows[1]) - y
        self.near += share * (self.near_seen - self.near)
        self.far += share * (max(float(rows[0]) - y, 1.0) - self.far)
        self.near = max(self.near, self.far + 3.0)


def _tolerance(width: float) -> float:
    """Px by which an edge may be wrong where the near end is so many px wide."""
    return max(_LEAST_TOLERANCE, _TOLERANCE_SHARE * width)
