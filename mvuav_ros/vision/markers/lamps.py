"""Lights that are fixed to the body and no markers, mapped while its markers are known."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.markers.lights import Light, coordinates
from mvuav_ros.vision.markers.marker_memory import Expectation
from mvuav_ros.vision.markers.rig_view import (
    ROLL,
    SCALE,
    Array,
    ViewState,
    WeakPerspective,
    deviations_of,
)
from mvuav_ros.vision.markers.view_correction import Belief, Correction, NamedPlaces

FARTHEST = 1.5  # Of the body's size, from its middle: what is farther off is none of its lamps
MOST = 24  # Lamps
DEPTH = 0.4  # Of the body's size (1 sigma): how far before or behind its middle a lamp may be
NOISE = 0.7  # px (1 sigma), of a lamp's place
GATE = 4.0  # Standard deviations from its place within which a light may be a lamp
MIN_SEEN = 5  # Frames with a lamp, from which on it is known
MIN_SHARE = 0.5  # Of the frames in which it should be in sight, with a lamp that is kept
HIDDEN = 8.0  # px from a marker, within which its light hides a lamp
FEWEST = 3  # Lamps that show where the body is
ALIKE = 2.0  # Times its noise, by which a lamp takes part: its frames err alike
OTHER = 0.01
_STEP = 1e-3  # Of the body's size, for slopes


class Lamps:
    """Where the body's lamps are on it: landmarks, as the markers are, but learnt in flight.

    Each has a Kalman filter of its place, which begins at the depth of the body's middle. As the
    body turns, its depth shows. Lights that do not go with the body are not found again, and go.
    """

    def __init__(self) -> None:
        self._points = np.empty((0, 3))  # units of the body's size: right, down, ahead
        self._covariances = np.empty((0, 3, 3))
        self._seen: Array = np.empty(0)  # frames with the lamp,
        self._due: Array = np.empty(0)  # and with its place in view

    def find(
        self, shape: WeakPerspective, view: ViewState, lights: Sequence[Light]
    ) -> dict[int, Light]:
        """The lamps that are known and in sight, by a view's prior; none if these are too few."""
        known = np.flatnonzero(self._seen >= MIN_SEEN)
        rows, found = self._pairs(shape, view, lights, known)
        if len(rows) < FEWEST:
            return {}
        return {int(known[row]): lights[i] for row, i in zip(rows, found.tolist(), strict=True)}

    def correction(
        self, shape: WeakPerspective, before: Belief, found: Mapping[int, Light]
    ) -> Correction | None:
        """What lamps make of views; None where they contradict each other."""
        rows = [*found]
        at = WeakPerspective(self._points[rows], shape.lens)
        _, _, variances = self._seen_at(shape, before.mean[:1, :8], self._points[rows], self._covariances[rows])
        noise = np.repeat(ALIKE**2 * (variances + NOISE**2), 2)
        named = NamedPlaces(
            np.arange(len(rows))[None], coordinates([*found.values()]).reshape(1, -1)
        )
        own = float(noise.max())
        correction = Correction.of(at, before, named, own, np.tile(noise, (len(before.mean), 1)))
        return correction if max(correction.nis) <= GATE**2 else None

    def learn(
        self,
        shape: WeakPerspective,
        view: ViewState,
        lights: Sequence[Light],
        markers: Mapping[int, Expectation],
        missing: Collection[int],
    ) -> None:
        """Learn from a frame whose markers are known, of which some may be missing.

        The lights are those without a name, the view is by the markers.
        """
        rows, found = self._pairs(shape, view, lights, np.arange(len(self._points)))
        at, slopes, _ = self._seen_at(shape, view.parameters[None], self._points, self._covariances)
        every = coordinates(lights)
        at_markers = np.array([(x, y) for x, y, _ in markers.values()])
        hidden = np.hypot(*(at[:, None] - at_markers).transpose(2, 0, 1)).min(axis=1) < HIDDEN
        width, height = shape.lens.size
        inside = (at > 0).all(axis=1) & (at < (width, height)).all(axis=1)
        self._due += inside & ~hidden
        self._due[rows] += (~inside | hidden)[rows]
        self._seen[rows] += 1
        c, h = self._covariances[rows], slopes[rows]
        gain = c @ h.transpose(0, 2, 1) @ np.linalg.inv(h @ c @ h.transpose(0, 2, 1) + NOISE**2 * np.eye(2))
        self._points[rows] += (gain @ (every[found] - at[rows])[..., None])[..., 0]
        self._covariances[rows] = c - gain @ h @ c
        kept = self._seen > MIN_SHARE * self._due - 3
        self._points, self._covariances = self._points[kept], self._covariances[kept]
        self._seen, self._due = self._seen[kept], self._due[kept]
        new = np.ones(len(every), np.bool_)
        new[found] = False
        for marker in missing:
            x, y, deviation = markers[marker]
            new &= np.hypot(*(every - (x, y)).T) > HIDDEN + GATE * deviation
        if not missing:
            self._add(shape, view, every[new])

    def log_odds(
        self, shape: WeakPerspective, lights: Sequence[Light], views: Array, named: Array
    ) -> Array:
        """(v,), of views (v, 8) by where known lamps are seen, the lights (v, k, 2) being named."""
        known = np.flatnonzero(self._seen >= MIN_SEEN)
        every = coordinates(lights)
        if not (len(known) and len(every)):
            return np.zeros(len(views))
        points = self._points[known]
        chance = (self._seen[known] + 1.0) / (self._due[known] + 2.0)
        at = WeakPerspective(points, shape.lens).project(views)
        scale = np.exp(2.0 * views[:, SCALE, None])
        variances = np.trace(self._covariances[known], axis1=1, axis2=2)
        variances = np.minimum(self._covariances[known][:, [0, 1], [0, 1]].sum(axis=1), variances) * scale + (3 * NOISE) ** 2
        apart = np.square(at[:, :, None] - every).sum(axis=-1)
        used = (np.abs(named[:, :, None] - every) < 0.5).all(axis=-1).any(axis=1)
        nearest = np.where(used[:, None], np.inf, apart).min(axis=-1)
        density = (1.0 + nearest / (4.0 * variances)) ** -3 / (2.0 * math.pi * variances)
        odds = np.log(1.0 - chance + chance * density / 1e-5)
        inside = ((at > 0) & (at < shape.lens.size)).all(axis=-1)
        hidden = (np.hypot(*np.moveaxis(at[:, :, None] - named[:, None], -1, 0)) < HIDDEN).any(axis=-1)
        odds = np.where(inside & ~hidden, odds, 0.0).sum(axis=1)
        return np.logaddexp(math.log1p(-OTHER) + odds, math.log(OTHER))

    def _add(self, shape: WeakPerspective, view: ViewState, places: Array) -> None:
        turn = np.exp(complex(*view.parameters[[SCALE, ROLL]]))
        points = np.zeros((len(places), 3))
        for _ in range(3):
            at = WeakPerspective(points, shape.lens).project(view.parameters)
            away = (places - at).view(np.complex128) / turn
            points[:, :2] += away.view(np.float64)
        points = points[np.hypot(*points.T[:2]) < FARTHEST][: MOST - len(self._points)]
        flat = (NOISE / abs(turn)) ** 2
        # depth direction is along the view, about
        one = np.ones(len(points))
        self._points = np.concatenate((self._points, points))
        self._covariances = np.concatenate((self._covariances, np.diag((flat, flat, DEPTH**2)) * one[:, None, None]))
        self._seen, self._due = np.concatenate((self._seen, one)), np.concatenate((self._due, one))

    def _pairs(
        self, shape: WeakPerspective, view: ViewState, lights: Sequence[Light], which: NDArray[np.intp]
    ) -> tuple[list[int], NDArray[np.intp]]:
        """Rows of some lamps, and the lights that are nearest to each other, within the gate."""
        if not (len(which) and lights):
            return [], np.empty(0, np.intp)
        points, covariances = self._points[which], self._covariances[which]
        at, _, variances = self._seen_at(shape, view.parameters[None], points, covariances)
        _, slopes = WeakPerspective(points, shape.lens).linearize(view.parameters[None])
        deviations = np.sqrt(deviations_of(slopes[0], view.covariance) ** 2 + variances + NOISE**2)
        apart = np.hypot(*(at[:, None] - coordinates(lights)).transpose(2, 0, 1))
        nearest = apart.argmin(axis=1)
        rows = np.arange(len(which))
        good = (apart[rows, nearest] < GATE * deviations) & (apart.argmin(axis=0)[nearest] == rows)
        return np.flatnonzero(good).tolist(), nearest[good]

    def _seen_at(
        self, shape: WeakPerspective, view: Array, points: Array, covariances: Array
    ) -> tuple[Array, Array, Array]:
        """Of lamps: places (j, 2), px; slopes by their points (j, 2, 3); larger variances (j,), px²."""
        moved = np.concatenate((np.zeros((1, 3)), _STEP * np.eye(3)))
        every = (points[:, None] + moved).reshape(-1, 3)
        at = WeakPerspective(every, shape.lens).project(view)[0].reshape(-1, 4, 2)
        slopes = ((at[:, 1:] - at[:, :1]) / _STEP).transpose(0, 2, 1)
        spread = slopes @ covariances @ slopes.transpose(0, 2, 1)
        return at[:, 0], slopes, np.trace(spread, axis1=1, axis2=2)
