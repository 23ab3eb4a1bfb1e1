"""A whole body named in one frame, when none of its markers is known."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mvuav_ros.vision.markers.centroid import Detection
from mvuav_ros.vision.markers.grouping import label_five
from mvuav_ros.vision.markers.identity.acquisition import (
    ANY_ROLL,
    DOUBT,
    MAX_CANDIDATES,
    Guess,
    guess_start,
)
from mvuav_ros.vision.markers.lights import Lights, are_close
from mvuav_ros.vision.markers.results import TANKER_NAMES, Cluster
from mvuav_ros.vision.markers.rig_view import NamedPlaces, ViewState, WeakPerspective, X, Y, fit

MOST_RATIO = 8.0  # Areas of a body's largest and smallest marker, one over the other
CLEAR_MISFIT = (1.0, 0.008)
"""px, and units of the body's size: what a body among other lights may differ by."""
LONE_MISFIT = 0.06
"""The same, in units of its size, for a body that is alone in the frame, seen by a camera that is
not calibrated."""
STRICT_MISFIT = (0.25, 0.001)
"""The same, of one that is what its rig says; another must show the same misfit for some time."""
OTHER_BODY_MISFIT = 0.15  # The same for five lights that the thesis's assumption alone must name
LONGEST_REST = 15  # Frames between two attempts to name lights that could not be named, at most
CONFIRMED = 3  # Frames in which a body must be named alike where one frame does not make it certain
CONFIRMED_ODD = 10
"""The same where one of the lights may well be another one, which by then has gone elsewhere."""
SAME_MISFIT = (0.2, 0.25)
"""px, and part of it, by which the misfit may change meanwhile: that of a rig measured badly stays,
that of a light that is no marker does not."""


class Named(NamedTuple):
    """All markers of a body, by name."""

    # in the rig's order, px without distortion; empty if they cannot be named.
    spots: tuple[Detection, ...] = ()
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


def _alike(guess: Guess, spots: Sequence[Detection]) -> bool:
    areas = [spots[index].area for index in guess.chosen]
    return max(areas) <= MOST_RATIO * min(areas)


def _as_the_thesis(shape: WeakPerspective, spots: Sequence[Detection]) -> Named | None:
    """Five lights in no doubt but for their order: by the distances, upright (Appendix A)."""
    spots = sorted(spots, key=lambda spot: (spot.x, spot.y))
    order = label_five([Cluster(spot.x, spot.y, spot.area) for spot in spots])
    chosen = tuple(spots[index] for index in order)
    areas = [spot.area for spot in chosen]
    left, right = chosen[0], chosen[-1]
    span = math.hypot(right.x - left.x, right.y - left.y)
    if span == 0.0 or max(areas) > MOST_RATIO * min(areas):
        return None
    roll = math.atan2(right.y - left.y, right.x - left.x)
    scale = math.log(0.56 * span)
    start = np.array([roll, scale, 0.0, 0.0, 0.0, 0.0, scale - math.log(0.25), 0.0])
    start[[X, Y]] = np.mean([(spot.x, spot.y) for spot in chosen], axis=0)
    deviations = np.array((1.0, 1.0, span, span, 0.4, 0.4, 0.5, 1e-3))
    places = np.array([[(spot.x, spot.y) for spot in chosen]])
    prior = start[None], np.diag(deviations**2)[None]
    view = fit(shape, prior, NamedPlaces(np.arange(5)[None], places, 0.02 * span)).view()
    if view.misfit > OTHER_BODY_MISFIT * view.scale:
        return None
    return Named(chosen, view, True, False)


@dataclass
class Attempts:
    """When to name a whole body: the more often that failed, the less often it is tried."""

    count: int  # markers of the body
    agreed: int = 0  # frames in a row that named the body alike
    last: tuple[Detection, ...] = ()  # places of its markers in the last one
    _failures: int = 0
    _rest: int = 0
    _lights: int = 0
    _first_misfit: float = 0.0

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
        self._rest = min(self._failures, LONGEST_REST)
        self._failures = 2 * self._failures + 1 if self._failures < LONGEST_REST else LONGEST_REST

    def confirmed(self, named: Named) -> bool:
        """Whether enough frames in a row have named the body alike."""
        return named.certain or self.agreed >= (CONFIRMED_ODD if named.odd else CONFIRMED)

    def succeed(self, named: Named) -> bool:
        """Take a way of naming them; whether it is that of the last attempt."""
        assert named.view is not None
        reach = 0.5 * named.view.scale
        alike = all(are_close(a, b, reach) for a, b in zip(self.last, named.spots, strict=False))
        most = SAME_MISFIT[0] + SAME_MISFIT[1] * self._first_misfit
        changed = abs(named.view.misfit - self._first_misfit) > most
        goes_on = alike and bool(self.last) and not (named.odd and changed)
        self.agreed = self.agreed + 1 if goes_on else 1
        if not goes_on:
            self._first_misfit = named.view.misfit
        self.last, self._failures, self._rest = named.spots, 0, 0
        return alike
