"""Which lights are the rig's, when nothing is known yet: the start, and after a long loss."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import permutations, product

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.markers.centroid import Detection
from mvuav_ros.vision.markers.lens import Lens
from mvuav_ros.vision.markers.view.fit import Fits, NamedPlaces, fit
from mvuav_ros.vision.markers.view.weak_perspective import (
    BARREL,
    COUNT,
    FOCAL,
    KNOWN_FOCAL,
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
BARREL_DEVIATION = 0.1
"""1 sigma, of what a lens that is not calibrated does at half the diagonal."""
MODEL_ERROR = 0.004
"""By how much a body may differ from its rig, in units of its size (1 sigma)."""
DOUBT = 6.0
"""Two ways of naming the lights whose costs differ by less than this are both possible."""
MAX_CANDIDATES = 12
WELL_FITTED = (0.3, 0.003)
"""px, and units of the body's size: a larger misfit may be that of another minimum of the cost."""
_TILTS = np.array([tilts for tilts in product((-0.6, 0.0, 0.6), repeat=2) if any(tilts)])
_USUAL_FOCAL, _FOCAL_DEVIATION = 1.4, 0.6
"""Focal length of a camera that is not calibrated, in half diagonals of the image (1.4: 71 degrees
across), and how far its logarithm may be off (1 sigma)."""
_REACH = 0.17
"""How far from its expected place a light is looked for, in units of the body's size."""
_TRIED = 16
_APART = 0.6
"""rad: two starts for one way of naming the lights are tilted at least this differently."""
_WAYS_TRIED = 8
_FEW_LIGHTS, _FEW_SPOTS, _TILTS_EACH = 3, 4, 4
"""A body of so few lights looks alike in several ways: among so few spots, each of them is tried
from so many directions."""
_MOST_COMPARISONS = 150_000


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
    as seen from a grid of directions and distances; the best are fitted, each from several
    directions, as the cost may have more than one minimum.

    Args:
        shape: the body.
        spots: at most `MAX_CANDIDATES`, px without distortion.
        roll: expected, rad.
        roll_deviation: of that (1 sigma, rad).
    """
    places = np.array([complex(spot.x, spot.y) for spot in spots])
    few = len(shape.points) <= _FEW_LIGHTS and len(places) <= _FEW_SPOTS
    starts = (_every_way if few else _rough_guesses)(shape, places)
    if not starts:
        return []
    chosen = np.array([way for way, _ in starts], np.intp)
    parameters = np.array([start for _, start in starts])
    flat = np.column_stack((places.real, places.imag))
    fits = _fit(shape, flat[chosen], parameters)
    guesses: dict[tuple[int, ...], Guess] = {}
    fitted = [(way, fits.view(index)) for index, (way, _) in enumerate(starts)]
    best = min(fitted, key=lambda guess: guess[1].cost)
    if best[1].misfit > WELL_FITTED[0] + WELL_FITTED[1] * best[1].scale:
        fitted += _tilted(shape, flat, *best)
        best = min(fitted, key=lambda guess: guess[1].cost)
    for way, view in fitted + _variants(shape, flat, *best):
        away = math.remainder(view.roll - roll, 2 * math.pi) / roll_deviation
        guess = Guess(way, view, view.cost + away**2)
        if way not in guesses or guess.cost < guesses[way].cost:
            guesses[way] = guess
    return sorted(guesses.values(), key=lambda guess: guess.cost)


def _tilted(
    shape: WeakPerspective, flat: Array, way: tuple[int, ...], view: ViewState
) -> list[tuple[tuple[int, ...], ViewState]]:
    """One way of naming the lights from directions all round, as the fit has several minima."""
    starts = np.repeat(view.parameters[None], len(_TILTS), axis=0)
    starts[:, [PITCH, YAW]] = _TILTS
    fits = _fit(shape, np.repeat(flat[None, list(way)], len(_TILTS), axis=0), starts)
    return [(way, fits.view(index)) for index in range(len(_TILTS))]


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
    expected[SCALE] = np.median(starts[:, SCALE])
    expected[FOCAL] = math.log(shape.lens.focal or _USUAL_FOCAL * shape.lens.half_diagonal)
    deviations = np.empty(COUNT)
    deviations[[ROLL, SCALE, X, Y]] = free
    deviations[[PITCH, YAW]] = TILT
    deviations[FOCAL] = _FOCAL_DEVIATION if shape.lens.focal is None else KNOWN_FOCAL
    deviations[BARREL] = BARREL_DEVIATION if shape.lens.focal is None else 1e-4
    prior = expected[None], np.diag(deviations**2)[None]
    deviation = 0.3 + MODEL_ERROR * math.exp(float(np.median(starts[:, SCALE])))
    m, n = measured.shape[:2]
    seen = np.broadcast_to(np.arange(n), (m, n))
    return fit(shape, prior, NamedPlaces(seen, measured, deviation), starts, iterations=8)


Start = tuple[tuple[int, ...], Array]


def _rough_guesses(shape: WeakPerspective, places: NDArray[np.complex128]) -> list[Start]:
    """Distinct spots for all lights, and views to start the fit from; the best ones first."""
    views, looks = looks_of(shape.points.tobytes())
    views = views.copy()
    views[:, [X, Y]] = shape.centre
    first, second = shape.base
    count = len(places)
    if count < looks.shape[1]:
        return []
    step = max(1, round(count * count * looks.size * count / _MOST_COMPARISONS))
    views, looks = views[::step], looks[::step]
    i, j = (index.ravel() for index in np.indices((count, count)))
    i, j = i[i != j], j[i != j]
    turn = (places[j] - places[i])[:, None] / (looks[:, second] - looks[:, first])
    shift = places[i][:, None] - turn * looks[:, first]
    expected = (turn[..., None] * looks + shift[..., None]).astype(np.complex64)
    # A small last axis would make the least of them slow.
    distance = np.abs(expected - places.astype(np.complex64)[:, None, None, None])
    nearest = distance.min(axis=0) / np.abs(turn)[..., None].astype(np.float32)
    cost = (nearest**2).sum(axis=-1)
    cost[(nearest > _REACH).any(axis=-1)] = np.inf
    found: list[Start] = []
    known: dict[tuple[int, ...], list[Array]] = {}
    flat_cost = cost.ravel()
    possible = np.flatnonzero(np.isfinite(flat_cost))
    best_first = possible[np.argsort(flat_cost[possible])]
    for flat in best_first[: 40 * _TRIED]:
        pair, look = divmod(int(flat), len(looks))
        chosen = tuple(distance[:, pair, look].argmin(axis=0).tolist())
        if len(set(chosen)) < len(chosen):
            continue
        tilts = known.setdefault(chosen, [])
        if len(known) > _WAYS_TRIED:
            del known[chosen]
            continue
        tilt = views[look][[PITCH, YAW]]
        if any(float(np.abs(tilt - other).max()) < _APART for other in tilts):
            continue
        tilts.append(tilt)
        start = _start_from(
            shape, views[look], complex(turn[pair, look]), complex(shift[pair, look])
        )
        found.append((chosen, start))
        if len(found) == (_TRIED if count == looks.shape[1] else _TRIED // 2):
            break
    return found


def _every_way(shape: WeakPerspective, places: NDArray[np.complex128]) -> list[Start]:
    """The spots in every order, each as seen from the directions from which it fits best."""
    views, looks = looks_of(shape.points.tobytes())
    middle = looks.mean(axis=1, keepdims=True)
    look_size = (np.abs(looks - middle) ** 2).sum(axis=1)
    found: list[Start] = []
    for way in permutations(range(len(places)), looks.shape[1]):
        seen = places[list(way)]
        turn = ((looks - middle).conj() * (seen - seen.mean())).sum(axis=1) / look_size
        left = np.abs(seen - seen.mean() - turn[:, None] * (looks - middle)) ** 2
        cost = left.sum(axis=1) / np.maximum(np.abs(turn), 1e-9) ** 2
        tilts: list[Array] = []
        for look in np.argsort(cost).tolist():
            tilt = views[look][[PITCH, YAW]]
            if any(float(np.abs(tilt - other).max()) < _APART for other in tilts):
                continue
            tilts.append(tilt)
            shift = complex(seen.mean() - turn[look] * middle[look, 0])
            found.append((way, _start_from(shape, views[look], complex(turn[look]), shift)))
            if len(tilts) == _TILTS_EACH:
                break
    return found


def _start_from(shape: WeakPerspective, view: Array, turn: complex, shift: complex) -> Array:
    """A view from some direction that has been turned, enlarged and moved."""
    parameters = view.copy()
    parameters[ROLL] = math.atan2(turn.imag, turn.real)
    parameters[SCALE] = math.log(max(abs(turn), 1e-9))
    parameters[FOCAL] += parameters[SCALE]
    parameters[X], parameters[Y] = shift.real, shift.imag
    _explain_by_place(shape, parameters)
    return parameters


def _explain_by_place(shape: WeakPerspective, parameters: Array) -> None:
    """Take out of an apparent tilt what follows from the place beside the image's centre."""
    c, s = math.cos(parameters[ROLL]), math.sin(parameters[ROLL])
    x, y = parameters[X] - shape.centre[0], parameters[Y] - shape.centre[1]
    factor = math.exp(-parameters[FOCAL])
    parameters[YAW] += factor * (c * x + s * y)
    parameters[PITCH] -= factor * (c * y - s * x)


@lru_cache(maxsize=4)
def looks_of(points: bytes) -> tuple[Array, NDArray[np.complex128]]:
    """Views all round behind a body, (v, 8), and the lights' places in them, (v, n).

    In the order of their likelihood, so that every second one of them is a coarser grid.

    Args:
        points: of its shape (see `WeakPerspective`), as a key.
    """
    shape = WeakPerspective(np.frombuffer(points).reshape(-1, 3), 1.0, Lens((1, 1)))
    tilts = (-1.0, -0.75, -0.5, -0.25, 0.0, 0.25, 0.5, 0.75, 1.0)
    near = [part * shape.most_nearness for part in (0.05, 0.2, 0.45)]
    views = np.array(
        [
            (0.0, 0.0, 0.0, 0.0, pitch, yaw, -math.log(n), 0.0)
            for pitch, yaw, n in product(tilts, tilts, near)
            if math.hypot(pitch, yaw) < 1.15
        ]
    )
    places = shape.project(views)
    return views, places[..., 0] + 1j * places[..., 1]
