"""How a rig's markers look to a camera: seven numbers, and an eighth for a lens not calibrated."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.markers.lens import Lens
from mvuav_ros.vision.rig import MarkerRig

Array = NDArray[np.float64]

ROLL, SCALE, X, Y, PITCH, YAW, FOCAL, BARREL = range(8)
"""Places in a view's parameters."""
COUNT = 8
KNOWN_FOCAL = 0.01
"""Part by which a calibrated focal length may be wrong (1 sigma)."""
_NEAREST = 0.05
"""Least distance of a marker over the rig's: what would come to lie behind the camera."""


@dataclass(frozen=True, eq=False)
class WeakPerspective:
    """A rig seen from behind, in units of its size.

    Attributes:
        points: (n, 3), x right, y down, z ahead; the middle of the markers is the origin and the
            farthest marker is at 1.
        size: m.
        lens: of the camera.
        offsets: (n,), by how much the markers of a body that is not what its rig says are seen
            beside it: x + iy in units of the scale, turned with the roll.
    """

    points: Array
    size: float
    lens: Lens
    offsets: NDArray[np.complex128] | None = None

    @classmethod
    def of(cls, rig: MarkerRig, lens: Lens) -> WeakPerspective:
        """The shape of a rig whose x axis points away from the camera."""
        x, y, z = rig.positions.T
        points = np.column_stack((-y, -z, x))
        points = points - points.mean(axis=0)
        size = float(np.hypot(np.hypot(*points.T[:2]), points.T[2]).max()) or 1.0
        return cls(points / size, size, lens)

    def with_offsets(self, view: ViewState, measured: Array) -> WeakPerspective:
        """The shape that shows the markers where they are (n, 2), px, in a view."""
        beside = measured - replace(self, offsets=None).project(view.parameters)
        turn = np.exp(complex(view.parameters[SCALE], view.roll))
        return replace(self, offsets=(beside[:, 0] + 1j * beside[:, 1]) / turn)

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
        return self.linearize(parameters)[0]

    def linearize(self, parameters: Array) -> tuple[Array, Array]:
        """Places (..., n, 2) and by how much they move with the parameters, (..., n, 2, 8).

        Image points are complex numbers, x + iy from the image's centre.
        """
        roll, scale, x, y, pitch, yaw, focal, barrel = np.moveaxis(parameters, -1, 0)[..., None]
        px, py, pz = self.points.T
        c, s = np.cos(yaw), np.sin(yaw)
        qx, flat_z = c * px + s * pz, c * pz - s * px
        c, s = np.cos(pitch), np.sin(pitch)
        qy, qz = c * py - s * flat_z, s * py + c * flat_z
        turn = np.exp(scale + 1j * roll)
        near = np.exp(scale - focal)
        free = near < self.most_nearness
        near = np.minimum(near, self.most_nearness)
        larger = 1.0 / np.maximum(1.0 + near * qz, _NEAREST)
        turned = turn * (qx + 1j * qy)
        cx, cy = self.centre
        image = (x - cx + 1j * (y - cy) + turned) * larger
        nearer = image * (near * larger)
        turn = turn * larger
        slopes = np.empty((*image.shape, COUNT), np.complex128)
        slopes[..., X] = larger
        slopes[..., Y] = 1j * larger
        turned = turned * larger
        slopes[..., ROLL] = 1j * turned
        slopes[..., FOCAL] = by_focal = nearer * (qz * free)
        slopes[..., SCALE] = turned - by_focal
        slopes[..., PITCH] = -1j * turn * qz - nearer * qy
        slopes[..., YAW] = turn * (flat_z + 1j * s * qx) + nearer * (c * qx)
        slopes[..., BARREL] = 0.0
        if self.lens.focal is None:
            squared = (image * image.conj()).real / self.lens.half_diagonal**2
            outward = 2.0 / self.lens.half_diagonal**2 * (image.conj()[..., None] * slopes).real
            slopes *= (1.0 + barrel * squared)[..., None]
            slopes += (barrel * image)[..., None] * outward
            slopes[..., BARREL] = image * squared
            image = image * (1.0 + barrel * squared)
        if self.offsets is not None:
            beside = self.offsets * np.exp(scale + 1j * roll)
            image = image + beside
            slopes[..., ROLL] += 1j * beside
            slopes[..., SCALE] += beside
        places = np.stack((image.real + cx, image.imag + cy), axis=-1)
        return places, np.stack((slopes.real, slopes.imag), axis=-2)


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


def deviations_of(jacobian: Array, covariance: Array) -> Array:
    """How uncertain places are (1 sigma, px), (n,): the larger axis of each one's ellipse."""
    spread = jacobian @ covariance @ jacobian.swapaxes(-1, -2)
    mean = 0.5 * (spread[:, 0, 0] + spread[:, 1, 1])
    half = np.hypot(0.5 * (spread[:, 0, 0] - spread[:, 1, 1]), spread[:, 0, 1])
    return np.asarray(np.sqrt(np.maximum(mean + half, 0.0)))
