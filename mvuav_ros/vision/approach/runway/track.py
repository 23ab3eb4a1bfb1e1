"""One possible runway followed from frame to frame, as several strips that may be it.

All of them are weighed anew in every few frames, and what is followed and reported is their mean,
weighted by what many frames together say of each.
"""

from __future__ import annotations

import math

import numpy as np

from mvuav_ros.vision.approach.derotation import Derotation, turn_strips
from mvuav_ros.vision.approach.edges import Strip
from mvuav_ros.vision.approach.runway.appearance import FEATURES
from mvuav_ros.vision.approach.runway.candidates import describe_around
from mvuav_ros.vision.approach.runway.edge_track import (
    LEAST_SUPPORT,
    MEMORY,
    WIDE,
    YOUNG,
    EdgeTrack,
    View,
    support,
    tolerance,
)
from mvuav_ros.vision.approach.runway.geometry import (
    agrees,
    apart,
    columns_at,
    is_plausible,
    overlap,
    points_along,
    strip_through,
)
from mvuav_ros.vision.approach.runway.hypotheses import Hypotheses, Weighed
from mvuav_ros.vision.approach.runway.probability import log_odds_of

_MOST_STRIPS = 8
"""Tried around the mean each time."""
_MISS_MEMORY = 0.15
"""Share of a frame that does not show it in what a track remembers."""
_DIM = -1.5
"""Log odds below which nothing is reported, and the lines along a strip are not worth their time
between two weighings."""
_DIM_PERIOD = 4
"""Frames from one weighing to the next of a young track that is."""
_MISSED = -4.0
"""Log odds of a weighing in which nothing is there."""
_CLEAR_PX, _CLEAR_SHARE = 1.0, 0.03
"""Standard deviation of the near end's corners, px or widths, below which the edges are measured on
the frame itself."""
_LOCK_WIDTH, _LOCK_AGE, _LOCK_ODDS = 30.0, 20, 0.5
_LOCK_AGREEMENT, _LOCK_SUPPORT = 0.4, 0.7
"""Px, frames, log odds, and agreement or support from which a runway is followed by its edges
alone: near the ground everything around it has straight edges too."""
_MOST_UNSEEN = 3
_DISTINCT = 0.5
"""Share of the last frames with clear lines, or clear colours, from which edges are kept where
those are gone."""
_PAINT = FEATURES.index('paint')
_STEPS = (FEATURES.index('brightness'), FEATURES.index('colour'))
_OPEN = FEATURES.index('open_end')


class RunwayTrack(EdgeTrack):
    """The mean of strips that overlap, and how likely one of them is the runway.

    Attributes:
        log_odds: that one of the strips is the runway, averaged over the last frames.
        moved: frames that differed from the one before.
        locked: it is followed by its edges alone.
        agreement: probability of the strips that are where the mean is.
    """

    MOST_MISSES = 4

    def __init__(self, strip: Strip, log_odds: float) -> None:
        """Begin with a candidate."""
        super().__init__(strip)
        self.log_odds = log_odds
        self.moved = 0
        self.locked = False
        self.agreement = 1.0
        self._found = [strip]
        self._hypotheses = Hypotheses()
        self._spread = np.zeros((2, 2))
        self._rested = self._unseen = 0
        self._sharp = 0.0

    def covers(self, strip: Strip) -> bool:
        """Whether a strip may be the same runway: around, within or beside the mean."""
        return overlap(self.strip(), strip)

    def add(self, strip: Strip) -> None:
        """Take in what a search has found, in the next frame."""
        self._found.append(strip)

    def turn(self, old: Derotation, new: Derotation) -> None:
        """Go over to another derotation."""
        self._found = [turn_strips(strip[None], old, new)[0] for strip in self._found]
        super().turn(old, new)

    def step(self, view: View, period: int) -> None:
        """Follow it into the next frame; ``period`` is frames from one weighing to the next."""
        if self.age:
            self.predict(view)
        if not self._plausible(view):
            self.give_up()
            return
        before = self.strip()
        self._follow(view, period)
        if self._plausible(view):
            self._lines.move(before, self.strip())
        else:
            self.give_up()

    def _plausible(self, view: View) -> bool:
        return is_plausible(self.strip(), view.working.size)

    def _follow(self, view: View, period: int) -> None:
        self.age += 1
        self.moved += view.registration.moving
        self._rested += 1
        dim = self.log_odds < _DIM
        if self.age <= YOUNG:
            period = _DIM_PERIOD if dim else 1
        elif dim:
            period *= 2
        if self._rested < period and self.age > 1:
            if self.locked:
                self.follow_edges(view)
            elif self.points is not None:
                self._rest(view)
            return
        share, self._rested = float(self._rested), 0
        if self.locked and self._hold(view):
            self._found = []
            return
        seen = self._plausible(view) and self._weigh(view, share)
        self._found = []
        if seen:
            self.misses = 0
            return
        self.misses += 1
        self.points = None
        self.log_odds += (1.0 - (1.0 - _MISS_MEMORY) ** share) * (_MISSED - self.log_odds)

    def _rest(self, view: View) -> None:
        """Follow without weighing; wide edges are measured in every frame."""
        strip = self.strip()
        rows = strip[1] + strip[4:6]
        mean = columns_at(strip[None], rows)[0]
        self.points = points_along(mean, rows, self._spread)
        if self.log_odds < _DIM:
            return
        lines = self.by_lines(view, strip)
        if lines is not None:
            self.take_in(lines, rows, view)
            return
        wide = float(mean[1, 1] - mean[0, 1]) >= WIDE
        if self._clear and wide and (self._look.clear or self._rested % 2 == 0):
            exact = self._look.find(view.frame, strip, wide=True)
            if all(map(agrees, exact, self.points)):
                self._update(exact, float(0.3 * rows[0] + 0.7 * rows[1]))

    def _hold(self, view: View) -> bool:
        """Follow a locked runway by its edges alone; whether it stays locked."""
        if self._plausible(view) and self.follow_edges(view):
            self._unseen = 0
            self.see_ends(view)
            return True
        self._unseen += 1
        self.locked = self._unseen <= _MOST_UNSEEN
        return self.locked

    def _weigh(self, view: View, share: float) -> bool:
        """Weigh all strips that may be the runway; whether there are any."""
        frame = self.strip()
        expected = np.concatenate([self._hypotheses.strips(frame), *(s[None] for s in self._found)])
        seen = describe_around(view.working, frame, expected, _MOST_STRIPS)
        if seen is None:
            return False
        measured, features, valid = seen
        odds = np.where(valid, log_odds_of(features), -np.inf)
        best = int(odds.argmax())
        now = float(odds[best]) + math.log(
            float(np.exp(odds[apart(measured, odds)] - odds[best]).sum())
        )
        memory = max(1.0 - (1.0 - MEMORY) ** share, 1.0 / self.age)
        self.log_odds += memory * (now - self.log_odds)
        weighed = self._hypotheses.weigh(measured, odds, share, frame)
        self._look.paint_lead = float(features[best, _PAINT] - features[best, _STEPS].sum())
        self._measure(view, weighed, memory)
        self.open_end = bool(features[best, _OPEN] > 0.5)
        self._hypotheses.settle(weighed.strips, self.strip())
        return True

    def _measure(self, view: View, weighed: Weighed, memory: float) -> None:
        """Find the edges about the mean of the strips."""
        strips, shares = weighed.strips, weighed.shares
        best = strips[int(shares.argmax())]
        rows = best[1] + best[4:6]
        corners = columns_at(strips, rows)
        mean = np.tensordot(shares, corners, axes=1)
        self._spread = spread = np.sqrt(np.tensordot(shares, (corners - mean) ** 2, axes=1))
        points = points_along(mean, rows, spread)
        width = float(mean[1, 1] - mean[0, 1])
        near_mean = np.abs(corners - mean).max(axis=(1, 2)) < tolerance(width)
        self.agreement += memory * (float(shares[near_mean].sum()) - self.agreement)
        self._clear = bool(spread[:, 1].max() < max(_CLEAR_PX, _CLEAR_SHARE * width))
        wide = width >= WIDE
        through = strip_through(mean, rows, best[4:6])
        if self._clear or wide:
            exact = self._look.find(view.frame, through, wide=wide)
            if all(map(agrees, exact, points)) or (wide and support(exact) > LEAST_SUPPORT):
                points, self._clear = exact, True
                self._sharp += memory * (support(exact) - self._sharp)
                self.locked = (
                    width > _LOCK_WIDTH
                    and self.age > _LOCK_AGE
                    and self.log_odds > _LOCK_ODDS
                    and (self.agreement > _LOCK_AGREEMENT or self._sharp > _LOCK_SUPPORT)
                )
        if not self._clear and self._look.coloured and self.distinct > _DISTINCT:
            # Strips that differ much have a mean that may be none of them.
            held = self.seen_edges(view, wide=wide)
            self._clear = held is not None
            points = held or points
        if not self.locked:
            self._lines.expect(self.strip(), through)
            lines = self.by_lines(view, self.known_span(through))
            if lines is None and self.distinct > _DISTINCT and not self._look.coloured:
                lines = points_along(columns_at(self.strip()[None], rows)[0], rows, spread)
            points = lines or points
        self.take_in(points, rows, view)
        self._ends_at(rows)
