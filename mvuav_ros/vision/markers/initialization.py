"""A body named that is not known yet: whole, in one frame or in some that name it alike."""

from __future__ import annotations

import math
import operator
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from mvuav_ros.vision.markers.hypotheses import Hypothesis, Prior, body_hypotheses, fit
from mvuav_ros.vision.markers.lights import Light, Point, are_close, by_size, candidates, places_of
from mvuav_ros.vision.markers.marker_results import TANKER_NAMES
from mvuav_ros.vision.markers.rig_view import (
    COUNT,
    FOCAL,
    SCALE,
    ViewState,
    WeakPerspective,
    X,
    Y,
)
from mvuav_ros.vision.markers.thesis_tracker import label_five
from mvuav_ros.vision.markers.view_correction import Belief, Correction, NamedPlaces
from mvuav_ros.vision.rig import MAX_NAMED

MAX_RATIO = 8.0
"""Areas of a body's largest and smallest marker, one over the other, where other lights are in
view. Lamps of one kind differ by 4, those of two kinds, of which one blooms, by 25 and more."""
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
MARGIN = 2.0  # Of the logarithm of the odds of the best way of naming lights over the next one's
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
    named = _whole(shape, spots, bodies, len(spots))
    is_alone = len(spots) == count and shape.lens.focal is None
    if named is None and is_alone and tuple(names) == TANKER_NAMES:
        named = _as_the_thesis(shape, spots)
    # A body's lights may be far smaller than letters, and than lamps nearer by.
    if named is None and len(every) > min(len(spots), MAX_NAMED):
        step = MAX_AT_START // 2
        first = step * (turn % max(1, math.ceil(len(every) / step) - 1))
        some = every[first : first + MAX_AT_START]
        named = _whole(shape, some, _bodies(shape, some, count), len(every))
    if named is None and len(spots) <= MAX_WITH_HIDDEN and not any(map(_is_strict, bodies)):
        named = _with_hidden(shape, spots)
    return named or Named(remark=f'{len(spots)} lights in view, {count} do not stand out')


def _whole(
    shape: WeakPerspective, spots: Sequence[Light], bodies: Sequence[Hypothesis], lights: int
) -> Named | None:
    """All markers among some spots, of so many lights in view."""
    best, count = _outstanding(bodies), len(shape.points)
    if best is None or not _is_probable(shape, best, lights):
        return None
    alone, residual = lights == count, best.view.rms_residual
    free = alone and shape.lens.focal is None
    exact = CLEAR_RESIDUAL[0] + CLEAR_RESIDUAL[1] * best.view.scale
    if residual > max(LONE_RESIDUAL * best.view.scale if free else 0.0, exact):
        return None
    is_sure = best.evidence > SURE_AT_START and lights <= MAX_NAMED
    frames = 1 if alone or is_sure else CONFIRMED
    if not (free or _is_strict(best)):
        if not alone and _may_be_otherwise(shape, best.lights(spots)):
            return None
        frames = CONFIRMED_ODD
    remark = '' if alone else f'{lights} lights in view, the {count} that fit were used'
    return Named(best.lights(spots), best.view, frames, residual <= exact, remark)


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


def _may_be_otherwise(shape: WeakPerspective, named: Mapping[int, Light]) -> bool:
    """Whether the lights of a body may as well have all other names, one being another light.

    Where four lie nearly in one plane, a glare may be where an upside-down body has its fifth.
    """
    fewest = fewest_at_start(shape)
    if fewest == len(named):
        return False
    markers, lights = [*named], [*named.values()]
    ways = body_hypotheses(shape, lights, Prior.at_start(shape), fewest)
    whole = [way.evidence for way in ways if len(way.assignment) == len(lights)]
    own = max(whole, default=-math.inf)
    return any(
        way.evidence > own - MARGIN and all(markers[i] != marker for marker, i in way.assignment)
        for way in ways
    )


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
    if len(spots) != len(shape.points):
        # One of the others may be a glare in a marker's place.
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
    along = math.copysign(1.0, math.cos(shape.upright))
    spots = sorted(spots, key=lambda spot: (along * spot.x, along * spot.y))
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
    agreed: int = 0  # frames that named the body alike, less attempts that failed since the first
    last: Mapping[int, Light] = field(default_factory=dict)  # its markers in the last one
    failed: int = 0  # attempts
    rest: int = 0  # frames until the next attempt
    _lights: int = 0
    _came: bool = False  # whether there were others in the frame before
    _is_flicker: bool = False  # the same, of the first frame of those that agree
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
        # One frame of garbage does not undo many that agree.
        self.agreed, self.rest = max(self.agreed - 1, 0), RESTED
        if self.agreed == 0:
            self.last = {}
        self.failed += 1

    def confirmed(self, named: Named, is_calibrated: bool) -> bool:
        """Whether enough frames have named the body alike."""
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
        # Another marker may be dark in each frame, as behind a propeller.
        goes_on = alike and len(self.last) == len(named.lights) and len(both) > len(self.last) - 2
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
        fitted = fit(self._shape, NamedPlaces.of(found), prior, start[SCALE], start[None])
        self._view = fitted.view()
        return self._view.rms_residual / self._view.scale
