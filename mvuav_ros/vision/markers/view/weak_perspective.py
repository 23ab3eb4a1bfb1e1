"""How a rig's markers look to a camera: seven numbers, and an eighth for a lens not calibrated."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.markers.lens import Lens
from mvuav_ros.vision.rig import MarkerRig

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

ROLL, SCALE, X, Y, PITCH, YAW, FOCAL, BARREL = range(8)
"""Places in a view's parameters."""
COUNT = 8
KNOWN_FOCAL = 0.01
"""Part by which a calibrated focal length may be wrong (1 sigma)."""
_NEAREST = 0.05
"""Least distance of a marker over the rig's: what would come to lie behind the camera."""
_LEAST_AREA = 1e-3
"""Twice that of a triangle in which three markers are not on one line, in squared units."""
_EXPONENTS: Complex = np.zeros((COUNT, 6), np.complex128)
"""Of a view: i times yaw + pitch, yaw - pitch, yaw, and pitch; log of the scale plus i times the
roll; log of the scale less that of the focal length."""
_EXPONENTS[YAW, :3] = _EXPONENTS[PITCH, [0, 3]] = _EXPONENTS[ROLL, 4] = 1j
_EXPONENTS[PITCH, 1] = -1j
_EXPONENTS[SCALE, 4:] = 1.0
_EXPONENTS[FOCAL, 5] = -1.0


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
    offsets: Complex | None = None

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
    def triangle(self) -> tuple[int, int, int] | None:
        """The three markers of the largest triangle as seen from behind; None if on one line."""
        flat = self.points[:, 0] + 1j * self.points[:, 1]

        def area(three: tuple[int, int, int]) -> float:
            a, b, c = (complex(flat[marker]) for marker in three)
            return abs(((b - a).conjugate() * (c - a)).imag)

        largest = max(combinations(range(len(flat)), 3), key=area, default=None)
        return None if largest is None or area(largest) < _LEAST_AREA else largest

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
        """Places (..., n, 2) and by how much they move with the parameters, (..., n, 2, 8)."""
        views = np.ascontiguousarray(parameters).reshape(-1, COUNT)
        places, slopes = self.linearize_all(views)
        count = len(self.points)
        jacobian = slopes.reshape(len(views), COUNT, count, 2).transpose(0, 2, 3, 1)
        before = parameters.shape[:-1]
        return places.reshape(*before, count, 2), jacobian.reshape(*before, count, 2, COUNT)

    def linearize_all(self, views: Array) -> tuple[Array, Array]:
        """The same of m views at once, in the order in which matrix products take it.

        Image points are complex numbers, x + iy from the image's centre.

        Args:
            views: (m, 8), contiguous.

        Returns:
            Places (m, 2 n), x and y of each marker in turn, and by how much they move with the
            parameters, (m, 8, 2 n).
        """
        n = len(self.points)
        powers = np.exp(views.dot(_EXPONENTS))
        seen = powers.view(np.float64)[:, :8].dot(self._turns)
        turned = seen[:, : 6 * n].view(np.complex128).reshape(-1, 3, n)
        qz, across = seen[:, 6 * n : 7 * n], seen[:, 7 * n :].reshape(-1, 2, n)
        near = powers[:, 5:].real
        free = near < self.most_nearness
        near = np.minimum(near, self.most_nearness)
        larger = 1.0 / np.maximum(1.0 + near * qz, _NEAREST)
        turned = turned * (powers[:, 4:5] * larger)[:, None]
        origin = views[:, X : Y + 1].view(np.complex128) - self._middle
        image = turned[:, 0] + origin * larger
        nearer = image * (near * larger)
        slopes = np.empty((len(views), COUNT, n), np.complex128)
        slopes[:, X] = larger
        np.multiply(larger, 1j, out=slopes[:, Y])
        np.multiply(turned[:, 0], 1j, out=slopes[:, ROLL])
        np.multiply(nearer, qz * free, out=slopes[:, FOCAL])
        np.subtract(turned[:, 0], slopes[:, FOCAL], out=slopes[:, SCALE])
        np.add(turned[:, 1:], nearer[:, None] * across, out=slopes[:, PITCH : YAW + 1])
        slopes[:, BARREL] = 0.0
        if self.lens.focal is None:
            image = self._bend(image, slopes, views[:, BARREL:])
        if self.offsets is not None:
            beside = self.offsets * powers[:, 4:5]
            image = image + beside
            slopes[:, ROLL] += 1j * beside
            slopes[:, SCALE] += beside
        image += self._middle
        return image.view(np.float64), slopes.view(np.float64)

    def _bend(self, image: Complex, slopes: Complex, barrel: Array) -> Complex:
        """Points (m, n) seen through a lens that is not calibrated; changes their slopes too."""
        squared = (image * image.conj()).real / self.lens.half_diagonal**2
        bent = 1.0 + barrel * squared
        outward = 2.0 / self.lens.half_diagonal**2 * (image.conj()[:, None] * slopes).real
        slopes *= bent[:, None]
        slopes += (barrel * image)[:, None] * outward
        slopes[:, BARREL] = image * squared
        return np.asarray(image * bent)

    @cached_property
    def _middle(self) -> complex:
        return complex(*self.centre.tolist())

    @cached_property
    def _turns(self) -> Array:
        """(8, 9 n): what makes the turned points of cosines and sines of yaw and pitch.

        The rows are cosine and sine of yaw + pitch, yaw - pitch, yaw, and pitch. The columns are
        qx + i qy of the turned points q, its derivatives by pitch and by yaw (each complex), qz,
        and the derivatives of qz, negative.
        """
        (px, py, pz), n = self.points.T, len(self.points)
        cos_sum, sin_sum, cos_less, sin_less, ca, sa, cb, sb = np.eye(8)[..., None]
        ca_cb, sa_sb = 0.5 * (cos_less + cos_sum), 0.5 * (cos_less - cos_sum)
        sa_cb, ca_sb = 0.5 * (sin_sum + sin_less), 0.5 * (sin_sum - sin_less)
        qx, ahead = ca * px + sa * pz, ca * pz - sa * px
        qy = cb * py - ca_sb * pz + sa_sb * px
        qz = sb * py + ca_cb * pz - sa_cb * px
        sb_qx, cb_qx = ca_sb * px + sa_sb * pz, ca_cb * px + sa_cb * pz
        pairs = (qx, qy), (0.0 * qz, -qz), (ahead, sb_qx)
        complexes = [np.stack(pair, axis=-1).reshape(8, 2 * n) for pair in pairs]
        return np.hstack((*complexes, qz, -qy, cb_qx))


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
