"""Which lights are the body's, when nothing is known yet: the start, and after a long loss."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import product

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.markers.centroid import Detection
from mvuav_ros.vision.markers.view import (
    NEARNESS,
    PITCH,
    ROLL,
    SCALE,
    YAW,
    Array,
    ViewState,
    WeakPerspective,
    X,
    Y,
)

ANY_ROLL = 1.6
"""rad, 1 sigma: at the start an upright body is likelier than one upside down."""
TILT = 0.4
"""rad, 1 sigma: the camera looks at the body from behind, give or take."""
MODEL_ERROR = 0.004
"""By how much a body may differ from its rig, in units of its size (1 sigma)."""
DOUBT = 6.0
"""Two ways of naming the lights whose costs differ by less than this are both possible."""
MAX_CANDIDATES = 14
_NEARNESS, _NEARNESS_DEVIATION = 0.25, 0.7
_REACH = 0.17
"""How far from its expected place a light is looked for, in units of the body's size."""
_TRIED = 10


@dataclass(frozen=True, eq=False)
class Guess:
    """One way of naming the lights.

    Attributes:
        chosen: (n,), for each of the body's lights the index of the spot.
        view: fitted to them.
        cost: the less, the more probable.
    """

    chosen: tuple[int, ...]
    view: ViewState
    cost: float


def guess_start(
    shape: WeakPerspective,
    spots: Sequence[Detection],
    roll: float = 0.0,
    roll_deviation: float = ANY_ROLL,
) -> list[Guess]:
    """All probable ways of seeing the whole body in a number of spots, most probable first.

    The two lights that lie farthest apart are tried on every pair of spots, in both orders and
    as seen from a grid of directions and distances; the best are fitted.

    Args:
        shape: the body.
        spots: at most `MAX_CANDIDATES`.
        roll: expected, rad.
        roll_deviation: of that (1 sigma, rad).
    """
    places = np.array([complex(spot.x, spot.y) for spot in spots])
    rough = _rough_guesses(shape, places)
    guesses: dict[tuple[int, ...], Guess] = {}
    for chosen, parameters in rough:
        if chosen in guesses:
            continue
        view = _fit(shape, places[list(chosen)], parameters)
        turned = math.remainder(view.roll - roll, 2 * math.pi) / roll_deviation
        guesses[chosen] = Guess(chosen, view, view.cost + turned**2)
        if len(guesses) == _TRIED:
            break
    return sorted(guesses.values(), key=lambda guess: guess.cost)


def _fit(shape: WeakPerspective, places: NDArray[np.complex128], start: Array) -> ViewState:
    measured = np.column_stack((places.real, places.imag))
    expected = np.array([start[ROLL], start[SCALE], start[X], start[Y], 0.0, 0.0, _NEARNESS])
    free = 1e4
    deviations = np.array([free, free, free, free, TILT, TILT, _NEARNESS_DEVIATION])
    prior = ViewState(expected, np.diag(deviations**2), np.zeros((len(places), 2)))
    deviation = 0.3 + MODEL_ERROR * math.exp(float(start[SCALE]))
    return prior.fitted(shape, np.arange(len(places)), measured, deviation, start)


def _rough_guesses(
    shape: WeakPerspective, places: NDArray[np.complex128]
) -> list[tuple[tuple[int, ...], Array]]:
    """Distinct spots for all lights, and a view to start the fit from; the best ones first."""
    views, looks = _looks(shape)
    first, second = shape.base
    count = len(places)
    if count < looks.shape[1]:
        return []
    i, j = (index.ravel() for index in np.indices((count, count)))
    i, j = i[i != j], j[i != j]
    turn = (places[j] - places[i])[:, None] / (looks[:, second] - looks[:, first])
    shift = places[i][:, None] - turn * looks[:, first]
    expected = turn[..., None] * looks + shift[..., None]
    apart = (expected[..., None] - places).astype(np.complex64)
    distance = np.abs(apart) / np.abs(turn)[..., None, None]
    nearest = distance.min(axis=-1)
    cost = (nearest**2).sum(axis=-1)
    cost[(nearest > _REACH).any(axis=-1)] = np.inf
    found: list[tuple[tuple[int, ...], Array]] = []
    known: set[tuple[int, ...]] = set()
    for flat in np.argsort(cost, axis=None)[: 40 * _TRIED]:
        pair, look = divmod(int(flat), len(looks))
        if not np.isfinite(cost[pair, look]):
            break
        chosen = tuple(distance[pair, look].argmin(axis=-1).tolist())
        if chosen in known or len(set(chosen)) < len(chosen):
            continue
        known.add(chosen)
        parameters = views[look].copy()
        parameters[ROLL] = np.angle(turn[pair, look])
        parameters[SCALE] = math.log(abs(turn[pair, look]))
        parameters[X], parameters[Y] = shift[pair, look].real, shift[pair, look].imag
        _explain_by_place(shape, parameters)
        found.append((chosen, parameters))
        if len(found) == 2 * _TRIED:
            break
    return found


def _explain_by_place(shape: WeakPerspective, parameters: Array) -> None:
    """Take out of an apparent tilt what follows from the place beside the image's centre."""
    c, s = math.cos(parameters[ROLL]), math.sin(parameters[ROLL])
    x, y = parameters[X] - shape.centre[0], parameters[Y] - shape.centre[1]
    factor = parameters[NEARNESS] / math.exp(parameters[SCALE])
    parameters[YAW] += factor * (c * x + s * y)
    parameters[PITCH] -= factor * (c * y - s * x)


@lru_cache(maxsize=4)
def _looks(shape: WeakPerspective) -> tuple[Array, NDArray[np.complex128]]:
    """Views all round behind the body, (v, 7), and the lights' places in them, (v, n)."""
    tilts = (-1.0, -0.75, -0.5, -0.25, 0.0, 0.25, 0.5, 0.75, 1.0)
    near = [part * shape.most_nearness for part in (0.02, 0.1, 0.2, 0.35, 0.6)]
    views = np.array(
        [
            (0.0, 0.0, 0.0, 0.0, pitch, yaw, n)
            for pitch, yaw, n in product(tilts, tilts, near)
            if math.hypot(pitch, yaw) < 1.15
        ]
    )
    views[:, [X, Y]] = shape.centre
    places = shape.project(views) - shape.centre
    return views, places[..., 0] + 1j * places[..., 1]
