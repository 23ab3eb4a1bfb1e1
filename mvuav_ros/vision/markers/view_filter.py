"""How a rig is seen, carried from frame to frame, and which markers contradict the others."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.markers.view import (
    BARREL,
    COUNT,
    NEARNESS,
    Array,
    ViewState,
    WeakPerspective,
    deviations_of,
    fit,
    turned,
)

Point = tuple[float, float]


@dataclass(frozen=True)
class ViewTuning:
    """How views change, and how exactly rigs are measured.

    Chosen on the simulator's flights (vibration 0 to 3, roll sweeps, docking) and the reference's
    videos.

    Attributes:
        jitter: random walk of the parameters (see `WeakPerspective.project`) per square root of a second.
        unrest: the same of their rates: how quickly a motion changes.
        rates_last: s, after which a motion has changed.
        noise: px (1 sigma), of a light's place.
        rig_error: of a marker's place on the rig, in units of its size (1 sigma), at first.
        least_rig_error: the least that is learnt from how well the markers fit.
        gate: squared distance over variance from which on a marker contradicts the others.
        doubt: two explanations whose costs differ by less than this are both possible.
    """

    jitter: tuple[float, ...] = (0.08, 0.02, 25.0, 25.0, 0.03, 0.03, 0.01, 0.002)
    unrest: tuple[float, ...] = (0.8, 0.15, 250.0, 250.0, 0.3, 0.3, 0.03, 0.0)
    rates_last: float = 1.0
    noise: float = 0.3
    rig_error: float = 0.004
    least_rig_error: float = 0.0015
    gate: float = 16.0
    doubt: float = 6.0
    learning: float = 0.03


TUNING = ViewTuning()
_PAIRS_UP_TO = 8


@dataclass(frozen=True, eq=False)
class Consensus:
    """What a set of named lights agrees on.

    Attributes:
        view: by the markers that agree.
        kept: those markers.
        dropped: the ones that contradict them, or may.
    """

    view: ViewState
    kept: tuple[int, ...]
    dropped: tuple[int, ...] = ()


class ViewFilter:
    """A Kalman filter of a view and its rates, whose measurements are named lights.

    Attributes:
        shape: the rig.
        view: at `time`; after `predict` the prior of that frame.
        time: s.
        offsets: (n, 2), by how much the markers lie beside the rig's (see `turned`); None where
            the rig is what it says. They are found at the start, not learnt later.
    """

    def __init__(
        self, shape: WeakPerspective, view: ViewState, time: float, offsets: Array | None = None
    ) -> None:
        """Begin with a view of all markers."""
        self.shape = shape
        self.view = view
        self.time = time
        self.offsets = offsets
        self._rates: Array = np.zeros(COUNT)
        unrest = np.array(TUNING.unrest)
        self._rate_covariance: Array = np.diag(unrest**2 * TUNING.rates_last / 2 + 1e-12)
        self._cross: Array = np.zeros((COUNT, COUNT))
        """Covariance of the rates with the parameters."""
        relative = view.misfit / view.scale
        self._most_rig_error = max(TUNING.rig_error, 1.5 * relative if offsets is None else 0.01)
        self._rig_error = self._most_rig_error

    @property
    def deviation(self) -> float:
        """Of a measured marker from where the view has it (1 sigma, px)."""
        return math.hypot(TUNING.noise, self._rig_error * self.view.scale)

    def deviation_of(self, parameter: int) -> float:
        """How uncertain a parameter is (1 sigma)."""
        return math.sqrt(self.view.covariance[parameter, parameter])

    def predict(self, time: float) -> None:
        """Go on to a later time (s)."""
        elapsed = time - self.time
        self.time = time
        jitter, unrest = np.array(TUNING.jitter), np.array(TUNING.unrest)
        if self.shape.lens.focal is not None:
            jitter[BARREL] = 0.0
        fade = math.exp(-elapsed / TUNING.rates_last)
        reach = TUNING.rates_last * (1.0 - fade)
        parameters = self.view.parameters + reach * self._rates
        parameters[NEARNESS] = min(max(parameters[NEARNESS], 0.0), self.shape.most_nearness)
        covariance = (
            self.view.covariance
            + reach * (self._cross + self._cross.T)
            + reach * reach * self._rate_covariance
            + np.diag(jitter**2 * elapsed + unrest**2 * elapsed**3 / 3)
        )
        self._cross = fade * (self._cross + reach * self._rate_covariance)
        self._cross += np.diag(unrest**2 * reach**2 / 2)
        stationary = 0.5 * TUNING.rates_last * (1.0 - fade * fade)
        self._rate_covariance = fade * fade * self._rate_covariance
        self._rate_covariance += np.diag(unrest**2 * stationary)
        self._rates = fade * self._rates
        self.view = ViewState(parameters, covariance)

    def places(self, view: ViewState | None = None) -> tuple[Array, Array]:
        """Where the markers should be, (n, 2) px, and how uncertain that is, (n,) px."""
        view = view or self.view
        places, jacobian = self.linearized(view)
        return places, deviations_of(jacobian, view.covariance)

    def linearized(self, view: ViewState) -> tuple[Array, Array]:
        """Where the markers should be, and by how much that moves with the parameters."""
        places, jacobian = self.shape.linearize(view.parameters)
        if self.offsets is not None:
            places = places + turned(self.offsets, view.parameters)
        return places, jacobian

    def look(self, found: Mapping[int, Point]) -> ViewState:
        """The view by the named lights (px without distortion), from this frame's prior."""
        if not found:
            return self.view
        seen = np.array([list(found)], np.intp)
        return self.fit(seen, np.array([list(found.values())]))[0]

    def fit(self, seen: NDArray[np.intp], measured: Array) -> list[ViewState]:
        """Views by several ways of naming markers, (m, k), from this frame's prior."""
        deviation = self.deviation
        return fit(self.shape, self.view, seen, measured, deviation, offsets=self.offsets)

    def weigh(self, found: Mapping[int, Point]) -> Consensus:
        """Which of the named lights agree.

        The fewest are dropped without which the others fit; where it is not clear which those
        are, all that they may be.
        """
        markers = tuple(found)
        view = self.look(found)
        if not markers or view.surprise.max() <= TUNING.gate:
            return Consensus(view, markers)
        for dropped in (1, 2, 3):
            if len(markers) - dropped < 2 or (dropped > 1 and len(markers) > _PAIRS_UP_TO):
                break
            consensus = self._without(found, dropped)
            if consensus is not None:
                return consensus
        return self._greedy(found)

    def _without(self, found: Mapping[int, Point], number: int) -> Consensus | None:
        """The consensus of all but a number of markers; None where none agree."""
        markers = list(found)
        rests = list(combinations(range(len(markers)), len(markers) - number))
        seen = np.array([[markers[i] for i in rest] for rest in rests], np.intp)
        places = np.array(list(found.values()))
        views = self.fit(seen, places[np.array(rests)])
        fitting = [
            (view.cost, rest)
            for view, rest in zip(views, rests, strict=True)
            if view.surprise.max() <= TUNING.gate
        ]
        if not fitting:
            return None
        least = min(cost for cost, _ in fitting)
        kept = set(range(len(markers)))
        for cost, rest in fitting:
            if cost < least + TUNING.doubt:
                kept &= set(rest)
        return self._consensus(found, [markers[i] for i in sorted(kept)])

    def _greedy(self, found: Mapping[int, Point]) -> Consensus:
        rest = dict(found)
        view = self.look(rest)
        while len(rest) > 2 and view.surprise.max() > TUNING.gate:
            del rest[list(rest)[int(view.surprise.argmax())]]
            view = self.look(rest)
        if view.surprise.max() > TUNING.gate or 2 * len(rest) <= len(found):
            rest = {}
        return self._consensus(found, list(rest))

    def _consensus(self, found: Mapping[int, Point], kept: Sequence[int]) -> Consensus:
        view = self.look({marker: found[marker] for marker in kept})
        return Consensus(view, tuple(kept), tuple(m for m in found if m not in kept))

    def commit(self, view: ViewState, seen: int) -> None:
        """Keep a frame's view; the rates follow from how it differs from the prior.

        Args:
            view: of this frame.
            seen: how many markers it was fitted to.
        """
        if seen:
            prior = self.view
            gain = np.linalg.solve(prior.covariance, self._cross.T).T
            self._rates = self._rates + gain @ (view.parameters - prior.parameters)
            less = prior.covariance - view.covariance
            self._rate_covariance = self._rate_covariance - gain @ less @ gain.T
            self._cross = gain @ view.covariance
        self.view = view
        if seen == len(self.shape.points) and seen > 3:
            self._learn_rig_error(view, seen)

    def _learn_rig_error(self, view: ViewState, seen: int) -> None:
        """How well markers that agree fit tells how exact the rig is; less exact only slowly."""
        freedom = max(2 * seen - 6, 1)
        shown = view.misfit * math.sqrt(2 * seen / freedom) / math.sqrt(2) / view.scale
        shown = min(max(2.0 * shown, TUNING.least_rig_error), self._most_rig_error)
        self._rig_error += TUNING.learning * (shown - self._rig_error)
