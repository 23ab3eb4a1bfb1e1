"""How a rig's markers look to a camera: seven numbers, and an eighth for a lens not calibrated."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.rig import MarkerRig

Array = NDArray[np.float64]

ROLL, SCALE, X, Y, PITCH, YAW, FOCAL, BARREL = range(8)
"""Places in a view's parameters."""
COUNT = 8
_STEPS = np.array((1e-5, 1e-5, 1e-3, 1e-3, 1e-5, 1e-5, 1e-5, 1e-5))
_SHIFTS = np.concatenate((np.zeros((1, COUNT)), np.diag(_STEPS), np.diag(-_STEPS)))
_POSSIBLE = (
    np.array((-np.inf, -5.0, -1e5, -1e5, -1.4, -1.4, 0.0, -0.6)),
    np.array((np.inf, 12.0, 1e5, 1e5, 1.4, 1.4, 20.0, 0.3)),
)
"""What parameters can become when nothing has been seen for long."""
_SHARED = [ROLL, SCALE, PITCH, YAW, FOCAL]
KNOWN_FOCAL = 0.01
"""Part by which a calibrated focal length may be wrong (1 sigma)."""


class Lens:
    """From the pixels of an image to those of a camera without distortion, and back.

    Attributes:
        focal: px, of that camera; None where the camera is not calibrated, whose pixels are taken
            as they are.
        centre: (2,), its principal point, px.
    """

    def __init__(self, size: tuple[int, int], camera: CameraModel | None = None) -> None:
        """Prepare for images of a size.

        Args:
            size: width and height, px.
            camera: calibrated, for images of that size; None where it is not known.
        """
        self._camera = camera
        self.focal: float | None = None
        self.centre: Array = np.array((0.5 * (size[0] - 1), 0.5 * (size[1] - 1)))
        self.half_diagonal = math.hypot(*size) / 2
        if camera is not None:
            matrix = camera.matrix
            self.focal = math.sqrt(matrix[0, 0] * matrix[1, 1])
            self.centre = matrix[:2, 2].copy()
            self._ideal: Array = np.array(
                [(self.focal, 0.0, self.centre[0]), (0.0, self.focal, self.centre[1]), (0, 0, 1.0)]
            )

    def to_ideal(self, pixels: Array) -> Array:
        """(n, 2) px of the image as px without distortion."""
        camera = self._camera
        if camera is None or not len(pixels):
            return pixels
        points = np.ascontiguousarray(pixels, np.float64).reshape(-1, 1, 2)
        ideal = cv2.undistortPoints(points, camera.matrix, camera.distortion, P=self._ideal)
        return np.asarray(ideal, np.float64).reshape(-1, 2)

    def to_image(self, ideal: Array) -> Array:
        """(n, 2) px without distortion as px of the image."""
        camera = self._camera
        if camera is None or not len(ideal):
            return ideal
        focal = self._ideal[0, 0]
        rays = np.column_stack(((ideal - self.centre) / focal, np.ones(len(ideal))))
        # Far outside of the frame a lens model turns back: nothing is seen there anyway.
        np.clip(rays[:, :2], -1.5, 1.5, out=rays[:, :2])
        zero = np.zeros(3)
        image = cv2.projectPoints(rays, zero, zero, camera.matrix, camera.distortion)[0]
        return np.asarray(image, np.float64).reshape(-1, 2)


@dataclass(frozen=True, eq=False)
class WeakPerspective:
    """A rig seen from behind, in units of its size.

    Attributes:
        points: (n, 3), x right, y down, z ahead; the middle of the markers is the origin and the
            farthest marker is at 1.
        size: m.
        lens: of the camera.
    """

    points: Array
    size: float
    lens: Lens

    @classmethod
    def of(cls, rig: MarkerRig, lens: Lens) -> WeakPerspective:
        """The shape of a rig whose x axis points away from the camera."""
        x, y, z = rig.positions.T
        points = np.column_stack((-y, -z, x))
        points = points - points.mean(axis=0)
        size = float(np.hypot(np.hypot(*points.T[:2]), points.T[2]).max()) or 1.0
        return cls(points / size, size, lens)

    @property
    def centre(self) -> Array:
        """(2,), px: off it, near and far markers shift against each other."""
        return self.lens.centre

    @cached_property
    def base(self) -> tuple[int, int]:
        """The two markers farthest apart as seen from behind."""
        flat = self.points[:, 0] + 1j * self.points[:, 1]
        apart = np.abs(flat[:, None] - flat)
        first, second = np.unravel_index(int(np.argmax(apart)), apart.shape)
        return int(first), int(second)

    @cached_property
    def most_nearness(self) -> float:
        """Units per distance: with more, markers would come to lie behind the camera."""
        return float(0.85 / max(0.35, -self.points[:, 2].min()))

    def project(self, parameters: Array) -> Array:
        """Where the markers are seen.

        Args:
            parameters: (..., 8): roll (rad), log of the scale (px per unit), x and y of the
                origin (px), pitch and yaw away from straight behind (rad), log of the focal
                length (px: the less, the nearer the rig), barrel (share by which the
                lens moves a point at half the image's diagonal; 0 where it is calibrated).

        Returns:
            (..., n, 2), px.
        """
        roll, scale, x, y, pitch, yaw, focal, barrel = np.moveaxis(parameters, -1, 0)[..., None]
        px, py, pz = self.points.T
        c, s = np.cos(yaw), np.sin(yaw)
        qx, qz = c * px + s * pz, c * pz - s * px
        c, s = np.cos(pitch), np.sin(pitch)
        qy, qz = c * py - s * qz, s * py + c * qz
        size = np.exp(scale)
        nearness = np.minimum(size * np.exp(-focal), self.most_nearness)
        larger = 1.0 / np.maximum(1.0 + nearness * qz, 0.05)
        c, s = np.cos(roll) * size, np.sin(roll) * size
        cx, cy = self.centre
        u = (x - cx + c * qx - s * qy) * larger
        v = (y - cy + s * qx + c * qy) * larger
        if self.lens.focal is None:
            bent = 1.0 + barrel * ((u * u + v * v) / self.lens.half_diagonal**2)
            u, v = u * bent, v * bent
        return np.stack((cx + u, cy + v), axis=-1)

    def linearize(self, parameters: Array) -> tuple[Array, Array]:
        """Places (..., n, 2) and by how much they move with the parameters, (..., n, 2, 8)."""
        places = self.project(parameters[..., None, :] + _SHIFTS)
        slopes = places[..., 1 : COUNT + 1, :, :] - places[..., COUNT + 1 :, :, :]
        slopes = slopes / (2 * _STEPS)[:, None, None]
        return places[..., 0, :, :], np.moveaxis(slopes, -3, -1)


@dataclass(frozen=True, eq=False)
class ViewState:
    """An estimate of how a shape is seen.

    Attributes:
        parameters: (8,), see `WeakPerspective.project`.
        covariance: (8, 8).
        misfit: root mean square of the residuals of the markers it was fitted to, px.
        cost: squared residuals and squared distance from the prior, both over their variances.
        surprise: (k,), for each of those markers how far it lies from where all others put it:
            squared distance over variance.
    """

    parameters: Array
    covariance: Array
    misfit: float = 0.0
    cost: float = 0.0
    surprise: Array = field(default_factory=lambda: np.zeros(0))

    @property
    def scale(self) -> float:
        """Pixels per unit of the shape."""
        return math.exp(float(self.parameters[SCALE]))

    @property
    def roll(self) -> float:
        """In the image, rad, right wing down positive."""
        return float(self.parameters[ROLL])


def turned(offsets: Array, parameters: Array) -> Array:
    """Offsets (n, 2) in units of the scale, turned with the roll: px, (..., n, 2)."""
    angle, size = parameters[..., ROLL, None], np.exp(parameters[..., SCALE, None])
    c, s = np.cos(angle) * size, np.sin(angle) * size
    x, y = offsets.T
    return np.stack((c * x - s * y, s * x + c * y), axis=-1)


def offsets_of(shape: WeakPerspective, view: ViewState, measured: Array) -> Array:
    """By how much markers lie beside the rig's, (n, 2) in units of the scale (see `turned`)."""
    beside = measured - shape.project(view.parameters)
    c, s = math.cos(view.roll), math.sin(view.roll)
    return np.asarray(beside @ np.array([(c, -s), (s, c)]) / view.scale)


@dataclass(frozen=True, eq=False)
class Fits:
    """Views fitted to several ways of naming markers, or from several priors.

    Attributes:
        parameters: (m, 8), see `WeakPerspective.project`.
        covariance: (m, 8, 8).
        cost: (m,), squared residuals and squared distance from the prior, over their variances.
        misfit: (m,), px, root mean square of the markers' distances.
        surprise: (m, k), for each marker how far it lies from where all others put it: squared
            distance over variance.
    """

    parameters: Array
    covariance: Array
    cost: Array
    misfit: Array
    surprise: Array

    def view(self, index: int = 0) -> ViewState:
        """One of the views."""
        return ViewState(
            self.parameters[index],
            self.covariance[index],
            float(self.misfit[index]),
            float(self.cost[index]),
            self.surprise[index],
        )


def fit(
    shape: WeakPerspective,
    prior: tuple[Array, Array],
    seen: NDArray[np.intp],
    measured: Array,
    deviation: Array,
    *,
    noise: float | None = None,
    offsets: Array | None = None,
    starts: Array | None = None,
    iterations: int = 6,
) -> Fits:
    """Views after looking at some of the markers: Gauss-Newton from a prior, many at once.

    Args:
        shape: the rig.
        prior: parameters (m or 1, 8) and their covariance (m or 1, 8, 8) before.
        seen: (m, k), which markers.
        measured: (m, k, 2), px, without distortion.
        deviation: (m, k) or what broadcasts to it: of a measurement from what the rig says
            (1 sigma, px per axis).
        noise: what a measurement's surprise is held against, where some are given larger
            deviations than they have; the deviation if None.
        offsets: (n, 2), by how much the markers lie beside the rig's (see `turned`).
        starts: (m, 8), where to begin; the prior if None.
        iterations: at most.
    """
    m, k = seen.shape
    mean = prior[0]
    weight = inverse(prior[1])
    parameters = np.repeat(mean, m // len(mean), axis=0) if starts is None else starts.copy()
    precision = 1.0 / np.broadcast_to(deviation, (m, k))
    rows = np.arange(m)[:, None]
    for _ in range(iterations):
        residual, jacobian = _residual(shape, parameters, seen, measured, offsets, rows)
        normal, towards = _normal_equations(residual, jacobian, precision)
        normal = normal + weight
        towards = towards + (weight @ (mean - parameters)[..., None])[..., 0]
        step = (inverse(normal) @ towards[..., None])[..., 0]
        longest = np.abs(step[:, _SHARED]).max(axis=1)
        parameters = parameters + step * np.minimum(1.0, 0.5 / np.maximum(longest, 1e-9))[:, None]
        parameters = np.clip(parameters, *_POSSIBLE)
        if longest.max() < 1e-3:
            break
    residual, jacobian = _residual(shape, parameters, seen, measured, offsets, rows)
    away = parameters - mean
    weighted = ((residual * precision[..., None]) ** 2).sum(axis=(1, 2))
    cost = weighted + (away[:, None] @ weight @ away[..., None])[:, 0, 0]
    covariance = inverse(normal)
    surprise = _surprise(residual, jacobian, covariance, 1.0 / precision, noise)
    misfit = np.sqrt((residual * residual).sum(axis=(1, 2)) / max(k, 1))
    return Fits(parameters, covariance, cost, misfit, surprise)


def inverse(matrices: Array) -> Array:
    """Inverses of positive matrices (m, n, n) whose rows are of very different sizes."""
    size = 1.0 / np.sqrt(np.maximum(np.einsum('mii->mi', matrices), 1e-300))
    sizes = size[:, :, None] * size[:, None, :]
    inverses = np.linalg.inv(matrices * sizes) * sizes
    return np.asarray(0.5 * (inverses + inverses.transpose(0, 2, 1)))


def _residual(
    shape: WeakPerspective,
    parameters: Array,
    seen: NDArray[np.intp],
    measured: Array,
    offsets: Array | None,
    rows: NDArray[np.intp],
) -> tuple[Array, Array]:
    places, jacobian = shape.linearize(parameters)
    if offsets is not None:
        places = places + turned(offsets, parameters)
    return measured - places[rows, seen], jacobian[rows, seen]


def _normal_equations(residual: Array, jacobian: Array, precision: Array) -> tuple[Array, Array]:
    m = len(residual)
    rows = (jacobian * precision[..., None, None]).reshape(m, -1, COUNT)
    columns = rows.transpose(0, 2, 1)
    normal = columns @ rows
    towards = (columns @ (residual * precision[..., None]).reshape(m, -1, 1))[..., 0]
    return normal, towards


def _surprise(
    residual: Array, jacobian: Array, covariance: Array, deviation: Array, noise: float | None
) -> Array:
    """(m, k), squared distances of markers from where all the others put them, over variances.

    A marker's place by the others follows from that by all: its residual r and the place's
    covariance h become (I - h / d²)⁻¹ r and (I - h / d²)⁻¹ h, with d the deviation at which it
    took part.
    """
    told = jacobian @ covariance[:, None] @ jacobian.transpose(0, 1, 3, 2)
    share = told / (deviation**2)[..., None, None]
    # A marker without which nothing is known about a direction tells nothing of itself there.
    a = np.maximum(1.0 - share[..., 0, 0], 1e-3)
    d = np.maximum(1.0 - share[..., 1, 1], 1e-3)
    b = np.clip(-share[..., 0, 1], -0.99 * np.sqrt(a * d), 0.99 * np.sqrt(a * d))
    inverted = np.stack((d, -b, -b, a), axis=-1).reshape(*a.shape, 2, 2)
    inverted /= (a * d - b * b)[..., None, None]
    apart = (inverted @ residual[..., None])[..., 0]
    variance = inverted @ told
    own = deviation**2 if noise is None else np.full_like(deviation, noise * noise)
    a, d = variance[..., 0, 0] + own, variance[..., 1, 1] + own
    b = 0.5 * (variance[..., 0, 1] + variance[..., 1, 0])
    x, y = apart[..., 0], apart[..., 1]
    return np.asarray((d * x * x - 2 * b * x * y + a * y * y) / (a * d - b * b))


def deviations_of(jacobian: Array, covariance: Array) -> Array:
    """How uncertain places are (1 sigma, px), (n,): the larger axis of each one's ellipse."""
    spread = np.einsum('nai,ij,nbj->nab', jacobian, covariance, jacobian)
    mean = 0.5 * (spread[:, 0, 0] + spread[:, 1, 1])
    half = np.hypot(0.5 * (spread[:, 0, 0] - spread[:, 1, 1]), spread[:, 0, 1])
    return np.asarray(np.sqrt(np.maximum(mean + half, 0.0)))
