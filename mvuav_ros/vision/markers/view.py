"""How a body's lights look to a camera that may not be calibrated."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.rig import MarkerRig

Array = NDArray[np.float64]

ROLL, SCALE, X, Y, PITCH, YAW, NEARNESS = range(7)
"""Places in a view's parameters."""
_STEPS = np.array((1e-5, 1e-5, 1e-3, 1e-3, 1e-5, 1e-5, 1e-5))
_ITERATIONS = 6
_POSSIBLE = (
    np.array((-np.inf, -5.0, -1e5, -1e5, -1.4, -1.4, 0.0)),
    np.array((np.inf, 12.0, 1e5, 1e5, 1.4, 1.4, 3.0)),
)
"""What parameters can become when nothing has been seen for long."""


@dataclass(frozen=True, eq=False)
class WeakPerspective:
    """A rig seen from behind, in units of its size.

    Attributes:
        points: (n, 3), x right, y down, z ahead; the middle of the lights is the origin and the
            farthest light is at 1.
        size: m.
        centre: (2,), of the image, px: off it, near and far lights shift against each other.
    """

    points: Array
    size: float
    centre: Array

    @classmethod
    def of(cls, rig: MarkerRig, width: int, height: int) -> WeakPerspective:
        """The shape of a rig whose x axis points away from the camera.

        Args:
            rig: the body.
            width: of the images, px.
            height: likewise.
        """
        x, y, z = rig.positions.T
        points = np.column_stack((-y, -z, x))
        points = points - points.mean(axis=0)
        size = float(np.hypot(np.hypot(*points.T[:2]), points.T[2]).max()) or 1.0
        return cls(points / size, size, np.array((0.5 * (width - 1), 0.5 * (height - 1))))

    @cached_property
    def base(self) -> tuple[int, int]:
        """The two lights farthest apart as seen from behind."""
        flat = self.points[:, 0] + 1j * self.points[:, 1]
        apart = np.abs(flat[:, None] - flat)
        first, second = np.unravel_index(int(np.argmax(apart)), apart.shape)
        return int(first), int(second)

    @cached_property
    def most_nearness(self) -> float:
        """With more, lights would come to lie behind the camera."""
        return float(0.85 / max(0.35, -self.points[:, 2].min()))

    def project(self, parameters: Array) -> Array:
        """Where the lights are seen.

        Args:
            parameters: (..., 7): roll (rad), log of the scale (px per unit), x and y of the
                origin (px), pitch and yaw away from straight behind (rad), nearness (units per
                distance: how strongly near lights look larger).

        Returns:
            (..., n, 2), px.
        """
        roll, scale, x, y, pitch, yaw, nearness = np.moveaxis(parameters, -1, 0)[..., None]
        px, py, pz = self.points.T
        c, s = np.cos(yaw), np.sin(yaw)
        qx, qz = c * px + s * pz, c * pz - s * px
        c, s = np.cos(pitch), np.sin(pitch)
        qy, qz = c * py - s * qz, s * py + c * qz
        larger = 1.0 / np.maximum(1.0 + nearness * qz, 0.05)
        size = np.exp(scale) * larger
        qx, qy = qx * size, qy * size
        c, s = np.cos(roll), np.sin(roll)
        cx, cy = self.centre
        x, y = cx + (x - cx) * larger, cy + (y - cy) * larger
        return np.stack((x + c * qx - s * qy, y + s * qx + c * qy), axis=-1)


@dataclass(frozen=True, eq=False)
class ViewState:
    """An estimate of how a shape is seen.

    Attributes:
        parameters: (7,), see `WeakPerspective.project`.
        covariance: (7, 7).
        offsets: (n, 2), by how much the lights lie beside the rig's, in units of the scale
            and turned with the roll; zero for a body that is what its rig says.
        misfit: root mean square of the residuals of the lights it was fitted to, px.
        cost: squared residuals and squared distance from the prior, both over their variances.
    """

    parameters: Array
    covariance: Array
    offsets: Array
    misfit: float = 0.0
    cost: float = 0.0

    @property
    def scale(self) -> float:
        """Pixels per unit of the shape."""
        return math.exp(float(self.parameters[SCALE]))

    @property
    def roll(self) -> float:
        """In the image, rad, right wing down positive."""
        return float(self.parameters[ROLL])

    def places(self, shape: WeakPerspective) -> Array:
        """Where the lights should be, (n, 2) px."""
        return shape.project(self.parameters) + self._turned_offsets(self.parameters)

    def deviations(self, shape: WeakPerspective) -> Array:
        """How uncertain that is (1 sigma, px), (n,): the larger axis of each light's ellipse."""
        jacobian = _jacobian(shape, self.parameters)
        spread = np.einsum('nai,ij,nbj->nab', jacobian, self.covariance, jacobian)
        mean = 0.5 * (spread[:, 0, 0] + spread[:, 1, 1])
        half = np.hypot(0.5 * (spread[:, 0, 0] - spread[:, 1, 1]), spread[:, 0, 1])
        return np.asarray(np.sqrt(np.maximum(mean + half, 0.0)))

    def jacobian(self, shape: WeakPerspective) -> Array:
        """By how much the places move with the parameters, (n, 2, 7)."""
        return _jacobian(shape, self.parameters)

    def later(self, elapsed: float, rates: Array, drift: Array) -> ViewState:
        """The view some time later, less certain.

        Args:
            elapsed: s.
            rates: (7,), of the parameters per second.
            drift: (7,), by how much the rates may be wrong (1 sigma).
        """
        covariance = self.covariance + np.diag((drift * elapsed) ** 2)
        parameters = np.clip(self.parameters + rates * elapsed, *_POSSIBLE)
        return ViewState(parameters, covariance, self.offsets)

    def with_offsets(self, shape: WeakPerspective, measured: Array) -> ViewState:
        """The same view of a body whose lights are where all of them are measured, (n, 2) px."""
        beside = measured - shape.project(self.parameters)
        c, s = math.cos(self.roll), math.sin(self.roll)
        turn_back = np.array([(c, -s), (s, c)]) / self.scale
        return ViewState(
            self.parameters, self.covariance, beside @ turn_back, self.misfit, self.cost
        )

    def fitted(
        self,
        shape: WeakPerspective,
        lights: NDArray[np.intp],
        measured: Array,
        deviation: float,
        start: Array | None = None,
    ) -> ViewState:
        """The view after looking at some of the lights: Gauss-Newton from this one as the prior.

        Args:
            shape: the body.
            lights: (k,), which ones.
            measured: (k, 2), px.
            deviation: of a measurement from what the rig says (1 sigma, px per axis).
            start: (7,), where to begin; the prior itself if None.
        """
        weight = np.linalg.inv(self.covariance)
        parameters = (self.parameters if start is None else start).copy()
        for _ in range(_ITERATIONS):
            residual = self._residual(shape, parameters, lights, measured)
            jacobian = _jacobian(shape, parameters)[lights].reshape(-1, 7) / deviation
            normal = jacobian.T @ jacobian + weight
            towards = jacobian.T @ residual.ravel() / deviation
            towards += weight @ (self.parameters - parameters)
            step = np.linalg.solve(normal, towards)
            longest = float(np.abs(step[[ROLL, SCALE, PITCH, YAW, NEARNESS]]).max())
            parameters = parameters + step * min(1.0, 0.5 / max(longest, 1e-9))
            parameters = np.clip(parameters, *_POSSIBLE)
            parameters[NEARNESS] = min(parameters[NEARNESS], shape.most_nearness)
            if longest < 1e-3:
                break
        residual = self._residual(shape, parameters, lights, measured)
        from_prior = parameters - self.parameters
        squares = float((residual * residual).sum())
        cost = squares / deviation**2 + float(from_prior @ weight @ from_prior)
        misfit = math.sqrt(squares / max(len(lights), 1))
        return ViewState(parameters, np.linalg.inv(normal), self.offsets, misfit, cost)

    def _residual(
        self, shape: WeakPerspective, parameters: Array, lights: NDArray[np.intp], measured: Array
    ) -> Array:
        places = shape.project(parameters) + self._turned_offsets(parameters)
        return np.asarray(measured - places[lights])

    def _turned_offsets(self, parameters: Array) -> Array:
        c, s = math.cos(parameters[ROLL]), math.sin(parameters[ROLL])
        turn = np.array([(c, s), (-s, c)]) * math.exp(parameters[SCALE])
        return np.asarray(self.offsets @ turn)


def _jacobian(shape: WeakPerspective, parameters: Array) -> Array:
    """(n, 2, 7), by central differences."""
    moved = np.concatenate((np.diag(_STEPS), np.diag(-_STEPS))) + parameters
    places = shape.project(moved)
    slopes = (places[:7] - places[7:]) / (2 * _STEPS)[:, None, None]
    return np.moveaxis(slopes, 0, -1)
