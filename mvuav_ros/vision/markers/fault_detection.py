"""Which of a frame's named markers contradict the others: fault detection and exclusion."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.markers.lights import Point
from mvuav_ros.vision.markers.rig_view import ViewState
from mvuav_ros.vision.markers.view_correction import Correction, NamedPlaces
from mvuav_ros.vision.markers.view_filter import ViewFilter

# How much evidence a doubt takes. Chosen on seeds 0 to 29 of flights of bare lights
# (`mvuav_thesis.light_flights`) and on the simulator's docking approaches.

GATE = 16.0  # squared distance over variance from which on a marker contradicts others
DOUBT = 6.0  # two explanations whose costs differ by less than this are both possible
MIN_FIRM = 3  # markers, without which none can be doubted
ALLOWANCE = 6.0  # per frame, of that distance: what is more is evidence
ENOUGH_EVIDENCE = 20.0  # evidence from which on a marker contradicts the others
MAX_EVIDENCE = 100.0  # to which the evidence against any marker can add up
FORGETTING = 0.9  # per frame, of the evidence against a marker that is out of sight
# Of the evidence against the worst marker, by which others must have less to be no suspects.
DOUBTFUL_SHARE = 0.1
RETURNED = 50.0  # evidence against a marker that was out of sight shortly before
MIN_AGREEING = 4  # markers that determine each other's places
MAX_DROPPED = 3  # Markers at once that may contradict the others


class Evidence(NamedTuple):
    """What a frame's places say for their names."""

    places: Mapping[int, tuple[float, float]]  # by marker, see `Correction.log_likelihoods`
    redundancy: float  # mean of the places in a fit of the view, from 0 to 1


class Consensus(NamedTuple):
    """What a set of named lights agrees on."""

    view: Callable[[], ViewState]  # by the markers that agree
    kept: tuple[int, ...]  # those markers
    dropped: tuple[int, ...] = ()  # the ones that contradict them
    # one of which, or some, must be another light; which ones, later frames show.
    suspects: tuple[int, ...] = ()


class FaultDetector:
    """Holds every frame's named lights against the rig: each marker against all the others.

    A light that drifts with the view does not stand out in a frame. Where the body has few lights,
    its distance from where the filter that ignores it expects it adds up over frames (CUSUM); when
    that is enough, that filter has not been bent by it.
    """

    def __init__(self, views: ViewFilter) -> None:
        self.views = views  # how the rig is seen
        # Markers that were out of sight or not alone shortly before, whose lights may be others;
        # where enough others are not, they hardly take part.
        self.untrusted: set[int] = set()
        # Markers whose names are too uncertain: where too few are in sight to check each other,
        # they do not move the view.
        self.doubtful: set[int] = set()
        # Evidence that markers' lights are others since a moment ago (see `Jumps`).
        self.jumps: Mapping[int, float] = {}
        self._evidence: dict[int, float] = {}
        # For what, and the evidence against each marker with this frame's.
        self._corrected: tuple[object, Correction, dict[int, float]] | None = None

    def _correct(self, found: Mapping[int, Point]) -> tuple[Correction, dict[int, float]]:
        """By all lights, and by the filters that ignore one each; and the evidence with it."""
        key = self.untrusted, self.doubtful, list(found.items())
        last = self._corrected
        if last is not None and last[1].before is self.views.means and last[0] == key:
            return last[1:]
        untrusted = self.untrusted.intersection(found)
        count = len(self.views.shape.points)
        # Of three lights of a larger body one may be another one; it would bend the view unseen.
        fewest = MIN_FIRM - (len(found) == MIN_FIRM < count)
        if len(found) - len(untrusted) < fewest:
            untrusted.clear()
        ignored = self.doubtful.intersection(found) if len(found) < MIN_AGREEING else ()
        correction = self.views.correct(found, untrusted, ignored)
        self._corrected = key, correction, self._added(correction)
        return self._corrected[1:]

    def nis_of(self, found: Mapping[int, Point]) -> dict[int, float]:
        """For each named light how far it lies from where the others put it (see `Correction`)."""
        return dict(zip(found, self._correct(found)[0].nis, strict=True))

    def weigh(self, found: Mapping[int, Point]) -> Consensus:
        """Which of the named lights agree, by this frame and by those before it.

        The fewest are dropped without which the others fit; if several may be those, all of these
        are suspects.
        """
        if not found:
            return Consensus(partial(self.views.look, {}), ())
        correction, evidence = self._correct(found)
        markers = tuple(found)
        contradicted = max(correction.nis) > GATE
        most = max(evidence.values(), default=0.0)
        if not contradicted and most < ENOUGH_EVIDENCE:
            return Consensus(correction.view, markers)
        if len(markers) < 2:
            return Consensus(partial(self.views.look, {}), (), markers)
        if len(markers) > 2 and most > DOUBT:
            consensus = self._without_suspects(found, correction, evidence)
            if consensus is not None:
                return consensus
        if not contradicted:
            return Consensus(correction.view, markers)
        most = min(len(markers) - 2, MAX_DROPPED)
        for dropped in range(min(most, 1), most + 1):
            consensus = self._without(found, dropped)
            if consensus is not None:
                return consensus
        return Consensus(partial(self.views.look, {}), (), (), markers)

    def _added(self, correction: Correction) -> dict[int, float]:
        """Evidence against each marker with this frame's: a cumulative sum, as in CUSUM charts."""
        if not self.views.has_bank:
            return {}
        evidence = {m: FORGETTING * before for m, before in self._evidence.items()}
        squares = zip(correction.gain.markers, correction.nis_by_ignoring(), strict=True)
        for marker, square in squares:
            shown = square - ALLOWANCE
            evidence[marker] = max(self._evidence.get(marker, 0.0) + shown, 0.0)
        return evidence

    def _without_suspects(
        self, found: Mapping[int, Point], correction: Correction, evidence: dict[int, float]
    ) -> Consensus | None:
        """What the others agree on, by the filter that has ignored the worst marker all along."""
        score = {
            m: evidence[m] + RETURNED * (m in self.untrusted) + self.jumps.get(m, 0.0)
            for m in found
            if evidence[m] > DOUBT
        }
        if not score:
            return None
        worst = max(score, key=lambda marker: score[marker])
        margin = max(DOUBT, DOUBTFUL_SHARE * score[worst])
        suspects = tuple(m for m in score if score[m] > score[worst] - margin)
        row = 1 + worst
        nis = zip(found, correction.nis_by(row), strict=True)
        if max(square for marker, square in nis if marker != worst) > GATE:
            return None
        if len(suspects) > 1:
            rest = tuple(m for m in found if m not in suspects)
            return Consensus(partial(correction.view, row), rest, (), suspects)
        kept = {m: place for m, place in found.items() if m != worst}
        self.views.exclude(worst)
        self._corrected = None
        self._evidence = {}
        return Consensus(partial(self.views.look, kept), tuple(kept), (worst,))

    def _without(self, found: Mapping[int, Point], number: int) -> Consensus | None:
        """The consensus of all but a number of markers; None where none agree."""
        markers = list(found)
        rests = list(combinations(range(len(markers)), len(markers) - number))
        seen: NDArray[np.intp] = np.array([[markers[i] for i in rest] for rest in rests], np.intp)
        places = np.array(list(found.values()))[np.array(rests)]
        fits = self.views.fit(NamedPlaces(seen, places.reshape(len(rests), -1)))
        jumped = [self.jumps.get(marker, 0.0) for marker in markers]
        fitting = [
            (cost + sum(jumped[i] for i in rest), rest)
            for row, (cost, rest) in enumerate(zip(fits.cost.tolist(), rests, strict=True))
            if max(fits.nis_by(row)) <= GATE
        ]
        if not fitting:
            return None
        least, best = min(fitting)
        kept = set(best)
        for cost, rest in fitting:
            if cost < least + DOUBT:
                kept &= set(rest)
        names = tuple(markers[i] for i in sorted(kept))
        view = partial(self.views.look, {marker: found[marker] for marker in names})
        others = tuple(m for m in found if m not in names)
        if len(others) > number:
            return Consensus(view, names, (), others)
        return Consensus(view, names, others)

    def evidence(self, found: Mapping[int, Point], landmarks: int = 0) -> Evidence:
        """What a frame's places say for their names, so many landmarks showing the view as well."""
        if not found:
            return Evidence({}, 0.0)
        redundancy = max(1.0 - self.views.unknowns / (2 * (len(found) + landmarks)), 0.0)
        return Evidence(self._correct(found)[0].log_likelihoods(), redundancy)

    def commit(self, found: Mapping[int, Point]) -> None:
        """Take a frame's named lights, which agree."""
        if not found:
            return
        correction, evidence = self._correct(found)
        over = max(evidence.values(), default=0.0) - MAX_EVIDENCE
        if over > 0.0:
            evidence = {m: max(sum_ - over, 0.0) for m, sum_ in evidence.items()}
        self._evidence = evidence
        self.views.commit(correction)
