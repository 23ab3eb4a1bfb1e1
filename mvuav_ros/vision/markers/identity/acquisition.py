"""Which lights are the rig's, when nothing is known yet: the start, and after a long loss."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations
from statistics import median_high

import numpy as np

from mvuav_ros.vision.markers.centroid import Detection
from mvuav_ros.vision.markers.rig_view import (
    BARREL,
    COUNT,
    FOCAL,
    KNOWN_FOCAL,
    PITCH,
    ROLL,
    SCALE,
    YAW,
    Array,
    Complex,
    Fits,
    NamedPlaces,
    ViewState,
    WeakPerspective,
    X,
    Y,
    fit,
    views_of_three,
)

ANY_ROLL = 1.6  # rad, 1 sigma: at the start an upright body is likelier than one upside down
TILT = 0.4  # rad, 1 sigma: the camera looks at the body from behind, give or take
BARREL_DEVIATION = 0.1  # 1 sigma, of what a lens that is not calibrated does at half the diagonal
MODEL_ERROR = 0.004  # By how much a body may differ from its rig, in units of its size (1 sigma)
DOUBT = 6.0  # Two ways of naming the lights whose costs differ by less than this are both possible
MAX_CANDIDATES = 12
_USUAL_FOCAL, _FOCAL_DEVIATION = 1.4, 0.6
"""Focal length of a camera that is not calibrated, in half diagonals of the image (1.4: 71 degrees
across), and how far its logarithm may be off (1 sigma)."""
_REACH = 0.17  # How far from its expected place a light is looked for, in units of the body's size
_ROUGH = 0.02  # The same, 1 sigma, where three lights tell the view
_MOST_TILTED = 1.2  # rad, from straight behind
_TRIED = 16
_FEW_SPOTS = 5
_TRIED_AMONG_MANY = 10
"""Ways of naming that are fitted."""


@dataclass(frozen=True, eq=False)
class Guess:
    """One way of naming the lights."""

    chosen: tuple[int, ...]  # (n,), for each of the body's lights the index of the spot
    view: ViewState  # fitted to them
    cost: float  # the less, the more probable


def guess_start(
    shape: WeakPerspective,
    spots: Sequence[Detection],
    roll: float = 0.0,
    roll_deviation: float = ANY_ROLL,
) -> list[Guess]:
    """All probable ways of seeing the whole body in a number of spots, most probable first.

    Three markers are tried on all threes of spots (`MAX_CANDIDATES` at most, px without
    distortion), in every order; the two views of each that follow tell where the other markers
    are, and the best are fitted. The roll is the expected one, with its deviation (1 sigma), rad.
    """
    places = np.array([complex(spot.x, spot.y) for spot in spots])
    starts = _rough_guesses(shape, places, roll, roll_deviation)
    if not starts:
        return []
    chosen = np.array([way for way, _ in starts], np.intp)
    parameters = np.array([start for _, start in starts])
    flat = np.column_stack((places.real, places.imag))
    fits = _fit(shape, flat[chosen], parameters)
    guesses: dict[tuple[int, ...], Guess] = {}
    fitted = [(way, fits.view(index)) for index, (way, _) in enumerate(starts)]
    best = min(fitted, key=lambda guess: guess[1].cost)
    for way, view in fitted + _variants(shape, flat, *best):
        away = math.remainder(view.roll - roll, 2 * math.pi) / roll_deviation
        guess = Guess(way, view, view.cost + away**2)
        if way not in guesses or guess.cost < guesses[way].cost:
            guesses[way] = guess
    return sorted(guesses.values(), key=lambda guess: guess.cost)


def _variants(
    shape: WeakPerspective, flat: Array, way: tuple[int, ...], view: ViewState
) -> list[tuple[tuple[int, ...], ViewState]]:
    """The ways that differ from one in a single light, which lies near its place as well."""
    apart = np.hypot(*(shape.project(view.parameters)[:, None] - flat).transpose(2, 0, 1))
    ways = [
        (*way[:marker], light, *way[marker + 1 :])
        for marker, light in np.argwhere(apart < _REACH * view.scale).tolist()
        if light not in way
    ][: _TRIED // 2]
    if not ways:
        return []
    starts = np.repeat(view.parameters[None], len(ways), axis=0)
    fits = _fit(shape, flat[np.array(ways)], starts)
    return [(other, fits.view(index)) for index, other in enumerate(ways)]


def _fit(shape: WeakPerspective, measured: Array, starts: Array) -> Fits:
    """Views of the whole body fitted to several ways of naming, from behind give or take."""
    free = 1e4
    expected = np.zeros(COUNT)
    expected[[X, Y]] = shape.centre
    # NumPy's own median imports its masked arrays, which takes as long as many frames.
    expected[SCALE] = median_high(starts[:, SCALE].tolist())
    expected[FOCAL] = math.log(shape.lens.focal or _USUAL_FOCAL * shape.lens.half_diagonal)
    deviations = np.empty(COUNT)
    deviations[[ROLL, SCALE, X, Y]] = free
    deviations[[PITCH, YAW]] = TILT
    deviations[FOCAL] = _FOCAL_DEVIATION if shape.lens.focal is None else KNOWN_FOCAL
    deviations[BARREL] = BARREL_DEVIATION if shape.lens.focal is None else 1e-4
    prior = expected[None], np.diag(deviations**2)[None]
    deviation = 0.3 + MODEL_ERROR * math.exp(expected[SCALE])
    m, n = measured.shape[:2]
    seen = np.broadcast_to(np.arange(n), (m, n))
    return fit(shape, prior, NamedPlaces(seen, measured, deviation), starts, iterations=8)


Start = tuple[tuple[int, ...], Array]


def _rough_guesses(
    shape: WeakPerspective, places: Complex, roll: float, roll_deviation: float
) -> list[Start]:
    """Distinct spots for all lights, and views to start the fit from; the best ones first."""
    if len(places) < len(shape.points):
        return []
    views = _rough_views(shape, places)
    views = views[np.hypot(views[:, PITCH], views[:, YAW]) < _MOST_TILTED]
    seen = shape.project(views)
    apart = np.abs((seen[..., 0] + 1j * seen[..., 1])[..., None] - places)
    beside = apart.min(axis=2) / np.exp(views[:, SCALE])[:, None]
    near = (beside < _REACH).all(axis=1)
    views, beside, nearest = views[near], beside[near], apart[near].argmin(axis=2)
    ordered = np.sort(nearest, axis=1)
    distinct = (ordered[:, 1:] > ordered[:, :-1]).all(axis=1)
    views, beside, nearest = views[distinct], beside[distinct], nearest[distinct]
    away = np.angle(np.exp(1j * (views[:, ROLL] - roll))) / roll_deviation
    cost = ((beside / _ROUGH) ** 2).sum(axis=1) + away**2
    cost += (views[:, PITCH] ** 2 + views[:, YAW] ** 2) / TILT**2
    most = _TRIED if len(places) <= _FEW_SPOTS else _TRIED_AMONG_MANY
    return [(tuple(nearest[i].tolist()), views[i]) for i in np.argsort(cost)[:most].tolist()]


def _rough_views(shape: WeakPerspective, places: Complex) -> Array:
    """Views (v, 8) in which three of the markers are any three of the spots, or two any two."""
    focal = shape.lens.focal or _USUAL_FOCAL * shape.lens.half_diagonal
    if shape.triangle is not None:
        orders = np.array(list(permutations(range(len(places)), 3)))
        return views_of_three(shape, shape.triangle, places[orders], focal)
    # Of markers on one line the tilt is not known.
    orders = np.array(list(permutations(range(len(places)), 2)))
    first, second = (shape.points[index, 0] + 1j * shape.points[index, 1] for index in shape.base)
    turn = (places[orders[:, 1]] - places[orders[:, 0]]) / (second - first)
    middle = places[orders[:, 0]] - turn * first
    views = np.zeros((len(orders), COUNT))
    views[:, ROLL], views[:, SCALE] = np.angle(turn), np.log(np.maximum(np.abs(turn), 1e-9))
    views[:, X], views[:, Y], views[:, FOCAL] = middle.real, middle.imag, math.log(focal)
    return views
