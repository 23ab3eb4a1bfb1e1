"""A whole body named in one frame, when none of its markers is known."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations
from statistics import median_high
from typing import NamedTuple

import numpy as np

from mvuav_ros.vision.markers.detection import label_five
from mvuav_ros.vision.markers.lights import Light, Lights, are_close
from mvuav_ros.vision.markers.marker_results import TANKER_NAMES, Cluster
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
    ViewState,
    WeakPerspective,
    X,
    Y,
    views_of_three,
)
from mvuav_ros.vision.markers.view_correction import Belief, Correction, NamedPlaces

ANY_ROLL = 1.6  # rad, 1 sigma: at the start an upright body is likelier than one upside down
FREE = 30.0, 1e4
"""rad and logarithm, and px (1 sigma): nothing is known of roll and size, and of the place."""
TILT = 0.4  # rad, 1 sigma: the camera looks at the body from behind, give or take
BARREL_DEVIATION = 0.1  # 1 sigma, of what a lens that is not calibrated does at half the diagonal
MODEL_ERROR = 0.004  # By how much a body may differ from its rig, in units of its size (1 sigma)
DOUBT = 6.0  # Two ways of naming the lights whose costs differ by less than this are both possible
MAX_CANDIDATES = 12
_TYPICAL_FOCAL, _FOCAL_DEVIATION = 1.4, 0.6
"""Focal length of a camera that is not calibrated, in half diagonals of the image (1.4: 71 degrees
across), and how far its logarithm may be off (1 sigma)."""
_REACH = 0.17  # How far from its expected place a light is looked for, in units of the body's size
_ROUGH = 0.02  # The same, 1 sigma, where three lights determine the view
_MAX_TILTED = 1.2  # rad, from straight behind
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
    spots: Sequence[Light],
    roll: float = 0.0,
    roll_deviation: float = ANY_ROLL,
) -> list[Guess]:
    """All probable ways of seeing the whole body in a number of spots, most probable first.

    Three markers are tried on all threes of spots (`MAX_CANDIDATES` at most, px without
    distortion), in every order; the two views of each that follow say where the other markers
    are, and the best are fitted. The roll is the expected one, with its deviation (1 sigma), rad.
    """
    places = np.array([complex(spot.x, spot.y) for spot in spots])
    starts = _rough_guesses(shape, places, roll, roll_deviation)
    if not starts:
        return []
    chosen = np.array([way for way, _ in starts], np.intp)
    parameters = np.array([start for _, start in starts])
    flat = np.column_stack((places.real, places.imag))
    fits = _fit(shape, flat[chosen].reshape(len(chosen), -1), parameters)
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
    fits = _fit(shape, flat[np.array(ways)].reshape(len(ways), -1), starts)
    return [(other, fits.view(index)) for index, other in enumerate(ways)]


def _fit(shape: WeakPerspective, measured: Array, starts: Array) -> Correction:
    """Views of the whole body fitted to several ways of naming (m, 2 n), px, from behind or so."""
    expected = np.zeros(COUNT)
    expected[[X, Y]] = shape.centre
    # NumPy's own median imports its masked arrays, which takes as long as many frames.
    expected[SCALE] = median_high(starts[:, SCALE].tolist())
    expected[FOCAL] = math.log(shape.lens.focal or _TYPICAL_FOCAL * shape.lens.half_diagonal)
    deviations = np.empty(COUNT)
    deviations[[ROLL, SCALE]], deviations[[X, Y]] = FREE
    deviations[[PITCH, YAW]] = TILT
    deviations[FOCAL] = _FOCAL_DEVIATION if shape.lens.focal is None else KNOWN_FOCAL
    deviations[BARREL] = BARREL_DEVIATION if shape.lens.focal is None else 1e-4
    variance = (0.3 + MODEL_ERROR * math.exp(expected[SCALE])) ** 2
    ways, width = measured.shape
    before = Belief(np.tile(expected, (ways, 1)), np.tile(np.diag(deviations**2), (ways, 1, 1)))
    named = NamedPlaces(np.arange(width // 2)[None], measured)
    noise = np.full((ways, width), variance)
    return Correction.of(shape, before, named, noise, variance, starts, iterations=8)


Start = tuple[tuple[int, ...], Array]


def _rough_guesses(
    shape: WeakPerspective, places: Complex, roll: float, roll_deviation: float
) -> list[Start]:
    """Distinct spots for all lights, and views to start the fit from; the best ones first."""
    if len(places) < len(shape.points):
        return []
    views = _rough_views(shape, places)
    views = views[np.hypot(views[:, PITCH], views[:, YAW]) < _MAX_TILTED]
    if not len(views):
        return []
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
    focal = shape.lens.focal or _TYPICAL_FOCAL * shape.lens.half_diagonal
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


MAX_RATIO = 8.0  # Areas of a body's largest and smallest marker, one over the other
CLEAR_MISFIT = (1.0, 0.008)
"""px, and units of the body's size: what a body among other lights may differ by."""
LONE_MISFIT = 0.06
"""The same, in units of its size, for a body that is alone in the frame, seen by a camera that is
not calibrated."""
STRICT_MISFIT = (0.25, 0.001)
"""The same, of one that is what its rig says; another must show the same misfit for some time."""
OTHER_BODY_MISFIT = 0.15  # The same for five lights that the thesis's assumption alone must name
MAX_REST = 15  # Frames between two attempts to name lights that could not be named, at most
CONFIRMED = 3  # Frames in which a body must be named alike where one frame does not make it certain
CONFIRMED_ODD = 10
"""The same where one of the lights may well be another one, which by then has gone elsewhere."""
SAME_MISFIT = (0.2, 0.25)
"""px, and part of it, by which the misfit may change meanwhile: that of a rig measured badly stays,
that of a light that is no marker does not."""


class Named(NamedTuple):
    """All markers of a body, by name."""

    # in the rig's order, px without distortion; empty if they cannot be named.
    lights: tuple[Light, ...] = ()
    view: ViewState | None = None  # fitted to them
    certain: bool = False  # whether one frame is enough to believe it
    fits: bool = True  # whether the body is what its rig says
    odd: bool = False  # whether one of the lights may well be another one
    remark: str = ''  # why they cannot be named, or what was left out


def initialize(
    shape: WeakPerspective,
    lights: Lights,
    names: Sequence[str],
    before: tuple[float, float] | None = None,
) -> Named:
    """Name a whole body of which no marker is known.

    Before a loss it had a roll, which may have changed (1 sigma, rad); at the start (None) an
    upright body is likelier than one upside down, and how exact the rig is must be seen.
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
            strict = STRICT_MISFIT[0] + STRICT_MISFIT[1] * best.view.scale
            odd = not free and best.view.misfit > strict
            return Named(chosen, best.view, alone and not odd, fits, odd, remark)
    if alone and tuple(names) == TANKER_NAMES and before is None and shape.lens.focal is None:
        return _as_the_thesis(shape, spots) or Named(remark=unclear)
    return Named(remark=unclear)


def _alike(guess: Guess, spots: Sequence[Light]) -> bool:
    areas = [spots[index].seen.area for index in guess.chosen]
    return max(areas) <= MAX_RATIO * min(areas)


def _as_the_thesis(shape: WeakPerspective, spots: Sequence[Light]) -> Named | None:
    """Five lights in no doubt but for their order: by the distances, upright (Appendix A)."""
    spots = sorted(spots, key=lambda spot: (spot.x, spot.y))
    order = label_five([Cluster(spot.x, spot.y, spot.seen.area) for spot in spots])
    chosen = tuple(spots[index] for index in order)
    areas = [spot.seen.area for spot in chosen]
    left, right = chosen[0], chosen[-1]
    span = math.hypot(right.x - left.x, right.y - left.y)
    if span == 0.0 or max(areas) > MAX_RATIO * min(areas):
        return None
    roll = math.atan2(right.y - left.y, right.x - left.x)
    scale = math.log(0.56 * span)
    start = np.array([roll, scale, 0.0, 0.0, 0.0, 0.0, scale - math.log(0.25), 0.0])
    start[[X, Y]] = np.mean([(spot.x, spot.y) for spot in chosen], axis=0)
    deviations = np.array((1.0, 1.0, span, span, 0.4, 0.4, 0.5, 1e-3))
    before = Belief(start[None], np.diag(deviations**2)[None])
    named = NamedPlaces.of({i: (spot.x, spot.y) for i, spot in enumerate(chosen)})
    variance = (0.02 * span) ** 2
    view = Correction.of(shape, before, named, np.full((1, 10), variance), variance).view()
    if view.misfit > OTHER_BODY_MISFIT * view.scale:
        return None
    # Three frames must agree: nearly any five lights have some such order.
    return Named(chosen, view, False, False)


@dataclass
class Attempts:
    """When to name a whole body: the more often that failed, the less often it is tried."""

    count: int  # markers of the body
    agreed: int = 0  # frames in a row that named the body alike
    last: tuple[Light, ...] = ()  # places of its markers in the last one
    _failures: int = 0
    _rest: int = 0
    _lights: int = 0
    _first_misfit: float = 0.0
    _is_odd: bool = False  # whether one of the lights may well have been another one meanwhile

    def due(self, lights: int) -> bool:
        """Whether to try in this frame: another number of lights may be what was waited for."""
        if lights != self._lights:
            complete = self._lights < self.count <= lights
            self._lights, self._rest = lights, 0 if complete else min(self._rest, 1)
        self._rest -= 1
        return self._rest < 0

    def fail(self) -> None:
        """No way of naming the lights stood out."""
        self.agreed, self.last = 0, ()
        self._rest = min(self._failures, MAX_REST)
        self._failures = 2 * self._failures + 1 if self._failures < MAX_REST else MAX_REST

    def confirmed(self, named: Named) -> bool:
        """Whether enough frames in a row have named the body alike."""
        odd = named.odd or self._is_odd
        return named.certain or self.agreed >= (CONFIRMED_ODD if odd else CONFIRMED)

    def succeed(self, named: Named) -> bool:
        """Take a way of naming them; whether it is that of the last attempt."""
        assert named.view is not None
        reach = 0.5 * named.view.scale
        alike = all(are_close(a, b, reach) for a, b in zip(self.last, named.lights, strict=False))
        most = SAME_MISFIT[0] + SAME_MISFIT[1] * self._first_misfit
        changed = abs(named.view.misfit - self._first_misfit) > most
        goes_on = alike and bool(self.last)
        self._is_odd = named.odd or (goes_on and self._is_odd)
        goes_on = goes_on and not (self._is_odd and changed)
        self.agreed = self.agreed + 1 if goes_on else 1
        if not goes_on:
            self._first_misfit = named.view.misfit
        self.last, self._failures, self._rest = named.lights, 0, 0
        return alike
