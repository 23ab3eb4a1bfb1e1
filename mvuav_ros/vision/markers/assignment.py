"""Names for the lights of one frame, or none where two names would fit."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import lru_cache
from itertools import combinations, islice, permutations, product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.markers.acquisition import (
    ANY_ROLL,
    DOUBT,
    MAX_CANDIDATES,
    Guess,
    guess_start,
)
from mvuav_ros.vision.markers.blobs import Blobs, may_be_light
from mvuav_ros.vision.markers.centroid import CentroidMeter, Cut, Detection
from mvuav_ros.vision.markers.labelling import label_five
from mvuav_ros.vision.markers.results import TANKER_NAMES, Cluster
from mvuav_ros.vision.markers.view import (
    ROLL,
    SCALE,
    Array,
    Lens,
    ViewState,
    WeakPerspective,
    X,
    Y,
    fit,
)
from mvuav_ros.vision.markers.view_filter import ViewFilter

ROUND = 1.4
"""Spread of a spot that may be a light."""
LEAST_SHARE = 0.2
"""Of the n-th largest spot's area: what is smaller is no marker of a body with n of them."""
MOST_RATIO = 8.0
"""Areas of a body's largest and smallest marker, one over the other."""
CLEAR_MISFIT = (1.0, 0.008)
"""px, and units of the body's size: what a body among other lights may differ by."""
LONE_MISFIT = 0.06
"""The same, in units of its size, for a body that is alone in the frame."""
OTHER_BODY_MISFIT = 0.15
"""The same for five lights that the thesis's assumption alone must name."""
NEARBY_ROLL = 0.5
"""rad (1 sigma), of the roll from the last frame to this one, or over a loss."""
GATE = 16.0
"""Squared distance over variance at which a light is too far from a marker's place."""
NOTHING = GATE + DOUBT
"""What it costs to leave a marker without a light."""
MOST_WAYS = 1000
MOST_REFITTED = 24
MOST_PERMUTED = 7
MOST_OF_THREE = 24
MOST_BENT = 0.15
MOST_MEASURED = 48
MOST_PAIRS = 300
MOST_COST = 24.0
STRANGE = 3
"""Frames without a name after which a light is a stranger."""
STRANGER_STEP = 8.0
"""px that a stranger may move in a frame, as the camera shakes."""


class Lights:
    """The spots of a frame that may be lights, measured.

    Attributes:
        spots: their places in px without distortion.
        measured: where the image shows them.
    """

    def __init__(self, blobs: Blobs, cut: Cut, meter: CentroidMeter, lens: Lens) -> None:
        boxes = [box for box in blobs.boxes if may_be_light(box)]
        # The largest tell what is small; of hundreds of specks no more is needed.
        boxes = sorted(boxes, key=lambda box: -box.area)[:MOST_MEASURED]
        measured = [blobs.measure(box, cut, meter) for box in boxes]
        self.spots = straightened(lens, measured)
        self.measured = dict(zip(self.spots, measured, strict=True))
        self._boxes = dict(zip(self.spots, boxes, strict=True))
        self._blobs = blobs
        self._lens = lens

    def __len__(self) -> int:
        return len(self.spots)

    def in_image(self, spot: Detection) -> Detection:
        """A spot where the image shows it."""
        return self.measured[spot]

    def split(
        self, spot: Detection, dx: float, dy: float, variance: float
    ) -> tuple[Detection, Detection]:
        """A spot that is two lights (see `Blobs.split`)."""
        pair = self._blobs.split(self._boxes[spot], dx, dy, variance)
        first, second = straightened(self._lens, pair)
        self.measured[first], self.measured[second] = pair
        return first, second

    def candidates(self, count: int) -> list[Detection]:
        """The round ones that could be among a body's ``count`` markers."""
        spots = [spot for spot in self.spots if spot.spread <= ROUND]
        if len(spots) < count:
            return spots
        least = LEAST_SHARE * spots[count - 1].area
        return [spot for spot in spots if spot.area >= least]


def straightened(lens: Lens, spots: Sequence[Detection]) -> list[Detection]:
    """Detections where a lens without distortion would show them."""
    if lens.focal is None or not spots:
        return list(spots)
    ideal = lens.to_ideal(np.array([(spot.x, spot.y) for spot in spots])).tolist()
    return [spot._replace(x=x, y=y) for spot, (x, y) in zip(spots, ideal, strict=True)]


class Expectation(NamedTuple):
    """Where a marker should be, px, and how sure that is (1 sigma, px)."""

    x: float
    y: float
    deviation: float


class Clutter:
    """Lights that have stayed without a name for some frames: glares, not returning markers."""

    def __init__(self) -> None:
        self._seen: list[tuple[float, float, int]] = []

    def include(self, spot: Detection) -> bool:
        """Whether a light has stood there, or close by, for long."""
        return any(
            age >= STRANGE and abs(x - spot.x) < STRANGER_STEP and abs(y - spot.y) < STRANGER_STEP
            for x, y, age in self._seen
        )

    def update(
        self, spots: Sequence[Detection], expected: Mapping[int, Expectation] | None
    ) -> None:
        """Take the lights of a frame that got no name.

        Args:
            spots: those lights.
            expected: where the markers without a light should be; what lies far from all of them
                is none. None where the body is out of sight: then only what was clutter before
                is followed.
        """
        seen = []
        for spot in spots:
            ages = [
                age
                for x, y, age in self._seen
                if abs(x - spot.x) < STRANGER_STEP and abs(y - spot.y) < STRANGER_STEP
            ]
            if expected is not None:
                near = any(_may_be_at(spot, place) for place in expected.values())
                ages.append(max(ages, default=0) + (1 if near else STRANGE))
            if ages:
                seen.append((spot.x, spot.y, max(ages)))
        self._seen = seen


def _may_be_at(spot: Detection, place: Expectation) -> bool:
    reach = STRANGER_STEP + 4.0 * place.deviation
    return math.hypot(spot.x - place.x, spot.y - place.y) < reach


class Named(NamedTuple):
    """All markers of a body, by name.

    Attributes:
        spots: in the rig's order, px without distortion; empty if they cannot be named.
        view: fitted to them.
        certain: whether one frame is enough to believe it.
        fits: whether the body is what its rig says.
        remark: why they cannot be named, or what was left out.
    """

    spots: tuple[Detection, ...] = ()
    view: ViewState | None = None
    certain: bool = False
    fits: bool = True
    remark: str = ''


def initialize(
    shape: WeakPerspective,
    lights: Lights,
    names: Sequence[str],
    before: tuple[float, float] | None = None,
) -> Named:
    """Name a whole body of which no marker is known.

    Args:
        shape: the body.
        lights: of the frame.
        names: the markers'.
        before: the roll before a loss and how far it may have changed (1 sigma, rad); None at
            the start, when an upright body is likelier than one upside down, and how exact the
            rig is must be seen.
    """
    count = len(names)
    spots = lights.candidates(count)
    if len(spots) < count:
        return Named(remark=f'{len(spots)} of {count} markers in view')
    unclear = f'{len(spots)} lights in view, {count} do not stand out'
    if len(spots) > MAX_CANDIDATES:
        return Named(remark=unclear)
    guesses = [
        g for g in guess_start(shape, spots, *(before or (0.0, ANY_ROLL))) if _alike(g, spots)
    ]
    alone = len(spots) == count
    if guesses:
        best = guesses[0]
        clear = len(guesses) == 1 or guesses[1].cost - best.cost >= DOUBT
        exact = CLEAR_MISFIT[0] + CLEAR_MISFIT[1] * best.view.scale
        free = alone and before is None and shape.lens.focal is None
        limit = LONE_MISFIT * best.view.scale if free else exact
        if best.view.misfit <= max(limit, exact) and clear:
            chosen = tuple(spots[index] for index in best.chosen)
            remark = '' if alone else f'{len(spots)} lights in view, the {count} that fit were used'
            fits = best.view.misfit <= exact
            return Named(chosen, best.view, alone, fits, remark)
    if alone and tuple(names) == TANKER_NAMES and before is None and shape.lens.focal is None:
        return _as_the_thesis(shape, spots) or Named(remark=unclear)
    return Named(remark=unclear)


def _alike(guess: Guess, spots: Sequence[Detection]) -> bool:
    areas = [spots[index].area for index in guess.chosen]
    return max(areas) <= MOST_RATIO * min(areas)


def _as_the_thesis(shape: WeakPerspective, spots: Sequence[Detection]) -> Named | None:
    """Five lights in no doubt but for their order: by the distances, upright (Appendix A)."""
    spots = sorted(spots, key=lambda spot: (spot.x, spot.y))
    order = label_five([Cluster(spot.x, spot.y, spot.area) for spot in spots])
    chosen = tuple(spots[index] for index in order)
    areas = [spot.area for spot in chosen]
    left, right = chosen[0], chosen[-1]
    span = math.hypot(right.x - left.x, right.y - left.y)
    if span == 0.0 or max(areas) > MOST_RATIO * min(areas):
        return None
    roll = math.atan2(right.y - left.y, right.x - left.x)
    scale = math.log(0.56 * span)
    start = np.array([roll, scale, 0.0, 0.0, 0.0, 0.0, scale - math.log(0.25), 0.0])
    start[[X, Y]] = np.mean([(spot.x, spot.y) for spot in chosen], axis=0)
    deviations = np.array((1.0, 1.0, span, span, 0.4, 0.4, 0.5, 1e-3))
    places = np.array([[(spot.x, spot.y) for spot in chosen]])
    prior = start[None], np.diag(deviations**2)[None]
    view = fit(shape, prior, np.arange(5)[None], places, np.array(0.02 * span)).view()
    if view.misfit > OTHER_BODY_MISFIT * view.scale:
        return None
    return Named(chosen, view, True, False)


Fits = Callable[[int, Detection], bool]
"""Whether a marker may look like this spot."""


def assign(
    expected: Mapping[int, Expectation], spots: Sequence[Detection], fits: Fits
) -> dict[int, Detection]:
    """Name the spots that lie where exactly one marker is expected.

    All ways of giving the spots to the markers are weighed; a marker is named where every way
    that costs little more than the best gives it the same spot.

    Args:
        expected: the markers that have no spot yet.
        spots: that have no name yet.
        fits: leaves out what cannot be.
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
    ways = list(islice(_ways(list(costs.items())), MOST_WAYS + 1))
    if len(ways) > MOST_WAYS:
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


def reacquire(
    views: ViewFilter, spots: Sequence[Detection], fits: Fits, fewest: int
) -> dict[int, Detection]:
    """Find a body again of which nothing is in sight where it was expected.

    Every pair of spots is tried as every pair of markers, within what the time since the loss
    allows of roll, size and place. A marker is named where every way that is about as probable
    as the best names it so.

    Args:
        views: of the frame.
        spots: px without distortion.
        fits: leaves out what cannot be.
        fewest: markers that must be found.
    """
    ways = _similar_ways(views, spots, fits, fewest)
    ways = list(
        {_completed(views, way, view, spots, fits) for way, view in _refitted(views, ways, spots)}
    )
    everything = len(views.shape.points)
    weighed = [
        (view.cost + NOTHING * (everything - len(way)), dict(way))
        for way, view in _refitted(views, ways, spots)
        if view.cost <= MOST_COST
    ]
    if not weighed:
        return {}
    least = min(cost for cost, _ in weighed)
    probable = [way for cost, way in weighed if cost < least + DOUBT]
    first = min(weighed, key=lambda pair: pair[0])[1]
    agreed = {m: i for m, i in first.items() if all(way.get(m) == i for way in probable)}
    return {m: spots[i] for m, i in agreed.items()} if len(agreed) >= fewest else {}


Way = tuple[tuple[int, int], ...]
"""Markers and the lights that they may be."""


def _refitted(
    views: ViewFilter, ways: Sequence[Way], spots: Sequence[Detection]
) -> list[tuple[Way, ViewState]]:
    """Ways of naming lights, each with the view that follows."""
    fitted: list[tuple[Way, ViewState]] = []
    for number in sorted({len(way) for way in ways}):
        same = [way for way in ways if len(way) == number][:MOST_REFITTED]
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
    if len(seen) >= 3 and 3 <= len(flat) <= MOST_PERMUTED:
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
    for t, s in zip(turn[pair, seen_pair][:MOST_PAIRS], shift[pair, seen_pair], strict=False):
        way = _nearest(t * flat + s, seen, reach, spots, fits)
        if len(way) >= fewest:
            tried[way] = -len(way)
    return sorted(tried, key=lambda way: tried[way])


def _ways_of_three(
    flat: NDArray[np.complex128], seen: NDArray[np.complex128], deviations: Array
) -> list[Way]:
    """All likely ways of naming three lights, by the turn, growth and distortion that they take."""
    ways, chosen = _threes(len(flat), min(len(seen), MOST_PERMUTED))
    markers = flat[ways] - flat[ways].mean(axis=1, keepdims=True)
    lights = seen[chosen] - seen[chosen].mean(axis=1, keepdims=True)
    turn = (markers.conj() * lights).sum(axis=1) / (np.abs(markers) ** 2).sum(axis=1)
    bent = np.abs(lights - turn[:, None] * markers) ** 2
    bent = bent.sum(axis=1) / (np.abs(turn[:, None] * markers) ** 2).sum(axis=1)
    cost = (np.log(np.maximum(np.abs(turn), 1e-9)) / (deviations[SCALE] + 0.1)) ** 2
    cost += (np.angle(turn) / (deviations[ROLL] + 0.1)) ** 2 + bent / MOST_BENT**2
    best = [int(index) for index in np.argsort(cost)[:MOST_OF_THREE] if cost[index] < GATE]
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


def places_of(found: Mapping[int, Detection]) -> dict[int, tuple[float, float]]:
    """Where named spots are, px."""
    return {marker: (spot.x, spot.y) for marker, spot in found.items()}
