"""A body named in one frame: whole at the start, with hidden markers where it was lost."""

from __future__ import annotations

import math
import operator
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, partial
from itertools import permutations
from statistics import median_high
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.markers.lights import Light, Point, are_close, by_size, candidates, places_of
from mvuav_ros.vision.markers.marker_results import TANKER_NAMES
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
from mvuav_ros.vision.markers.thesis_tracker import label_five
from mvuav_ros.vision.markers.view_correction import Belief, Correction, NamedPlaces
from mvuav_ros.vision.markers.view_filter import ViewFilter
from mvuav_ros.vision.rig import MAX_NAMED

ANY_ROLL = 1.6  # rad, 1 sigma: at the start an upright body is likelier than one upside down
FREE = 30.0, 1e4
"""rad and logarithm, and px (1 sigma): nothing is known of roll and size, and of the place."""
TILT = 0.4  # rad, 1 sigma: the camera looks at the body from behind, give or take
BARREL_DEVIATION = 0.1  # 1 sigma, of what a lens that is not calibrated does at half the diagonal
MODEL_ERROR = 0.004  # By how much a body may differ from its rig, in units of its size (1 sigma)
MARGIN = 2.0  # Of the logarithm of the odds of the best way of naming lights over the next one's
_TYPICAL_FOCAL, _FOCAL_DEVIATION = 1.4, 0.6
"""Focal length of a camera that is not calibrated, in half diagonals of the image (1.4: 71 degrees
across), and how far its logarithm may be off (1 sigma)."""
_REACH = 0.17  # How far from its expected place a light is looked for, in units of the body's size
_ROUGH = 0.02  # The same, 1 sigma, where three lights determine the view
KNOWN_TILT = 0.1
"""rad (1 sigma): where the tilt is known better, two lights show the rest of the view. By an older
filter it is not (see `JOLT` of `naming.py`)."""
_STEPS = 3  # Of an iteration that puts two markers on two spots, the tilt being as it was
_ROUGH_TWOS = 2.0  # px (1 sigma), by which they may miss them after that
_SAME_TILT = 0.2  # rad, within which two views to start from are the same
_KNOWN_LENS = 0.1  # Of the logarithm of the focal length (1 sigma): four lights are enough
_MAX_TILTED = 1.2  # rad, from straight behind
_TRIED, _FEW_SPOTS, _TRIED_AMONG_MANY = 16, 5, 10
"""Ways of naming that are fitted where there are so few spots, and where there are more."""
_MANY_HIDDEN = 6  # Of twelve markers among more spots: 41 threes instead of 220 are tried
MISSED_COST = 22.0  # Squared distance over variance from which on a marker has no light
CLUTTER_DENSITY = 1e-5  # Density of lights that are none of the body's, per px²
MAX_AWAY, ROUGHLY_AWAY = 40.0, 120.0
"""Squared distance over variance from what is known of the view, if it is: of views that show three
markers where they are, and of those about."""


@dataclass(frozen=True, eq=False)
class Prior:
    """What is known of a view before the lights of a frame are named."""

    mean: Array  # (8,), see `WeakPerspective.project`
    deviations: Array  # (8,), 1 sigma
    noise: float | None = None  # px (1 sigma), of the markers' places; None: the rig is not known

    @classmethod
    def at_start(cls, shape: WeakPerspective) -> Prior:
        """The camera looks at an upright body from behind, give or take."""
        mean, deviations = np.zeros(COUNT), np.empty(COUNT)
        mean[[X, Y]] = shape.lens.centre
        mean[FOCAL] = math.log(shape.lens.focal or _TYPICAL_FOCAL * shape.lens.half_diagonal)
        deviations[ROLL], deviations[SCALE], deviations[[X, Y]] = ANY_ROLL, FREE[0], FREE[1]
        deviations[[PITCH, YAW]] = TILT
        deviations[FOCAL] = _FOCAL_DEVIATION if shape.lens.focal is None else KNOWN_FOCAL
        deviations[BARREL] = BARREL_DEVIATION if shape.lens.focal is None else 1e-4
        return cls(mean, deviations)

    @classmethod
    def of(cls, views: ViewFilter, jolt: Sequence[float] = (0.0,) * FOCAL) -> Prior:
        """What a filter has of the view at its time, and by how much a jolt may have changed it."""
        view = views.view
        deviations = np.sqrt(view.covariance.diagonal())
        deviations[:FOCAL] = np.hypot(deviations[:FOCAL], jolt)
        return cls(view.parameters, deviations, views.deviation)

    @property
    def fewest(self) -> int:
        """Lights that more than determine a view with what is known of the lens."""
        return 4 if self.deviations[FOCAL] < _KNOWN_LENS else 5

    def away(self, views: Array) -> Array:
        """Squared distance over variance of views (v, 8), without what the lens makes of them."""
        apart = self.untwisted(views)[:, :FOCAL] - self.mean[:FOCAL]
        return np.asarray(np.square(apart / self.deviations[:FOCAL]).sum(axis=1))

    def untwisted(self, views: Array) -> Array:
        """Views (v, 8) whose roll is within half a turn of the expected one."""
        views = views.copy()
        off = views[:, ROLL] - self.mean[ROLL]
        views[:, ROLL] = self.mean[ROLL] + np.angle(np.exp(1j * off))
        return views

    def allows(self, views: Array, most: float = MAX_AWAY) -> NDArray[np.bool_]:
        """Which of some views (v, 8) are not out of the question."""
        is_near = np.hypot(views[:, PITCH], views[:, YAW]) < _MAX_TILTED
        return is_near if self.noise is None else is_near & (self.away(views) < most)


Assignment = tuple[tuple[int, int], ...]  # Markers, and for each the index of its spot
Start = tuple[Assignment, Array]


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """One way of naming the lights."""

    assignment: Assignment
    view: ViewState  # fitted to them
    evidence: float  # logarithm of its odds against lights that are all none of the body's
    without: dict[int, float]  # the same, by marker, of the assignment without it

    def lights(self, spots: Sequence[Light]) -> dict[int, Light]:
        """By marker, of all lights that might be named."""
        return {marker: spots[index] for marker, index in self.assignment}


def body_hypotheses(
    shape: WeakPerspective,
    spots: Sequence[Light],
    prior: Prior,
    fewest: int,
    clutter: float = CLUTTER_DENSITY,
) -> list[Hypothesis]:
    """All probable ways of seeing a body in a number of spots, most probable first.

    Three markers are tried on all threes of spots (`MAX_NAMED` at most, px without distortion), in
    every order; the views that follow say where the other markers are, and the best are fitted. The
    fewest of the markers must be among the spots, beside which there is so much clutter per px².
    """
    places = np.array([(spot.x, spot.y) for spot in spots]).reshape(-1, 2)
    starts = _starts(shape, places.view(np.complex128).ravel(), prior, fewest)
    if not starts:
        return []
    hypotheses = []
    # NumPy's own median imports its masked arrays, which takes as long as many frames.
    scale = median_high([float(start[SCALE]) for _, start in starts])
    for number in sorted({len(assignment) for assignment, _ in starts}):
        same = [start for start in starts if len(start[0]) == number]
        pairs = np.array([assignment for assignment, _ in same], np.intp)
        views = prior.untwisted(np.array([start for _, start in same]))
        named = NamedPlaces(pairs[..., 0], places[pairs[..., 1]].reshape(len(same), -1))
        fits = _fit(shape, named, prior, scale, views)
        # Logarithms of how probable clutter is in so many places, and in one place less.
        # It is not rare where more lights have no name than have one.
        density = clutter if len(spots) <= 2 * number else max(clutter, CLUTTER_DENSITY)
        others, fewer = (
            k * math.log(density)
            + math.log(math.comb(len(shape.points), k))
            + math.log(math.perm(len(spots), k))
            for k in (number, number - 1)
        )
        for row, (assignment, _) in enumerate(same):
            view, log_density = fits.view(row), float(fits.evidence[row])
            # By the chain rule, without what a marker's place is by all others.
            without = {
                marker: log_density - own - fewer
                for (marker, _), own in zip(assignment, fits.log_densities(row), strict=True)
            }
            hypotheses.append(Hypothesis(assignment, view, log_density - others, without))
    best: dict[Assignment, Hypothesis] = {}
    for hypothesis in sorted(hypotheses, key=lambda hypothesis: -hypothesis.evidence):
        best.setdefault(hypothesis.assignment, hypothesis)
    return list(best.values())


def _fit(
    shape: WeakPerspective, named: NamedPlaces, prior: Prior, scale: float, starts: Array
) -> Correction:
    """Views (f, 8) by named lights, of about this scale (its logarithm), from where to start."""
    mean = prior.mean[None].copy()
    if prior.deviations[SCALE] >= FREE[0]:
        mean[:, SCALE] = scale
    before = Belief(mean, np.diag(prior.deviations**2)[None])
    variance = (prior.noise or 0.3 + MODEL_ERROR * math.exp(scale)) ** 2
    return Correction.of(shape, before, named, variance, starts=starts, iterations=8)


def log_odds_of(best: Hypothesis, hypotheses: Sequence[Hypothesis]) -> dict[int, float]:
    """Logarithms of the odds of each name of the best hypothesis.

    For a name speaks what all that give it have for them; against it what the others have,
    what these have without this marker, and that no light is one of the body's.
    """
    odds = {}
    for name in best.assignment:
        alike = [one for one in hypotheses if name in one.assignment]
        own = [one.evidence for one in alike]
        without = [one.without[name[0]] for one in alike]
        others = [one.evidence for one in hypotheses if name not in one.assignment]
        against = np.logaddexp.reduce([0.0, *without, *others])
        odds[name[0]] = float(np.logaddexp.reduce(own) - against)
    return odds


def _starts(shape: WeakPerspective, places: Complex, prior: Prior, fewest: int) -> list[Start]:
    """Distinct spots for the lights, and views to start the fit from; the best ones first."""
    count = len(shape.points)
    if min(len(places), count) < fewest:
        return []
    seen, slopes = shape.linearize(prior.mean[None])
    expected = seen.view(np.complex128)[0], slopes.view(np.complex128)[0]
    may_be = _pairs(places, prior, *expected)
    views = _views_of_threes(shape, places, prior, count - fewest, may_be)
    errors = np.zeros((len(views), count))
    is_tilt_known = prior.deviations[[PITCH, YAW]].max() < KNOWN_TILT
    if is_tilt_known or not shape.triangles(0):
        by_two, around = _views_of_twos(shape, places, prior, expected, may_be)
        views, errors = np.concatenate((views, by_two)), np.concatenate((errors, around))
    allowed = prior.allows(views)
    views, errors = views[allowed], errors[allowed]
    if not len(views):
        return []
    seen, scale = shape.project(views), np.exp(views[:, SCALE])
    showing, nearest, squares = _nearest(seen, places, _REACH * scale, fewest)
    views, errors, scale = views[showing], errors[showing], scale[showing, None]
    cost = prior.away(views)
    has = squares < np.square(_REACH * scale)
    squares /= (_ROUGH * scale if prior.noise is None else 3.0 * prior.noise) ** 2 + errors**2
    if prior.noise is not None:
        has &= squares < MISSED_COST
    chosen = np.flatnonzero(has.sum(axis=1) >= fewest)
    cost = cost[chosen] + np.where(has, squares, MISSED_COST)[chosen].sum(axis=1)
    most = _TRIED if len(places) <= _FEW_SPOTS else _TRIED_AMONG_MANY
    starts: dict[tuple[Assignment, float, float], Start] = {}
    for row in chosen[np.argsort(cost)].tolist():
        markers = np.flatnonzero(has[row]).tolist()
        # Of markers with the same nearest spot only the nearest has it.
        own = {int(nearest[row, m]): m for m in sorted(markers, key=lambda m: -squares[row, m])}
        if len(own) < fewest:
            continue
        assignment = tuple(sorted((marker, spot) for spot, marker in own.items()))
        pitch, yaw = np.round(views[row, PITCH : YAW + 1] / _SAME_TILT).tolist()
        starts.setdefault((assignment, pitch, yaw), (assignment, views[row]))
        if len(starts) == most:
            break
    return list(starts.values())


def _nearest(
    seen: Array, places: Complex, reach: Array, fewest: int
) -> tuple[NDArray[np.intp], NDArray[np.intp], Array]:
    """The views (v, n, 2) with spots within reach (v,) of the fewest of their markers at least.

    And their markers' nearest spots, and squared distances from those, px², each (w, n). Marker by
    marker: most views of three are out of the question after the first other one.
    """
    left, spare = np.arange(len(seen)), np.full(len(seen), seen.shape[1] - fewest)
    nearest, squares = np.empty(seen.shape[:2], np.intp), np.empty(seen.shape[:2])
    limit = np.square(reach)
    for marker, (x, y) in enumerate(seen.transpose(1, 2, 0)):
        across, down = x[left, None] - places.real, y[left, None] - places.imag
        apart = across * across + down * down
        nearest[left, marker] = own = apart.argmin(axis=1)
        squares[left, marker] = away = apart[np.arange(len(left)), own]
        spare[left] -= away >= limit[left]
        left = left[spare[left] >= 0]
    return left, nearest[left], squares[left]


def _views_of_threes(
    shape: WeakPerspective, places: Complex, prior: Prior, hidden: int, may_be: NDArray[np.bool_]
) -> Array:
    """Views (v, 8) in which three markers are any three of the spots that may be by `_pairs`."""
    hidden = min(hidden, max(len(shape.points) - 3, 0))
    if len(places) > _FEW_SPOTS:
        hidden = min(hidden, _MANY_HIDDEN)
    triangles = shape.triangles(hidden)
    markers, orders = np.reshape(triangles, (-1, 3)).astype(np.intp), _orders(len(places))
    first, second, third = markers.T[..., None]
    a, b, c = orders.T
    allowed = may_be[first, second, a, b] & may_be[second, third, b, c]
    allowed &= may_be[third, first, c, a]
    number, row = np.nonzero(allowed)
    focal, roughly = math.exp(prior.mean[FOCAL]), partial(prior.allows, most=ROUGHLY_AWAY)
    return views_of_three(shape, markers[number], places[orders[row]], focal, roughly)


def _views_of_twos(
    shape: WeakPerspective,
    places: Complex,
    prior: Prior,
    expected: tuple[Complex, Complex],
    may_be: NDArray[np.bool_],
) -> tuple[Array, Array]:
    """Views (v, 8) of two markers on two spots, expected tilt; doubts (v, n) of all, 1 sigma px."""
    at, slopes = expected
    ahead = at - at[:, None]
    each_once = np.tri(len(at), dtype=np.bool_)[..., None, None]
    twos = np.array(np.nonzero(may_be & each_once))
    views = np.tile(prior.mean, (len(twos[0]), 1))
    # Perspective makes more than one step of it.
    for step in range(_STEPS):
        first, second, a, b = twos
        seen = shape.project(views).view(np.complex128)[..., 0]
        here = np.take_along_axis(seen, first[:, None], axis=1)[:, 0]
        there = np.take_along_axis(seen, second[:, None], axis=1)[:, 0]
        turn = (places[b] - places[a]) / (there - here)
        origin = places[a] - turn * (here - views[:, X] - 1j * views[:, Y])
        views[:, ROLL] += np.angle(turn)
        views[:, SCALE] += np.log(np.abs(turn))
        views[:, X], views[:, Y] = origin.real, origin.imag
        if not step:
            kept = prior.allows(views, most=ROUGHLY_AWAY)
            views, twos = views[kept], twos[:, kept]
    first, second, _, _ = twos
    tilted = slopes[[PITCH, YAW]] * prior.deviations[[PITCH, YAW], None]
    apart = tilted[:, None] - tilted[:, :, None]
    share = ahead[first] / ahead[first, second][:, None]
    errors = apart[:, first] - share * apart[:, first, second][..., None]
    return views, np.sqrt(_ROUGH_TWOS**2 + np.square(np.abs(errors)).sum(axis=0))


def _pairs(places: Complex, prior: Prior, expected: Complex, slopes: Complex) -> NDArray[np.bool_]:
    """Which two of the spots may be which two of the markers, (n, n, spots, spots)."""
    # By the logarithm of the offset between them, of which size and roll are the parts.
    offsets, found = _apart(expected), _apart(places)
    spread = (slopes[:, None] - slopes[:, :, None]) / offsets * prior.deviations[:, None, None]
    apart = np.log(found / offsets[:, :, None, None])
    xx, yy = np.square(spread.real).sum(axis=0) + 1e-4, np.square(spread.imag).sum(axis=0) + 1e-4
    xy = (spread.real * spread.imag).sum(axis=0)
    factors = np.array((yy, -2.0 * xy, xx)) / (xx * yy - xy * xy)
    a, b, c = factors[..., None, None]
    x, y = apart.real, apart.imag
    may_be = (a * x + b * y) * x + c * y * y < ROUGHLY_AWAY
    is_apart = (expected != expected[:, None])[..., None, None] & (places != places[:, None])
    return np.asarray(may_be & is_apart)


def _apart(places: Complex) -> Complex:
    """From each place (n,) to each, (n, n); 1 where there is no way between."""
    apart = places - places[:, None]
    apart[apart == 0.0] = 1.0
    return apart


@cache
def _orders(count: int) -> NDArray[np.intp]:
    """All ways of taking three of a number of spots in turn, (n, 3)."""
    return np.array([*permutations(range(count), 3)], np.intp).reshape(-1, 3)


MAX_RATIO = 8.0  # Areas of a body's largest and smallest marker, one over the other
CLEAR_RESIDUAL = (1.0, 0.008)
"""px, and units of the body's size: what a body among other lights may differ by."""
STRICT_RESIDUAL = (0.25, 0.001)
"""The same, of one that is what its rig says; another must show the same residual for some time."""
MAX_AT_START = 18  # Lights among which a body is looked for at once: in 8 ms
MIN_WITH_HIDDEN = 4  # Markers, with more of which one may be hidden at the start
MAX_WITH_HIDDEN = 8  # Lights up to which such a body is looked for: in 4 ms; of twelve in 15 ms
MIN_AWAY = 1.2
"""Of such a body's size, from its middle: a light that is nearer is the missing one, and the rig
is measured badly, or mirrored."""
MIN_APART = 3  # Lights that are no other body's: some of a flare's may lie on the body's own
LONE_RESIDUAL = 0.06  # In units of its size, of a body alone before a camera that is not calibrated
OTHER_BODY_RESIDUAL = 0.15  # The same for five lights that the thesis's assumption alone must name
RESTED = 2  # Frames after one whose lights could not be named
CONFIRMED = 3  # Frames in which a body must be named alike where one frame does not make it certain
CONFIRMED_ODD = 10  # The same where one of the lights may be another one, which has gone by then
SURE_AT_START = -13.0
"""Logarithm of the odds of a body among other lights from which on one frame is believed. That its
place and size may be anything costs 11 more than that they are those of some body in the image."""
SAME_RESIDUAL = (0.2, 0.2)
"""px, and part of it, by which the residual of a rig measured badly may change meanwhile."""


class Named(NamedTuple):
    """Markers of a body, by name."""

    lights: Mapping[int, Light] = {}  # px without distortion; empty if they cannot be named
    view: ViewState | None = None  # fitted to them
    frames: int = 1  # that must name it alike
    fits: bool = True  # whether the body is what its rig says
    remark: str = ''  # why they cannot be named, or what was left out


def fewest_at_start(shape: WeakPerspective) -> int:
    """Lights with which a body may begin: one may be out where the others show it is the body."""
    count = len(shape.points)
    return count - (shape.lens.focal is not None and count > MIN_WITH_HIDDEN)


def initialize(
    shape: WeakPerspective, lights: Sequence[Light], names: Sequence[str], turn: int = 0
) -> Named:
    """Name a whole body of which nothing is known; how exact its rig is must be seen.

    Among very many lights it is looked for by size, some in each turn.
    """
    count = len(names)
    every = by_size(lights)
    spots = candidates(every, count)
    if len(spots) < fewest_at_start(shape):
        return Named(remark=f'{len(spots)} of {count} markers in view')
    few = len(spots) <= MAX_NAMED
    bodies = _bodies(shape, spots, count) if few else []
    named = _whole(shape, spots, bodies, names, len(spots)) if few else None
    # A body's lights may be far smaller than letters, and than lamps nearer by.
    if named is None and len(every) > min(len(spots), MAX_NAMED):
        step = MAX_AT_START // 2
        first = step * (turn % max(1, math.ceil(len(every) / step) - 1))
        some = every[first : first + MAX_AT_START]
        named = _whole(shape, some, _bodies(shape, some, count), names, len(every))
    if named is None and len(spots) <= MAX_WITH_HIDDEN and not any(map(_is_strict, bodies)):
        named = _with_hidden(shape, spots)
    return named or Named(remark=f'{len(spots)} lights in view, {count} do not stand out')


def _whole(
    shape: WeakPerspective,
    spots: Sequence[Light],
    bodies: Sequence[Hypothesis],
    names: Sequence[str],
    lights: int,
) -> Named | None:
    """All markers among some spots, of so many lights in view."""
    count = len(names)
    alone = lights == count
    free = alone and shape.lens.focal is None
    best = _outstanding(bodies)
    if best is not None and _is_probable(shape, best, lights):
        exact = CLEAR_RESIDUAL[0] + CLEAR_RESIDUAL[1] * best.view.scale
        limit = LONE_RESIDUAL * best.view.scale if free else exact
        if best.view.rms_residual <= max(limit, exact):
            is_sure = best.evidence > SURE_AT_START and lights <= MAX_NAMED
            frames = 1 if alone or is_sure else CONFIRMED
            if not (free or _is_strict(best)):
                frames = CONFIRMED_ODD
            remark = '' if alone else f'{lights} lights in view, the {count} that fit were used'
            return Named(
                best.lights(spots), best.view, frames, best.view.rms_residual <= exact, remark
            )
    return _as_the_thesis(shape, spots) if free and tuple(names) == TANKER_NAMES else None


def _is_probable(shape: WeakPerspective, body: Hypothesis, lights: int) -> bool:
    """Whether the evidence of a body of all markers is more than so many lights give by chance.

    It is asked for among many lights, and where little is measured twice: four markers have eight
    coordinates and six unknowns, eight before any lens, and that it may be any costs evidence.
    """
    is_sure, is_strict = body.evidence > SURE_AT_START, _is_strict(body)
    if lights > MAX_NAMED:
        return is_sure and is_strict
    count, any_lens = len(shape.points), shape.lens.focal is None
    redundancy = 2 * count - (COUNT if any_lens else FOCAL)
    return lights == count or redundancy > 2 or is_sure or (any_lens and is_strict)


def _with_hidden(shape: WeakPerspective, spots: Sequence[Light]) -> Named | None:
    """A body without one marker, where the others leave no doubt."""
    count, fewest = len(shape.points), fewest_at_start(shape)
    if fewest == count:
        return None
    best = _outstanding(_bodies(shape, spots, fewest))
    if best is None or best.evidence < SURE_AT_START or not _is_strict(best):
        return None
    named = best.lights(spots)
    x, y = best.view.parameters[[X, Y]].tolist()
    away = [math.hypot(spot.x - x, spot.y - y) for spot in spots if spot not in named.values()]
    if min(away, default=math.inf) < MIN_AWAY * best.view.scale:
        return None
    return Named(named, best.view, CONFIRMED_ODD)


def _bodies(shape: WeakPerspective, spots: Sequence[Light], fewest: int) -> list[Hypothesis]:
    bodies = body_hypotheses(shape, spots, Prior.at_start(shape), fewest)
    bodies = [one for one in bodies if _may_be_one_body([*one.lights(spots).values()])]
    return [one for one in bodies if not any(_is_flare(one, body, spots) for body in bodies)]


def _outstanding(bodies: Sequence[Hypothesis]) -> Hypothesis | None:
    """The first one, if it is clearly more probable than the next."""
    if bodies and (len(bodies) == 1 or bodies[0].evidence >= bodies[1].evidence + MARGIN):
        return bodies[0]
    return None


def _is_strict(body: Hypothesis) -> bool:
    return body.view.rms_residual <= STRICT_RESIDUAL[0] + STRICT_RESIDUAL[1] * body.view.scale


def _may_be_one_body(lights: Sequence[Light]) -> bool:
    areas = [light.seen.area for light in lights]
    return max(areas) <= MAX_RATIO * min(areas)


def _is_flare(other: Hypothesis, body: Hypothesis, spots: Sequence[Light]) -> bool:
    """Whether another body is smaller, and so are its own lights: a flare repeats what it sees."""
    theirs, ours = ({light for _, light in hypothesis.assignment} for hypothesis in (other, body))
    is_smaller = other.view.scale < body.view.scale and body.evidence > SURE_AT_START
    if not is_smaller or len(theirs - ours) < MIN_APART:
        return False
    small, large, both = (
        sorted(spots[light].seen.area for light in lights)
        for lights in (theirs - ours, ours - theirs, ours & theirs)
    )
    # Where lights of both lie on each other, that is larger than any.
    return max(large) < min(both, default=math.inf) and all(map(operator.lt, small, large))


def _as_the_thesis(shape: WeakPerspective, spots: Sequence[Light]) -> Named | None:
    """Five lights in no doubt but for their order: by the distances, upright (Appendix A)."""
    spots = sorted(spots, key=lambda spot: (spot.x, spot.y))
    chosen = {marker: spots[index] for marker, index in enumerate(label_five(spots))}
    left, right = chosen[0], chosen[4]
    span = math.hypot(right.x - left.x, right.y - left.y)
    if span == 0.0 or not _may_be_one_body(spots):
        return None
    roll = math.atan2(right.y - left.y, right.x - left.x)
    scale = math.log(0.56 * span)
    start = np.array([roll, scale, 0.0, 0.0, 0.0, 0.0, scale - math.log(0.25), 0.0])
    start[[X, Y]] = np.mean([*places_of(chosen).values()], axis=0)
    deviations = np.array((1.0, 1.0, span, span, 0.4, 0.4, 0.5, 1e-3))
    before = Belief(start[None], np.diag(deviations**2)[None])
    named = NamedPlaces.of(places_of(chosen))
    view = Correction.of(shape, before, named, (0.02 * span) ** 2).view()
    if view.rms_residual > OTHER_BODY_RESIDUAL * view.scale:
        return None
    # Nearly any five lights have some such order.
    return Named(chosen, view, CONFIRMED, fits=False)


@dataclass
class Attempts:
    """When to name a whole body, and whether enough frames have named it alike."""

    # Whether a body was followed that was none: one that is not what its rig says must be seen
    # alike in enough frames from then on.
    was_wrong: bool = False
    agreed: int = 0  # frames in a row that named the body alike
    last: Mapping[int, Light] = field(default_factory=dict)  # its markers in the last one
    failed: int = 0  # attempts
    rest: int = 0  # frames until the next attempt
    _lights: int = 0
    _came: bool = False  # whether there were others in the frame before
    _is_flicker: bool = False  # the same, of the first frame of those in a row
    _first_residual: float = 0.0
    _is_odd: bool = False  # whether one of the lights may well have been another one meanwhile

    def due(self, lights: int) -> bool:
        """Whether to try in this frame: another number of lights may be what was waited for."""
        is_due = self.rest == 0 or (lights != self._lights and lights <= MAX_NAMED)
        self._came = 0 < self._lights != lights
        self.rest, self._lights = max(self.rest - 1, 0), lights
        return is_due

    def fail(self) -> None:
        """No way of naming the lights stood out."""
        self.agreed, self.last, self.rest = 0, {}, RESTED
        self.failed += 1

    def confirmed(self, named: Named, is_calibrated: bool) -> bool:
        """Whether enough frames in a row have named the body alike."""
        is_odd = self._is_odd or (self.was_wrong and not named.fits)
        # Any lens will do: what comes and goes may well look like a body for one frame.
        is_chance = self._is_flicker and not is_calibrated
        frames = max(named.frames, CONFIRMED if is_chance else 1)
        return self.agreed >= (CONFIRMED_ODD if is_odd else frames)

    def succeed(self, named: Named) -> bool:
        """Take a way of naming them; whether it is that of the last attempt."""
        assert named.view is not None
        reach = 0.5 * named.view.scale
        both = self.last.keys() & named.lights.keys()
        alike = all(are_close(self.last[m], named.lights[m], reach) for m in both)
        most = SAME_RESIDUAL[0] + SAME_RESIDUAL[1] * self._first_residual
        changed = abs(named.view.rms_residual - self._first_residual) > most
        goes_on = alike and self.last.keys() == named.lights.keys()
        self._is_odd = named.frames == CONFIRMED_ODD or (goes_on and self._is_odd)
        if goes_on and not (self._is_odd and changed):
            self.agreed += 1
        else:
            self.agreed, self._first_residual = 1, named.view.rms_residual
            self._is_flicker = self._came
        self.last = named.lights
        return alike


class Trial:
    """A body that is followed and not what its rig says: one measured badly goes on to differ."""

    def __init__(self, shape: WeakPerspective, view: ViewState, found: Mapping[int, Point]) -> None:
        """Begin with all markers, px without distortion, in a view fitted to them."""
        self._shape, self._view, self._left = shape, view, CONFIRMED_ODD
        self._first = self._rms_residual(found)

    def is_refuted(self, found: Mapping[int, Point], contradicted: bool = False) -> bool:
        """Whether it is none, by the markers found, some of which contradicted others before."""
        # Once all were seen alike in enough frames it is one.
        if self._left == 0:
            return False
        if len(found) < len(self._shape.points):
            return contradicted
        self._left -= 1
        least = SAME_RESIDUAL[0] / self._view.scale
        return abs(self._rms_residual(found) - self._first) > least + SAME_RESIDUAL[1] * self._first

    def _rms_residual(self, found: Mapping[int, Point]) -> float:
        """Of a view by these alone, in units of the body's size."""
        start, prior = self._view.parameters, Prior.at_start(self._shape)
        fitted = _fit(self._shape, NamedPlaces.of(found), prior, start[SCALE], start[None])
        self._view = fitted.view()
        return self._view.rms_residual / self._view.scale
