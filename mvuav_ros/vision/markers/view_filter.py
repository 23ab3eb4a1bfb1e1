"""How a rig is seen, carried from frame to frame by a Kalman filter."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
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
    max_motion_memory: float = 0.998  # per frame, of the quickest motion that was seen
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
    max_kept: int = 8  # frames in which a gain serves
    # While it does: part by which the prior variances have changed since the gain before, and the
    # time between two frames.
    same_variance: float = 0.3
    same_step: float = 0.2
    same_view: float = 0.03  # rad, and logarithms: of the view since then
    same_place: float = 30.0  # px, the same
    # Squared distances over variances of a marker from its place by the others, and of all
    # coordinates from the expected ones (mean).
    usual_nis: float = 8.0
    usual_innovation: float = 2.5


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
_MOVED: Array = np.full(COUNT, 1.0 / TUNING.same_view)
_MOVED[[X, Y]] = 1.0 / TUNING.same_place
"""Times which the changes of a view that has hardly moved are below 1."""
_NOTHING_KNOWN = 6.0, 3000.0
"""rad and px (1 sigma), of roll and place: there is nothing left to be less certain of."""
_MIN_HOLDING = 3  # Markers in a frame with which the motion is not forgotten
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
        # (f, 16), at `time`.
        self.means: Array = np.tile(mean, (filters, 1))
        # Of an earlier time, so many s ago, where the means have gone on alone since then.
        self._covariances: Array = np.tile(covariance, (filters, 1, 1))
        self._behind = 0.0
        self._step: tuple[float, Array] = 0.0, _UNITY  # s, and what it does to the states
        # Prior variances by which the newest gain was found, and whether those before were alike.
        self._variances: Array = np.zeros(COUNT)
        self._is_steady = False
        self._kept = _KeptGain()
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
    def belief(self) -> Belief:
        """At `time`; after `predict` the prior of that frame."""
        if self._behind:
            self._learn()
            walk, rate_noise = self._motion * _WALK_NOISE, self._motion * _RATE_NOISE
            if self._is_calibrated:
                walk[FOCAL:] = 0.0
            transition = self._step[1]
            noise = _process_noise(self._behind, walk, rate_noise)
            self._covariances = transition @ self._covariances @ transition.T + noise
            self._behind = 0.0
            before, now = self._variances, self._covariances[0].diagonal()[:COUNT]
            self._is_steady = bool((abs(now - before) <= TUNING.same_variance * before).all())
            self._variances = now
        return Belief(self.means, self._covariances)

    @property
    def view(self) -> ViewState:
        """At `time`; after `predict` the prior of that frame."""
        mean, covariance = self.belief
        return ViewState(mean[0, :COUNT], covariance[0, :COUNT, :COUNT])

    @property
    def deviation(self) -> float:
        """Of a measured marker from where the view has it (1 sigma, px)."""
        scale = math.exp(self.means.item(0, SCALE))
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
        if self._behind:
            # Nothing was committed in the last frame.
            self._covariances = self.belief.covariance
        elapsed = time - self.time
        if elapsed != self._step[0]:
            self._step = elapsed, _transition(elapsed)
        self.means = self.means.dot(self._step[1].T)
        self.means[:, :COUNT] = possible(self.means[:, :COUNT])
        self._behind, self.time = elapsed, time
        if self._seen < _MIN_HOLDING:
            self._covariances = self.belief.covariance
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
        again = None if untrusted else self._correct_as_before(found)
        if again is not None:
            return again
        own, wide = self.deviation**2, self.doubted_deviation**2
        noise = np.full((len(self.means), 2 * len(found)), own)
        if untrusted or self.has_bank:
            for index, marker in enumerate(found):
                rows = slice(None) if marker in untrusted else slice(1 + marker, 2 + marker)
                noise[rows, 2 * index : 2 * index + 2] = wide
        return Correction.of(self.shape, self.belief, found, noise, own)

    def _correct_as_before(self, found: Mapping[int, Point]) -> Correction | None:
        """The same with the gain of the last frames; None where it may have changed."""
        kept = self._kept
        gain, step = kept.gain, self._step[0]
        if gain is None or not kept.serves or not self._behind or kept.frames >= TUNING.max_kept:
            return None
        if abs(step - kept.step) > TUNING.same_step * kept.step or list(found) != gain.markers:
            return None
        views = np.ascontiguousarray(self.means[:, :COUNT])
        moved = _MOVED * (views[0] - gain.view)
        if moved.dot(moved) > 1.0:
            return None
        innovation = _flat(found) - self.shape.project_all(views)
        correction = Correction.by(gain, self.means, found, innovation)
        unusual = float(innovation[0].dot(correction.weighed[0])) / innovation.shape[1]
        if unusual > TUNING.usual_innovation or max(correction.nis) > TUNING.usual_nis:
            return None
        return correction if limited(correction.change[:, :COUNT])[1] < SETTLED else None

    def exclude(self, marker: int) -> None:
        """Go on from the filter that has ignored a marker: that one was another light."""
        mean, covariance = self.belief
        filters = len(mean)
        one = slice(1 + marker, 2 + marker)
        self.means = np.repeat(mean[one], filters, axis=0)
        self._covariances = np.repeat(covariance[one], filters, axis=0)
        self._kept = _KeptGain()

    def inflate(self, factor: float) -> None:
        """Be less certain: what was seen contradicts the view as a whole."""
        if self.deviation_of(ROLL) > _NOTHING_KNOWN[0] or self.deviation_of(X) > _NOTHING_KNOWN[1]:
            return
        growth = np.full(_STATES, math.sqrt(factor))
        if self._is_calibrated:
            growth[[FOCAL, BARREL, COUNT + FOCAL, COUNT + BARREL]] = 1.0
        self._covariances = growth[:, None] * growth * self.belief.covariance
        self._kept = _KeptGain()

    def commit(self, correction: Correction) -> None:
        """Take what a frame's named lights, which agree, have made of the views."""
        gain, count = correction.gain, len(self.shape.points)
        self._seen = len(gain.markers)
        if gain is not self._kept.gain:
            whole = gain.markers == list(range(count)) and gain.is_of_all
            self._kept = _KeptGain(gain, whole and self._is_steady, self._step[0])
        self.means, self._covariances, self._behind = correction.mean, gain.after, 0.0
        self._kept.add(correction)

    def _learn(self) -> None:
        """Learn from the frames since this was last done how the view moves, and of the rig."""
        kept, gain = self._kept, self._kept.gain
        self._kept = _KeptGain()
        if gain is None or len(gain.markers) < _MIN_EXACT:
            return
        self._learn_motion(kept, gain)
        # Four markers before a lens that is not known fit any rig.
        if self._is_calibrated or len(gain.markers) == len(self.shape.points):
            self._learn_rig_error(kept, len(gain.markers))

    def _learn_motion(self, kept: _KeptGain, gain: Gain) -> None:
        """The steps from the predicted views over their variances give the process noise."""
        frames = kept.frames
        expected = frames * (gain.covariance[0].diagonal() - gain.after[0].diagonal())[:COUNT]
        shown = np.minimum(_ALIKE.dot(kept.squares / np.maximum(expected, 1e-12)), TUNING.max_step)
        held = (1.0 - TUNING.motion_learning) ** frames
        motion = self._motion * (held + (1.0 - held) * shown)
        self._motion = np.minimum(np.maximum(motion, TUNING.min_motion), TUNING.max_motion)
        faded = TUNING.max_motion_memory**frames * self._max_motion
        self._max_motion = np.maximum(faded, kept.rates * kept.rates * _LIVELY)

    def _learn_rig_error(self, kept: _KeptGain, seen: int) -> None:
        """How well markers that agree fit shows how exact the rig is; less exact only slowly."""
        scale = math.exp(self.means.item(0, SCALE))
        shown = math.sqrt(kept.misfits / kept.frames * seen / max(2 * seen - 6, 1)) / scale
        shown = min(max(2.0 * shown, self._rig_errors[0]), self._rig_errors[1])
        rate = TUNING.learning if shown < self.rig_error else TUNING.unlearning
        self.rig_error += (1.0 - (1.0 - rate) ** kept.frames) * (shown - self.rig_error)


def _transition(elapsed: float) -> Array:
    """What so many s make of states (16, 16): the rates fade."""
    last = TUNING.rates_last
    fade = math.exp(-elapsed / last)
    transition, step = _UNITY.copy(), _STATES + 1
    flat = transition.ravel()
    flat[COUNT : COUNT * step : step] = last * (1.0 - fade)
    flat[COUNT * step :: step] = fade
    return transition


def _process_noise(elapsed: float, walk: Array, rate_noise: Array) -> Array:
    """What white noise (variances per s, (8,)) adds to the covariance in so many s, (16, 16)."""
    last = TUNING.rates_last
    fade = math.exp(-elapsed / last)
    reach = last * (1.0 - fade)
    # What lies on the diagonals of the four blocks of 8 x 8.
    noise, step = np.zeros((_STATES, _STATES)), _STATES + 1
    flat = noise.ravel()
    across = (0.5 * reach * reach) * rate_noise
    flat[: COUNT * step : step] = elapsed * walk + (elapsed**3 / 3) * rate_noise
    flat[COUNT : COUNT * step : step] = flat[COUNT * _STATES :: step] = across
    flat[COUNT * step :: step] = (0.5 * last * (1.0 - fade * fade)) * rate_noise
    return noise


def _flat(found: Mapping[int, Point]) -> Array:
    """The places' coordinates in turn, px."""
    return np.array(list(found.values())).ravel()


@dataclass
class _KeptGain:
    """The gain of the last frames, and what was seen with it."""

    gain: Gain | None = None
    serves: bool = False  # whether it may serve in the next frame
    step: float = 0.0  # s, from the frame before
    frames: int = 0
    squares: Array = field(default_factory=lambda: np.zeros(COUNT))  # sum, of steps of the view
    misfits: float = 0.0  # sum of squares, px²
    rates: Array = field(default_factory=lambda: np.zeros(COUNT))  # of the newest view

    def add(self, correction: Correction) -> None:
        """Take a frame."""
        change = correction.change[0, :COUNT]
        self.squares = self.squares + change * change
        self.misfits += correction.misfit() ** 2
        self.rates = correction.mean[0, COUNT:]
        self.frames += 1


Ellipse = tuple[float, float, float, float]


@dataclass(frozen=True, eq=False)
class Gain:
    """What k named lights will make of f views wherever near they are seen.

    Attributes:
        covariance: (f, 16, 16), of the priors.
        markers: those seen.
        view: (8,), the main filter's, at which the slopes are.
        slopes: (f, 8, 2 k), of the places by the parameters.
        towards: (f, 16, 2 k), covariance of the state with the places.
        weight: (f, 2 k, 2 k), inverse covariance of the innovations, px^-2.
        noise: (f, 2 k), px², variances at which the coordinates take part.
        own: px², variance of a marker's place.
    """

    covariance: Array
    markers: list[int]
    view: Array
    slopes: Array
    towards: Array
    weight: Array
    noise: Array
    own: float
    _others: dict[tuple[int, int], Ellipse] = field(default_factory=dict)
    _distances: dict[tuple[int, int, float], Ellipse] = field(default_factory=dict)
    _all_distances: dict[float, list[Ellipse]] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        covariance: Array,
        markers: list[int],
        view: Array,
        slopes: Array,
        noise: Array,
        own: float,
    ) -> Gain:
        """Where the places change with the views by these slopes."""
        count = noise.shape[1]
        towards = covariance[:, :, :COUNT] @ slopes
        spread = slopes.transpose(0, 2, 1) @ towards[:, :COUNT]
        spread.reshape(-1, count * count)[:, :: count + 1] += noise
        return cls(covariance, markers, view, slopes, towards, _inverses(spread), noise, own)

    @property
    def is_of_all(self) -> bool:
        """Whether no marker takes part in the main filter with less weight than the others."""
        return bool((self.noise[0] == self.own).all())

    @cached_property
    def after(self) -> Array:
        """The covariances with what has been seen, in Joseph's form: no variance gets negative.

        With K the gain, H the slopes and P the prior's covariance, it is A - (A H - K R) K^T, where
        A = (I - K H^T) P.
        """
        gain = self.towards @ self.weight
        transposed = gain.transpose(0, 2, 1)
        left = self.covariance - gain @ self.towards.transpose(0, 2, 1)
        rest = left[:, :, :COUNT] @ self.slopes
        rest -= gain * self.noise[:, None]
        left -= rest @ transposed
        return np.asarray(0.5 * (left + left.transpose(0, 2, 1)))

    def by_others(self, row: int, index: int) -> Ellipse:
        """What takes a marker's weighed innovation to that by all other markers alone.

        With w = S⁻¹ r, the weighed innovations, and B the marker's 2 x 2 block of S⁻¹, the
        innovation by the others alone is B⁻¹ w with the covariance B⁻¹, of which the marker's own
        variance is a part: xx, xy and yy of B⁻¹, and that variance.
        """
        found = self._others.get((row, index))
        if found is None:
            first, second = 2 * index, 2 * index + 1
            xx, xy, yy = (
                self.weight.item(row, i, j)
                for i, j in ((first, first), (first, second), (second, second))
            )
            determinant = max(xx * yy - xy * xy, 1e-12 * xx * yy)
            found = yy / determinant, -xy / determinant, xx / determinant
            found = self._others[row, index] = (*found, self.noise.item(row, first))
        return found

    def distance(self, row: int, index: int, variance: float) -> Ellipse:
        """What makes a marker's weighed innovation w a squared distance from where the others put it.

        It lies about there with a variance (px²) of both axes. The factors of the squares of w, of
        xx, xy and yy, and the determinant of the place's covariance, px⁴.
        """
        found = self._distances.get((row, index, variance))
        if found is None:
            a, b, c, own = self.by_others(row, index)
            xx, yy = max(a - own, 0.0) + variance, max(c - own, 0.0) + variance
            determinant = max(xx * yy - b * b, 1e-12 * xx * yy)
            # B⁻¹ C⁻¹ B⁻¹, with B⁻¹ of a, b and c and C of xx, b and yy.
            found = self._distances[row, index, variance] = (
                (yy * a * a - 2.0 * b * a * b + xx * b * b) / determinant,
                2.0 * (yy * a * b - b * (a * c + b * b) + xx * b * c) / determinant,
                (yy * b * b - 2.0 * b * b * c + xx * c * c) / determinant,
                determinant,
            )
        return found

    def distances(self, variance: float) -> list[Ellipse]:
        """That of each marker, of the main filter's."""
        found = self._all_distances.get(variance)
        if found is None:
            found = [self.distance(0, index, variance) for index in range(len(self.markers))]
            self._all_distances[variance] = found
        return found


@dataclass(frozen=True, eq=False)
class Correction:
    """What k named lights of a frame make of views: an iterated extended Kalman filter's update.

    It is that of f filters at once, of which the first is the main one, and the one after marker i
    of the rig's is that which ignores it.

    Attributes:
        gain: where the places were linearized last.
        before: (f, 16), the priors' means.
        found: the lights' places by marker, px without distortion.
        change: (f, 16), of the state.
        weighed: (f, 2 k), the innovations over their covariance, px^-1.
    """

    gain: Gain
    before: Array
    found: Mapping[int, Point]
    change: Array
    weighed: Array

    @classmethod
    def by(
        cls, gain: Gain, before: Array, found: Mapping[int, Point], innovation: Array
    ) -> Correction:
        """Correct priors by the innovations (f, 2 k), px, with a given gain."""
        weighed = _times(gain.weight, innovation)
        return cls(gain, before, found, _times(gain.towards, weighed), weighed)

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
        markers = list(found)
        in_order = markers == list(range(len(shape.points)))
        columns = None if in_order else columns_of(np.array(markers, np.intp))
        places = _flat(found)
        prior = parameters = np.ascontiguousarray(mean[:, :COUNT])
        for _ in range(_MAX_ITERATIONS):
            expected, slopes = shape.linearize_all(parameters)
            if columns is not None:
                expected, slopes = expected[:, columns], slopes[:, :, columns]
            innovation = places - expected
            away = prior - parameters
            if parameters is not prior:
                innovation -= _times(slopes.transpose(0, 2, 1), away)
            gain = Gain.of(covariance, markers, parameters[0], slopes, noise, own)
            weighed = _times(gain.weight, innovation)
            change = _times(gain.towards, weighed)
            step, largest = limited(change[:, :COUNT] + away)
            parameters = possible(parameters + step)
            if largest < SETTLED:
                break
        else:
            # What the last slopes predict of the residuals cannot be trusted.
            expected = shape.project_all(parameters)
            weighed = (places - (expected if columns is None else expected[:, columns])) / noise
        change[:, :COUNT] = parameters - prior
        return cls(gain, mean, found, change, weighed)

    @cached_property
    def mean(self) -> Array:
        """(f, 16), the states with what has been seen."""
        return self.before + self.change

    @property
    def after(self) -> Belief:
        """The states with what has been seen."""
        return Belief(self.mean, self.gain.after)

    def misfit(self, row: int = 0) -> float:
        """Root mean square of the markers' distances from their places in a filter's view, px."""
        residual = self.weighed[row] * self.gain.noise[row]
        return math.sqrt(float(residual.dot(residual)) / max(len(self.found), 1))

    def nis_of(self, row: int, index: int) -> float:
        """How far a marker lies from where a filter's others put it (chi², two degrees)."""
        weighed = self._weighed[row]
        x, y = weighed[2 * index], weighed[2 * index + 1]
        xx, xy, yy, _ = self.gain.distance(row, index, self.gain.own)
        return xx * x * x + xy * x * y + yy * y * y

    @cached_property
    def _weighed(self) -> list[list[float]]:
        rows: list[list[float]] = self.weighed.tolist()
        return rows

    @cached_property
    def nis(self) -> list[float]:
        """For each marker how far it lies from where the main filter's others put it."""
        return self._squares(self.gain.own)

    def _squares(self, variance: float) -> list[float]:
        weighed = self._weighed[0]
        distances = self.gain.distances(variance)
        return [
            xx * x * x + xy * x * y + yy * y * y
            for (xx, xy, yy, _), x, y in zip(distances, weighed[::2], weighed[1::2], strict=True)
        ]

    def deviation_by_others(self, row: int, index: int) -> float:
        """How exactly a filter's others determine a marker's place (1 sigma, px): larger axis."""
        xx, xy, yy, own = self.gain.by_others(row, index)
        largest = 0.5 * (xx + yy) - own + math.hypot(0.5 * (xx - yy), xy)
        return math.sqrt(max(largest, 0.0))

    def log_odds(self, beside: float, unknowns: int) -> dict[int, float]:
        """What each marker's place says for its name: the log of a ratio of two likelihoods.

        That of the marker where all others put it, over that of another light which lies within so
        many px of there (1 sigma per axis). It counts by the mean redundancy of the places in a fit
        of so many unknowns: what only goes on as before may as well be a light that was taken for
        the marker earlier.
        """
        redundancy = max(1.0 - unknowns / (2 * len(self.found)), 0.0)
        own, wide = self.gain.own, self.gain.own + beside * beside
        squares = zip(self.nis, self._squares(wide), strict=True)
        least, most = self.gain.distances(own), self.gain.distances(wide)
        return {
            marker: 0.5 * redundancy * (far - near + math.log(large[3] / small[3]))
            for marker, (near, far), small, large in zip(
                self.found, squares, least, most, strict=True
            )
        }

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
