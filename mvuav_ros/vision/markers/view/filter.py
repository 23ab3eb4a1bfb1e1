"""How a rig is seen, carried from frame to frame by a bank of Kalman filters."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.markers.view.filter_bank import RATES_LAST, Correction, FilterBank
from mvuav_ros.vision.markers.view.fit import Fits, NamedPlaces, fit
from mvuav_ros.vision.markers.view.weak_perspective import (
    BARREL,
    COUNT,
    FOCAL,
    PITCH,
    ROLL,
    SCALE,
    YAW,
    Array,
    ViewState,
    WeakPerspective,
    X,
    Y,
    deviations_of,
)

Point = tuple[float, float]


@dataclass(frozen=True)
class ViewTuning:
    """How views change, and how exactly rigs are measured.

    Chosen on seeds 0 to 7 of flights of bare lights (`simulation.light_flights`) and on the
    simulator's docking approaches; `learning` and `most_unseen` on seeds 9000 to 9029 and 9500 to
    9529. The parameters are those of `WeakPerspective.project`.
    """

    # Random walk of the parameters, per square root of a second.
    jitter: tuple[float, ...] = (0.08, 0.005, 25.0, 25.0, 0.01, 0.01, 0.01, 0.002)
    # The same of their rates: how quickly a motion changes.
    unrest: tuple[float, ...] = (0.8, 0.4, 250.0, 250.0, 0.3, 0.3, 0.0, 0.0)
    noise: float = 0.15  # px (1 sigma), of a light's place
    # Of a marker's place on the rig, in units of its size (1 sigma), at first.
    rig_error: float = 0.004
    least_rig_error: float = 0.0003  # the least that is learnt from how well the markers fit
    other_rig_error: float = 0.02  # the same for a body that is not what its rig says
    # Per frame, of a rig error that turns out less, or more.
    learning: float = 0.25
    unlearning: float = 0.003
    # Per frame, by which the variances of jitter and unrest follow the motion.
    motion_learning: float = 0.1
    # Per frame in which too few markers are seen, by which they grow again.
    motion_forgetting: float = 1.2
    # To which they grow at least, and at most.
    least_unseen: float = 0.1
    most_unseen: float = 8.0
    # To which they grow, in parts of the rates' squares over their variances.
    rates_share: float = 3.0
    most_surprising: float = 25.0  # of a step's square over its variance, that is learnt from
    # Of those variances, in parts of the usual ones.
    least_motion: float = 0.02
    most_motion: float = 4.0
    doubted: float = 10.0  # times the usual deviation at which a marker that is doubted takes part
    doubted_least: float = 2.0  # px, of that at least


TUNING = ViewTuning()
MAIN = 0
"""Place of the filter that believes all markers, before those that each doubt one."""
_MOST_DOUBTED = 12
"""Markers of a rig, each of which can be doubted all the time; of a larger rig none is."""
_UNREST: Array = np.square(TUNING.unrest)
_STATIONARY: Array = 0.5 * RATES_LAST * _UNREST
"""Variances of the rates in the long run."""
_LIVELY: Array = TUNING.rates_share / np.maximum(_STATIONARY, 1e-12)
_WALK: Array = np.square(TUNING.jitter)
_ALIKE = np.eye(COUNT)
for _pair in ((X, Y), (PITCH, YAW)):
    _ALIKE[np.ix_(_pair, _pair)] = 0.5
"""Averages over parameters whose motions are alike."""
_NOTHING_KNOWN = 6.0, 3000.0
"""rad and px (1 sigma), of roll and place: there is nothing left to be less certain of."""
_FEWEST_TELLING, _FEWEST_HOLDING = 4, 3
"""Markers by which a frame tells how the view moves, and with which that is not forgotten."""


class ViewFilter:
    """A Kalman filter of a view and its rates, whose measurements are named lights.

    Beside the filter that believes every marker there is one for each marker that all but
    ignores it, so that it is not led astray where that marker is another light.
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
        count = len(shape.points)
        # Markers that have a filter which ignores them: all, or none of a large rig.
        self.doubted = count if count <= _MOST_DOUBTED else 0
        self.bank = FilterBank.of(view, 1 + self.doubted, _STATIONARY)  # the filters
        relative = view.misfit / view.scale
        self._rig_errors = (TUNING.least_rig_error, max(TUNING.rig_error, 1.5 * relative))
        if shape.offsets is not None:
            # As the view changes, so does what lies beside the rig.
            self._rig_errors = (TUNING.other_rig_error, TUNING.other_rig_error)
        # Of a marker's place on the rig, in units of its size (1 sigma).
        self.rig_error: float = before.rig_error if before else self._rig_errors[1]
        self._seen = count
        self._liveliest: Array = before._liveliest if before else np.zeros(COUNT)
        self._motion: Array = before._motion if before else np.ones(COUNT)

    @property
    def _known(self) -> list[int]:
        """Parameters that a calibration tells."""
        return [FOCAL, BARREL] if self.shape.lens.focal is not None else []

    @property
    def view(self) -> ViewState:
        """At `time`; after `predict` the prior of that frame."""
        return ViewState(self.bank.parameters[MAIN], self.bank.covariance[MAIN])

    @property
    def deviation(self) -> float:
        """Of a measured marker from where the view has it (1 sigma, px)."""
        scale = math.exp(float(self.bank.parameters[MAIN, SCALE]))
        return math.hypot(TUNING.noise, self.rig_error * scale)

    @property
    def doubted_deviation(self) -> float:
        """The same of a marker that is doubted."""
        return max(TUNING.doubted * self.deviation, TUNING.doubted_least)

    def deviation_of(self, parameter: int) -> float:
        """How uncertain a parameter is (1 sigma)."""
        return math.sqrt(self.bank.covariance[MAIN, parameter, parameter])

    def predict(self, time: float) -> None:
        """Go on to a later time (s)."""
        walk, unrest = self._motion * _WALK, self._motion * _UNREST
        walk[self._known] = 0.0
        self.bank = self.bank.predicted(time - self.time, walk, unrest)
        self.time = time
        if self._seen < _FEWEST_HOLDING:
            usual = np.clip(self._liveliest, TUNING.least_unseen, TUNING.most_unseen)
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
        prior = self.bank.parameters[:1], self.bank.covariance[:1]
        return fit(self.shape, prior, NamedPlaces(seen, measured, self.deviation))

    def correct(self, found: Mapping[int, Point], contested: NDArray[np.bool_]) -> Correction:
        """What each filter makes of the named lights, px without distortion.

        All filters all but ignore the contested ones, (k,).
        """
        markers = np.array(list(found), np.intp)
        seen = NamedPlaces(markers[None], np.array(list(found.values())), self.deviation)
        doubting = (np.arange(len(self.bank.states))[:, None] == 1 + markers) | contested
        variances = np.where(doubting, self.doubted_deviation**2, self.deviation**2)
        return self.bank.corrected(self.shape, seen, variances)

    def upset(self, factor: float) -> None:
        """Be less certain: what was seen contradicts the view as a whole."""
        if self.deviation_of(ROLL) > _NOTHING_KNOWN[0] or self.deviation_of(X) > _NOTHING_KNOWN[1]:
            return
        self.bank = self.bank.less_certain(factor, self._known)

    def commit(self, correction: Correction) -> None:
        """Take what each filter has made of a frame's named lights, which agree."""
        self._seen = correction.variances.shape[1]
        if self._seen >= _FEWEST_TELLING:
            self._learn_motion(correction)
        self.bank = correction.after
        # Four markers before a lens that is not known fit any rig.
        fewest = _FEWEST_TELLING if self._known else max(len(self.shape.points), _FEWEST_TELLING)
        if self._seen >= fewest:
            self._learn_rig_error(correction.view(MAIN))

    def _learn_motion(self, correction: Correction) -> None:
        """The steps from the predicted views over their variances tell how lively the motion is."""
        before, after = correction.before, correction.after
        step = correction.change[MAIN, :COUNT]
        expected = (before.covariance[MAIN] - after.covariance[MAIN]).diagonal()
        shown = _ALIKE.dot(step * step / np.maximum(expected, 1e-12))
        shown = np.minimum(shown, TUNING.most_surprising)
        motion = self._motion * (1.0 + TUNING.motion_learning * (shown - 1.0))
        self._motion = np.minimum(np.maximum(motion, TUNING.least_motion), TUNING.most_motion)
        rates = before.rates[MAIN]
        self._liveliest = np.maximum(0.998 * self._liveliest, rates * rates * _LIVELY)

    def _learn_rig_error(self, view: ViewState) -> None:
        """How well markers that agree fit tells how exact the rig is; less exact only slowly."""
        seen = self._seen
        shown = view.misfit * math.sqrt(seen / max(2 * seen - 6, 1)) / view.scale
        shown = min(max(2.0 * shown, self._rig_errors[0]), self._rig_errors[1])
        rate = TUNING.learning if shown < self.rig_error else TUNING.unlearning
        self.rig_error += rate * (shown - self.rig_error)
