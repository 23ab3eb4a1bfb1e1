"""One possible runway followed from frame to frame: the mean of strips within strips."""

from __future__ import annotations

import math
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.approach.attitude import Derotation, turn_strips
from mvuav_ros.vision.approach.ground_motion import GroundMotion, Registration
from mvuav_ros.vision.approach.probability import Report, confidence_weights, log_odds_of
from mvuav_ros.vision.approach.search import LevelledImage, describe_around, ends_of
from mvuav_ros.vision.approach.side_lines import find_side_lines
from mvuav_ros.vision.approach.sight import Sight
from mvuav_ros.vision.approach.strip_edges import (
    EdgeLook,
    Edges,
    LevelledFrame,
    Strip,
    Strips,
    shows_shoulders,
)
from mvuav_ros.vision.approach.strips import (
    FollowedStrip,
    columns_at,
    end_rows,
    is_plausible,
    points_along,
    strip_along,
    strips_through,
)
from mvuav_ros.vision.approach.tuning import LINES, MOTION, SEARCH, SHOULDERS, TRACK, TRACKER


def weigh(measured: Strips, odds: NDArray[np.float64]) -> tuple[Strips, NDArray[np.float64], float]:
    """Weigh strips (m, 6) by their log odds (m,).

    Paint and rubber within a runway are seen more often than it: the wider counts more.

    Returns:
        Those that differ, likeliest first; how the probability is shared among them; and the log
        odds that the runway is one of them.
    """
    best = measured[int(odds.argmax())]
    columns = columns_at(measured, best[1] + np.array([SEARCH.first_row, 1.0]) * best[5])
    kept = _distinct(columns, odds, max(TRACK.same_share * _width(best), TRACK.same_px))
    widths = np.maximum(columns[kept, 1, 1] - columns[kept, 0, 1], 1.0)
    below = odds[kept] - odds[kept[0]]
    (narrow, hot), (wide, cold) = TRACK.hot, TRACK.cold
    temperature = float(np.interp(_width(best), (narrow, wide), (hot, cold)))
    weight = np.exp(below / temperature) * widths
    log_odds = float(odds[kept[0]]) + math.log(float(np.exp(below).sum()))
    return measured[kept], weight / weight.sum(), log_odds


def _width(strip: Strip) -> float:
    """At the near end, px."""
    return float((strip[3] - strip[2]) * strip[5])


def _distinct(
    columns: NDArray[np.float64], odds: NDArray[np.float64], apart: float
) -> NDArray[np.intp]:
    """Numbers of the strips that are so many px apart, best first, without hopeless ones."""
    order = np.argsort(-odds, kind='stable')
    order = order[odds[order] >= odds.max() + TRACK.max_odds_below]
    differ = np.abs(columns[order, None] - columns[order]).max(axis=(2, 3)) > apart
    kept: list[int] = []
    for place in range(len(order)):
        if differ[place, kept].all():
            kept.append(place)
    return np.asarray(order[kept[: TRACK.max_strips]])


class View(NamedTuple):
    """A frame as the tracks see it."""

    frame: LevelledFrame
    working: LevelledImage  # its working image
    sight: Sight  # where edges may meet on that
    registration: Registration  # of the working images
    motion: GroundMotion | None = None  # of these as well, in frames in which it is measured


def support(edges: Edges) -> float:
    """Of the less certain edge, 0 to 1."""
    return min(edge.support for edge in edges)


class EdgeKind(IntEnum):
    """What a runway's edges are measured by."""

    STRIPS = 0  # the mean of the strips that it may be
    STEP = 1  # the step from land to pavement, on the frame itself
    LINE = 2  # the outer side of the lines along both sides


class EdgeKinds:
    """Which kind of edge is the runway's: a hidden variable, filtered forwards over the frames.

    Only frames that are weighed count, and by `TRACK.kind_weight`, as they err alike. From one of
    them to the next the kind may become another one with a probability of `TRACK.kind_leave`.
    """

    def __init__(self) -> None:
        self._shares = np.array(TRACK.first_kinds)

    def share(self, *kinds: EdgeKind) -> float:
        """Probability of one of some kinds."""
        return float(self._shares[list(kinds)].sum())

    def take_in(self, evidence: dict[EdgeKind, float]) -> None:
        """Take in log odds of the kinds that a frame speaks of."""
        odds = np.array([evidence.get(kind, 0.0) for kind in EdgeKind])
        left = (1.0 - TRACK.kind_leave) * self._shares + TRACK.kind_leave / len(EdgeKind)
        shares = left * np.exp(TRACK.kind_weight * odds)
        self._shares = shares / shares.sum()

    @property
    def likeliest(self) -> EdgeKind:
        """The one with the greatest probability."""
        return EdgeKind(int(self._shares.argmax()))


class RunwayTrack(FollowedStrip):
    """The mean of strips that overlap, and how likely one of them is the runway.

    Which of them is the runway, its shoulders, a side stripe or a streak of rubber, one frame
    seldom shows. Every few frames they are weighed; the filter of the edges remembers their mean.
    """

    max_misses = 4
    min_length = TRACK.min_length

    def __init__(self, strip: Strip, log_odds: float) -> None:
        super().__init__(strip)
        self.log_odds = log_odds  # that it is the runway, averaged over the last frames
        self.moved = 0  # frames that differed from the one before
        # Shares of the last frames: with edges that are clear lines or colours, or steps where
        # lines are not looked for; and with pavement that goes on beyond both edges.
        self.distinct = self.shoulders = 0.0
        # Probability of the strips that are where the mean is, or of the edges' kind while locked.
        self.agreement = 1.0
        self.locked = False  # followed by its edges alone
        self.above_horizon = False  # of a horizon that has been known for longer
        self.still = MOTION.least_still  # log odds that it stands still in the picture
        self._found = strip[None]  # by a search, since it was weighed
        self._look, self.kinds = EdgeLook(), EdgeKinds()
        self._spread = np.zeros((2, 2))
        self._rested, self._memory = 0, 1.0

    @property
    def other_edges(self) -> float:
        """Odds that an edge is elsewhere: 1, even, where the image shows two places for it.

        It is so with paved shoulders that are plain to see.
        """
        return float(np.interp(self.shoulders, TRACK.shoulder_range, (0.0, 1.0)))

    @property
    def report(self) -> Report:
        """Evidence of whether it is the runway, and where it is followed."""
        return Report(self.rank, self.agreement, self.moved, self.distinct, self.other_edges)

    @property
    def rank(self) -> float:
        """Log odds, with what horizon and motion say, with which it stands against other tracks."""
        still = max(self.still, 0.0)  # nearly the logarithm of 1 + odds, and 0 where it moves
        return self.log_odds - TRACKER.above_horizon_odds * self.above_horizon - still

    @property
    def preference(self) -> float:
        """Log odds of a right report, however long it has been followed."""
        followed = self.report._replace(moved=TRACK.known_frames)
        return followed.log_odds_right(confidence_weights())

    @property
    def confidence(self) -> float:
        """Probability that it is the runway, and where it is reported."""
        return self.report.confidence(confidence_weights())

    def add(self, strip: Strip) -> None:
        """Take in what a search has found, in the next frame."""
        self._found = np.concatenate([self._found, strip[None]])

    def turn(self, old: Derotation, new: Derotation) -> None:
        """Go over to another derotation."""
        found = turn_strips(self._found, old, new)
        self._found = found[np.isfinite(found).all(axis=1)]
        super().turn(old, new)

    def step(self, view: View, period: int, *, shown: bool = False) -> None:
        """Follow it into the next frame; ``period`` is frames from one weighing to the next.

        Between weighings the edges of the one that is ``shown`` are measured, not those of others.
        """
        if is_plausible(self.strip(), view.working.size):
            self._follow(view, period, shown)
        if not is_plausible(self.strip(), view.working.size):
            self.give_up()
        elif view.motion is not None:
            odds = self.still + view.motion.still_odds(self.strip(), view.frame.level)
            self.still = min(max(odds, MOTION.least_still), MOTION.most_still)
        # What looks like a horizon in the picture may be the border of a field.
        known = view.sight.seen >= self.age
        self.above_horizon = known and self.lies_above(view.sight.row)

    def _follow(self, view: View, period: int, shown: bool) -> None:
        self.age += 1
        self.moved += view.registration.moving
        self._rested += 1
        young = self.age <= TRACK.young and self.log_odds > TRACK.dim_odds
        if self._rested < period and self.age > 1 and not young:
            # About a mean of strips, steps that are not there say nothing of their kind.
            if shown and self.points is not None and self.kinds.likeliest is not EdgeKind.STRIPS:
                self._measure(view, self.strip(), weighed=False)
            elif self.points is not None:
                self.points = self._predicted()
            return
        share, self._rested = float(self._rested), 0
        self._memory = max(1.0 - (1.0 - TRACK.memory) ** share, 1.0 / self.age)
        self._lock()
        if self.locked:
            self._measure(view, self.strip(), weighed=True)
            in_place = 0.0 if self.points is None else self.kinds.share(self.kinds.likeliest)
            self.agreement += self._memory * (in_place - self.agreement)
            strip = self.strip()
            ends = ends_of(view.working, strip)
            if ends is not None and ends[1] > 0.5 * self.near:
                self.follow_ends(*(strip[1] + ends).tolist())
            self.locked = self.points is not None
        seen = self.locked or self._weigh(view)
        self._found = self._found[:0]
        if seen:
            self.misses = 0
            return
        self.misses += 1
        self.points = None
        self.log_odds += (1.0 - (1.0 - TRACK.miss_memory) ** share) * (
            TRACK.missed_odds - self.log_odds
        )

    def _lock(self) -> None:
        """Near the ground everything around a runway has straight edges, too."""
        exact = self.kinds.share(EdgeKind.STEP, EdgeKind.LINE)
        near = _width(self.strip()) > TRACK.lock_width and self.age > TRACK.lock_age
        likely = self.confidence > TRACK.lock_confidence
        begins = near and likely and exact > TRACK.lock_share
        self.locked = begins or (self.locked and exact > TRACK.unlock_share)

    def _weigh(self, view: View) -> bool:
        """Weigh all strips that may be the runway; whether there are any."""
        seen = describe_around(view.working, self.strip(), self._found, TRACKER.max_weighed)
        if seen is None:
            return False
        measured, features = seen
        strips, shares, log_odds = weigh(measured, log_odds_of(features))
        self.log_odds += self._memory * (log_odds - self.log_odds)
        likeliest = strips[int(shares.argmax())]
        rows = end_rows(likeliest)
        corners = columns_at(strips, rows)
        mean = np.tensordot(shares, corners, axes=1)
        self._spread = np.sqrt(np.tensordot(shares, (corners - mean) ** 2, axes=1))
        width = float(mean[1, 1] - mean[0, 1])
        tolerance = max(TRACK.min_tolerance, TRACK.tolerance_share * width)
        near = np.abs(corners - mean).max(axis=(1, 2)) < tolerance
        self.agreement += self._memory * (float(shares[near].sum()) - self.agreement)
        self._measure(view, strips_through(mean[None], rows, rows[None])[0], weighed=True)
        self.follow_ends(*rows.tolist())
        return True

    def _measure(self, view: View, strip: Strip, *, weighed: bool) -> None:
        """Find the edges about a strip, by the likeliest kind."""
        width = _width(strip)
        measured: dict[EdgeKind, Edges | None] = {}
        if weighed and not self.locked:
            measured[EdgeKind.STRIPS] = points_along(strip, self._spread)
        evidence: dict[EdgeKind, float] = {}
        if weighed or self.kinds.likeliest is EdgeKind.STEP:
            edges, odds = self._find_steps(view, strip, weighed=weighed)
            measured[EdgeKind.STEP], evidence[EdgeKind.STEP] = edges, odds
        if width < LINES.max_width and (weighed or self.kinds.likeliest is EdgeKind.LINE):
            by_colour = measured.get(EdgeKind.STEP) if self._look.coloured else None
            known = by_colour or (self._predicted() if weighed else None)
            lines = find_side_lines(view.frame, strip, known, coloured=bool(by_colour))
            measured[EdgeKind.LINE] = lines
            evidence[EdgeKind.LINE] = TRACK.lines_seen[lines is not None]
        if weighed:
            self.kinds.take_in(evidence)
            # Where the runway is too wide for lines to be looked for, steps must do.
            plain = self._look.coloured or width >= LINES.max_width
            distinct = measured.get(EdgeKind.LINE) or (plain and measured.get(EdgeKind.STEP))
            self.distinct += self._memory * (bool(distinct) - self.distinct)
        self.points = measured.get(self.kinds.likeliest)
        self.predicted = self.points is None
        if self.points is not None:
            self.shape.move_reference(float(np.array([0.3, 0.7]) @ end_rows(strip)))
            self.shape.update(self.points, view.sight.meeting if weighed else None)
        elif not self.locked:
            # Not replaced by another kind's, which would be elsewhere.
            self.points = self._predicted()
        exact = self.kinds.likeliest is not EdgeKind.STRIPS
        if weighed and exact and width > SHOULDERS.min_width:
            shown = shows_shoulders(view.frame, self.strip())
            seen, unseen, unknown = TRACK.shoulder_memory
            memory = unknown if shown is None else seen if shown else unseen
            self.shoulders += memory * (bool(shown) - self.shoulders)

    def _predicted(self) -> Edges:
        """Points along the edges as followed."""
        strip = self.strip()
        return points_along(strip, self._spread, self.shape.variances(end_rows(strip)))

    def _find_steps(self, view: View, strip: Strip, *, weighed: bool) -> tuple[Edges | None, float]:
        """The steps along both edges, if they are seen, and the log odds of that kind."""
        steps = self._look.find(view.frame, strip)
        if weighed and support(steps) < TRACK.plain_support:
            # Strips are found on an image that is the coarser the wider they are.
            coarse = self._look.find(view.frame, strip, far_off=True)
            if support(coarse) > support(steps) + TRACK.min_support:
                steps = self._look.find(view.frame, strip_along(coarse, strip))
        clear, width = support(steps), _width(strip)
        # Far away the clearest steps are those of lines, unless they have a colour.
        if width < TRACK.wide and not self._look.coloured:
            return None, TRACK.steps_away
        odds = TRACK.support_odds * (clear - TRACK.min_support)
        if self._look.coloured and width < TRACK.colour_width:
            odds += TRACK.colour_odds
        # Without strips that are weighed beside it, its place is no more than a guess.
        needed = TRACK.min_support if weighed and not self.locked else TRACK.plain_support
        return steps if clear > needed else None, odds
