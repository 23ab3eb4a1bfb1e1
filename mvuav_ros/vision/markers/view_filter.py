"""The view of a body carried from frame to frame while some of its markers are out of sight."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from mvuav_ros.vision.markers.view import Array, ViewState, WeakPerspective

DRIFT = np.array((0.5, 0.07, 90.0, 90.0, 0.05, 0.05, 0.03))
"""How a view wanders off its rates in a second (1 sigma; see `WeakPerspective.project`)."""
RATE_SCALE = np.array((1.5, 0.3, 200.0, 200.0, 0.3, 0.4, 0.1))
"""Usual rates per second, a prior where the lights' velocities do not tell."""
RATES_LAST = 1.0
"""Seconds after which a motion has changed."""
SHARP = 0.7
"""px, of a light from its place in a view that has been adjusted to the body (1 sigma)."""
LEAST_MODEL_ERROR = 0.006
"""Of a rig, in units of the body's size."""
_RATE_MEMORY = 0.8


class ViewFilter:
    """A view, how it changes, and when.

    Attributes:
        view: at `time`.
        time: s.
    """

    def __init__(
        self, shape: WeakPerspective, view: ViewState, time: float, before: ViewFilter | None = None
    ) -> None:
        """Begin with a view of all markers, fitted without offsets.

        Args:
            shape: the body.
            view: of it.
            time: s.
            before: an earlier view_filter of the same body.
        """
        self.shape = shape
        self.view = view
        self.time = time
        self._rates: Array = np.zeros(7)
        self._model_error = max(LEAST_MODEL_ERROR, view.misfit / view.scale)
        if before is not None:
            self._model_error = max(self._model_error, before._model_error)

    def refresh(self, positions: Array, velocities: Array, time: float) -> int | None:
        """Take a frame in which all markers were seen, later than `time`.

        What the rig does not explain of the markers' places is taken to be the body's own,
        as far as that was so at the start.

        Args:
            positions: (n, 2), px.
            velocities: (n, 2), px/s; NaN where unknown.
            time: s.

        Returns:
            A marker that cannot be where it was seen, the others being right; None if all can.
        """
        elapsed = max(time - self.time, 0.0)
        prior = self.view.later(elapsed, self._rates, DRIFT / max(elapsed, 1e-9) ** 0.5)
        prior = ViewState(prior.parameters, prior.covariance, np.zeros_like(self.view.offsets))
        everything = np.arange(len(positions))
        fitted = prior.fitted(self.shape, everything, positions, self._loose)
        limit = self.most_misfit(fitted.scale)
        if fitted.misfit > limit and len(positions) > 3:
            others = [
                prior.fitted(self.shape, rest, positions[rest], self._loose).misfit
                for rest in (np.delete(everything, index) for index in everything)
            ]
            best = int(np.argmin(others))
            if others[best] < 0.5 * limit:
                return best
        self.view = fitted.with_offsets(self.shape, positions)
        self.time = time
        self._rates = np.zeros(7)
        if np.isfinite(velocities).all():
            jacobian = self.view.jacobian(self.shape).reshape(-1, 7) * RATE_SCALE
            # Velocities are good to a few px/s.
            normal = jacobian.T @ jacobian / 25.0 + np.eye(7)
            self._rates = RATE_SCALE * np.linalg.solve(
                normal, jacobian.T @ velocities.ravel() / 25.0
            )
        return None

    def most_misfit(self, scale: float) -> float:
        """How badly this very body may fit its rig, px, at a scale (px)."""
        return 1.0 + 1.5 * self._model_error * scale

    @property
    def _loose(self) -> float:
        """How far a marker may be from the rig's place (1 sigma, px)."""
        return SHARP + self._model_error * self.view.scale

    def advance(self, time: float) -> ViewState:
        """Carry the view on to a later time (s): the prior for what is seen then."""
        elapsed = time - self.time
        self.view = self.view.later(elapsed, self._rates, DRIFT / math.sqrt(elapsed))
        self._rates = self._rates * math.exp(-elapsed / RATES_LAST)
        self.time = time
        return self.view

    def look(self, prior: ViewState, seen: Mapping[int, tuple[float, float]]) -> ViewState:
        """The view by the markers in sight, from the prior of this frame."""
        if not seen:
            return prior
        lights = np.array(list(seen), np.intp)
        return prior.fitted(self.shape, lights, np.array(list(seen.values())), SHARP)

    def settle(self, prior: ViewState, view: ViewState, elapsed: float) -> None:
        """Keep the view of this frame, and learn the rates from how it differs from the prior."""
        if elapsed > 0.0:
            change = (view.parameters - prior.parameters) / elapsed
            self._rates = self._rates + (1 - _RATE_MEMORY) * change
            self._rates = np.clip(self._rates, -3.0 * RATE_SCALE, 3.0 * RATE_SCALE)
        self.view = view
