"""Lights on the body that are no markers: landmarks, whose places are learnt in flight."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.markers.hypotheses import CLUTTER_DENSITY
from mvuav_ros.vision.markers.lights import Light, coordinates
from mvuav_ros.vision.markers.rig_view import (
    COUNT,
    ROLL,
    SCALE,
    Array,
    ViewState,
    WeakPerspective,
    deviations_of,
)
from mvuav_ros.vision.markers.view_correction import (
    FREEDOM,
    TAIL,
    Belief,
    Correction,
    NamedPlaces,
    times,
)

Indices = NDArray[np.intp]

# Chosen on drawn flights with four to eight lamps on the body, whose lights go out, or which
# leaves the image; and on glares (seeds 99740 to 99749 of `tools/compare_markers.py`).
MAX_AWAY = 1.5  # Of the body's size, from its middle: what is farther away is none of its lamps
MAX_LAMPS = 24
DEPTH = 0.4  # Of the body's size (1 sigma): how far behind or before its middle a lamp may be
NOISE, NOISE_FOUND = 0.7, 2.0  # px (1 sigma), of a lamp's place; in a view that was just found
GATE = 4.0  # Standard deviations within which a light may be a lamp
MIN_SEEN, MIN_SHARE = 8, 0.9  # Looks with a lamp that is known, and of those that should show it
MIN_MOVED = 10.0
"""px, by which a lamp that is known has moved in the image with the body: a glare does not."""
MIN_KEPT, SPARED = 0.5, 3  # Of the looks that should show it, of any that is kept; but for some
HIDDEN = 8.0  # px from a marker, whose light hides a lamp
MIN_LAMPS = 3  # Lamps that show where the body is
ALIKE = 2.0  # By which their deviations are taken larger, as all frames err alike
CHANGED = 0.01  # Probability that the lamps are others than they were
_STEP = 1e-3  # Of the body's size, for slopes
_LAMP = np.dtype(
    [
        ('point', float, 3),  # units of the body's size: right, down, ahead
        ('covariance', float, (3, 3)),
        ('seen', float),  # looks with the lamp
        ('due', float),  # looks that should have shown it
        ('first', float, 2),  # px, where it was seen first
        ('moved', float),  # px, how far from there at most
    ]
)


class Lamps:
    """Where a body's lamps are on it, each with a Kalman filter of its place.

    It begins at the depth of the body's middle; as the body turns, its depth shows. A light that
    does not go with the body is not where it is expected in later frames, and is forgotten.

    Lamps that are known are not taken for markers. Where few markers are in sight they show how the
    body is seen, and they speak for or against a view in which it is found again.
    """

    def __init__(self) -> None:
        self._lamps = np.empty(0, _LAMP)

    @property
    def _known(self) -> Indices:
        lamps = self._lamps
        enough = np.maximum(MIN_SEEN, MIN_SHARE * lamps['due'])
        return np.flatnonzero((lamps['seen'] >= enough) & (lamps['moved'] >= MIN_MOVED))

    @property
    def is_learning(self) -> bool:
        """Whether a light may yet turn out to be one."""
        return len(self._known) < len(self._lamps)

    @property
    def are_known(self) -> bool:
        """Whether there are enough of them to show where the body is."""
        return len(self._known) >= MIN_LAMPS

    def find(
        self, shape: WeakPerspective, view: ViewState, lights: Sequence[Light]
    ) -> dict[int, Light]:
        """The known lamps among a frame's lights by a view; none where they are too few."""
        seen, found, *_ = self._pairs(shape, view, lights, self._known)
        if len(seen) < MIN_LAMPS:
            return {}
        return {lamp: lights[i] for lamp, i in zip(seen.tolist(), found.tolist(), strict=True)}

    def correction(
        self, shape: WeakPerspective, before: Belief, found: Mapping[int, Light]
    ) -> Correction | None:
        """What lamps make of priors of views; None where they do not agree."""
        rows = [*found]
        _, slopes = self._places(shape, before.mean[0, :COUNT], rows)
        noise = ALIKE**2 * (self._variances(slopes, rows) + NOISE**2)
        every = np.tile(np.repeat(noise, 2), (len(before.mean), 1))
        named = NamedPlaces.of(dict(enumerate(light[:2] for light in found.values())))
        lamps = WeakPerspective(self._lamps['point'][rows], shape.lens)
        correction = Correction.of(lamps, before, named, float(noise.max()), every)
        return correction if max(correction.nis) <= GATE**2 else None

    def log_odds(
        self, shape: WeakPerspective, lights: Sequence[Light], views: Array, named: Array
    ) -> Array:
        """(v,), what lamps among a frame's lights say for views (v, 8) by its named ones (v, k, 2).

        The logarithm of how probable it is to see so much of them, over that without any.
        """
        known = self._known
        if not (len(known) and lights):
            return np.zeros(len(views))
        every = coordinates(lights)
        at = WeakPerspective(self._lamps['point'][known], shape.lens).project(views)
        away = np.square(at[:, :, None] - every).sum(axis=-1)
        is_named = (named[:, :, None] == every).all(axis=-1).any(axis=1)
        nearest = np.where(is_named[:, None], np.inf, away).min(axis=-1)
        flat = self._lamps['covariance'][known][:, (0, 1), (0, 1)].sum(axis=-1)
        variances = flat * np.exp(2.0 * views[:, SCALE, None]) + NOISE_FOUND**2
        # Student's t, as of a marker's place.
        density = (1.0 + nearest / (FREEDOM * variances)) ** -TAIL / (2.0 * math.pi * variances)
        share = (self._lamps['seen'][known] + 1.0) / (self._lamps['due'][known] + 2.0)
        odds = np.log(1.0 - share + share * density / CLUTTER_DENSITY)
        odds[~self._are_in_view(shape, at, named)] = 0.0
        either = math.log1p(-CHANGED) + odds.sum(axis=1), math.log(CHANGED)
        return np.asarray(np.logaddexp(*either))

    def learn(
        self,
        shape: WeakPerspective,
        view: ViewState,
        lights: Sequence[Light],
        markers: Array,
        *,
        is_whole: bool,
    ) -> None:
        """Learn from a frame's lights without a name, in the view by its markers.

        All markers should be at (n, 2), px; if the whole body was seen, new lights may be lamps.
        """
        lamps, places = self._lamps, coordinates(lights)
        if not (len(lamps) or len(places)):
            return
        seen, found, at, slopes = self._pairs(shape, view, lights, np.arange(len(lamps)))
        is_due = self._are_in_view(shape, at, markers)
        is_due[seen] = True
        lamps['due'] += is_due
        lamps['seen'][seen] += 1.0
        before, slopes = lamps['covariance'][seen], slopes[seen]
        towards = before @ slopes.transpose(0, 2, 1)
        gain = towards @ np.linalg.inv(slopes @ towards + NOISE**2 * np.eye(2))
        lamps['point'][seen] += times(gain, places[found] - at[seen])
        lamps['covariance'][seen] = before - gain @ slopes @ before
        moved = np.hypot(*(places[found] - lamps['first'][seen]).T)
        lamps['moved'][seen] = np.maximum(lamps['moved'][seen], moved)
        self._lamps = lamps[lamps['seen'] + SPARED > MIN_KEPT * lamps['due']]
        if is_whole:
            self._add(shape, view, np.delete(places, found, axis=0))

    def _add(self, shape: WeakPerspective, view: ViewState, places: Array) -> None:
        """Take lights (k, 2), px, for lamps at the depth of the body's middle, and see."""
        turn = np.exp(complex(*view.parameters[[SCALE, ROLL]]))
        points = np.zeros((len(places), 3))
        # Perspective makes more than one step of it.
        for _ in range(3):
            at = WeakPerspective(points, shape.lens).project(view.parameters)
            points[:, :2] += ((places - at).view(np.complex128) / turn).view(np.float64)
        near = np.flatnonzero(np.hypot(*points.T[:2]) < MAX_AWAY)[: MAX_LAMPS - len(self._lamps)]
        new = np.zeros(len(near), _LAMP)
        new['point'], new['first'] = points[near], places[near]
        new['seen'] = new['due'] = 1.0
        rows = len(self._lamps) + np.arange(len(new))
        self._lamps = np.concatenate((self._lamps, new))
        # Each may be anywhere on the ray on which it is seen.
        _, slopes = self._places(shape, view.parameters, rows)
        ray = np.cross(slopes[:, 0], slopes[:, 1])
        ray /= ray[:, 2:]
        spread = (NOISE / abs(turn)) ** 2 * np.eye(3) + DEPTH**2 * ray[:, :, None] * ray[:, None]
        self._lamps['covariance'][rows] = spread

    def _pairs(
        self, shape: WeakPerspective, view: ViewState, lights: Sequence[Light], lamps: Indices
    ) -> tuple[Indices, Indices, Array, Array]:
        """Those of some lamps that are seen, and as which lights: each the other's nearest.

        And the places and slopes of all of these lamps (see `_places`).
        """
        at, slopes = self._places(shape, view.parameters, lamps)
        if not (len(lamps) and lights):
            return np.empty(0, np.intp), np.empty(0, np.intp), at, slopes
        _, by_view = WeakPerspective(self._lamps['point'][lamps], shape.lens).linearize(
            view.parameters[None]
        )
        variances = self._variances(slopes, lamps) + NOISE**2
        variances += deviations_of(by_view[0], view.covariance) ** 2
        away = np.square(at[:, None] - coordinates(lights)).sum(axis=-1)
        nearest, rows = away.argmin(axis=1), np.arange(len(lamps))
        is_seen = away[rows, nearest] < GATE**2 * variances
        is_seen &= away.argmin(axis=0)[nearest] == rows
        return lamps[is_seen], nearest[is_seen], at, slopes

    def _places(
        self, shape: WeakPerspective, view: Array, lamps: Sequence[int] | Indices
    ) -> tuple[Array, Array]:
        """Where lamps are seen in a view (8,), (j, 2) px, and the slopes by their points."""
        moved = np.concatenate((np.zeros((1, 3)), _STEP * np.eye(3)))
        points = (self._lamps['point'][lamps][:, None] + moved).reshape(-1, 3)
        at = WeakPerspective(points, shape.lens).project(view).reshape(-1, 4, 2)
        return at[:, 0], (at[:, 1:] - at[:, :1]).transpose(0, 2, 1) / _STEP

    def _variances(self, slopes: Array, lamps: Sequence[int] | Indices) -> Array:
        """Of their places across and down together, px²."""
        spread = slopes @ self._lamps['covariance'][lamps] @ slopes.transpose(0, 2, 1)
        return np.asarray(np.trace(spread, axis1=1, axis2=2))

    @staticmethod
    def _are_in_view(shape: WeakPerspective, at: Array, markers: Array) -> NDArray[np.bool_]:
        """Whether places (..., j, 2), px, are in the image and no marker (..., k, 2) hides them."""
        seen = shape.lens.to_image(at.reshape(-1, 2)).reshape(at.shape)
        inside = ((seen > 0.0) & (seen < shape.lens.size)).all(axis=-1)
        apart = np.square(at[..., :, None, :] - markers[..., None, :, :]).sum(axis=-1)
        return np.asarray(inside & (apart > HIDDEN**2).all(axis=-1))
