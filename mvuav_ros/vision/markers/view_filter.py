"""How a rig is seen, carried from frame to frame by a Kalman filter."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping

import numpy as np

from mvuav_ros.vision.markers.lights import Point
from mvuav_ros.vision.markers.rig_view import (
    COUNT,
    PITCH,
    SCALE,
    SETTLED,
    SHARED,
    YAW,
    Array,
    ViewState,
    WeakPerspective,
    X,
    Y,
    deviations_of,
    possible,
)
from mvuav_ros.vision.markers.view_correction import Belief, Correction, NamedPlaces, times

# How views change, and how exactly rigs are measured. Chosen on seeds 0 to 7 of flights of bare
# lights (`mvuav_thesis.light_flights`) and on the simulator's docking approaches; `LEARNING` and
# `MAX_UNSEEN` on seeds 9000 to 9029 and 9500 to 9529. The parameters
# are those of `WeakPerspective.project`.

# Random walk of the parameters and of their rates, per square root of a second.
WALK_NOISE = (0.08, 0.005, 25.0, 25.0, 0.01, 0.01, 0.01, 0.002)
RATE_NOISE = (0.8, 0.4, 250.0, 250.0, 0.3, 0.3, 0.0, 0.0)
NOISE = 0.15  # px (1 sigma), of a light's place
RIG_ERROR = 0.004  # of a marker's place, in units of the rig's size (1 sigma), at first
MIN_RIG_ERROR = 0.0003  # the least that is learnt from how well the markers fit
OTHER_RIG_ERROR = 0.02  # the same for a body that is not what its rig says
LEARNING = 0.25  # per frame, of a rig error that turns out less
UNLEARNING = 0.003  # and of one that turns out more
MOTION_LEARNING = 0.1  # per frame, by which the process noise follows the motion
# Per frame in which too few markers are seen, by which it grows again; to so many of the rates'
# squares over their variances, and to these least and greatest values.
MOTION_FORGETTING = 1.2
RATES_SHARE = 3.0
MIN_UNSEEN = 0.1
MAX_UNSEEN = 8.0
MAX_MOTION_MEMORY = 0.998  # per frame, of the quickest motion that was seen
MAX_STEP = 25.0  # square over its variance, of a step that is learnt from
MIN_MOTION = 0.02  # of the process noise, in parts of the usual one
MAX_MOTION = 4.0
DOUBTED = 10.0  # times the usual deviation at which a marker that is doubted takes part
MIN_DOUBTED = 2.0  # px, of that at least
IGNORED = 1e3  # px (1 sigma), of a marker that takes no part
RATES_LAST = 1.0  # s, after which a motion has changed
# Coordinates of all markers less the unknowns of the view, with which a light that drifts from
# its marker bends the view. With more it stands out in a frame, with less nothing is checked.
BENDING = (1, 2)
MAX_KEPT = 8  # frames in which a gain serves
# While it does: the prior variances over those of the gain before, as a gain that still settles
# would settle later; and part by which the time between two frames has changed.
SAME_VARIANCE = (0.95, 1.3)
SAME_STEP = 0.2
# rad, and logarithms: of the view since then. The slopes leave half its square, 0.02 px.
SAME_VIEW = 0.015
SAME_PLACE = 30.0  # px, the same
# Squared distances over variances of a marker from its place by the others, and of all
# coordinates from the expected ones (mean).
TYPICAL_NIS = 8.0
TYPICAL_INNOVATION = 2.5
_STATES = 2 * COUNT
_RATE_NOISE: Array = np.square(RATE_NOISE)
_STATIONARY: Array = 0.5 * RATES_LAST * _RATE_NOISE  # Of the rates in the long run
_LIVELY: Array = RATES_SHARE / np.maximum(_STATIONARY, 1e-12)
_WALK_NOISE: Array = np.square(WALK_NOISE)
_ALIKE = np.eye(COUNT)
for _pair in ((X, Y), (PITCH, YAW)):
    _ALIKE[np.ix_(_pair, _pair)] = 0.5
"""Averages over parameters whose motions are alike."""
_BLOCKS: Array = np.asarray(np.kron(np.eye(4).reshape(4, 2, 2), np.eye(COUNT)).reshape(4, -1))
"""The four quarters of a matrix of states (16, 16), each with ones on its diagonal, flat."""
_NOISE_BLOCKS: Array = np.asarray(_BLOCKS * np.tile(_RATE_NOISE, 2 * _STATES))
_MOVED: Array = np.full(COUNT, 1.0 / SAME_VIEW)
_MOVED[[X, Y]] = 1.0 / SAME_PLACE
"""Times which the changes of a view that has hardly moved are below 1."""
_SAME_TIME = 2e-9  # s, by which two steps differ only as their stamps are rounded
_MIN_HOLDING = 3  # Markers in a frame with which the motion is not forgotten
_MIN_EXACT = 4  # Markers by which a frame shows how the view moves, and how exact the rig is


class ViewFilter:
    """A Kalman filter of a view and its rates, whose measurements are named lights.

    A body with just enough lights has a second filter for each marker, which has all but ignored
    that marker in all frames: a light that drifts slowly with the view is seen by that one alone.
    All of them go on together, the main one first.
    """

    def __init__(
        self, shape: WeakPerspective, view: ViewState, time: float, before: ViewFilter | None = None
    ) -> None:
        """Begin at a time (s) with a view fitted to all markers.

        The filter before of this very rig has learnt its exactness and motion.
        """
        self.shape, self.time = shape, time
        covariance = np.diag(np.concatenate((np.zeros(COUNT), _STATIONARY + 1e-12)))
        covariance[:COUNT, :COUNT] = view.covariance
        mean = np.concatenate((view.parameters, np.zeros(COUNT)))
        self._is_calibrated = shape.lens.focal is not None
        # Parameters that the lights alone give: a calibration gives the last two.
        self.unknowns = COUNT - 2 if self._is_calibrated else COUNT
        self._walk = np.where(np.arange(COUNT) < self.unknowns, _WALK_NOISE, 0.0)
        count = len(shape.points)
        least, most = BENDING
        # Whether each marker has a filter that all but ignores it.
        self.has_bank = least <= 2 * count - self.unknowns <= most
        filters = 1 + self.has_bank * count
        # (f, 16), at `time`.
        self.means: Array = np.tile(mean, (filters, 1))
        # Of the frame before where the means have gone on alone since then.
        self._covariances: Array = np.tile(covariance, (filters, 1, 1))
        self._is_behind = False
        self._step, self._transition, self._noise = 0.0, *_dynamics(0.0, self._walk)
        # Prior variances by which the newest gain was found, and whether those before were alike.
        self._variances: Array = np.zeros(COUNT)
        self._is_steady = False
        self._newest: list[Correction] = []  # of the last frames, all with one gain
        self._gain_step = math.inf  # s, from the frame before the first of them; inf: it goes
        relative = view.rms_residual / view.scale
        self._rig_errors = (MIN_RIG_ERROR, max(RIG_ERROR, 1.5 * relative))
        if shape.offsets is not None:
            # As the view changes, so does what lies beside the rig.
            self._rig_errors = (OTHER_RIG_ERROR, OTHER_RIG_ERROR)
        # Of a marker's place on the rig, in units of its size (1 sigma).
        self.rig_error: float = before.rig_error if before else self._rig_errors[1]
        self._seen = count
        self._max_motion: Array = before._max_motion if before else np.zeros(COUNT)
        self._motion: Array = before._motion if before else np.ones(COUNT)

    @property
    def belief(self) -> Belief:
        """At `time`; after `predict` the prior of that frame."""
        self._catch_up()
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
        return math.hypot(NOISE, self.rig_error * scale)

    def predict(self, time: float) -> None:
        """Go on to a later time (s)."""
        # To the last frame, even if nothing was committed there.
        self._catch_up()
        elapsed = time - self.time
        if abs(elapsed - self._step) > _SAME_TIME:
            self._step, self._transition, self._noise = elapsed, *_dynamics(elapsed, self._walk)
        self.means = self.means.dot(self._transition)
        self._is_behind, self.time = True, time
        if self._seen < _MIN_HOLDING:
            self._catch_up()
            usual = np.clip(self._max_motion, MIN_UNSEEN, MAX_UNSEEN)
            grown = np.minimum(MOTION_FORGETTING * self._motion, usual)
            self._motion = np.maximum(self._motion, grown)
        self._seen = 0

    def _catch_up(self) -> None:
        """Take the covariances to `time`, where the means are already."""
        if not self._is_behind:
            return
        self._learn()
        before = self._covariances.reshape(-1, _STATES).dot(self._transition)
        across = self._transition.T @ before.reshape(self._covariances.shape)
        self._covariances = across + self._noise * np.concatenate((self._motion, self._motion))
        self._is_behind = False
        self.means[:, :COUNT] = possible(self.means[:, :COUNT])
        old, new = self._variances, self._covariances[0].diagonal()[:COUNT]
        least, most = SAME_VARIANCE
        self._is_steady = bool(((new >= least * old) & (new <= most * old)).all())
        self._variances = new

    def places(self, view: ViewState) -> tuple[Array, Array]:
        """Where the markers should be in a view, (n, 2) px, and how uncertain that is, (n,) px."""
        places, slopes = self.shape.linearize(view.parameters[None])
        return places.reshape(-1, 2), deviations_of(slopes[0], view.covariance)

    def look(self, found: Mapping[int, Point]) -> ViewState:
        """The view by the named lights (px without distortion), from this frame's prior."""
        return self.fit(NamedPlaces.of(found)).view() if found else self.view

    def fit(self, named: NamedPlaces) -> Correction:
        """Views by several ways of naming markers, from this frame's prior."""
        mean, covariance = self.belief
        before = Belief(mean[:1, :COUNT], covariance[:1, :COUNT, :COUNT])
        return Correction.of(self.shape, before, named, self.deviation**2)

    def correct(
        self,
        found: Mapping[int, Point],
        untrusted: Collection[int] = (),
        ignored: Collection[int] = (),
    ) -> Correction:
        """What named lights make of the view: untrusted ones hardly take part, ignored ones not."""
        again = None if untrusted or ignored else self._correct_as_before(found)
        if again is not None:
            return again
        before = self.belief  # Learns how exact the rig is
        usual = self.deviation
        own, wide = usual**2, max(DOUBTED * usual, MIN_DOUBTED) ** 2
        noise = np.full((len(self.means), 2 * len(found)), own)
        if untrusted or ignored or self.has_bank:
            for index, marker in enumerate(found):
                rows = slice(None) if marker in untrusted else slice(1 + marker, 2 + marker)
                noise[rows, 2 * index : 2 * index + 2] = wide
                if marker in ignored:
                    noise[:, 2 * index : 2 * index + 2] = IGNORED**2
        return Correction.of(self.shape, before, NamedPlaces.of(found), own, noise)

    def _correct_as_before(self, found: Mapping[int, Point]) -> Correction | None:
        """The same with the gain of the last frames; None where it may have changed."""
        if not 0 < len(self._newest) < MAX_KEPT or not self._is_behind:
            return None
        gain, step = self._newest[0].gain, self._step
        if abs(step - self._gain_step) > SAME_STEP * step or list(found) != gain.markers:
            return None
        places = [x for place in found.values() for x in place]
        width = len(places)
        away = np.empty((len(self.means), width + COUNT))
        away[:, :width], away[:, width:] = places, self.means[:, :COUNT]
        away -= gain.at
        moved = (_MOVED * away[:, width:]).ravel()
        if moved.dot(moved) > len(away):
            return None
        both = times(gain.effect, away)
        change, weighed = both[:, :_STATES], both[:, _STATES:]
        main = away[0]
        innovation = main[:width] - main[width:].dot(gain.slopes[0])
        if innovation.dot(weighed[0]) > TYPICAL_INNOVATION * width:
            return None
        turned = (SHARED * change[:, :COUNT]).ravel()
        if turned.dot(turned) > SETTLED**2 * len(change):
            return None
        correction = Correction(gain, self.means, change, weighed)
        return correction if max(correction.nis) <= TYPICAL_NIS else None

    def anchor(self, correction: Correction) -> None:
        """Take what other landmarks than the markers say of the views, before these do."""
        self.means, self._covariances = correction.after
        self._newest = []

    def exclude(self, marker: int) -> None:
        """Go on from the filter that has ignored a marker: that one was another light."""
        mean, covariance = self.belief
        filters = len(mean)
        one = slice(1 + marker, 2 + marker)
        self.means = np.repeat(mean[one], filters, axis=0)
        self._covariances = np.repeat(covariance[one], filters, axis=0)
        self._newest = []

    def commit(self, correction: Correction) -> None:
        """Take what a frame's named lights, which agree, have made of the views."""
        gain = correction.gain
        self._seen = len(gain.markers)
        if not self._newest or gain is not self._newest[0].gain:
            # With markers missing, or such that hardly take part, a gain is not used again.
            serves = self._seen == len(self.shape.points) and (gain.noise[0] == gain.own).all()
            self._gain_step = self._step if serves and self._is_steady else math.inf
            self._newest = []
        self._newest = [*self._newest, correction]  # A copy of the filter keeps its own
        self.means, self._covariances = correction.before + correction.change, gain.after
        self._is_behind = False

    def _learn(self) -> None:
        """Learn from the frames since this was last done how the view moves, and of the rig."""
        newest, self._newest = self._newest, []
        if not newest or len(newest[0].gain.markers) < _MIN_EXACT:
            return
        self._learn_motion(newest)
        # Four markers before a lens that is not known fit any rig.
        seen = len(newest[0].gain.markers)
        if self._is_calibrated or seen == len(self.shape.points):
            self._learn_rig_error(newest, seen)

    def _learn_motion(self, newest: list[Correction]) -> None:
        """The steps from the predicted views over their variances give the process noise."""
        gain = newest[0].gain
        steps = np.square([one.change[0, :COUNT] for one in newest])
        rates = np.square([one.before[0, COUNT:] for one in newest])
        expected = (gain.covariance[0] - gain.after[0]).diagonal()[:COUNT]
        ratios = (steps / np.maximum(expected, 1e-12)).dot(_ALIKE)
        shown = np.minimum(ratios, MAX_STEP)
        growth = (1.0 - MOTION_LEARNING) + MOTION_LEARNING * shown
        motion = self._motion * np.multiply.reduce(growth, axis=0)
        self._motion = np.minimum(np.maximum(motion, MIN_MOTION), MAX_MOTION)
        faded = MAX_MOTION_MEMORY ** len(newest) * self._max_motion
        self._max_motion = np.maximum(faded, rates.max(axis=0) * _LIVELY)

    def _learn_rig_error(self, newest: list[Correction], seen: int) -> None:
        """How well markers that agree fit shows how exact the rig is; less exact only slowly."""
        share = 2.0 * math.sqrt(seen / max(2 * seen - 6, 1)) / math.exp(self.means.item(0, SCALE))
        residuals = np.array([one.weighed[0] for one in newest]) * newest[0].gain.noise[0]
        least, most = self._rig_errors
        for squares in np.square(residuals).sum(axis=1).tolist():
            shown = min(max(share * math.sqrt(squares / seen), least), most)
            rate = LEARNING if shown < self.rig_error else UNLEARNING
            self.rig_error += rate * (shown - self.rig_error)


def _dynamics(elapsed: float, walk: Array) -> tuple[Array, Array]:
    """What so many s make of states in rows, and the covariance that white noise adds, (16, 16)."""
    last = RATES_LAST
    fade = math.exp(-elapsed / last)
    reach = last * (1.0 - fade)
    across, rates = 0.5 * reach * reach, 0.5 * last * (1.0 - fade * fade)
    # Every frame's own where stamps jitter: products of constants instead of four `np.kron`.
    transition = np.dot((1.0, 0.0, reach, fade), _BLOCKS)
    noise = np.dot((elapsed**3 / 3, across, across, rates), _NOISE_BLOCKS)
    noise[: COUNT * (_STATES + 1) : _STATES + 1] += elapsed * walk
    return transition.reshape(_STATES, _STATES), noise.reshape(_STATES, _STATES)
