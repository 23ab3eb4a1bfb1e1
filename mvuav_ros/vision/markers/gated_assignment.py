"""Which of a frame's detections belongs to which known light: a global nearest neighbour."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.spatial import cKDTree

Array = NDArray[np.float64]
Integers = NDArray[np.intp]

IMPOSSIBLE = 1e6  # The cost of a pair that cannot be, and a distance beyond all others (px)
MOST_CHOICES = 8  # Detections, the nearest, that a known light is held against
_JUMPS_TRIED = 5


def nearest_other(places: Array) -> Array:
    """The distance from each of (n, 2) places to the nearest other one, px; far if alone."""
    if len(places) < 2:
        return np.full(len(places), IMPOSSIBLE)
    return np.asarray(cKDTree(places).query(places, k=2)[0][:, 1])


def choices(predicted: Array, seen: Array, widest: float) -> tuple[Array, Integers]:
    """The detections (m, 2) near each known light (n, 2), px, at most `MOST_CHOICES`.

    Returns:
        (n, k) their distances (px, infinite beyond the widest) and (n, k) their numbers.
    """
    count = np.arange(1, min(MOST_CHOICES, len(seen)) + 1)
    apart, number = cKDTree(seen).query(predicted, k=count, distance_upper_bound=widest)
    return apart, np.minimum(number, len(seen) - 1)


def assign(cost: Array, number: Integers) -> Integers:
    """Give detections to known lights so that most have one, and the sum of costs is least.

    Pairs in which neither has another choice are taken at once; only the rest, which among
    well-separated lights is nothing, is left to the Hungarian method.

    Args:
        cost: (n, k) of each light's choices, `IMPOSSIBLE` where they cannot be a pair.
        number: (n, k) of the detections.

    Returns:
        (n,) the detection's number, or -1.
    """
    given = np.full(len(cost), -1)
    possible = cost < IMPOSSIBLE
    rivals = np.bincount(number[possible], minlength=int(number.max(initial=0)) + 1)
    only = possible.argmax(axis=1)
    first = number[np.arange(len(cost)), only]
    sure = (possible.sum(axis=1) == 1) & (rivals[first] == 1)
    given[sure] = first[sure]
    rows = np.flatnonzero(possible.any(axis=1) & ~sure)
    if len(rows) == 0:
        return given
    light, choice = np.nonzero(possible[rows])
    columns, column = np.unique(number[rows[light], choice], return_inverse=True)
    dense = np.full((len(rows), len(columns)), IMPOSSIBLE)
    dense[light, column] = cost[rows[light], choice]
    chosen, taken = linear_sum_assignment(dense)
    valid = dense[chosen, taken] < IMPOSSIBLE
    given[rows[chosen[valid]]] = columns[taken[valid]]
    return given


def common_shift(
    predicted: Array, seen: Array, nearest: Array, longest: float, tolerance: float
) -> Array | None:
    """A jump that most lights made together, as by a push to the camera.

    The shifts from every prediction to every detection vote in cells; the fullest are tried.

    Args:
        predicted: (n, 2) px.
        seen: (m, 2) px.
        nearest: (n,) px, from each prediction to the nearest detection.
        longest: px, of a jump.
        tolerance: px, by which the lights may differ.

    Returns:
        (2,) px, or None where they made none.
    """
    count = len(predicted)
    at_rest = int((nearest < tolerance).sum())
    if count < 3 or len(seen) < 3 or at_rest > count - 2:
        return None
    shifts = (seen[None] - predicted[:, None]).reshape(-1, 2)
    shifts = shifts[np.abs(shifts).max(axis=1) < longest]
    if len(shifts) < 3:
        return None
    tree = cKDTree(seen)
    best, shift = 0, None
    for candidate in _most_common(shifts, longest, tolerance):
        apart = tree.query(predicted + candidate, distance_upper_bound=tolerance)[0]
        fitting = int(np.isfinite(apart).sum())
        if fitting > best:
            best, shift = fitting, candidate
    return shift if best >= max(3, 0.6 * count, at_rest + 2) else None


def _most_common(shifts: Array, longest: float, tolerance: float) -> list[Array]:
    """The middles of the cells into which most shifts fall."""
    side = int(2 * longest / tolerance) + 2
    cells = np.floor((shifts + longest) / tolerance).astype(np.intp)
    votes = np.bincount(cells[:, 0] * side + cells[:, 1], minlength=side * side).reshape(side, side)
    # Two by two cells, as a jump may lie at the border of one.
    votes = votes[:-1, :-1] + votes[1:, :-1] + votes[:-1, 1:] + votes[1:, 1:]
    fullest = np.argsort(-votes.ravel(), kind='stable')[:_JUMPS_TRIED]
    middles = []
    for corner in np.stack(np.unravel_index(fullest, votes.shape), axis=-1):
        inside = np.all((cells >= corner) & (cells <= corner + 1), axis=1)
        if inside.any():
            middles.append(np.median(shifts[inside], axis=0))
    return middles
