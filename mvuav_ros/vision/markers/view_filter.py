"""How a rig is seen, carried from frame to frame, and which markers contradict the others."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.markers.view import (
    BARREL,
    COUNT,
    FOCAL,
    SCALE,
    Array,
    Fits,
    ViewState,
    WeakPerspective,
    deviations_of,
    fit,
    inverse,
    turned,
)

Point = tuple[float, float]


@dataclass(frozen=True)
class ViewTuning:
    """How views change, how exactly rigs are measured, and how much evidence a doubt takes.

    Chosen on seeds 0 to 7 of flights of bare lights (`simulation.light_flights`) and on the
    simulator's docking approaches; the parameters are those of `WeakPerspective.project`.

    Attributes:
        jitter: random walk of the parameters, per square root of a second.
        unrest: the same of their rates: how quickly a motion changes.
        rates_last: s, after which a motion has changed.
        noise: px (1 sigma), of a light's place.
        rig_error: of a marker's place on the rig, in units of its size (1 sigma), at first.
        least_rig_error: the least that is learnt from how well the markers fit.
        other_rig_error: the same for a body that is not what its rig says.
        learning, unlearning: per frame, of a rig error that turns out less, or more.
        gate: squared distance over variance from which on a marker contradicts the others.
        doubt: two explanations whose costs differ by less than this are both possible.
        doubted: times the usual deviation at which a marker that is doubted takes part.
        doubted_least: px, of that at least.
        fewest_firm: markers, without which none can be doubted.
        allowance: of a squared distance over variance, per frame: what is more is evidence.
        enough: evidence from which on a marker contradicts the others.
        most_evidence: to which the evidence against any marker can add up.
        forgetting: per frame, of the evidence against a marker that is out of sight.
        doubtful_share: of the evidence against the worst marker, by which another must have
            less so that it is not a suspect as well.
        contested: evidence that a marker has against it that was out of sight shortly before.
        upset: by which all variances grow where what is seen makes no sense.
        free: by which they grow to find out whether it is only the motion that was not foreseen.
        fewest_free: coordinates for that.
        exact: deviations, root mean square, up to which the markers then fit the rig.
    """

    jitter: tuple[float, ...] = (0.08, 0.005, 25.0, 25.0, 0.01, 0.01, 0.01, 0.002)
    unrest: tuple[float, ...] = (0.8, 0.4, 250.0, 250.0, 0.3, 0.3, 0.0, 0.0)
    rates_last: float = 1.0
    noise: float = 0.15
    rig_error: float = 0.004
    least_rig_error: float = 0.0003
    other_rig_error: float = 0.02
    learning: float = 0.1
    unlearning: float = 0.003
    gate: float = 16.0
    doubt: float = 6.0
    doubted: float = 10.0
    doubted_least: float = 2.0
    fewest_firm: int = 3
    allowance: float = 6.0
    enough: float = 20.0
    most_evidence: float = 100.0
    forgetting: float = 0.9
    doubtful_share: float = 0.1
    contested: float = 50.0
    upset: float = 4.0
    free: float = 1e3
    fewest_free: int = 8
    exact: float = 3.0


TUNING = ViewTuning()
MAIN = 0
"""Place of the filter that believes all markers, before those that each doubt one."""
_MOST_DOUBTED = 12
"""Markers of a rig, each of which can be doubted all the time; of a larger rig none is."""
_PAIRS_UP_TO = 8


@dataclass(frozen=True, eq=False)
class Consensus:
    """What a set of named lights agrees on.

    Attributes:
        view: by the markers that agree.
        kept: those markers.
        dropped: the ones that contradict them.
        suspects: one of which, or some, must be another light; which ones, later frames tell.
    """

    view: ViewState
    kept: tuple[int, ...]
    dropped: tuple[int, ...] = ()
    suspects: tuple[int, ...] = ()


class ViewFilter:
    """A Kalman filter of a view and its rates, whose measurements are named lights.

    Several hypotheses are carried along. Beside the filter that believes every marker there is
    one for each marker that all but ignores it. How far that marker lies from where such a filter
    expects it, frame after frame, is the evidence that it is another light; and when that is
    enough, the filter has not been led astray by it.

    Attributes:
        shape: the rig.
        time: s.
        offsets: (n, 2), by how much the markers lie beside the rig's (see `turned`); None where
            the rig is what it says. They are found at the start, not learnt later.
        contested: markers that were out of sight or not alone shortly before, whose lights may
            be others; where enough others are not, they hardly take part.
    """

    def __init__(
        self,
        shape: WeakPerspective,
        view: ViewState,
        time: float,
        offsets: Array | None = None,
        rig_error: float | None = None,
    ) -> None:
        """Begin with a view of all markers.

        Args:
            shape: the rig.
            view: fitted to all of its markers.
            time: s.
            offsets: see above.
            rig_error: learnt of this very rig before, in units of its size.
        """
        self.shape = shape
        self.time = time
        self.offsets = offsets
        self.contested: set[int] = set()
        count = len(shape.points)
        doubted = count if count <= _MOST_DOUBTED else 0
        m = 1 + doubted
        self._fitted: tuple[tuple[tuple[int, Point], ...], Fits] | None = None
        self._evidence: Array = np.zeros(doubted)
        self._parameters: Array = np.repeat(view.parameters[None], m, axis=0)
        self._covariance: Array = np.repeat(view.covariance[None], m, axis=0)
        unrest = np.array(TUNING.unrest)
        rates = np.diag(unrest**2 * TUNING.rates_last / 2 + 1e-12)
        self._rates: Array = np.zeros((m, COUNT))
        self._rate_covariance: Array = np.repeat(rates[None], m, axis=0)
        self._cross: Array = np.zeros((m, COUNT, COUNT))
        """Covariance of the rates with the parameters."""
        relative = view.misfit / view.scale
        self._rig_errors = (TUNING.least_rig_error, max(TUNING.rig_error, 1.5 * relative))
        if offsets is not None:
            # As the view changes, so does what lies beside the rig.
            self._rig_errors = (TUNING.other_rig_error, TUNING.other_rig_error)
        self.rig_error = rig_error or self._rig_errors[1]

    @property
    def view(self) -> ViewState:
        """At `time`; after `predict` the prior of that frame."""
        return ViewState(self._parameters[MAIN], self._covariance[MAIN])

    @property
    def _doubted(self) -> float:
        """Deviation at which a marker that is doubted takes part, px."""
        return max(TUNING.doubted * self.deviation, TUNING.doubted_least)

    @property
    def deviation(self) -> float:
        """Of a measured marker from where the view has it (1 sigma, px)."""
        return math.hypot(
            TUNING.noise, self.rig_error * math.exp(float(self._parameters[MAIN, SCALE]))
        )

    def deviation_of(self, parameter: int) -> float:
        """How uncertain a parameter is (1 sigma)."""
        return math.sqrt(self._covariance[MAIN, parameter, parameter])

    def predict(self, time: float) -> None:
        """Go on to a later time (s)."""
        elapsed = time - self.time
        self.time = time
        self._fitted = None
        jitter, unrest = np.array(TUNING.jitter), np.array(TUNING.unrest)
        if self.shape.lens.focal is not None:
            jitter[[FOCAL, BARREL]] = 0.0
        fade = math.exp(-elapsed / TUNING.rates_last)
        reach = TUNING.rates_last * (1.0 - fade)
        self._parameters = self._parameters + reach * self._rates
        self._covariance = (
            self._covariance
            + reach * (self._cross + self._cross.transpose(0, 2, 1))
            + reach * reach * self._rate_covariance
            + np.diag(jitter**2 * elapsed + unrest**2 * elapsed**3 / 3)
        )
        self._cross = fade * (self._cross + reach * self._rate_covariance)
        self._cross += np.diag(unrest**2 * reach**2 / 2)
        stationary = 0.5 * TUNING.rates_last * (1.0 - fade * fade)
        self._rate_covariance = fade * fade * self._rate_covariance
        self._rate_covariance += np.diag(unrest**2 * stationary)
        self._rates = fade * self._rates

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
        return self.fit(np.array([list(found)]), np.array([list(found.values())])).view()

    def fit(self, seen: NDArray[np.intp], measured: Array) -> Fits:
        """Views by several ways of naming markers, (m, k), from this frame's prior."""
        prior = self._parameters[:1], self._covariance[:1]
        deviation = np.array(self.deviation)
        return fit(self.shape, prior, seen, measured, deviation, offsets=self.offsets)

    def _fit_all(self, found: Mapping[int, Point]) -> Fits:
        """What each filter makes of the named lights."""
        key = tuple(found.items())
        if self._fitted is not None and self._fitted[0] == key:
            return self._fitted[1]
        m = len(self._parameters)
        markers = np.array(list(found), np.intp)
        measured = np.broadcast_to(np.array(list(found.values())), (m, len(found), 2))
        doubting = np.arange(m)[:, None] == 1 + markers
        contested = [marker in self.contested for marker in found]
        if len(found) - sum(contested) >= TUNING.fewest_firm:
            doubting |= np.array(contested)
        deviation = np.where(doubting, self._doubted, self.deviation)
        fits = fit(
            self.shape,
            (self._parameters, self._covariance),
            np.broadcast_to(markers, (m, len(found))),
            measured,
            deviation,
            noise=self.deviation,
            offsets=self.offsets,
        )
        self._fitted = key, fits
        return fits

    def surprise_of(self, found: Mapping[int, Point]) -> dict[int, float]:
        """For each named light how far it lies from where the others put it (see `Fits`)."""
        return dict(zip(found, self._fit_all(found).surprise[MAIN].tolist(), strict=True))

    def weigh(self, found: Mapping[int, Point]) -> Consensus:
        """Which of the named lights agree, by this frame and by those before it.

        The fewest are dropped without which the others fit; while it is not clear which those
        are, all that they may be are suspects.
        """
        if not found:
            return Consensus(self.view, ())
        fits = self._fit_all(found)
        view = fits.view()
        evidence = self._weighed(found, fits)
        markers = tuple(found)
        strange = view.surprise.max() > TUNING.gate
        if not strange and evidence.max(initial=0.0) < TUNING.enough:
            return Consensus(view, markers)
        if len(markers) < 2:
            return Consensus(self.view, (), markers)
        suspicion = None
        if len(markers) > 2 and evidence.max(initial=0.0) > TUNING.doubt:
            suspicion = self._without_suspects(found, evidence, fits)
            if suspicion is not None and not suspicion.suspects:
                return suspicion
        contested = len(self.contested.intersection(markers))
        judged = 0 < contested <= len(markers) - TUNING.fewest_firm
        if (strange or suspicion is not None) and not judged and self._moved_oddly(found):
            return Consensus(self.look(found), markers)
        if suspicion is not None:
            return suspicion
        if not strange:
            return Consensus(view, markers)
        for dropped in (2, 3):
            if len(markers) - dropped < 2 or len(markers) > _PAIRS_UP_TO:
                break
            consensus = self._without(found, dropped)
            if consensus is not None:
                return consensus
        return self._greedy(found)

    def _moved_oddly(self, found: Mapping[int, Point]) -> bool:
        """Whether markers never out of sight fit the rig, though not where the view expected them.

        Then it is the motion that was not foreseen, which the view is told.
        """
        if 2 * len(found) < TUNING.fewest_free:
            return False
        before = self._state()
        self.upset(TUNING.free)
        view = self.look(found)
        if view.surprise.max() <= TUNING.gate and view.misfit <= TUNING.exact * self.deviation:
            self._evidence = 0 * self._evidence
            return True
        self._restore(before)
        return False

    def _weighed(self, found: Mapping[int, Point], fits: Fits) -> Array:
        """Evidence against each marker with this frame's: a cumulative sum, as in CUSUM charts."""
        evidence = TUNING.forgetting * self._evidence
        doubted = [marker for marker in found if marker < len(evidence)]
        for index, marker in enumerate(found):
            if marker in doubted:
                strange = fits.surprise[1 + marker, index] - TUNING.allowance
                evidence[marker] = max(self._evidence[marker] + strange, 0.0)
        return evidence

    def _without_suspects(
        self, found: Mapping[int, Point], evidence: Array, fits: Fits
    ) -> Consensus | None:
        """What the others agree on, by the filter that has doubted the worst marker all along."""
        score = {m: float(evidence[m]) for m in found if evidence[m] > TUNING.doubt}
        for marker in self.contested & set(score):
            score[marker] += TUNING.contested
        if not score:
            return None
        worst = max(score, key=lambda marker: score[marker])
        margin = max(TUNING.doubt, TUNING.doubtful_share * score[worst])
        suspects = tuple(m for m in score if score[m] > score[worst] - margin)
        others = [index for index, m in enumerate(found) if m != worst]
        if fits.surprise[1 + worst][others].max() > TUNING.gate:
            return None
        if len(suspects) > 1:
            kept = tuple(m for m in found if m not in suspects)
            return Consensus(fits.view(1 + worst), kept, (), suspects)
        kept = tuple(m for m in found if m != worst)
        self._believe(1 + worst)
        return Consensus(self.look({m: found[m] for m in kept}), kept, (worst,))

    def _state(self) -> tuple[Array, ...]:
        return (
            self._parameters,
            self._covariance,
            self._rates,
            self._rate_covariance,
            self._cross,
            self._evidence,
        )

    def _restore(self, state: tuple[Array, ...]) -> None:
        self._fitted = None
        (
            self._parameters,
            self._covariance,
            self._rates,
            self._rate_covariance,
            self._cross,
            self._evidence,
        ) = state

    def _believe(self, index: int) -> None:
        """Go on with what one of the filters has found, and no evidence against any marker."""
        *filters, evidence = self._state()
        self._restore(
            (*(np.repeat(x[index : index + 1], len(x), 0) for x in filters), 0 * evidence)
        )

    def _without(self, found: Mapping[int, Point], number: int) -> Consensus | None:
        """The consensus of all but a number of markers; None where none agree."""
        markers = list(found)
        rests = list(combinations(range(len(markers)), len(markers) - number))
        seen = np.array([[markers[i] for i in rest] for rest in rests], np.intp)
        places = np.array(list(found.values()))
        fits = self.fit(seen, places[np.array(rests)])
        fitting = [
            (cost, rest)
            for cost, rest, surprise in zip(fits.cost, rests, fits.surprise, strict=True)
            if surprise.max() <= TUNING.gate
        ]
        if not fitting:
            return None
        least, best = min(fitting)
        kept = set(best)
        for cost, rest in fitting:
            if cost < least + TUNING.doubt:
                kept &= set(rest)
        names = tuple(markers[i] for i in sorted(kept))
        view = self.look({marker: found[marker] for marker in names})
        others = tuple(m for m in found if m not in names)
        if len(others) > number:
            return Consensus(view, names, (), others)
        return Consensus(view, names, others)

    def _greedy(self, found: Mapping[int, Point]) -> Consensus:
        rest = dict(found)
        view = self.look(rest)
        while len(rest) > 2 and view.surprise.max() > TUNING.gate:
            del rest[list(rest)[int(view.surprise.argmax())]]
            view = self.look(rest)
        if view.surprise.max() > TUNING.gate or 2 * len(rest) <= len(found):
            return Consensus(self.view, (), (), tuple(found))
        return Consensus(view, tuple(rest), tuple(m for m in found if m not in rest))

    def upset(self, factor: float = TUNING.upset) -> None:
        """Be less certain: what was seen contradicts the view as a whole."""
        self._fitted = None
        self._covariance = factor * self._covariance
        self._rate_covariance = factor * self._rate_covariance
        self._cross = factor * self._cross

    def commit(self, found: Mapping[int, Point]) -> None:
        """Take a frame's named lights, which agree."""
        if not found:
            return
        fits = self._fit_all(found)
        self._evidence = self._weighed(found, fits)
        self._evidence -= max(self._evidence.max(initial=0.0) - TUNING.most_evidence, 0.0)
        np.maximum(self._evidence, 0.0, out=self._evidence)
        gain = self._cross @ inverse(self._covariance)
        step = (fits.parameters - self._parameters)[..., None]
        self._rates = self._rates + (gain @ step)[..., 0]
        less = self._covariance - fits.covariance
        self._rate_covariance = self._rate_covariance - gain @ less @ gain.transpose(0, 2, 1)
        self._cross = gain @ fits.covariance
        self._parameters, self._covariance = fits.parameters, fits.covariance
        if len(found) == len(self.shape.points) > 3:
            self._learn_rig_error(fits.view(), len(found))

    def _learn_rig_error(self, view: ViewState, seen: int) -> None:
        """How well markers that agree fit tells how exact the rig is; less exact only slowly."""
        shown = view.misfit * math.sqrt(seen / max(2 * seen - 6, 1)) / view.scale
        shown = min(max(2.0 * shown, self._rig_errors[0]), self._rig_errors[1])
        rate = TUNING.learning if shown < self.rig_error else TUNING.unlearning
        self.rig_error += rate * (shown - self.rig_error)
