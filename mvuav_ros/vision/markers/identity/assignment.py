"""Names for the lights of one frame, or none where two names would fit."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import islice
from typing import NamedTuple

from mvuav_ros.vision.markers.centroid import Detection
from mvuav_ros.vision.markers.identity.acquisition import DOUBT

GATE = 16.0  # Squared distance over variance at which a light is too far from a marker's place
NOTHING = GATE + DOUBT  # What it costs to leave a marker without a light
MOST_WAYS = 1000


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
