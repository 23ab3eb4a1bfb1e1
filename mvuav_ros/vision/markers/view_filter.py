"""How a rig is seen, carried from frame to frame by a Kalman filter."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.markers.rig_view import (
    BARREL,
    COUNT,
    FOCAL,
    PITCH,
    ROLL,
    SCALE,
    SETTLED,
    YAW,
    Array,
    Fits,
    NamedPlaces,
    ViewState,
    WeakPerspective,
    X,
    Y,
    columns_of,
    deviations_of,
    fit,
    limited,
    possible,
)

Point = tuple[float, float]


@dataclass(frozen=True)
class ViewTuning:
    """How views change, and how exactly rigs are measured.

    Chosen on seeds 0 to 7 of flights of bare lights (`mvuav_thesis.light_flights`) and on the
    simulator's docking approaches; `learning` and `max_unseen` on seeds 9000 to 9029 and 9500 to
    9529. The parameters are those of `WeakPerspective.project`.
    """

    # Random walk of the parameters, per square root of a second.
    walk_noise: tuple[float, ...] = (0.08, 0.005, 25.0, 25.0, 0.01, 0.01, 0.01, 0.002)
    # The same of their rates: how quickly a motion changes.
    rate_noise: tuple[float, ...] = (0.8, 0.4, 250.0, 250.0, 0.3, 0.3, 0.0, 0.0)
    noise: float = 0.15  # px (1 sigma), of a light's place
    # Of a marker's place on the rig, in units of its size (1 sigma), at first.
    rig_error: float = 0.004
    min_rig_error: float = 0.0003  # the least that is learnt from how well the markers fit
    other_rig_error: float = 0.02  # the same for a body that is not what its rig says
    # Per frame, of a rig error that turns out less, or more.
    learning: float = 0.25
    unlearning: float = 0.003
    # Per frame, by which the variances of jitter and process noise follow the motion.
    motion_learning: float = 0.1
    # Per frame in which too few markers are seen, by which they grow again.
    motion_forgetting: float = 1.2
    # To which they grow at least, and at most.
    min_unseen: float = 0.1
    max_unseen: float = 8.0
    # To which they grow, in parts of the rates' squares over their variances.
    rates_share: float = 3.0
    max_step: float = 25.0  # square over its variance, of a step that is learnt from
    # Of those variances, in parts of the usual ones.
    min_motion: float = 0.02
    max_motion: float = 4.0
    doubted: float = 10.0  # times the usual deviation at which a marker that is doubted takes part
    min_doubted: float = 2.0  # px, of that at least
    rates_last: float = 1.0  # s, after which a motion has changed
    # Coordinates of all markers less the unknowns of the view, with which a light that slowly
    # drifts away from its marker bends the view instead of standing out: four lights, and five
    # without a calibration. With more it stands out in a frame, with less nothing can be checked.
    bending: tuple[int, int] = (1, 2)


TUNING = ViewTuning()
_STATES = 2 * COUNT
_UNITY: Array = np.eye(_STATES)
_MAX_ITERATIONS = 6
_RATE_NOISE: Array = np.square(TUNING.rate_noise)
_STATIONARY: Array = 0.5 * TUNING.rates_last * _RATE_NOISE  # Of the rates in the long run
_LIVELY: Array = TUNING.rates_share / np.maximum(_STATIONARY, 1e-12)
_WALK_NOISE: Array = np.square(TUNING.walk_noise)
_ALIKE = np.eye(COUNT)
for _pair in ((X, Y), (PITCH, YAW)):
    _ALIKE[np.ix_(_pair, _pair)] = 0.5
"""Averages over parameters whose motions are alike."""
_NOTHING_KNOWN = 6.0, 3000.0
"""rad and px (1 sigma), of roll and place: there is nothing left to be less certain of."""
_MIN_HOLDING = 3  # Markers in a frame with which the motion is not forgotten
_FREEDOM = 4.0  # Degrees, of the distribution of a place about where the others put it
_MIN_EXACT = 4  # Markers by which a frame shows how the view moves, and how exact the rig is


class Belief(NamedTuple):
    """Parameters of views and their rates per s (f, 16), and the covariances (f, 16, 16)."""

    mean: Array
    covariance: Array


class ViewFilter:
    """A Kalman filter of a view and its rates, whose measurements are named lights.

    How far each marker lies from where all the others put it follows in closed form from the
    innovations and their covariance (see `Correction.nis`). A body with just enough lights has a
    second filter for each marker, which has all but ignored that marker in all frames: a light that
    drifts slowly with the view is seen by that filter alone. All of them go on together, the main
    one first.
    """

    def __init__(
        self,
        shape: WeakPerspective,
        view: ViewState,
        time: float,
        before: ViewFilter | None = None,
    ) -> None:
        """Begin at a time (s) with a view fitted to all markers.

        The filter before of this very rig has learnt its exactness and motion.
        """
        # The rig, with what lies beside it on a body that is not what its rig says.
        self.shape = shape
        self.time = time  # s
        covariance = np.diag(np.concatenate((np.zeros(COUNT), _STATIONARY + 1e-12)))
        covariance[:COUNT, :COUNT] = view.covariance
        mean = np.concatenate((view.parameters, np.zeros(COUNT)))
        self._is_calibrated = shape.lens.focal is not None
        count = len(shape.points)
        least, most = TUNING.bending
        few = least <= 2 * count - self.unknowns <= most
        # Whether each marker has a filter that all but ignores it.
        self.has_bank = few
        filters = 1 + few * count
        self.belief = Belief(np.tile(mean, (filters, 1)), np.tile(covariance, (filters, 1, 1)))
        relative = view.misfit / view.scale
        self._rig_errors = (TUNING.min_rig_error, max(TUNING.rig_error, 1.5 * relative))
        if shape.offsets is not None:
            # As the view changes, so does what lies beside the rig.
            self._rig_errors = (TUNING.other_rig_error, TUNING.other_rig_error)
        # Of a marker's place on the rig, in units of its size (1 sigma).
        self.rig_error: float = before.rig_error if before else self._rig_errors[1]
        self._seen = count
        self._max_motion: Array = before._max_motion if before else np.zeros(COUNT)
        self._motion: Array = before._motion if before else np.ones(COUNT)

    @property
    def view(self) -> ViewState:
        """At `time`; after `predict` the prior of that frame."""
        mean, covariance = self.belief
        return ViewState(mean[0, :COUNT], covariance[0, :COUNT, :COUNT])

    @property
    def deviation(self) -> float:
        """Of a measured marker from where the view has it (1 sigma, px)."""
        scale = math.exp(self.belief.mean.item(0, SCALE))
        return math.hypot(TUNING.noise, self.rig_error * scale)

    @property
    def doubted_deviation(self) -> float:
        """The same of a marker that is doubted."""
        return max(TUNING.doubted * self.deviation, TUNING.min_doubted)

    @property
    def unknowns(self) -> int:
        """Parameters that the lights alone give."""
        return COUNT - 2 if self._is_calibrated else COUNT

    def deviation_of(self, parameter: int) -> float:
        """How uncertain a parameter is (1 sigma)."""
        return math.sqrt(self.belief.covariance.item(0, parameter, parameter))

    def predict(self, time: float) -> None:
        """Go on to a later time (s)."""
        walk, rate_noise = self._motion * _WALK_NOISE, self._motion * _RATE_NOISE
        if self._is_calibrated:
            walk[FOCAL:] = 0.0
        self.belief = _predicted(self.belief, time - self.time, walk, rate_noise)
        self.time = time
        if self._seen < _MIN_HOLDING:
            usual = np.clip(self._max_motion, TUNING.min_unseen, TUNING.max_unseen)
            grown = np.minimum(TUNING.motion_forgetting * self._motion, usual)
            self._motion = np.maximum(self._motion, grown)
        self._seen = 0

    def places(self, view: ViewState | None = None) -> tuple[Array, Array]:
        """Where the markers should be, (n, 2) px, and how uncertain that is, (n,) px."""
        view = view or self.view
        places, jacobian = self.shape.linearize(view.parameters)
        return places, deviations_of(jacobian, view.covariance)

    def look(self, found: Mapping[int, Point]) -> ViewState:
        """The view by the named lights (px without distortion), from this frame's prior."""
        if not found:
            return self.view
        return self.fit(np.array([list(found)]), np.array([list(found.values())])).view()

    def fit(self, seen: NDArray[np.intp], measured: Array) -> Fits:
        """Views by several ways of naming markers, (m, k), from this frame's prior."""
        mean, covariance = self.belief
        prior = mean[:1, :COUNT], covariance[:1, :COUNT, :COUNT]
        return fit(self.shape, prior, NamedPlaces(seen, measured, self.deviation))

    def correct(self, found: Mapping[int, Point], untrusted: Collection[int] = ()) -> Correction:
        """What the named lights, px without distortion, make of the view.

        Those on probation are all but ignored.
        """
        own, wide = self.deviation**2, self.doubted_deviation**2
        noise = np.full((len(self.belief.mean), 2 * len(found)), own)
        if untrusted or self.has_bank:
            for index, marker in enumerate(found):
                rows = slice(None) if marker in untrusted else slice(1 + marker, 2 + marker)
                noise[rows, 2 * index : 2 * index + 2] = wide
        return Correction.of(self.shape, self.belief, found, noise, own)

    def exclude(self, marker: int) -> None:
        """Go on from the filter that has ignored a marker: that one was another light."""
        mean, covariance = self.belief
        filters = len(mean)
        one = slice(1 + marker, 2 + marker)
        self.belief = Belief(
            np.repeat(mean[one], filters, axis=0), np.repeat(covariance[one], filters, axis=0)
        )

    def inflate(self, factor: float) -> None:
        """Be less certain: what was seen contradicts the view as a whole."""
        if self.deviation_of(ROLL) > _NOTHING_KNOWN[0] or self.deviation_of(X) > _NOTHING_KNOWN[1]:
            return
        growth = np.full(_STATES, math.sqrt(factor))
        if self._is_calibrated:
            growth[[FOCAL, BARREL, COUNT + FOCAL, COUNT + BARREL]] = 1.0
        mean, covariance = self.belief
        self.belief = Belief(mean, growth[:, None] * growth * covariance)

    def commit(self, correction: Correction) -> None:
        """Take what a frame's named lights, which agree, have made of the views."""
        self._seen = len(correction.found)
        if self._seen >= _MIN_EXACT:
            self._learn_motion(correction)
        self.belief = correction.after
        # Four markers before a lens that is not known fit any rig.
        fewest = _MIN_EXACT if self._is_calibrated else max(len(self.shape.points), _MIN_EXACT)
        if len(correction.found) >= fewest:
            self._learn_rig_error(correction)

    def _learn_motion(self, correction: Correction) -> None:
        """The steps from the predicted views over their variances give the process noise."""
        before, after = correction.before, correction.after
        step = correction.change[0, :COUNT]
        expected = (before.covariance[0].diagonal() - after.covariance[0].diagonal())[:COUNT]
        shown = np.minimum(_ALIKE.dot(step * step / np.maximum(expected, 1e-12)), TUNING.max_step)
        motion = self._motion * ((1.0 - TUNING.motion_learning) + TUNING.motion_learning * shown)
        self._motion = np.minimum(np.maximum(motion, TUNING.min_motion), TUNING.max_motion)
        rates = before.mean[0, COUNT:]
        self._max_motion = np.maximum(0.998 * self._max_motion, rates * rates * _LIVELY)

    def _learn_rig_error(self, correction: Correction) -> None:
        """How well markers that agree fit shows how exact the rig is; less exact only slowly."""
        seen, scale = len(correction.found), math.exp(correction.after.mean.item(0, SCALE))
        shown = correction.misfit() * math.sqrt(seen / max(2 * seen - 6, 1)) / scale
        shown = min(max(2.0 * shown, self._rig_errors[0]), self._rig_errors[1])
        rate = TUNING.learning if shown < self.rig_error else TUNING.unlearning
        self.rig_error += rate * (shown - self.rig_error)


def _predicted(belief: Belief, elapsed: float, walk: Array, rate_noise: Array) -> Belief:
    """The same so many s later: rates that fade, driven by white noise (variances per s, (8,))."""
    mean, covariance = belief
    last = TUNING.rates_last
    fade = math.exp(-elapsed / last)
    reach = last * (1.0 - fade)
    # What lies on the diagonals of the four blocks of 8 x 8.
    transition, noise, step = _UNITY.copy(), np.zeros((_STATES, _STATES)), _STATES + 1
    flat = transition.ravel()
    flat[COUNT : COUNT * step : step] = reach
    flat[COUNT * step :: step] = fade
    flat = noise.ravel()
    across = (0.5 * reach * reach) * rate_noise
    flat[: COUNT * step : step] = elapsed * walk + (elapsed**3 / 3) * rate_noise
    flat[COUNT : COUNT * step : step] = flat[COUNT * _STATES :: step] = across
    flat[COUNT * step :: step] = (0.5 * last * (1.0 - fade * fade)) * rate_noise
    half = covariance.reshape(-1, _STATES).dot(transition.T).reshape(covariance.shape)
    mean = mean.dot(transition.T)
    mean[:, :COUNT] = possible(mean[:, :COUNT])
    return Belief(mean, transition @ half + noise)


@dataclass(frozen=True, eq=False)
class Correction:
    """What k named lights of a frame make of views: an iterated extended Kalman filter's update.

    It is that of f filters at once, of which the first is the main one, and the one after marker i
    of the rig's is that which ignores it.

    Attributes:
        before: the priors.
        found: the lights' places by marker, px without distortion.
        change: (f, 16), of the state.
        towards: (f, 16, 2 k), covariance of the state with the places.
        slopes: (f, 8, 2 k), of the places by the parameters.
        weight: (f, 2 k, 2 k), inverse covariance of the innovations, px^-2.
        weighed: (f, 2 k), the innovations times that.
        noise: (f, 2 k), px², variances at which the coordinates take part.
        own: px², variance of a marker's place.
    """

    before: Belief
    found: Mapping[int, Point]
    change: Array
    towards: Array
    slopes: Array
    weight: Array
    weighed: Array
    noise: Array
    own: float

    @classmethod
    def of(
        cls,
        shape: WeakPerspective,
        before: Belief,
        found: Mapping[int, Point],
        noise: Array,
        own: float,
    ) -> Correction:
        """Correct priors by lights, of whose coordinates each has a variance (f, 2 k), px²."""
        mean, covariance = before
        count = 2 * len(found)
        markers = list(found)
        in_order = markers == list(range(len(shape.points)))
        columns = None if in_order else columns_of(np.array(markers, np.intp))
        places = np.array(list(found.values())).ravel()
        prior = parameters = np.ascontiguousarray(mean[:, :COUNT])
        for _ in range(_MAX_ITERATIONS):
            expected, slopes = shape.linearize_all(parameters)
            if columns is not None:
                expected, slopes = expected[:, columns], slopes[:, :, columns]
            innovation = places - expected
            away = prior - parameters
            if parameters is not prior:
                innovation -= _times(slopes.transpose(0, 2, 1), away)
            towards = covariance[:, :, :COUNT] @ slopes
            spread = slopes.transpose(0, 2, 1) @ towards[:, :COUNT]
            spread.reshape(-1, count * count)[:, :: count + 1] += noise
            weight = _inverses(spread)
            weighed = _times(weight, innovation)
            change = _times(towards, weighed)
            step, largest = limited(change[:, :COUNT] + away)
            parameters = possible(parameters + step)
            if largest < SETTLED:
                break
        else:
            # What the last slopes predict of the residuals cannot be trusted.
            expected = shape.linearize_all(parameters)[0]
            weighed = (places - (expected if columns is None else expected[:, columns])) / noise
        change[:, :COUNT] = parameters - prior
        return cls(before, found, change, towards, slopes, weight, weighed, noise, own)

    @cached_property
    def after(self) -> Belief:
        """The states with what has been seen, in Joseph's form: no variance gets negative.

        With K the gain, H the slopes and P the prior's covariance, it is A - (A H - K R) K^T, where
        A = (I - K H^T) P.
        """
        mean, covariance = self.before
        gain = self.towards @ self.weight
        transposed = gain.transpose(0, 2, 1)
        left = covariance - gain @ self.towards.transpose(0, 2, 1)
        rest = left[:, :, :COUNT] @ self.slopes
        rest -= gain * self.noise[:, None]
        left -= rest @ transposed
        return Belief(mean + self.change, 0.5 * (left + left.transpose(0, 2, 1)))

    def misfit(self, row: int = 0) -> float:
        """Root mean square of the markers' distances from their places in a filter's view, px."""
        residual = self.weighed[row] * self.noise[row]
        return math.sqrt(float(residual.dot(residual)) / max(len(self.found), 1))

    def _by_others(self, row: int, index: int) -> tuple[float, float, float, float, float]:
        """From all other markers alone: one's innovation, px, and its place's covariance.

        With w = S⁻¹ r, the weighed innovations, and B the marker's 2 x 2 block of S⁻¹, the
        innovation by the others alone is B⁻¹ w with the covariance B⁻¹, of which the marker's own
        variance is a part: x, y, and xx, xy, yy of the rest.
        """
        item, first, second = self.weight.item, 2 * index, 2 * index + 1
        xx, xy, yy = (
            item(row, first, first),
            item(row, first, second),
            item(row, second, second),
        )
        determinant = max(xx * yy - xy * xy, 1e-12 * xx * yy)
        xx, xy, yy = yy / determinant, -xy / determinant, xx / determinant
        x, y = self.weighed.item(row, first), self.weighed.item(row, second)
        variance = self.noise.item(row, first)
        return xx * x + xy * y, xy * x + yy * y, xx - variance, xy, yy - variance

    def nis_of(self, row: int, index: int) -> float:
        """How far a marker lies from where a filter's others put it (chi², two degrees)."""
        return _weighed_distance(*self._by_others(row, index), self.own)[0]

    @cached_property
    def _distances(self) -> list[tuple[float, float]]:
        """For each marker from where the main filter's others put it.

        The squared distance over the variance, the marker's own included, and the determinant of
        that, px⁴.
        """
        return [_weighed_distance(*other, self.own) for other in self._others]

    @cached_property
    def _others(self) -> list[tuple[float, float, float, float, float]]:
        return [self._by_others(0, index) for index in range(len(self.found))]

    @cached_property
    def nis(self) -> list[float]:
        """For each marker how far it lies from where the main filter's others put it."""
        return [square for square, _ in self._distances]

    def deviation_by_others(self, row: int, index: int) -> float:
        """How exactly a filter's others determine a marker's place (1 sigma, px): larger axis."""
        _, _, xx, xy, yy = self._by_others(row, index)
        largest = 0.5 * (xx + yy) + math.hypot(0.5 * (xx - yy), xy)
        return math.sqrt(max(largest, 0.0))

    def log_likelihoods(self, beside: float) -> dict[int, tuple[float, float]]:
        """How probable each marker's place is by all others, logarithm per px².

        First that of the marker itself, then that of another light which lies within so many px of
        there (1 sigma per axis).
        """
        wide = self.own + beside * beside
        densities = {}
        for marker, other, (near, least) in zip(
            self.found, self._others, self._distances, strict=True
        ):
            far, most = _weighed_distance(*other, wide)
            densities[marker] = log_density(near, least), log_density(far, most)
        return densities

    def view(self, row: int = 0) -> ViewState:
        """What follows of a filter's view."""
        mean, covariance = self.after
        nis = [self.nis_of(row, index) for index in range(len(self.found))]
        return ViewState(
            mean[row, :COUNT],
            covariance[row, :COUNT, :COUNT],
            self.misfit(row),
            nis=np.array(nis),
        )


def _times(matrices: Array, vectors: Array) -> Array:
    """Products of matrices (f, n, k) and vectors (f, k)."""
    return np.asarray((matrices @ vectors[..., None])[..., 0])


def _inverses(matrices: Array) -> Array:
    """Of positive matrices (f, n, n)."""
    inverses = np.empty_like(matrices)
    for matrix, inverse in zip(matrices, inverses, strict=True):
        if not cv2.invert(matrix, inverse, cv2.DECOMP_CHOLESKY)[0]:
            inverse[:] = np.linalg.pinv(matrix, hermitian=True)
    return inverses


def log_density(square: float, determinant: float) -> float:
    """Of Student's t in two dimensions, at a squared distance over its covariance.

    Its tails are wider than a normal distribution's: at times a motion was not foreseen.
    """
    tail = (0.5 * _FREEDOM + 1.0) * math.log1p(square / _FREEDOM)
    return -tail - 0.5 * math.log(determinant) - math.log(2.0 * math.pi)


def _weighed_distance(
    x: float, y: float, xx: float, xy: float, yy: float, variance: float
) -> tuple[float, float]:
    """A squared distance over its covariance and a variance of both axes, and the determinant."""
    xx, yy = (xx if xx > 0.0 else 0.0) + variance, (yy if yy > 0.0 else 0.0) + variance
    determinant = max(xx * yy - xy * xy, 1e-12 * xx * yy)
    return (yy * x * x - 2.0 * xy * x * y + xx * y * y) / determinant, determinant
