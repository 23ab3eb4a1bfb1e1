"""What is remembered of each of a body's markers: its look, and where its motion takes it."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from statistics import median
from typing import NamedTuple

import numpy as np

from mvuav_ros.vision.markers.assignment import GATE, Expectation
from mvuav_ros.vision.markers.centroid import Detection
from mvuav_ros.vision.markers.lights import Frame, Lens, area_fits
from mvuav_ros.vision.markers.motion import MotionPredictor
from mvuav_ros.vision.markers.results import FAR_OFF, NO_WINDOW, Window
from mvuav_ros.vision.markers.rig_view import Array

TYPICAL_AREA = (0.6, 1.6)
TYPICAL_SPREAD = 1.06
"""Area and spread over the light's usual ones within which nothing has happened to it."""
LIKELY_AREA = (0.3, 3.2)
LIKELY_SPREAD = 1.3
"""The same for a spot that may be the marker after all."""
_MEMORY = 0.8
PLACE_NOISE = 0.5  # px (1 sigma): of a joined light's middle, and of a marker's place in its view
SURE_SIDE = 2.0
"""Deviations that the two must lie apart, so that it is clear which is on which side."""


class AppearanceModel:
    """A light's usual area (px) and spread (see `Detection`), and its background's pull (px)."""

    __slots__ = ('area', 'pull', 'radius', 'spread')

    def __init__(self, spot: Detection) -> None:
        self.area = float(spot.area)
        self.spread = spot.spread
        self.radius = spot.radius
        self.pull: tuple[float, float] | None = None

    def learn(self, spot: Detection) -> None:
        """Follow slow changes, as of the distance."""
        _, _, area, spread = spot
        if spread:
            self.area += (1 - _MEMORY) * (area - self.area)
            self.spread += (1 - _MEMORY) * (spread - self.spread)
            self.radius = math.sqrt(self.area / math.pi)

    def is_usual(self, area: int, spread: float) -> bool:
        """Whether nothing has happened to the light."""
        usual = self.area
        return (
            TYPICAL_AREA[0] * usual <= area <= TYPICAL_AREA[1] * usual + 4
            and spread <= TYPICAL_SPREAD * self.spread + 1.0 / area
        )

    def is_likely(self, spot: Detection) -> bool:
        """Whether it may be the light."""
        # Of a light of few pixels one more or less is nothing.
        if not LIKELY_AREA[0] * self.area - 2 <= spot.area <= LIKELY_AREA[1] * self.area + 6:
            return False
        return spot.spread <= max(LIKELY_SPREAD * self.spread, 1.0) + 2.0 / spot.area


def offset_in(
    spot: Detection, areas: tuple[float, float], places: Array, spread: Array
) -> tuple[float, float] | None:
    """From the first to the second of two markers that make up one light.

    The light's place is the mean of theirs, weighted by their areas. What is wrong with the
    expected places is mostly wrong with both alike, and that the light's place takes out (a
    Kalman filter's update).

    Args:
        spot: the light.
        areas: of the markers, px.
        places: (4,), expected, px.
        spread: (4, 4), the places' covariance, px².

    Returns:
        px, or None where the light is not where it should be, or the sides are not sure.
    """
    share = areas[0] / (areas[0] + areas[1])
    middle = np.hstack((share * np.eye(2), (1.0 - share) * np.eye(2)))
    spread = spread + PLACE_NOISE**2 * np.eye(4)
    innovation = np.array((spot.x, spot.y)) - middle @ places
    variance = middle @ spread @ middle.T + PLACE_NOISE**2 * np.eye(2)
    if innovation @ np.linalg.solve(variance, innovation) > GATE:
        return None
    gain = spread @ middle.T @ np.linalg.inv(variance)
    x0, y0, x1, y1 = (places + gain @ innovation).tolist()
    spread = spread - gain @ middle @ spread
    apart = np.hstack((-np.eye(2), np.eye(2)))
    widest = math.sqrt(max(float(np.linalg.eigvalsh(apart @ spread @ apart.T)[-1]), 0.0))
    sure = math.hypot(x1 - x0, y1 - y0) > SURE_SIDE * widest
    return (x1 - x0, y1 - y0) if sure else None


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
        x, y = (median(values) for values in zip(*away.values(), strict=True))
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
        self._usual += JUMPS.learning * (mean - self._usual)
        return marker if has_jumped else None


RETURNING = 2
"""Frames after its return in which a marker is named by the geometry: its motion, by which its
window is placed, is not known yet."""
KNOWN_PLACE = 5.0  # px (1 sigma): where a marker's place is known better, even clutter may be it
SURE_PLACE = 2.0  # px (1 sigma): a place known this well stands in for a measurement
PROBATION = 15
"""Frames after a marker was out of sight or not alone in which its light may be another one."""
EDGE = 4.0  # px of dark that a window shows around a light
FORGOTTEN = 10  # Frames unseen after which a light's own motion says nothing any more


class Motion(NamedTuple):
    """What the markers' own motion says of a frame."""

    expected: Sequence[Expectation]  # where every marker should be, px without distortion
    unseen: Sequence[int]  # frames since each marker was seen; 0 where its motion is known

    def refine(self, index: int, by_view: Expectation) -> Expectation:
        """Where a marker should be by its own motion, if that says more than the view."""
        # The others show how the camera shakes; a marker's own motion does not, when it is old.
        unseen, far = self.unseen[index], by_view.deviation
        if unseen == 0 or (far > KNOWN_PLACE and unseen < FORGOTTEN):
            moved = self.expected[index]
            apart = math.hypot(moved.x - by_view.x, moved.y - by_view.y)
            if moved.deviation < far and apart < 3.0 * math.hypot(moved.deviation, far):
                return moved
        return by_view


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


@dataclass
class KnownMarker:
    """What is remembered of one marker."""

    look: AppearanceModel  # of its light
    last_seen: float = -math.inf  # s
    unseen: int = 0  # frames since then
    returning: int = RETURNING  # frames until its motion is known again
    untrusted: int = 0  # frames in which its light may be another one
    returned: int = 0  # frames in which it may be another one that shines in its place
    odds: float = CONFIDENCE.first  # of its name, their logarithm

    @property
    def confidence(self) -> float:
        """Probability of its name."""
        return 1.0 / (1.0 + math.exp(-self.odds))

    def weigh(self, ratio: float) -> None:
        """Bayes's rule with a log ratio of likelihoods, after a frame in which it may be stolen."""
        kept = self.confidence * (1.0 - CONFIDENCE.stolen)
        odds = math.log(kept / (1.0 - kept)) + CONFIDENCE.share * ratio
        self.odds = min(max(odds, -CONFIDENCE.most), CONFIDENCE.most)


class MarkerMemory:
    """All of a body's markers."""

    def __init__(self, time: float, spots: Sequence[Detection]) -> None:
        """Begin with all of them, at a time (s), px of the image."""
        self.markers = [KnownMarker(AppearanceModel(spot)) for spot in spots]  # in the rig's order
        self.predictor = MotionPredictor(len(spots))  # of their motions
        self.jumps = Jumps()  # of their lights
        self.predict(time)
        # x and y of every marker in turn in the newest frame, px, by its own motion; and where
        # those out of sight should be by all that is known.
        self.predicted = self.reported = [math.nan] * (2 * len(spots))
        self.remember(time, spots, {}, {})

    @property
    def looks(self) -> list[AppearanceModel]:
        """Of every marker's light."""
        return [marker.look for marker in self.markers]

    @property
    def newest(self) -> float:
        """When a marker was last seen, s."""
        return max(marker.last_seen for marker in self.markers)

    @property
    def untrusted(self) -> set[int]:
        """Markers whose lights may be others."""
        return {index for index, marker in enumerate(self.markers) if marker.untrusted}

    @property
    def returned(self) -> set[int]:
        """Markers that were out of sight shortly before, or are."""
        return {index for index, marker in enumerate(self.markers) if marker.returned}

    def predict(self, time: float) -> None:
        """Go on to the next frame, s."""
        self.predicted = self.reported = self.predictor.predict(time)

    def tell(self, places: Array, deviations: Array) -> None:
        """Where the view has the markers (n, 2), px, and how surely (n,): better, or not."""
        own = self.predictor.deviations()
        self.reported = list(self.predicted)
        for index, marker in enumerate(self.markers):
            if marker.unseen and deviations[index] < own[index]:
                self.reported[2 * index : 2 * index + 2] = places[index].tolist()

    def motion(self, lens: Lens) -> Motion:
        """What the markers' own motion says of the newest frame."""
        flat = np.array(self.predicted).reshape(-1, 2)
        places = lens.to_ideal(np.where(np.abs(flat) < FAR_OFF, flat, 0.0)).tolist()
        deviations = self.predictor.deviations().tolist()
        return Motion(
            [Expectation(x, y, d) for (x, y), d in zip(places, deviations, strict=True)],
            [max(marker.unseen, marker.returning) for marker in self.markers],
        )

    def look(self, frame: Frame) -> tuple[list[Detection | None], list[Window]]:
        """The usual frame: the markers to which nothing has happened in their windows, or None."""
        windows: list[Window] = []
        spots: list[Detection | None] = []
        for index, marker in enumerate(self.markers):
            spot = None
            window = NO_WINDOW
            if not (marker.unseen or marker.returning):
                look = marker.look
                radius = max(frame.parameters.search_radius, math.ceil(look.radius + EDGE))
                x, y = self.predicted[2 * index], self.predicted[2 * index + 1]
                window = Window.around(x, y, radius, frame.size)
                # The background changes slowly: every third frame is enough to look at it.
                pull = look.pull if (index + frame.number) % 3 else None
                spot = frame.meter.measure(frame.cut, window, frame.size, pull)
                if pull is None:
                    look.pull = frame.meter.pull
                if spot is not None and not _is_usual(look, spot, window, frame):
                    spot = None
            windows.append(window)
            spots.append(spot)
        return spots, windows

    def watch(self, seen: Mapping[int, Detection]) -> None:
        """Doubt a marker whose light, px, is the only one not where its own motion takes it."""
        away = {
            m: (spot.x - self.predicted[2 * m], spot.y - self.predicted[2 * m + 1])
            for m, spot in seen.items()
        }
        jumped = self.jumps.update(away)
        if jumped is not None:
            self.markers[jumped].untrusted = PROBATION

    def distrust(self, seen: Mapping[int, Detection]) -> dict[int, int]:
        """Doubt those expected and not seen; for how many frames each was doubted before."""
        before: dict[int, int] = {}
        for index, known in enumerate(self.markers):
            if not (index in seen or (known.returning and not known.unseen)):
                before[index] = known.untrusted
                known.untrusted = PROBATION
        return before

    def trust_again(self, doubted: Mapping[int, int], alone: Collection[int]) -> None:
        """Doubt those no more than before (see `distrust`) that were alone after all."""
        for index in doubted.keys() & set(alone):
            self.markers[index].untrusted = doubted[index]

    def trust(self, markers: Collection[int]) -> None:
        """Doubt these no longer, which were found again together."""
        for index in markers:
            self.markers[index].untrusted = self.markers[index].returned = 0

    def start_afresh(self) -> None:
        """All markers have got other names: their motions are not known, and none is in doubt."""
        for index, marker in enumerate(self.markers):
            marker.returning = RETURNING
            marker.untrusted = marker.returned = 0
            marker.odds = CONFIDENCE.first
            self.predictor.forget(index)

    def remember(
        self,
        time: float,
        spots: Sequence[Detection | None],
        expected: Mapping[int, Expectation],
        odds: Mapping[int, float],
        unverified: Collection[int] = (),
    ) -> None:
        """Learn from a frame's spots of all markers, and where those should be that have none.

        The odds are what the places say for the names (see `Correction.log_odds`). Those found that
        the others cannot contradict are unverified.
        """
        positions: list[float | None] = []
        for index, (marker, spot) in enumerate(zip(self.markers, spots, strict=True)):
            if spot is None:
                marker.unseen += 1
                marker.returned = PROBATION
                place = expected[index]
                # Where the others leave no doubt, the filter goes on as if it had been seen.
                sure = place.deviation < SURE_PLACE
                positions += (place.x, place.y) if sure else (None, None)
                continue
            positions += (spot.x, spot.y)
            marker.look.learn(spot)
            marker.last_seen = time
            if index not in unverified:
                marker.untrusted = max(marker.untrusted - 1, 0)
                marker.returned = max(marker.returned - 1, 0)
            marker.returning = max(marker.returning - 1, 0)
            if marker.unseen:
                marker.unseen = 0
                marker.odds = CONFIDENCE.again
                marker.returning = RETURNING
                if self.predictor.unseen(index) > FORGOTTEN:
                    self.predictor.forget(index)
            if index in odds:
                marker.weigh(odds[index])
        self.predictor.update(positions)


def _is_usual(look: AppearanceModel, spot: Detection, window: Window, frame: Frame) -> bool:
    """Whether nothing has happened to a light, nor does the window cut it."""
    if not look.is_usual(spot.area, spot.spread) or not area_fits(spot.area, frame.parameters):
        return False
    x0, x1, y0, y1 = window
    right, bottom = frame.size[0] - 1, frame.size[1] - 1
    reach = look.radius + 1.0
    x, y = spot.x, spot.y
    cut_x = x - reach < x0 > 0 or x + reach > x1 < right
    return not (cut_x or y - reach < y0 > 0 or y + reach > y1 < bottom)
