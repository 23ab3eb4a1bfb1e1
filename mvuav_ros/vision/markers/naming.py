"""Names for the lights of a frame in which not all markers are where and as they should be."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from functools import partial
from itertools import compress, islice
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.markers.fault_detection import (
    DOUBT,
    GATE,
    MIN_AGREEING,
    MIN_FIRM,
    Consensus,
    FaultDetector,
)
from mvuav_ros.vision.markers.hypotheses import (
    CLUTTER_DENSITY,
    MISSED_COST,
    Landmarks,
    Prior,
    body_hypotheses,
    log_odds_of,
)
from mvuav_ros.vision.markers.initialization import MAX_AT_START
from mvuav_ros.vision.markers.lamps import Lamps
from mvuav_ros.vision.markers.lights import (
    Detection,
    Light,
    apart_from,
    are_close,
    by_size,
    candidates,
    coordinates,
    places_of,
)
from mvuav_ros.vision.markers.marker_memory import MIN_ODDS, Expectation, KnownMarker
from mvuav_ros.vision.markers.rig_view import Array, ViewState, WeakPerspective
from mvuav_ros.vision.markers.view_filter import ViewFilter
from mvuav_ros.vision.rig import MAX_NAMED

GATE_OF_FEW = 6.0  # `GATE` where too few are in sight for later frames to show it
MAX_WAYS = 1000
MAX_RETURNED = 10  # Lights among which a body that was out of sight is looked for
AppearanceCost = Callable[[int, Light], float]
"""What it costs to take a light for a marker by its looks: 0 where it may well be the marker."""
UNLIKELY_COST = 4.0
"""What a size or shape costs that no marker should have. It makes a way of naming improbable, and
not impossible: a marker that the frame cuts looks like that."""


def assign(
    expected: Mapping[int, Expectation], lights: Sequence[Light], appearance: AppearanceCost
) -> dict[int, Light]:
    """Name the lights that lie where exactly one marker is expected, and look like it.

    A marker is named where all ways of naming that cost little more than the best agree.
    """
    choices: list[tuple[int, dict[int, float]]] = []
    for marker, place in expected.items():
        near = {}
        for number, light in enumerate(lights):
            cost = ((light.x - place.x) ** 2 + (light.y - place.y) ** 2) / place.deviation**2
            unlike = appearance(marker, light) if cost <= GATE else math.inf
            if unlike < math.inf:
                near[number] = cost + unlike
        if near:
            choices.append((marker, near))
    ways = list(islice(_ways(choices), MAX_WAYS + 1))
    if len(ways) > MAX_WAYS:
        return {}
    least, best = min(ways, key=lambda pair: pair[0])
    probable = [way for cost, way in ways if cost < least + DOUBT]
    return {
        marker: lights[number]
        for marker, number in best.items()
        if all(way.get(marker) == number for way in probable)
        and not appearance(marker, lights[number])
    }


def _ways(
    choices: list[tuple[int, dict[int, float]]], taken: frozenset[int] = frozenset()
) -> Iterator[tuple[float, dict[int, int]]]:
    if not choices:
        yield 0.0, {}
        return
    (marker, near), *rest = choices
    for cost, way in _ways(rest, taken):
        yield cost + MISSED_COST, way
    for number, own in near.items():
        if number not in taken:
            for cost, way in _ways(rest, taken | {number}):
                yield cost + own, {marker: number, **way}


MIN_REACQUIRED = (2, 3)
"""Lights of a body that is found again, where all others are known to be no markers, and where some
may be none: two of those nearly always look like some two markers."""
MAX_HIDDEN = 2  # Markers of a body that may be hidden while it is looked for by an older filter
JOLT = (0.1, 0.05, 100.0, 100.0, 0.1, 0.1)
"""rad, logarithm and px (1 sigma): how far off that may be of roll, size, place and tilt."""
SAME_SPOT = 3.0  # Two markers closer than this (px) are one light
RARE_CLUTTER, KNOWN_CLUTTER = 0.1, 0.3
"""Strange lights where none was seen in the last seconds, over those where some are about; and
beside those that are known where all may be."""


class Reacquired(NamedTuple):
    """A body that was found again."""

    view: ViewState  # fitted to its lights
    lights: Mapping[int, Light]  # by marker
    odds: Mapping[int, float]  # logarithms, of these names, by all ways of naming the lights

    @property
    def is_sure(self) -> bool:
        """Whether a name is probable enough to be reported; if not, no view may follow it."""
        return max(self.odds.values()) >= MIN_ODDS


def reacquire(
    shape: WeakPerspective,
    prior: Prior,
    lights: Sequence[Light],
    appearance: AppearanceCost,
    clutter: float = CLUTTER_DENSITY,
    fewest: int = MIN_REACQUIRED[0],
    landmarks: Landmarks | None = None,
) -> Reacquired | None:
    """Find a body again of which too little is in sight where it was expected.

    The fewest of its markers must be among the lights, beside so much clutter per px². Landmarks,
    such as lamps, speak for or against a view as well.
    """
    hypotheses = body_hypotheses(shape, lights, prior, fewest, clutter, landmarks)
    likely = [
        one for one in hypotheses if not any(appearance(m, lights[i]) for m, i in one.assignment)
    ]
    if not likely:
        return None
    best, *others = likely
    names, own = {*best.assignment}, {light for _, light in best.assignment}
    for other in others:
        is_same = own == {light for _, light in other.assignment}
        renames = is_same and names.isdisjoint(other.assignment)
        # Four markers in one plane are seen alike from its other side, in later frames as well.
        if renames and best.evidence - other.evidence < MIN_ODDS:
            return None
    odds = log_odds_of(best, hypotheses)
    named = {marker: lights[i] for marker, i in best.assignment if odds[marker] > 0.0}
    if len(named) < fewest:
        return None
    return Reacquired(best.view, named, {marker: odds[marker] for marker in named})


REMEMBERED = 150  # Frames for which lights may be clutter after one, or as many, have been seen
SETTLED = 30  # Frames in which none has come, after which all of it may be known
CLUTTER_STEP = 8.0  # px that clutter may move in a frame, as the camera shakes


class Clutter:
    """Lights that are where no marker can be, followed by their places: glares, for example."""

    def __init__(self) -> None:
        self._places: Array = np.empty((0, 2))  # px without distortion
        self._most = self._since_most = 0  # at once, and the frames since there were as many
        self._settled = 0  # frames since the last of it came

    @property
    def is_about(self) -> bool:
        """Whether there was any within the last seconds."""
        return self._most > 0

    @property
    def may_be_new(self) -> bool:
        """Whether other lights may be clutter as well: some is out of sight, or came lately."""
        return self.is_about and (len(self._places) < self._most or self._settled < SETTLED)

    def include(self, lights: Sequence[Light]) -> NDArray[np.bool_]:
        """Which lights are where some was in the last frame, or close by."""
        (x, y), (own_x, own_y) = coordinates(lights).T[..., None], self._places.T
        is_beside = (np.abs(x - own_x) < CLUTTER_STEP) & (np.abs(y - own_y) < CLUTTER_STEP)
        return np.asarray(is_beside.any(axis=1))

    def update(self, lights: Sequence[Light], expected: Mapping[int, Expectation] | None) -> None:
        """Take the lights of a frame that got no name, and where markers without one should be.

        What lies far from all of those is clutter. Where the body is out of sight (None), only what
        was clutter before is followed.
        """
        places, before = coordinates(lights), self.include(lights)
        is_clutter = before
        if expected is not None:
            x, y, deviation = np.array([*expected.values()]).reshape(-1, 3).T
            away = np.hypot(places[:, :1] - x, places[:, 1:] - y)
            is_clutter = before | (away >= CLUTTER_STEP + 4.0 * deviation).all(axis=1)
        self._settled = 0 if (is_clutter & ~before).any() else self._settled + 1
        self._places = places[is_clutter]
        self._since_most += 1
        if len(self._places) >= self._most or self._since_most >= REMEMBERED:
            self._most, self._since_most = len(self._places), 0


KNOWN_PLACE = 5.0  # px (1 sigma): where a marker's place is known better, even clutter may be it
TOUCHING = 3.0  # px beyond the edge of a light within which it may be a marker as well
LARGER = 1.2  # Times the area of the larger of two lights, or of both, which they have together
JOINED_PLACE = 1.5  # px (1 sigma), of the places of two markers that are known by their mean alone
BESIDE = 24.0
"""px within which another light may be taken for a marker that is not where it was expected."""


def _distances(lights: Sequence[Light], expected: Collection[Expectation]) -> Array:
    """(n,), of lights from the nearest place of a marker, squared and over the variance."""
    x, y, deviations = np.array([*expected]).reshape(-1, 3).T
    places = coordinates(lights)
    across, down = places[:, :1] - x, places[:, 1:] - y
    return np.asarray(((across * across + down * down) / deviations**2).min(axis=1))


class Search:
    """Names the lights of a frame by the body's geometry, some markers being known already."""

    def __init__(
        self,
        faults: FaultDetector,
        markers: Sequence[KnownMarker],
        consensus: Consensus,
        found: Mapping[int, Light],
    ) -> None:
        """Begin with the markers found so far, without those that a consensus drops."""
        self.found = {index: found[index] for index in (*consensus.kept, *consensus.suspects)}
        # Those of the found of which one or some must be another light.
        self.suspects = set(consensus.suspects)
        # What speaks against each marker; another one where others have taken all names.
        self.faults = faults
        self.views = faults.views  # at this frame's time
        self.reacquired: Mapping[int, float] = {}  # log odds of the markers found again together
        self._every: Sequence[Light] = ()  # lights of the frame
        self.lamps: list[Light] = []  # lights that are lamps (see `Lamps`)
        self.alone: set[int] = set()  # markers beside whose lights no other light is near
        self._known: tuple[int, ...] = tuple(self.found)
        self._doubtful = faults.doubtful
        self._markers = markers
        self._view = consensus.view()
        self._expected: list[Expectation] = []  # of all markers, by this view:
        self._expected_by: ViewState | None = None

    @property
    def given(self) -> set[int]:
        """The markers that have got their lights in this frame, by the geometry alone."""
        return self.found.keys() - set(self._known)

    @property
    def missing(self) -> list[int]:
        """The markers without a light."""
        return [index for index in range(len(self._markers)) if index not in self.found]

    @property
    def landmarks(self) -> int:
        """Lamps that show whether the names are right; one name alone may be a lamp's."""
        return len(self.lamps) if len(self.found) > 1 else 0

    def name(
        self, lights: Sequence[Light], clutter: Clutter, lamps: Lamps, older: ViewFilter
    ) -> None:
        """Name the lights of a frame; the older filter is that which last had enough firm names."""
        self._clutter, self._known_lamps, self._every = clutter, lamps, lights
        if lamps.are_known:
            self._find_lamps()
        lights = [light for light in lights if light not in self.lamps]
        self._free = apart_from(lights, [*self.found.values()])
        if not self.suspects:
            self._name_clear()
            if len(self.found) >= 2 and len(self.missing) >= 2:
                self._name_joined()
        # Names from before, unless all markers have theirs; of three no two show the third one.
        firm, count = self.found.keys() - self._doubtful, len(self._markers)
        if len(firm) < count and count > MIN_FIRM:
            firm -= self.given
        if len(firm) < MIN_FIRM:
            self._find_again()
        self._check()
        self.alone = {
            marker
            for marker, own in self.found.items()
            if sum(are_close(own, light, BESIDE) for light in lights) <= 1
        }
        named = list(self.found.values())
        nameless = [light for light in self._free if light not in named]
        known = len(self.found) >= min(3, len(self._markers))
        clutter.update(nameless, self.expected(self.missing) if known else None)
        few = len(self.reacquired) < MIN_FIRM
        if not self.found or (nameless and self.missing and few):
            self._find_otherwise(lights, older)

    def _find_lamps(self) -> None:
        """Distinguish lamps from markers; they show the view where few markers do."""
        shape, near = self.views.shape, self.expected([*self.found])
        # A marker's light hides a lamp that is close by.
        lights = [light for light in self._every if not self._inside(light, near)]
        seen = self._known_lamps.find(shape, self._view, lights)
        if not seen:
            return
        if len(self.found.keys() - self.suspects - self._doubtful) < MIN_AGREEING:
            correction = self._known_lamps.correction(shape, self.views.belief, seen)
            if correction is None:
                return
            self.views.anchor(correction)
        self.lamps = [*seen.values()]
        kept = apart_from([*self.found.values()], self.lamps)
        self.found = {m: light for m, light in self.found.items() if light in kept}
        self.suspects &= self.found.keys()
        self._known = tuple(self.found)
        self._view = self.views.look(places_of(self.found))

    def learn_lamps(self) -> None:
        """Follow the lamps among the lights, if there are any and the view is in no doubt."""
        firm = self.found.keys() - self.suspects - self._doubtful
        if self._every and MIN_AGREEING <= len(firm) == len(self.found):
            lights = apart_from(self._every, [*self.found.values()])
            expected = self.expected(range(len(self._markers))).values()
            places = np.array([place[:2] for place in expected])
            whole = not self.missing
            self._known_lamps.learn(self.views.shape, self._view, lights, places, is_whole=whole)

    def _name_clear(self) -> None:
        """Name what is clear: each name makes the view, and so the rest, clearer."""
        least = self.views.deviation
        strange = {*compress(self._free, self._clutter.include(self._free))}
        while self._free and self.missing:
            places = self.expected(range(len(self._markers)))
            gates = {
                index: places[index]._replace(deviation=math.hypot(places[index].deviation, least))
                for index in self.missing
            }

            def unlike(index: int, light: Light, gates: dict[int, Expectation] = gates) -> float:
                if gates[index].deviation > KNOWN_PLACE and light in strange:
                    return math.inf
                return self._appearance_cost(index, light)

            free = []
            near = _distances(self._free, gates.values()) <= GATE
            for light in compress(self._free, near):
                inside = self._inside(light, places)
                areas = [self._markers[index].area for index in inside]
                # The lights of two markers may have run together.
                if len(inside) < 2 or light.seen.area <= LARGER * max(areas):
                    free.append(light)
            named = assign(gates, free, unlike)
            if not named:
                return
            self._take({**self.found, **named})

    def _inside(self, light: Light, places: Mapping[int, Expectation]) -> list[int]:
        reach = light.seen.radius + TOUCHING
        return [
            index
            for index, place in places.items()
            if math.hypot(light.x - place.x, light.y - place.y) < reach
        ]

    def _name_joined(self) -> None:
        """Name two markers whose lights have run together: where they are by their mean alone."""
        places = self.expected(self.missing)
        for light in self._free:
            pair = self._inside(light, places)
            if len(pair) != 2 or max(places[index].deviation for index in pair) > JOINED_PLACE:
                continue
            known = [self._markers[index] for index in pair]
            both = sum(marker.area for marker in known)
            if not LARGER * max(m.area for m in known) < light.seen.area < LARGER * both:
                continue
            first, second = (places[index] for index in pair)
            share = known[0].area / both
            off_x = light.x - share * first.x - (1.0 - share) * second.x
            off_y = light.y - share * first.y - (1.0 - share) * second.y
            for index, marker in zip(pair, known, strict=True):
                x, y = places[index].x + off_x, places[index].y + off_y
                # The lens bends both alike.
                u, v = light.seen.x + x - light.x, light.seen.y + y - light.y
                seen = Detection(u, v, round(marker.area), marker.spread)
                self.found[index] = Light(x, y, seen)
            self._free.remove(light)
            self._view = self.views.look(places_of(self.found))
            return

    def _take(self, found: dict[int, Light]) -> None:
        self.found = found
        self._view = self.views.look(places_of(found))
        named = list(found.values())
        self._free = [light for light in self._free if light not in named]

    def _find_again(self) -> None:
        """Name a body of which fewer markers than show each other's place are firm."""
        lights = [*self.found.values(), *self._free]
        new = self._unknown(lights)
        may_be_none, density = self._clutter.may_be_new, self._clutter_density(len(new))
        if self._clutter.is_about and not may_be_none:
            density *= KNOWN_CLUTTER
        prior, fewest = Prior.of(self.views), MIN_REACQUIRED[may_be_none]
        if len(new) > MAX_NAMED:
            fewest = MIN_AGREEING
        new = self._nearest(new, MAX_RETURNED)
        again = self._reacquire(self.views.shape, prior, new, density, fewest)
        if again is None:
            return
        self.suspects.clear()
        self.reacquired = again.odds
        self._free = lights
        self._take(dict(again.lights))
        away = max(self.faults.nis_of(places_of(self.found)).values())
        if again.is_sure and away > GATE and len(again.lights) >= MIN_AGREEING:
            self._begin(self.views.shape, again)
        self._name_clear()

    def _reacquire(
        self,
        shape: WeakPerspective,
        prior: Prior,
        lights: Sequence[Light],
        clutter: float,
        fewest: int,
    ) -> Reacquired | None:
        landmarks = partial(self._known_lamps.log_odds, shape, self._every)
        return reacquire(shape, prior, lights, self._appearance_cost, clutter, fewest, landmarks)

    def _unknown(self, lights: Sequence[Light]) -> list[Light]:
        """Those that are no known clutter."""
        return [*compress(lights, ~self._clutter.include(lights))]

    def _nearest(self, lights: Sequence[Light], most: int) -> list[Light]:
        """Those nearest to where markers are expected, if there are too many."""
        if len(lights) <= most:
            return [*lights]
        places = self.expected(range(len(self._markers))).values()
        return [lights[row] for row in _distances(lights, places).argsort()[:most].tolist()]

    def _clutter_density(self, lights: int) -> float:
        """Density of lights that are no markers, per px², of so many that may be."""
        usual = CLUTTER_DENSITY if self._clutter.is_about else RARE_CLUTTER * CLUTTER_DENSITY
        return max(usual, (lights - MAX_NAMED) / math.prod(self.views.shape.lens.size))

    def _find_otherwise(self, every: Sequence[Light], older: ViewFilter) -> None:
        """Find the body where names that may be those of other lights have bent the view."""
        count = len(self._markers)
        spots = by_size(every)
        few = len(spots) <= MAX_AT_START
        lights = candidates(spots, count) if few else self._unknown(spots)
        density = self._clutter_density(len(every) if few else len(lights))
        lights = self._nearest(lights, MAX_AT_START)
        is_firm = len(self.found.keys() - self.suspects - self._doubtful) >= MIN_FIRM
        holds = is_firm or (self.found and count > MIN_FIRM)
        if holds and len(lights) <= len(self.found):
            return
        prior = Prior.of(older, JOLT)
        # All of them among many lights: to look for others as well would stall the stream.
        hidden = MAX_HIDDEN if len(lights) <= MAX_NAMED else 0
        fewest = min(count, max(count - hidden, prior.fewest))
        if is_firm:
            fewest = max(fewest, len(self.found))
        again = self._reacquire(older.shape, prior, lights, density, fewest)
        if again is None or not again.is_sure:
            return
        if holds and not self._is_better(again):
            return
        shape = older.shape
        if shape.offsets is not None and len(again.lights) == count:
            places = np.array(list(places_of(again.lights).values()))
            shape = shape.with_offsets(again.view, places)
        self.found, self.suspects, self.reacquired = dict(again.lights), set(), again.odds
        self._begin(shape, again)

    def _begin(self, shape: WeakPerspective, again: Reacquired) -> None:
        """Follow a body that was found again from where it is: the filter has lost it."""
        self.views = ViewFilter(shape, again.view, self.views.time, self.views)
        self.faults, self._view = FaultDetector(self.views), self.views.view
        self._known = ()  # All names are given anew.

    def _is_better(self, again: Reacquired) -> bool:
        """Whether a body says more of the lights than the names found so far.

        It must name two markers more, or one and show that one of those names is wrong.
        """
        is_same = all(
            marker in again.lights and are_close(again.lights[marker], light, SAME_SPOT)
            for marker, light in self.found.items()
        )
        if len(again.lights) <= len(self.found) + is_same:
            return False
        # Of as many names: more of them make none of them more probable.
        best = sorted(again.odds.values())[-len(self.found) :]
        return sum(best) > sum(self._markers[marker].odds for marker in self.found)

    def _check(self) -> None:
        """Take back names that the others contradict, those given in this frame first."""
        newcomers = [marker for marker in self.found if marker not in self._known]
        few = len(self.found) < MIN_AGREEING < len(self._markers)
        while newcomers and len(self._known) >= 2:
            nis = self.faults.nis_of(places_of(self.found))
            if max(nis.values()) <= (GATE_OF_FEW if few else GATE):
                break
            worst = max(newcomers, key=lambda marker: nis[marker])
            newcomers.remove(worst)
            del self.found[worst]
        consensus = self.faults.weigh(places_of(self.found))
        for marker in consensus.dropped:
            del self.found[marker]
        self.suspects = set(consensus.suspects)
        self._view = consensus.view()

    def expected(self, markers: Collection[int]) -> dict[int, Expectation]:
        """Where markers should be by the view of those found so far, px without distortion."""
        if self._expected_by is not self._view:
            places, deviations = self.views.places(self._view)
            rows = zip(*places.T.tolist(), deviations.tolist(), strict=True)
            self._expected_by, self._expected = self._view, [Expectation(*row) for row in rows]
        return {index: self._expected[index] for index in markers}

    def _appearance_cost(self, index: int, light: Light) -> float:
        return 0.0 if self._markers[index].is_likely(light.seen) else UNLIKELY_COST
