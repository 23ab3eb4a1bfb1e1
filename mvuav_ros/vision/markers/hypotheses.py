"""Ways of naming a frame's lights as the markers of one body, and how probable each is."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, partial
from itertools import permutations
from statistics import median_high

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.markers.lights import Light, coordinates
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
from mvuav_ros.vision.markers.view_filter import ViewFilter

ANY_ROLL = 0.9
"""rad (1 sigma): at the start an upright body is likelier than one upside down, by 6 of the log
odds; the other way round where the camera is mounted so. A lens repeats a body upside down, and
four of its lights may look alike both ways."""
FREE = 30.0, 1e4
"""rad and logarithm, and px (1 sigma): nothing is known of roll and size, and of the place."""
TILT = 0.4  # rad, 1 sigma: the camera looks at the body from behind, give or take
BARREL_DEVIATION = 0.1  # 1 sigma, of what a lens that is not calibrated does at half the diagonal
MODEL_ERROR = 0.004  # By how much a body may differ from its rig, in units of its size (1 sigma)
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
        mean[ROLL], mean[[X, Y]] = shape.upright, shape.lens.centre
        mean[FOCAL] = math.log(shape.lens.focal or _TYPICAL_FOCAL * shape.lens.half_diagonal)
        deviations[ROLL], deviations[SCALE], deviations[[X, Y]] = ANY_ROLL, FREE[0], FREE[1]
        deviations[[PITCH, YAW]] = TILT
        deviations[FOCAL] = _FOCAL_DEVIATION if shape.lens.focal is None else KNOWN_FOCAL
        deviations[BARREL] = BARREL_DEVIATION if shape.lens.focal is None else 1e-4
        return cls(mean, deviations)

    @classmethod
    def of(cls, views: ViewFilter, jolt: Sequence[float] = (0.0,) * FOCAL) -> Prior:
        """What a filter has of the view at its time, and by how much a jolt may have changed it.

        What it has lost of roll and tilt is what they are at the start: a body turns about that.
        """
        view, usual = views.view, cls.at_start(views.shape)
        mean, deviations = view.parameters.copy(), np.sqrt(view.covariance.diagonal())
        deviations[:FOCAL] = np.hypot(deviations[:FOCAL], jolt)
        turns = [ROLL, PITCH, YAW]
        share = deviations[turns] ** 2 / (deviations[turns] ** 2 + usual.deviations[turns] ** 2)
        off = usual.untwisted(mean[None])[0] - usual.mean
        mean[turns] -= share * off[turns]
        deviations[turns] *= np.sqrt(1.0 - share)
        return cls(mean, deviations, views.deviation)

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
Landmarks = Callable[[Array, Array], Array]
"""Log odds (v,) of views (v, 8) with named lights (v, k, 2), px, by what else of the body shows."""


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
    landmarks: Landmarks | None = None,
) -> list[Hypothesis]:
    """All probable ways of seeing a body in a number of spots, most probable first.

    Three markers are tried on all threes of spots (`MAX_NAMED` at most, px without distortion), in
    every order; the views that follow say where the other markers are, and the best are fitted. The
    fewest of the markers must be among the spots, beside which there is so much clutter per px².
    Landmarks speak for or against a view as well.
    """
    places = coordinates(spots)
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
        fits = fit(shape, named, prior, scale, views)
        # Logarithms of how probable clutter is in so many places, and in one place less.
        # It is not rare where more lights have no name than have one.
        density = clutter if len(spots) <= 2 * number else max(clutter, CLUTTER_DENSITY)
        others, fewer = (
            k * math.log(density)
            + math.log(math.comb(len(shape.points), k))
            + math.log(math.perm(len(spots), k))
            for k in (number, number - 1)
        )
        evidence = fits.evidence
        if landmarks is not None:
            evidence = evidence + landmarks(fits.after.mean, places[pairs[..., 1]])
        for row, (assignment, _) in enumerate(same):
            view, log_density = fits.view(row), float(evidence[row])
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


def fit(
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
