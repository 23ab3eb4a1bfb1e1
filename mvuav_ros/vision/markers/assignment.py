"""Names for the lights of one frame, or none where two names would fit."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import permutations
from typing import NamedTuple

import numpy as np

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
from mvuav_ros.vision.markers.view import ROLL, SCALE, ViewState, WeakPerspective, X, Y
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
MOST_WAYS = 3000
STRANGE = 3
"""Frames without a name after which a light is a clutter."""
STRANGER_STEP = 8.0
"""px that a clutter may move in a frame, as the camera shakes."""


class Lights:
    """The spots of a frame that may be lights, measured."""

    def __init__(self, blobs: Blobs, cut: Cut, meter: CentroidMeter) -> None:
        boxes = [box for box in blobs.boxes if may_be_light(box)]
        # The largest tell what is small; of hundreds of specks no more is needed.
        boxes = sorted(boxes, key=lambda box: -box.area)[: 4 * MAX_CANDIDATES]
        self.spots = [blobs.measure(box, cut, meter) for box in boxes]
        self._boxes = dict(zip(self.spots, boxes, strict=True))
        self._blobs = blobs

    def __len__(self) -> int:
        return len(self.spots)

    def split(
        self, spot: Detection, dx: float, dy: float, variance: float
    ) -> tuple[Detection, Detection]:
        """A spot that is two lights (see `Blobs.split`)."""
        return self._blobs.split(self._boxes[spot], dx, dy, variance)

    def candidates(self, count: int) -> list[Detection]:
        """The round ones that could be among a body's ``count`` markers."""
        spots = [spot for spot in self.spots if spot.spread <= ROUND]
        if len(spots) < count:
            return spots
        least = LEAST_SHARE * spots[count - 1].area
        return [spot for spot in spots if spot.area >= least]


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

    def update(self, spots: Sequence[Detection]) -> None:
        """Take the lights of a frame that got no name."""
        self._seen = [
            (
                spot.x,
                spot.y,
                1
                + max(
                    (
                        age
                        for x, y, age in self._seen
                        if abs(x - spot.x) < STRANGER_STEP and abs(y - spot.y) < STRANGER_STEP
                    ),
                    default=0,
                ),
            )
            for spot in spots
        ]


class Named(NamedTuple):
    """All markers of a body, by name.

    Attributes:
        spots: in the rig's order.
        view: fitted to them.
        certain: whether one frame is enough to believe it.
        remark: empty, or what was left out.
    """

    spots: tuple[Detection, ...]
    view: ViewState
    certain: bool
    remark: str = ''


def initialize(
    shape: WeakPerspective, lights: Lights, names: Sequence[str], before: ViewFilter | None
) -> Named | str:
    """Name a whole body of which no marker is known.

    Args:
        shape: the body.
        lights: of the frame.
        names: the markers'.
        before: how it was seen a frame ago or before a loss; None at the start, when an upright
            body is likelier than one upside down, and how exact the rig is must be seen.

    Returns:
        The markers, or why they cannot be named.
    """
    count = len(names)
    spots = lights.candidates(count)
    if len(spots) < count:
        return f'{len(spots)} of {count} markers in view'
    if len(spots) > MAX_CANDIDATES:
        return f'{len(spots)} lights in view, {count} do not stand out'
    expected = (0.0, ANY_ROLL) if before is None else (before.view.roll, NEARBY_ROLL)
    guesses = [g for g in guess_start(shape, spots, *expected) if _alike(g, spots)]
    alone = len(spots) == count
    if guesses:
        best = guesses[0]
        scale = best.view.scale
        limit = CLEAR_MISFIT[0] + CLEAR_MISFIT[1] * scale
        if before is not None:
            limit = before.most_misfit(scale)
        elif alone:
            limit = max(limit, LONE_MISFIT * scale)
        clear = len(guesses) == 1 or guesses[1].cost - best.cost >= DOUBT
        if best.view.misfit <= limit and clear:
            chosen = tuple(spots[index] for index in best.chosen)
            remark = '' if alone else f'{len(spots)} lights in view, the {count} that fit were used'
            return Named(chosen, best.view, alone, remark)
    if alone and tuple(names) == TANKER_NAMES and before is None:
        named = _as_the_thesis(shape, spots)
        if named is not None:
            return named
    return f'{len(spots)} lights in view, {count} do not stand out'


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
    start = np.array([roll, math.log(0.56 * span), 0.0, 0.0, 0.0, 0.0, 0.25])
    start[[X, Y]] = np.mean([(spot.x, spot.y) for spot in chosen], axis=0)
    deviations = np.array((1.0, 1.0, span, span, 0.4, 0.4, 0.5))
    prior = ViewState(start, np.diag(deviations**2), np.zeros((5, 2)))
    places = np.array([(spot.x, spot.y) for spot in chosen])
    view = prior.fitted(shape, np.arange(5), places, 0.02 * span)
    if view.misfit > OTHER_BODY_MISFIT * view.scale:
        return None
    return Named(chosen, view, True)


Fits = Callable[[int, Detection], bool]
"""Whether a marker may look like this spot."""


class Expectation(NamedTuple):
    """Where a marker should be, px, and how sure that is (1 sigma, px)."""

    x: float
    y: float
    deviation: float


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
    ways = list(_ways(list(costs.items())))
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
    view_filter: ViewFilter, prior: ViewState, spots: Sequence[Detection], fits: Fits
) -> dict[int, Detection]:
    """Find a body again of which nothing is in sight where it was expected.

    Every pair of spots is tried as every pair of markers, within what the time since the loss
    allows of roll, size and place; three or more spots must fit, and no other way as well.
    """
    shape = view_filter.shape
    places = prior.places(shape)
    flat = places[:, 0] + 1j * places[:, 1]
    seen = np.array([complex(spot.x, spot.y) for spot in spots])
    reach = max(4.0, 0.05 * prior.scale)
    allowed = 3.0 * np.sqrt(np.diag(prior.covariance))
    tried: dict[tuple[tuple[int, int], ...], float] = {}
    for a, b in permutations(range(len(flat)), 2):
        if a > b:
            continue
        for i, j in permutations(range(len(seen)), 2):
            turn = (seen[j] - seen[i]) / (flat[b] - flat[a])
            if abs(math.log(max(abs(turn), 1e-9))) > allowed[SCALE] + 0.1:
                continue
            if abs(math.atan2(turn.imag, turn.real)) > allowed[ROLL] + 0.1:
                continue
            moved = seen[i] + turn * (flat - flat[a])
            middle = moved.mean() - flat.mean()
            if abs(middle) > math.hypot(allowed[X], allowed[Y]):
                continue
            way = _nearest(moved, seen, reach, spots, fits)
            if len(way) >= 3 or len(way) == len(flat):
                tried[way] = -len(way)
    best = sorted(tried, key=lambda way: tried[way])[:12]
    weighed = []
    for way in best:
        found = {marker: spots[number] for marker, number in way}
        view = view_filter.look(prior, {m: (s.x, s.y) for m, s in found.items()})
        if view.misfit <= CLEAR_MISFIT[0] + CLEAR_MISFIT[1] * view.scale:
            weighed.append((view.cost + NOTHING * (len(flat) - len(way)), found))
    weighed.sort(key=lambda pair: pair[0])
    if not weighed or (len(weighed) > 1 and weighed[1][0] - weighed[0][0] < DOUBT):
        return {}
    return weighed[0][1]


def _nearest(
    places: np.ndarray[tuple[int], np.dtype[np.complex128]],
    seen: np.ndarray[tuple[int], np.dtype[np.complex128]],
    reach: float,
    spots: Sequence[Detection],
    fits: Fits,
) -> tuple[tuple[int, int], ...]:
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
