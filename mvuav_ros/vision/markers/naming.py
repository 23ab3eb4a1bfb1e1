"""Names for the lights of a frame in which not all markers are where and as they should be."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from functools import lru_cache
from itertools import combinations, islice, permutations, product

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.markers.centroid import Detection
from mvuav_ros.vision.markers.fault_detection import TUNING as FAULTS
from mvuav_ros.vision.markers.fault_detection import Consensus, Evidence, FaultDetector
from mvuav_ros.vision.markers.initialization import DOUBT, Named
from mvuav_ros.vision.markers.lights import Light, are_close, places_of
from mvuav_ros.vision.markers.marker_memory import Expectation, KnownMarker
from mvuav_ros.vision.markers.rig_view import ROLL, SCALE, Array, ViewState, X, Y
from mvuav_ros.vision.markers.view_correction import NamedPlaces
from mvuav_ros.vision.markers.view_filter import ViewFilter

GATE = 16.0  # Squared distance over variance at which a light is too far from a marker's place
GATE_OF_FEW = 6.0  # The same where too few are in sight for later frames to show it
NOTHING = GATE + DOUBT  # What it costs to leave a marker without a light
MAX_WAYS = 1000
Fits = Callable[[int, Light], bool]
"""Whether a marker may look like this light."""


def assign(
    expected: Mapping[int, Expectation], lights: Sequence[Light], fits: Fits
) -> dict[int, Light]:
    """Name the lights that lie where exactly one marker is expected.

    All ways of giving the lights to the markers that ``fits`` does not rule out are weighed; a
    marker is named where every way that costs little more than the best gives it the same light.
    """
    costs: dict[int, dict[int, float]] = {}
    for marker, place in expected.items():
        near = {}
        for number, light in enumerate(lights):
            cost = ((light.x - place.x) ** 2 + (light.y - place.y) ** 2) / place.deviation**2
            if cost <= GATE and fits(marker, light):
                near[number] = cost
        if near:
            costs[marker] = near
    if not costs:
        return {}
    ways = list(islice(_ways(list(costs.items())), MAX_WAYS + 1))
    if len(ways) > MAX_WAYS:
        return {}
    return {marker: lights[number] for marker, number in _shared(ways).items()}


def _ways(
    choices: list[tuple[int, dict[int, float]]], taken: frozenset[int] = frozenset()
) -> Iterator[tuple[float, dict[int, int]]]:
    if not choices:
        yield 0.0, {}
        return
    (marker, near), *rest = choices
    for cost, way in _ways(rest, taken):
        yield cost + NOTHING, way
    for number, own in near.items():
        if number not in taken:
            for cost, way in _ways(rest, taken | {number}):
                yield cost + own, {marker: number, **way}


def _shared(ways: Sequence[tuple[float, dict[int, int]]]) -> dict[int, int]:
    """What all ways share that cost little more than the best."""
    least, best = min(ways, key=lambda pair: pair[0])
    probable = [way for cost, way in ways if cost < least + DOUBT]
    return {m: light for m, light in best.items() if all(w.get(m) == light for w in probable)}


MAX_COST = 24.0
"""Squared residuals and distance from the prior over their variances, of a way that may be."""
MAX_REFITTED = 24
MAX_PERMUTED = 7  # Markers of a rig, and lights, up to which all threes are tried
MAX_OF_THREE = 24
MAX_BENT = 0.15
"""By how much three markers may look distorted, in units of their size (1 sigma)."""
MAX_PAIRS = 300
Way = tuple[tuple[int, int], ...]
"""Markers and the lights that they may be."""


def reacquire(
    views: ViewFilter, lights: Sequence[Light], fits: Fits, fewest: int
) -> dict[int, Light] | None:
    """Find a body again of which nothing is in sight where it was expected.

    Every three of the lights (px without distortion) are tried as every three of the markers, or
    every two as every two, within what the time since the loss allows of roll, size and place. A
    marker is named where every way that is about as probable as the best names it so.

    Returns:
        The markers named, none of them where it is not clear which they are; None where no way of
        naming the fewest lights is possible.
    """
    if len(lights) < fewest:
        return {}
    # Of four lights and more some three nearly always look like three of the markers.
    everything = len(views.shape.points)
    fewest = max(fewest, min(FAULTS.min_agreeing, len(lights), everything))
    ways = _similar_ways(views, lights, fits, fewest)
    completed = {
        _completed(views, way, view, lights, fits) for way, view in _refitted(views, ways, lights)
    }
    weighed = [
        (view.cost + NOTHING * (everything - len(way)), dict(way))
        for way, view in _refitted(views, list(completed), lights)
        if view.cost <= MAX_COST
    ]
    if not weighed:
        return None
    agreed = {marker: lights[number] for marker, number in _shared(weighed).items()}
    return agreed if len(agreed) >= fewest else {}


def _refitted(
    views: ViewFilter, ways: Sequence[Way], lights: Sequence[Light]
) -> list[tuple[Way, ViewState]]:
    """Ways of naming lights, each with the view that follows."""
    fitted: list[tuple[Way, ViewState]] = []
    for number in sorted({len(way) for way in ways}):
        same = [way for way in ways if len(way) == number][:MAX_REFITTED]
        seen = np.array([[marker for marker, _ in way] for way in same], np.intp)
        places = np.array([[(lights[i].x, lights[i].y) for _, i in way] for way in same])
        fits = views.fit(NamedPlaces(seen, places.reshape(len(same), -1)))
        fitted += [(way, fits.view(index)) for index, way in enumerate(same)]
    return fitted


def _completed(
    views: ViewFilter, way: Way, view: ViewState, lights: Sequence[Light], fits: Fits
) -> Way:
    """A way with the lights that lie where its view has the other markers."""
    places, deviations = views.places(view)
    named = dict(way)
    for marker in range(len(places)):
        if marker in named:
            continue
        apart = [
            (math.hypot(light.x - places[marker, 0], light.y - places[marker, 1]), number)
            for number, light in enumerate(lights)
            if number not in named.values() and fits(marker, light)
        ]
        if apart and min(apart)[0] < 4.0 * math.hypot(deviations[marker], views.deviation):
            named[marker] = min(apart)[1]
    return tuple(sorted(named.items()))


def _similar_ways(views: ViewFilter, lights: Sequence[Light], fits: Fits, fewest: int) -> list[Way]:
    """Ways of naming lights in which the body has only been turned, grown and moved."""
    prior = views.view
    places = views.places()[0]
    flat = places[:, 0] + 1j * places[:, 1]
    seen = np.array([complex(light.x, light.y) for light in lights])
    if len(seen) < 2:
        return []
    if len(seen) >= 3 and 3 <= len(flat) <= MAX_PERMUTED:
        ways = _ways_of_three(flat, seen, np.sqrt(np.diag(prior.covariance)))
        if fewest > 2 or ways:
            return [w for w in ways if all(fits(marker, lights[light]) for marker, light in w)]
    reach = max(6.0, 0.15 * prior.scale)
    allowed = 3.0 * np.sqrt(np.diag(prior.covariance))
    a, b = np.triu_indices(len(flat), 1)
    i, j = (index.ravel() for index in np.indices((len(seen), len(seen))))
    i, j = i[i != j], j[i != j]
    turn = (seen[j] - seen[i])[None, :] / (flat[b] - flat[a])[:, None]
    shift = seen[i][None, :] - turn * flat[a][:, None]
    moved = turn * flat.mean() + shift - flat.mean()
    possible = np.abs(np.log(np.maximum(np.abs(turn), 1e-9))) < allowed[SCALE] + 0.15
    possible &= np.abs(np.angle(turn)) < min(allowed[ROLL], math.pi) + 0.1
    possible &= np.abs(moved) < math.hypot(allowed[X], allowed[Y]) + reach
    pair, seen_pair = np.nonzero(possible)
    tried: dict[Way, float] = {}
    for t, s in zip(turn[pair, seen_pair][:MAX_PAIRS], shift[pair, seen_pair], strict=False):
        way = _nearest(t * flat + s, seen, reach, lights, fits)
        if len(way) >= fewest:
            tried[way] = -len(way)
    return sorted(tried, key=lambda way: tried[way])


def _ways_of_three(
    flat: NDArray[np.complex128], seen: NDArray[np.complex128], deviations: Array
) -> list[Way]:
    """All likely ways of naming three lights, by the turn, growth and distortion that they take."""
    ways, chosen = _threes(len(flat), min(len(seen), MAX_PERMUTED))
    markers = flat[ways] - flat[ways].mean(axis=1, keepdims=True)
    lights = seen[chosen] - seen[chosen].mean(axis=1, keepdims=True)
    turn = (markers.conj() * lights).sum(axis=1) / (np.abs(markers) ** 2).sum(axis=1)
    bent = np.abs(lights - turn[:, None] * markers) ** 2
    bent = bent.sum(axis=1) / (np.abs(turn[:, None] * markers) ** 2).sum(axis=1)
    cost = (np.log(np.maximum(np.abs(turn), 1e-9)) / (deviations[SCALE] + 0.1)) ** 2
    cost += (np.angle(turn) / (deviations[ROLL] + 0.1)) ** 2 + bent / MAX_BENT**2
    best = [int(index) for index in np.argsort(cost)[:MAX_OF_THREE] if cost[index] < GATE]
    return [
        tuple(sorted(zip(ways[index].tolist(), chosen[index].tolist(), strict=True)))
        for index in best
    ]


@lru_cache(maxsize=32)
def _threes(markers: int, lights: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Three markers in any order, and three lights for them, (w, 3) each."""
    pairs = product(permutations(range(markers), 3), combinations(range(lights), 3))
    ways, chosen = zip(*pairs, strict=True)
    return np.array(ways), np.array(chosen)


def _nearest(
    places: NDArray[np.complex128],
    seen: NDArray[np.complex128],
    reach: float,
    lights: Sequence[Light],
    fits: Fits,
) -> Way:
    apart = np.abs(places[:, None] - seen)
    way = []
    taken: set[int] = set()
    for marker in np.argsort(apart.min(axis=1)).tolist():
        number = int(apart[marker].argmin())
        if apart[marker, number] <= reach and number not in taken and fits(marker, lights[number]):
            taken.add(number)
            way.append((marker, number))
    return tuple(sorted(way))


STRANGE = 3  # Frames without a name after which a light is clutter
REMEMBERED = 150  # Frames for which lights may be clutter after one has been seen
CLUTTER_STEP = 8.0  # px that clutter may move in a frame, as the camera shakes


class Clutter:
    """Lights that have stayed without a name for some frames: glares, not returning markers."""

    def __init__(self) -> None:
        self._seen: list[tuple[Light, int]] = []
        self._frames_without = REMEMBERED

    @property
    def is_about(self) -> bool:
        """Whether there was any within the last seconds."""
        return self._frames_without < REMEMBERED

    def include(self, light: Light) -> bool:
        """Whether a light has stood there, or close by, for long."""
        return any(age >= STRANGE and _is_beside(light, other) for other, age in self._seen)

    def update(self, lights: Sequence[Light], expected: Mapping[int, Expectation] | None) -> None:
        """Take the lights of a frame that got no name.

        What lies far from all places where markers without a light are expected is none. Where the
        body is out of sight (None), only what was clutter before is followed.
        """
        seen = []
        for light in lights:
            ages = [age for other, age in self._seen if _is_beside(light, other)]
            if expected is not None:
                near = any(_may_be_at(light, place) for place in expected.values())
                ages.append(0 if near else max(ages, default=0) + STRANGE)
            if ages:
                seen.append((light, max(ages)))
        self._seen = seen
        strange = any(age >= STRANGE for _, age in seen)
        self._frames_without = 0 if strange else self._frames_without + 1


def _is_beside(a: Light, b: Light) -> bool:
    return abs(a.x - b.x) < CLUTTER_STEP and abs(a.y - b.y) < CLUTTER_STEP


def _may_be_at(light: Light, place: Expectation) -> bool:
    reach = CLUTTER_STEP + 4.0 * place.deviation
    return math.hypot(light.x - place.x, light.y - place.y) < reach


KNOWN_PLACE = 5.0  # px (1 sigma): where a marker's place is known better, even clutter may be it
CERTAIN = 15.0
"""px (1 sigma): where every marker's place is known better, what lies far from all is clutter."""
TOUCHING = 3.0  # px beyond the edge of a light within which it may be a marker as well
LARGER = 1.2  # Times the area of the larger of two lights, or of both, which they have together
JOINED_PLACE = 1.5  # px (1 sigma), of the places of two markers that are known by their mean alone
BESIDE = 24.0
"""px within which another light may be taken for a marker that is not where it was expected."""
MAX_RETURNED = 10  # Lights among which a body that was out of sight is looked for


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
        self._known = tuple(self.found)
        self.faults = faults  # what speaks against each marker
        self.views = faults.views  # at this frame's time
        # Those of the found of which one or some must be another light.
        self.suspects = set(consensus.suspects)
        # Markers found again together, after hardly any was in sight.
        self.reacquired: set[int] = set()
        self.alone: set[int] = set()  # markers beside whose lights no other light is near
        self.unexplained = 0  # lights that may be markers and have no name
        # Whether lights without a name cannot be markers that return: false where it is only not
        # clear which they are.
        self.is_contradicted = True
        self._markers = markers
        self._view = consensus.view()
        self._was_certain = float(self.views.places()[1].max()) < CERTAIN

    @property
    def given(self) -> set[int]:
        """The markers that have got their lights in this frame, by the geometry alone."""
        return self.found.keys() - set(self._known)

    @property
    def missing(self) -> list[int]:
        """The markers without a light."""
        return [index for index in range(len(self._markers)) if index not in self.found]

    def name(self, lights: Sequence[Light], clutter: Clutter, fewest: int) -> int:
        """Give names to the lights of the frame; how many lights have none.

        A body that is out of sight is found again by the fewest markers or more.
        """
        self._clutter = clutter
        self._free = [
            light
            for light in lights
            if not any(are_close(light, own, own.seen.radius) for own in self.found.values())
        ]
        if not self.suspects:
            self._name_clear()
            if len(self.found) >= 2 and len(self.missing) >= 2:
                self._name_joined()
        if len(self.found) < 2:
            self._find_again(fewest)
        self._check()
        self.alone = {
            marker
            for marker, own in self.found.items()
            if sum(are_close(own, light, BESIDE) for light in lights) <= 1
        }
        named = list(self.found.values())
        nameless = [light for light in self._free if light not in named]
        known = len(self.found) >= min(3, len(self._markers)) or self._was_certain
        clutter.update(nameless, self.expected(self.missing) if known else None)
        self.unexplained = sum(not clutter.include(light) for light in nameless)
        return len(nameless)

    def _name_clear(self) -> None:
        """Name what is clear: each name makes the view, and so the rest, clearer."""
        least = self.views.deviation
        while self._free and self.missing:
            places = self.expected(range(len(self._markers)))
            gates = {
                index: places[index]._replace(deviation=math.hypot(places[index].deviation, least))
                for index in self.missing
            }
            free = [light for light in self._free if not self._is_joined(light, places)]

            def fits(index: int, light: Light, gates: dict[int, Expectation] = gates) -> bool:
                if gates[index].deviation > KNOWN_PLACE and self._clutter.include(light):
                    return False
                return self._is_likely(index, light)

            named = assign(gates, free, fits)
            if not named:
                return
            self._take({**self.found, **named})

    def _is_joined(self, light: Light, places: Mapping[int, Expectation]) -> bool:
        """Whether the lights of two markers have run together."""
        inside = self._inside(light, places)
        areas = [self._markers[index].area for index in inside]
        return len(inside) > 1 and light.seen.area > LARGER * max(areas)

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
            self._free = [other for other in self._free if other is not light]
            self._view = self.views.look(places_of(self.found))
            return

    def _take(self, found: dict[int, Light]) -> None:
        self.found = found
        self._view = self.views.look(places_of(found))
        named = list(found.values())
        self._free = [light for light in self._free if light not in named]

    def _find_again(self, fewest: int) -> None:
        """Name a body of which at most one marker is where it was expected."""
        lights = [*self.found.values(), *self._free]
        new = [light for light in lights if not self._clutter.include(light)][:MAX_RETURNED]
        fewest = max(fewest, 3) if self.found else fewest
        ways = reacquire(self.views, new, self._is_likely, fewest)
        self.is_contradicted = ways is None
        if ways:
            self.suspects.clear()
            self.reacquired = set(ways)
            self._free = lights
            self._take(ways)
            self._name_clear()

    def _check(self) -> None:
        """Take back names that the others contradict, those given in this frame first."""
        newcomers = [marker for marker in self.found if marker not in self._known]
        few = len(self.found) < FAULTS.min_agreeing < len(self._markers)
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
        if self.suspects and not consensus.kept:
            self.faults.inflate()

    def replace(self, faults: FaultDetector, named: Named) -> None:
        """Take the names of a body that was named afresh."""
        self.faults, self.views, self._view = faults, faults.views, faults.views.view
        self.found = dict(enumerate(named.lights))
        self.suspects = set()

    def finish(self) -> Evidence:
        """Keep the view of this frame; what the places found say for their names."""
        return self.faults.commit(places_of(self.found))

    def expected(self, markers: Collection[int]) -> dict[int, Expectation]:
        """Where markers should be by the view of those found so far, px without distortion."""
        places, deviations = self.views.places(self._view)
        x, y = places.T.tolist()
        by_view = deviations.tolist()
        return {i: Expectation(x[i], y[i], by_view[i]) for i in markers}

    def _is_likely(self, index: int, light: Light) -> bool:
        return self._markers[index].is_likely(light.seen)
