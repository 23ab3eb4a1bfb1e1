"""Names for lights, or none where two names would fit: near their places, or by the rig alone."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations, islice, permutations, product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.markers.centroid import Detection
from mvuav_ros.vision.markers.fault_detection import TUNING as FAULTS
from mvuav_ros.vision.markers.initialization import DOUBT
from mvuav_ros.vision.markers.lights import are_close, places_of
from mvuav_ros.vision.markers.rig_view import ROLL, SCALE, Array, ViewState, X, Y
from mvuav_ros.vision.markers.view_filter import ViewFilter

GATE = 16.0  # Squared distance over variance at which a light is too far from a marker's place
NOTHING = GATE + DOUBT  # What it costs to leave a marker without a light
MAX_WAYS = 1000


class Expectation(NamedTuple):
    """Where a marker should be, px, and how sure that is (1 sigma, px)."""

    x: float
    y: float
    deviation: float


Fits = Callable[[int, Detection], bool]
"""Whether a marker may look like this spot."""


def assign(
    expected: Mapping[int, Expectation], spots: Sequence[Detection], fits: Fits
) -> dict[int, Detection]:
    """Name the spots that lie where exactly one marker is expected.

    All ways of giving the spots to the markers that ``fits`` does not rule out are weighed; a
    marker is named where every way that costs little more than the best gives it the same spot.
    """
    costs: dict[int, dict[int, float]] = {}
    for marker, place in expected.items():
        near = {}
        for number, spot in enumerate(spots):
            cost = ((spot.x - place.x) ** 2 + (spot.y - place.y) ** 2) / place.deviation**2
            if cost <= GATE and fits(marker, spot):
                near[number] = cost
        if near:
            costs[marker] = near
    if not costs:
        return {}
    ways = list(islice(_ways(list(costs.items())), MAX_WAYS + 1))
    if len(ways) > MAX_WAYS:
        return {}
    least = min(cost for cost, _ in ways)
    probable = [way for cost, way in ways if cost < least + DOUBT]
    named = {}
    for marker in costs:
        given = {way.get(marker) for way in probable}
        agreed = given.pop()
        if not given and agreed is not None:
            named[marker] = spots[agreed]
    return named


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


MAX_COST = 24.0
"""Squared residuals and distance from the prior over their variances, of a way that may be."""
MAX_REFITTED = 24
MAX_EXTENDED = 3
"""Lights without a name that are weighed together."""
MAX_PERMUTED = 7  # Markers of a rig, and lights, up to which all threes are tried
MAX_OF_THREE = 24
MAX_BENT = 0.15
"""By how much three markers may look distorted, in units of their size (1 sigma)."""
MAX_PAIRS = 300


def reacquire(
    views: ViewFilter, spots: Sequence[Detection], fits: Fits, fewest: int
) -> dict[int, Detection] | None:
    """Find a body again of which nothing is in sight where it was expected.

    Every pair of spots (px without distortion) is tried as every pair of markers, within what the
    time since the loss allows of roll, size and place. A marker is named where every way that is
    about as probable as the best names it so.

    Returns:
        The markers named, none of them where it is not clear which they are; None where no way of
        naming the fewest spots is possible.
    """
    if len(spots) < fewest:
        return {}
    # Of four lights and more some three nearly always look like three of the markers.
    fewest = max(fewest, min(FAULTS.min_agreeing, len(spots), len(views.shape.points)))
    ways = _similar_ways(views, spots, fits, fewest)
    ways = list(
        {_completed(views, way, view, spots, fits) for way, view in _refitted(views, ways, spots)}
    )
    agreed = _agreed(views, ways, spots)
    if agreed is None:
        return None
    return agreed if len(agreed) >= fewest else {}


def extend(
    views: ViewFilter,
    found: Mapping[int, Detection],
    spots: Sequence[Detection],
    fits: Fits,
) -> dict[int, Detection]:
    """The markers found, and more where those do not determine the others' places well.

    All ways of giving the spots without a name (px without distortion) to the missing markers are
    weighed, each by the view that follows; a marker is named where every way that is about as
    probable as the best does so.
    """
    known = tuple(zip(found, range(len(found)), strict=True))
    places, deviations = views.places(views.look(places_of(found)))
    near: dict[int, list[int]] = {}
    for number, spot in enumerate(spots[:MAX_EXTENDED], len(found)):
        apart = np.hypot(spot.x - places[:, 0], spot.y - places[:, 1])
        inside = apart < 4.0 * np.hypot(deviations, views.deviation)
        near[number] = [m for m in np.flatnonzero(inside).tolist() if m not in found]
        near[number] = [m for m in near[number] if fits(m, spot)]
    ways: list[Way] = [known]
    for number, markers in near.items():
        ways += [
            (*way, (marker, number))
            for way in ways
            for marker in markers
            if marker not in dict(way)
        ]
    every = [*found.values(), *spots]
    return _agreed(views, [tuple(sorted(way)) for way in ways], every) or {}


@dataclass(frozen=True)
class RecoveryTuning:
    """When lights that were not expected where they are get names.

    Chosen on seeds 0 to 11 of flights of bare lights (`mvuav_thesis.light_flights`).
    """

    # Lights that must fit at once: a single one that does not go with the others may as well be
    # another light.
    min_new: int = 2
    # Frames in a row that must name the lights alike, where they are as few as can decide.
    confirmed: int = 2
    same: float = 40.0  # px, within which a marker may move between two frames


RECOVERY = RecoveryTuning()


class Recovery:
    """Names more lights with the markers in sight by the rig alone, whatever the motion was."""

    def __init__(self) -> None:
        self._last: dict[int, Detection] = {}
        self._agreed = 0

    def name(
        self,
        views: ViewFilter,
        found: Mapping[int, Detection],
        spots: Sequence[Detection],
        fits: Fits,
    ) -> dict[int, Detection]:
        """The markers found, and spots without a name that fit the rig with them in one way only.

        Where any are named, the views have become as uncertain as that takes.
        """
        fewest = max(-(-FAULTS.min_free // 2), len(found) + RECOVERY.min_new)
        if len(found) + min(len(spots), MAX_EXTENDED) < fewest:
            self._agreed = 0
            return dict(found)
        before = views.belief
        views.inflate(FAULTS.free)
        named = extend(views, found, spots, fits)
        view = views.look(places_of(named))
        max_cost = FAULTS.fitting_few if len(named) <= fewest else FAULTS.fitting
        if len(named) < fewest or view.cost > max_cost:
            self._agreed = 0
        elif self._believes(named, fewest):
            return named
        views.belief = before
        return dict(found)

    def _believes(self, named: dict[int, Detection], fewest: int) -> bool:
        alike = named.keys() == self._last.keys() and all(
            are_close(spot, self._last[marker], RECOVERY.same) for marker, spot in named.items()
        )
        self._agreed = self._agreed + 1 if alike and self._agreed else 1
        self._last = named
        return len(named) > fewest or self._agreed >= RECOVERY.confirmed


def _agreed(
    views: ViewFilter, ways: Sequence[Way], spots: Sequence[Detection]
) -> dict[int, Detection] | None:
    """What all ways share that are about as probable as the best; None where no way is possible."""
    everything = len(views.shape.points)
    weighed = [
        (view.cost + NOTHING * (everything - len(way)), dict(way))
        for way, view in _refitted(views, ways, spots)
        if view.cost <= MAX_COST
    ]
    if not weighed:
        return None
    least = min(cost for cost, _ in weighed)
    probable = [way for cost, way in weighed if cost < least + DOUBT]
    first = min(weighed, key=lambda pair: pair[0])[1]
    agreed = {m: i for m, i in first.items() if all(way.get(m) == i for way in probable)}
    return {m: spots[i] for m, i in agreed.items()}


Way = tuple[tuple[int, int], ...]
"""Markers and the lights that they may be."""


def _refitted(
    views: ViewFilter, ways: Sequence[Way], spots: Sequence[Detection]
) -> list[tuple[Way, ViewState]]:
    """Ways of naming lights, each with the view that follows."""
    fitted: list[tuple[Way, ViewState]] = []
    for number in sorted({len(way) for way in ways}):
        same = [way for way in ways if len(way) == number][:MAX_REFITTED]
        seen = np.array([[marker for marker, _ in way] for way in same], np.intp)
        places = np.array([[(spots[i].x, spots[i].y) for _, i in way] for way in same])
        fits = views.fit(seen, places)
        fitted += [(way, fits.view(index)) for index, way in enumerate(same)]
    return fitted


def _completed(
    views: ViewFilter, way: Way, view: ViewState, spots: Sequence[Detection], fits: Fits
) -> Way:
    """A way with the lights that lie where its view has the other markers."""
    places, deviations = views.places(view)
    named = dict(way)
    for marker in range(len(places)):
        if marker in named:
            continue
        apart = [
            (math.hypot(spot.x - places[marker, 0], spot.y - places[marker, 1]), number)
            for number, spot in enumerate(spots)
            if number not in named.values() and fits(marker, spot)
        ]
        if apart and min(apart)[0] < 4.0 * math.hypot(deviations[marker], views.deviation):
            named[marker] = min(apart)[1]
    return tuple(sorted(named.items()))


def _similar_ways(
    views: ViewFilter, spots: Sequence[Detection], fits: Fits, fewest: int
) -> list[Way]:
    """Ways of naming spots in which the body has only been turned, grown and moved."""
    prior = views.view
    places = views.places()[0]
    flat = places[:, 0] + 1j * places[:, 1]
    seen = np.array([complex(spot.x, spot.y) for spot in spots])
    if len(seen) < 2:
        return []
    if len(seen) >= 3 and 3 <= len(flat) <= MAX_PERMUTED:
        ways = _ways_of_three(flat, seen, np.sqrt(np.diag(prior.covariance)))
        if fewest > 2 or ways:
            return [w for w in ways if all(fits(marker, spots[light]) for marker, light in w)]
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
        way = _nearest(t * flat + s, seen, reach, spots, fits)
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
    places: np.ndarray[tuple[int], np.dtype[np.complex128]],
    seen: np.ndarray[tuple[int], np.dtype[np.complex128]],
    reach: float,
    spots: Sequence[Detection],
    fits: Fits,
) -> Way:
    apart = np.abs(places[:, None] - seen)
    way = []
    taken: set[int] = set()
    for marker in np.argsort(apart.min(axis=1)).tolist():
        number = int(apart[marker].argmin())
        if apart[marker, number] <= reach and number not in taken and fits(marker, spots[number]):
            taken.add(number)
            way.append((marker, number))
    return tuple(sorted(way))
