"""What is remembered of each of a body's markers: its light, and where its motion takes it."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import NamedTuple

from mvuav_ros.vision.markers.fault_detection import MIN_AGREEING, MIN_FIRM, Evidence
from mvuav_ros.vision.markers.lights import Detection, Frame, Light, Pull, area_fits
from mvuav_ros.vision.markers.marker_results import NO_WINDOW, Window
from mvuav_ros.vision.markers.motion import MotionPredictor


class Expectation(NamedTuple):
    """Where a marker should be, px, and how sure that is (1 sigma, px)."""

    x: float
    y: float
    deviation: float


UNKNOWN = Expectation(math.nan, math.nan, math.inf)


# When a light has jumped. Chosen on seeds 9500 to 9529, 9900 to 9929 and 9982 of
# `mvuav_thesis.integrity_runs`.

MIN_MOVING = 3  # lights whose middle one shows how all have moved
JUMP_DEVIATIONS = 4.5  # of what is usual, from which on it has
MIN_TYPICAL = 0.04  # px, of that at least: `MAX_PULL` comes and goes with the background
ALONE = 0.5  # part of its jump by which all others must be nearer to their places
JUMP_LEARNING = 0.05  # per frame, of what is usual
JUMP_FORGETTING = 0.9  # per frame, of the evidence of a jump
MAX_JUMP = 60.0  # evidence that a jump can be


class Jumps:
    """How far lights lie from where their own motion takes them, against what is usual."""

    def __init__(self) -> None:
        # That a marker's light is another one since a moment ago: the square of how many times
        # farther than usual it was.
        self.evidence: dict[int, float] = {}
        self._usual = 1.0
        self._frames = 1

    def update(self, away: Mapping[int, tuple[float, float]]) -> int | None:
        """The marker whose light has jumped, by how far (px) each is from where its motion goes."""
        faded = {m: JUMP_FORGETTING * evidence for m, evidence in self.evidence.items()}
        self.evidence = {m: evidence for m, evidence in faded.items() if evidence > 1.0}
        if len(away) < MIN_MOVING:
            return None
        # What has shaken the camera has moved all of them.
        across, down = zip(*away.values(), strict=True)
        x, y = sorted(across)[len(away) // 2], sorted(down)[len(away) // 2]
        apart = [math.hypot(dx - x, dy - y) for dx, dy in away.values()]
        usual = math.hypot(self._usual, MIN_TYPICAL)
        limit = JUMP_DEVIATIONS * usual
        mean = sum([d if d < limit else limit for d in apart]) / len(apart)
        self._frames += 1
        self._usual += max(JUMP_LEARNING, 1.0 / self._frames) * (mean - self._usual)
        second, farthest = sorted(apart)[-2:]
        # Where others have moved oddly as well, it is the motion that was not foreseen.
        if farthest <= limit or second >= ALONE * farthest:
            return None
        marker = list(away)[apart.index(farthest)]
        jumped = min((farthest / usual) ** 2, MAX_JUMP)
        self.evidence[marker] = max(self.evidence.get(marker, 0.0), jumped)
        return marker


# How the probability of a name follows what the places say. Chosen on seeds 20000 to 20008 of
# `tools/compare_markers.py`.

FIRST_ODDS = 5.0  # log odds of a name that is given to the whole body
MIN_ODDS = 2.0  # log odds, below which a name is withheld (probability 0.88)
# Probability that another light is close to a marker's place: where one has been out of sight
# and lights are about that are no markers, where none are, where it was seen a frame ago, and
# where it was as one of those that stay when the others go (seeds 27580 to 27595).
ANOTHER_BESIDE = (0.5, 0.08, 0.01, 0.15)
# Of lights that are no markers, per px²: where some are about, and where none are.
STRANGE_DENSITY = (1e-5, 1e-6)
# Of what a frame's place says, as the errors of following frames are alike; times the
# redundancy, as what only goes on as before may be a light that was taken for the marker.
FRAME_SHARE = 0.5
STOLEN = 2e-4  # probability per frame that another light takes a marker's place
MIN_HELD_ODDS = -2.0  # log odds, of a name that is still held
MAX_ODDS = 9.0

TYPICAL_AREA, TYPICAL_SPREAD = (0.6, 1.6), 1.06
"""Area and spread over the light's usual ones within which nothing has happened to it."""
LIKELY_AREA, LIKELY_SPREAD = (0.3, 3.2), 1.3
"""The same for a light that may be the marker after all."""
SPECK = 0.1  # Of the smallest marker's usual area: what is smaller is none, however it dims
_LEARNING = 0.2  # Per frame, by which the usual area and spread follow the light
RETURNING = 2
"""Frames after its return in which a marker is named by the geometry: its motion, by which its
window is placed, is not known yet."""
SURE_PLACE = 2.0  # px (1 sigma): a place known this well stands in for a measurement
PROBATION, UNCHECKED = 15, 45
"""Frames after a marker was out of sight or not alone in which its light may be another one; where
no other light could show it."""
RING_EVERY = 3  # Frames in one of which a light's background is looked at
EDGE = 4.0  # px of dark that a window shows around a light


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
    odds: float = FIRST_ODDS  # of its name, their logarithm

    @property
    def confidence(self) -> float:
        """Probability of its name."""
        return 1.0 / (1.0 + math.exp(-self.odds))

    def weigh(self, ratio: float) -> None:
        """Bayes's rule with a log ratio of likelihoods, after a frame in which it may be stolen."""
        kept = (1.0 - STOLEN) / (STOLEN + math.exp(-self.odds))
        odds, least, most = math.log(kept) + ratio, MIN_HELD_ODDS, MAX_ODDS
        # Conditions, as min and max take several times as long.
        self.odds = least if odds < least else most if odds > most else odds

    def give(
        self, own: float, other: float, others: bool, followed: bool, left: bool = False
    ) -> None:
        """Bayes's rule for a light that has been given the name by its place.

        The logarithms of its densities are its own and that of another light close by, per px².
        Others are about; it was followed to this frame in no doubt; it is left of those that were.
        """
        among_others, alone, usual, staying = ANOTHER_BESIDE
        beside = among_others if others else alone
        if followed:
            beside = staying if left else usual
        anywhere = STRANGE_DENSITY[0 if others else 1]
        odds = own - math.log(beside * math.exp(other) + anywhere)
        odds = min(odds, FIRST_ODDS if self.unseen else self.odds)
        self.odds = max(odds, MIN_HELD_ODDS)

    def learn(self, spot: Detection) -> None:
        """Follow slow changes of its light, as of the distance."""
        _, _, area, spread = spot
        self.area += _LEARNING * (area - self.area)
        self.spread += _LEARNING * (spread - self.spread)
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

    def __init__(
        self, time: float, lights: Mapping[int, Light], count: int, is_redundant: bool = True
    ) -> None:
        """Begin at a time (s) with lights of so many; in a redundant body a wrong one can show."""
        spots = {marker: light.seen for marker, light in lights.items()}
        # One that has not been seen yet may look like any other.
        usual = sorted(spots.values(), key=lambda spot: spot.area)[len(spots) // 2]
        every = [spots.get(marker, usual) for marker in range(count)]
        self.markers = [KnownMarker(float(s.area), s.spread, s.radius) for s in every]
        self.predictor = MotionPredictor(count)  # of their motions
        self.jumps = Jumps()  # of their lights
        self._is_redundant = is_redundant
        self._probation = PROBATION if is_redundant else UNCHECKED
        self._was_checked = True  # whether there were enough of them to check each other
        self.predict(time)
        self.remember(time, spots, dict.fromkeys(range(count), UNKNOWN))

    @property
    def untrusted(self) -> set[int]:
        """Markers whose lights may be others."""
        return {index for index, marker in enumerate(self.markers) if marker.untrusted}

    def predict(self, time: float) -> None:
        """Go on to the next frame, s."""
        flat = self.predictor.predict(time)
        # Where each marker is in the newest frame, px, by its own motion.
        self.predicted = list(zip(flat[::2], flat[1::2], strict=True))

    def look(self, frame: Frame) -> tuple[dict[int, Detection], list[Window]]:
        """The usual frame: the markers to which nothing has happened in their windows.

        One whose light is the only one that has jumped is doubted.
        """
        windows: list[Window] = []
        pulls: list[Pull | None] = []
        least, size = frame.parameters.search_radius, frame.size
        for index, (known, (x, y)) in enumerate(zip(self.markers, self.predicted, strict=True)):
            window = NO_WINDOW
            if not (known.unseen or known.returning):
                window = Window.around(x, y, max(least, math.ceil(known.radius + EDGE)), size)
            windows.append(window)
            # The background changes slowly: it is looked at in turn.
            pulls.append(known.pull if (index + frame.number) % RING_EVERY else None)
        found = frame.meter.measure_all(windows, pulls)
        spots: dict[int, Detection] = {}
        for index, (known, seen) in enumerate(zip(self.markers, found, strict=True)):
            if seen is not None:
                spot, known.pull = seen
                fits = known.is_usual(spot) and area_fits(spot.area, frame.parameters)
                if fits and not _is_cut(spot, known.radius + 1.0, windows[index], size):
                    spots[index] = spot
        away = {}
        for index, (seen_x, seen_y, _, _) in spots.items():
            x, y = self.predicted[index]
            away[index] = seen_x - x, seen_y - y
        jumped = self.jumps.update(away)
        if jumped is not None:
            self.markers[jumped].untrusted = self._probation
        return spots, windows

    def distrust(self, seen: Collection[int]) -> dict[int, int]:
        """Doubt those expected and not seen; for how many frames each was doubted before."""
        before: dict[int, int] = {}
        for index, known in enumerate(self.markers):
            if not (index in seen or (known.returning and not known.unseen)):
                before[index] = known.untrusted
                known.untrusted = self._probation
        return before

    @property
    def least_area(self) -> float:
        """Px, of a light that may be a marker; rain, stars and noise are smaller."""
        return SPECK * min(marker.area for marker in self.markers)

    @property
    def doubtful(self) -> set[int]:
        """Markers whose names are too uncertain to be reported."""
        return {i for i, marker in enumerate(self.markers) if marker.odds < MIN_ODDS}

    def trust_again(self, doubted: Mapping[int, int], alone: Collection[int]) -> None:
        """Doubt those no more than before (see `distrust`) that were alone after all."""
        for index in doubted.keys() & set(alone):
            self.markers[index].untrusted = doubted[index]

    def trust(self, markers: Collection[int]) -> None:
        """Doubt these no longer, which were found again together."""
        # That says nothing of just enough lights: some view fits any of them.
        if self._is_redundant:
            for index in markers:
                self.markers[index].untrusted = 0

    def start_afresh(self) -> None:
        """All markers have got other names: their motions are not known, see also `trust`."""
        for index, marker in enumerate(self.markers):
            marker.returning = RETURNING
            marker.odds = FIRST_ODDS
            self.predictor.forget(index)
        self.trust(range(len(self.markers)))

    def remember(
        self, time: float, spots: Mapping[int, Detection], expected: Mapping[int, Expectation]
    ) -> None:
        """Learn from a frame's markers, px, and where those should be that have no light."""
        positions: list[float] = []
        for index, marker in enumerate(self.markers):
            spot = spots.get(index)
            if spot is None:
                marker.unseen += 1
                place = expected[index]
                # Where the others leave no doubt, the filter goes on as if it had been seen.
                sure = place.deviation < SURE_PLACE
                positions += (place.x, place.y) if sure else (math.nan, math.nan)
                continue
            positions += (spot.x, spot.y)
            marker.learn(spot)
            marker.last_seen = time
            if marker.returning:
                marker.returning -= 1
            if marker.unseen:
                marker.unseen = 0
                marker.returning = RETURNING
            if marker.untrusted and marker.odds >= MIN_ODDS:
                marker.untrusted -= 1
        self.predictor.update(positions)

    def weigh(
        self,
        seen: Collection[int],
        evidence: Evidence,
        given: Collection[int] = (),
        others: bool = False,
        found_again: Mapping[int, float] | None = None,
        landmarks: int = 0,
    ) -> None:
        """Follow the probabilities of the names by the evidence of their places.

        Some have been given in this frame by the geometry; others are lights that are no markers
        and about. Some names were found again together, with these log odds. So many landmarks,
        such as lamps, show the view as well.
        """
        usual = FRAME_SHARE * evidence.redundancy
        checked = len(seen) + landmarks >= MIN_AGREEING
        few = len(seen) + landmarks < MIN_FIRM
        # What four and more agree on, another light would contradict.
        among_others = others and not checked
        firm: set[int] = set()
        if among_others:
            unsure = self.doubtful | self.untrusted
            firm = {m for m in seen if m not in unsure and not self.markers[m].unseen}
        # Lights of following frames are the same, right or wrong: only another marker adds to them.
        again = found_again or {}
        joined = not (others or again.keys().isdisjoint(given))
        for index in seen:
            marker = self.markers[index]
            own, other = evidence.places.get(index, (0.0, 0.0))
            if not marker.unseen:
                # What could not be checked before is not like the frames before.
                is_new = checked and marker.odds < MIN_ODDS
                marker.weigh((1.0 if is_new else usual) * (own - other))
            # When the others go, the light of one that stays may be another one as well.
            left = among_others and self._was_checked and few
            if index in again:
                odds = min(max(again[index], MIN_HELD_ODDS), FIRST_ODDS)
                if index in given:
                    marker.odds = odds
                elif joined:
                    marker.odds = max(marker.odds, odds)
            elif index in given or left:
                followed = not (marker.untrusted or marker.unseen)
                # By fewer than two others hardly anything is known of its place.
                known = followed or not among_others or len(firm - {index}) >= 2
                marker.give(own if known else other, other, among_others, followed, left)
        self._was_checked = not few


def _is_cut(spot: Detection, reach: float, window: Window, size: tuple[int, int]) -> bool:
    """Whether a window cuts what lies so near to a light (px) and would be in the image."""
    x, y, _, _ = spot
    x0, x1, y0, y1 = window
    is_cut_across = x - reach < x0 > 0 or x + reach > x1 < size[0] - 1
    return is_cut_across or y - reach < y0 > 0 or y + reach > y1 < size[1] - 1
