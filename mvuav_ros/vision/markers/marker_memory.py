"""What is remembered of each of a body's markers: its light, and where its motion takes it."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from mvuav_ros.vision.markers.centroid import Detection, Pull
from mvuav_ros.vision.markers.lights import Frame, Light, area_fits
from mvuav_ros.vision.markers.marker_results import NO_WINDOW, Window
from mvuav_ros.vision.markers.motion import MotionPredictor
from mvuav_ros.vision.markers.rig_view import Array


class Expectation(NamedTuple):
    """Where a marker should be, px, and how sure that is (1 sigma, px)."""

    x: float
    y: float
    deviation: float


@dataclass(frozen=True)
class JumpTuning:
    """When a light has jumped.

    Chosen on seeds 9500 to 9529, 9900 to 9929 and 9982 of `offline.evaluation.integrity_runs`.
    """

    fewest: int = 3  # lights whose middle one shows how all have moved
    deviations: float = 4.5  # of what is usual, from which on it has
    least: float = 0.03  # px, of what is usual at least
    alone: float = 0.5  # part of its jump by which all others must be nearer to their places
    learning: float = 0.05  # per frame, of what is usual
    forgetting: float = 0.9  # per frame, of the evidence of a jump
    most: float = 60.0  # evidence that a jump can be


JUMPS = JumpTuning()


class Jumps:
    """How far lights lie from where their own motion takes them, against what is usual."""

    def __init__(self) -> None:
        # That a marker's light is another one since a moment ago: the square of how many times
        # farther than usual it was.
        self.evidence: dict[int, float] = {}
        self._usual = 1.0
        self._frames = 1

    def update(self, away: Mapping[int, tuple[float, float]]) -> int | None:
        """Take from where its own motion takes each marker to where its light is, px.

        Returns:
            The marker whose light has jumped in this frame, if one has.
        """
        kept = {m: JUMPS.forgetting * evidence for m, evidence in self.evidence.items()}
        self.evidence = {m: evidence for m, evidence in kept.items() if evidence > 1.0}
        if len(away) < JUMPS.fewest:
            return None
        # What has shaken the camera has moved all of them.
        middle = len(away) // 2
        x, y = (sorted(values)[middle] for values in zip(*away.values(), strict=True))
        usual = math.hypot(self._usual, JUMPS.least)
        limit = JUMPS.deviations * usual
        apart = sorted((math.hypot(dx - x, dy - y), m) for m, (dx, dy) in away.items())
        farthest, marker = apart[-1]
        # Where others have moved oddly as well, it is the motion that was not foreseen.
        has_jumped = farthest > limit and apart[-2][0] < JUMPS.alone * farthest
        if has_jumped:
            jumped = min((farthest / usual) ** 2, JUMPS.most)
            self.evidence[marker] = max(self.evidence.get(marker, 0.0), jumped)
        mean = sum(min(distance, limit) for distance, _ in apart) / len(apart)
        self._frames += 1
        self._usual += max(JUMPS.learning, 1.0 / self._frames) * (mean - self._usual)
        return marker if has_jumped else None


@dataclass(frozen=True)
class ConfidenceTuning:
    """How the probability of a name follows what the places say.

    Chosen on seeds 20000 to 20008 of `tools/compare_markers.py`.
    """

    first: float = 5.0  # log odds of a name that is given to the whole body
    again: float = 2.5  # of one that is given back to a single marker
    # Of what a frame's place says, as the errors of following frames are alike.
    share: float = 0.5
    stolen: float = 2e-4  # probability per frame that another light takes a marker's place
    most: float = 9.0  # log odds


CONFIDENCE = ConfidenceTuning()

TYPICAL_AREA = (0.6, 1.6)
TYPICAL_SPREAD = 1.06
"""Area and spread over the light's usual ones within which nothing has happened to it."""
LIKELY_AREA = (0.3, 3.2)
LIKELY_SPREAD = 1.3
"""The same for a light that may be the marker after all."""
_LEARNING = 0.2  # Per frame, by which the usual area and spread follow the light
RETURNING = 2
"""Frames after its return in which a marker is named by the geometry: its motion, by which its
window is placed, is not known yet."""
SURE_PLACE = 2.0  # px (1 sigma): a place known this well stands in for a measurement
PROBATION = 15
"""Frames after a marker was out of sight or not alone in which its light may be another one."""
RING_EVERY = 3  # Frames in one of which a light's background is looked at
EDGE = 4.0  # px of dark that a window shows around a light
FORGOTTEN = 10  # Frames unseen after which a light's own motion says nothing any more


@dataclass(slots=True)
class KnownMarker:
    """What is remembered of one marker."""

    area: float  # of its light, usually, px
    spread: float  # the same; see `Detection`
    radius: float  # px
    pull: Pull | None = None  # of its background, px
    last_seen: float = -math.inf  # s
    unseen: int = 0  # frames since then
    returning: int = RETURNING  # frames until its motion is known again
    untrusted: int = 0  # frames in which its light may be another one
    odds: float = CONFIDENCE.first  # of its name, their logarithm

    @property
    def confidence(self) -> float:
        """Probability of its name."""
        return 1.0 / (1.0 + math.exp(-self.odds))

    def weigh(self, ratio: float) -> None:
        """Bayes's rule with a log ratio of likelihoods, after a frame in which it may be stolen."""
        kept = (1.0 - CONFIDENCE.stolen) / (1.0 + math.exp(-self.odds))
        odds = math.log(kept / (1.0 - kept)) + CONFIDENCE.share * ratio
        self.odds = min(max(odds, -CONFIDENCE.most), CONFIDENCE.most)

    def learn(self, spot: Detection) -> None:
        """Follow slow changes of its light, as of the distance."""
        self.area += _LEARNING * (spot.area - self.area)
        self.spread += _LEARNING * (spot.spread - self.spread)
        self.radius = math.sqrt(self.area / math.pi)

    def is_usual(self, spot: Detection) -> bool:
        """Whether nothing has happened to its light."""
        _, _, area, spread = spot
        return (
            TYPICAL_AREA[0] * self.area <= area <= TYPICAL_AREA[1] * self.area + 4
            and spread <= TYPICAL_SPREAD * self.spread + 1.0 / area
        )

    def is_likely(self, spot: Detection) -> bool:
        """Whether it may be its light."""
        # Of a light of few pixels one more or less is nothing.
        if not LIKELY_AREA[0] * self.area - 2 <= spot.area <= LIKELY_AREA[1] * self.area + 6:
            return False
        return spot.spread <= max(LIKELY_SPREAD * self.spread, 1.0) + 2.0 / spot.area


class MarkerMemory:
    """All of a body's markers."""

    def __init__(self, time: float, lights: Sequence[Light], probation: int = PROBATION) -> None:
        """Begin with all of them, at a time (s).

        In so many frames after a doubt a marker's light may be another one.
        """
        spots = [light.seen for light in lights]
        self.markers = [KnownMarker(float(s.area), s.spread, s.radius) for s in spots]
        self.predictor = MotionPredictor(len(spots))  # of their motions
        self.jumps = Jumps()  # of their lights
        self._probation = probation
        self.predict(time)
        self.remember(time, dict(enumerate(spots)), {}, {})

    @property
    def newest(self) -> float:
        """When a marker was last seen, s."""
        return max(marker.last_seen for marker in self.markers)

    @property
    def untrusted(self) -> set[int]:
        """Markers whose lights may be others."""
        return {index for index, marker in enumerate(self.markers) if marker.untrusted}

    def predict(self, time: float) -> None:
        """Go on to the next frame, s."""
        # x and y of every marker in turn in the newest frame, px, by its own motion; and where
        # those out of sight should be by all that is known.
        self.predicted = self.reported = self.predictor.predict(time)

    def tell(self, places: Array, deviations: Array) -> None:
        """Where the view has the markers (n, 2), px, and how surely (n,): better, or not."""
        own = self.predictor.deviations()
        self.reported = list(self.predicted)
        for index, marker in enumerate(self.markers):
            if marker.unseen and deviations[index] < own[index]:
                self.reported[2 * index : 2 * index + 2] = places[index].tolist()

    def look(self, frame: Frame) -> tuple[dict[int, Detection], list[Window]]:
        """The usual frame: the markers to which nothing has happened in their windows."""
        windows = [NO_WINDOW] * len(self.markers)
        looked: list[int] = []
        pulls: list[Pull | None] = []
        search_radius = frame.parameters.search_radius
        for index, known in enumerate(self.markers):
            if known.unseen or known.returning:
                continue
            x, y = self.predicted[2 * index], self.predicted[2 * index + 1]
            radius = max(search_radius, math.ceil(known.radius + EDGE))
            windows[index] = Window.around(x, y, radius, frame.size)
            looked.append(index)
            # The background changes slowly: it is looked at in turn.
            pulls.append(known.pull if (index + frame.number) % RING_EVERY else None)
        bounds = [windows[index] for index in looked]
        found = frame.meter.measure_all(frame.cut, bounds, frame.size, pulls)
        spots: dict[int, Detection] = {}
        for index, window, seen in zip(looked, bounds, found, strict=True):
            if seen is not None:
                known = self.markers[index]
                spot, known.pull = seen
                if _is_usual(known, spot, window, frame):
                    spots[index] = spot
        return spots, windows

    def watch(self, seen: Mapping[int, Detection]) -> None:
        """Doubt a marker whose light, px, is the only one not where its own motion takes it."""
        away = {
            m: (spot.x - self.predicted[2 * m], spot.y - self.predicted[2 * m + 1])
            for m, spot in seen.items()
        }
        jumped = self.jumps.update(away)
        if jumped is not None:
            self.markers[jumped].untrusted = self._probation

    def distrust(self, seen: Collection[int]) -> dict[int, int]:
        """Doubt those expected and not seen; for how many frames each was doubted before."""
        before: dict[int, int] = {}
        for index, known in enumerate(self.markers):
            if not (index in seen or (known.returning and not known.unseen)):
                before[index] = known.untrusted
                known.untrusted = self._probation
        return before

    def trust_again(self, doubted: Mapping[int, int], alone: Collection[int]) -> None:
        """Doubt those no more than before (see `distrust`) that were alone after all."""
        for index in doubted.keys() & set(alone):
            self.markers[index].untrusted = doubted[index]

    def trust(self, markers: Collection[int]) -> None:
        """Doubt these no longer, which were found again together."""
        for index in markers:
            self.markers[index].untrusted = 0

    def start_afresh(self) -> None:
        """All markers have got other names: their motions are not known, and none is in doubt."""
        for index, marker in enumerate(self.markers):
            marker.returning = RETURNING
            marker.untrusted = 0
            marker.odds = CONFIDENCE.first
            self.predictor.forget(index)

    def remember(
        self,
        time: float,
        spots: Mapping[int, Detection],
        expected: Mapping[int, Expectation],
        odds: Mapping[int, float],
        unverified: Collection[int] = (),
    ) -> None:
        """Learn from a frame's markers, px, and where those should be that have no light.

        The odds are what the places say for the names (see `Correction.log_odds`). Those found that
        the others cannot contradict are unverified.
        """
        positions: list[float | None] = []
        for index, marker in enumerate(self.markers):
            spot = spots.get(index)
            if spot is None:
                marker.unseen += 1
                place = expected[index]
                # Where the others leave no doubt, the filter goes on as if it had been seen.
                sure = place.deviation < SURE_PLACE
                positions += (place.x, place.y) if sure else (None, None)
                continue
            positions += (spot.x, spot.y)
            marker.learn(spot)
            marker.last_seen = time
            if marker.untrusted and index not in unverified:
                marker.untrusted -= 1
            if marker.returning:
                marker.returning -= 1
            if marker.unseen:
                marker.unseen = 0
                marker.odds = CONFIDENCE.again
                marker.returning = RETURNING
                if self.predictor.unseen(index) > FORGOTTEN:
                    self.predictor.forget(index)
            if index in odds:
                marker.weigh(odds[index])
        self.predictor.update(positions)


def _is_usual(known: KnownMarker, spot: Detection, window: Window, frame: Frame) -> bool:
    """Whether nothing has happened to a light, nor does the window cut it."""
    if not known.is_usual(spot) or not area_fits(spot.area, frame.parameters):
        return False
    x0, x1, y0, y1 = window
    right, bottom = frame.size[0] - 1, frame.size[1] - 1
    reach = known.radius + 1.0
    x, y = spot.x, spot.y
    cut_x = x - reach < x0 > 0 or x + reach > x1 < right
    return not (cut_x or y - reach < y0 > 0 or y + reach > y1 < bottom)
