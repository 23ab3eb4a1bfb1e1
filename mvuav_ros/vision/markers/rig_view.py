"""How a rig's markers look to a camera: the view's parameters, fits, and three lights' views."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.markers.lights import Lens
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
_MIN_AREA = 1e-3
"""Twice that of a triangle in which three markers are not on one line, in squared units."""
_ANGLES: Array = np.zeros((COUNT, 4))
"""Of a view: yaw + pitch, yaw - pitch, yaw, and pitch."""
_ANGLES[YAW, :3] = _ANGLES[PITCH, [0, 3]] = 1.0
_ANGLES[PITCH, 1] = -1.0
_EXPONENTS: Complex = np.zeros((COUNT, 13), np.complex128)
"""Of a view: log of the scale plus i times the roll, plus and minus i times each of those angles;
zero; log of the scale less that of the focal length plus i times each of the angles."""
_EXPONENTS[:, :4], _EXPONENTS[:, 4:8], _EXPONENTS[:, 9:] = 1j * _ANGLES, -1j * _ANGLES, 1j * _ANGLES
_EXPONENTS[SCALE] = (*[1.0] * 8, 0.0, *[1.0] * 4)
_EXPONENTS[ROLL, :8] = 1j
_EXPONENTS[FOCAL, 9:] = -1.0
_NEARNESS: Array = np.zeros(COUNT)
"""Of a view: logarithm of units per distance."""
_NEARNESS[SCALE], _NEARNESS[FOCAL] = 1.0, -1.0


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
        return None if largest is None or area(largest) < _MIN_AREA else largest

    @cached_property
    def _max_nearness(self) -> float:
        """Logarithm of units per distance: with more, markers would be behind the camera."""
        return math.log(0.85 / max(0.35, -float(self.points[:, 2].min())))

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

        Image points are complex numbers, x + iy from the image's centre: N / D, where N is the
        turned point in px plus the origin's place, and D its depth over the origin's. By a
        parameter p, that changes by (dN/dp - N / D dD/dp) / D.

        Args:
            views: (m, 8), contiguous.

        Returns:
            Places (m, 2 n), x and y of each marker in turn, and by how much they move with the
            parameters, (m, 8, 2 n).
        """
        m, n = len(views), len(self.points)
        turned, deeper = self._turns
        powers = np.exp(views.dot(_EXPONENTS))
        slopes = powers[:, :9].dot(turned).reshape(m, COUNT, n)
        depths = powers[:, 9:].view(np.float64).dot(deeper).reshape(m, COUNT, n)
        nearness = views.dot(_NEARNESS)
        if is_clipped := nearness.max() > self._max_nearness:
            # The origin comes no nearer, whatever scale and focal length say.
            excess = np.maximum(nearness - self._max_nearness, 0.0)
            depths *= np.exp(-excess)[:, None, None]
        larger = 1.0 / np.maximum(1.0 + depths[:, SCALE], _NEAREST)
        if is_clipped:
            depths[excess > 0.0, SCALE] = depths[excess > 0.0, FOCAL] = 0.0
        origin = views[:, X : Y + 1].view(np.complex128) - self._middle
        image = (slopes[:, SCALE] + origin) * larger
        slopes -= image[:, None] * depths
        slopes *= larger[:, None]
        if self.lens.focal is None:
            image, slopes = self._bend(image, slopes, views[:, BARREL:])
        if self.offsets is not None:
            beside = self.offsets * np.exp(views[:, SCALE] + 1j * views[:, ROLL])[:, None]
            image = image + beside
            slopes[:, ROLL] += 1j * beside
            slopes[:, SCALE] += beside
        image += self._middle
        return image.view(np.float64), slopes.view(np.float64)

    def _bend(self, image: Complex, slopes: Complex, barrel: Array) -> tuple[Complex, Complex]:
        """Points (m, n) seen through a lens that is not calibrated, and their slopes (m, 8, n).

        With k the barrel over half the diagonal squared, z becomes z (1 + k |z|²), and dz becomes
        (1 + 2 k |z|²) dz + k z² dz*.
        """
        share = 1.0 / self.lens.half_diagonal**2
        cubic = image * (image.real**2 + image.imag**2) * share
        bent = (barrel * share) * image
        slopes = (1.0 + 2.0 * (bent * image.conj()).real)[:, None] * slopes + (
            (bent * image)[:, None] * slopes.conj()
        )
        slopes[:, BARREL] = cubic
        return image + barrel * cubic, slopes

    @cached_property
    def _middle(self) -> complex:
        return complex(*self.centre.tolist())

    @cached_property
    def _turns(self) -> tuple[Complex, Array]:
        """(9, 8 n) and (8, 8 n): what makes derivatives of the turned points of `_EXPONENTS`.

        The derivatives are those by the parameters, of N and of D in `linearize_all`; those by the
        logarithm of the scale are the turned points and their depths themselves.
        """
        (px, py, pz), n = self.points.T, len(self.points)
        # By cosine and sine of each of the angles.
        cos_sum, sin_sum, cos_less, sin_less, ca, sa, cb, sb = np.eye(8)[..., None]
        ca_cb, sa_sb = 0.5 * (cos_less + cos_sum), 0.5 * (cos_less - cos_sum)
        sa_cb, ca_sb = 0.5 * (sin_sum + sin_less), 0.5 * (sin_sum - sin_less)
        qx, ahead = ca * px + sa * pz, ca * pz - sa * px
        qy = cb * py - ca_sb * pz + sa_sb * px
        qz = sb * py + ca_cb * pz - sa_cb * px
        sb_qx, cb_qx = ca_sb * px + sa_sb * pz, ca_cb * px + sa_cb * pz
        by = np.zeros((COUNT, 8, n), np.complex128)
        by[ROLL], by[SCALE] = 1j * qx - qy, qx + 1j * qy
        by[PITCH], by[YAW] = -1j * qz, ahead + 1j * sb_qx
        by = by.transpose(1, 0, 2)
        turned = np.zeros((9, COUNT, n), np.complex128)
        turned[:4], turned[4:8] = 0.5 * (by[::2] - 1j * by[1::2]), 0.5 * (by[::2] + 1j * by[1::2])
        turned[8, X], turned[8, Y] = 1.0, 1j
        deeper = np.zeros((8, COUNT, n))
        deeper[:, SCALE], deeper[:, FOCAL] = qz, -qz
        deeper[:, PITCH], deeper[:, YAW] = qy, -cb_qx
        return turned.reshape(9, COUNT * n), deeper.reshape(8, COUNT * n)


@dataclass(frozen=True, eq=False)
class ViewState:
    """An estimate of how a shape is seen.

    Attributes:
        parameters: (8,), see `WeakPerspective.project`.
        covariance: (8, 8).
        misfit: root mean square of the residuals of the markers it was fitted to, px.
        cost: squared residuals and squared distance from the prior, both over their variances.
    """

    parameters: Array
    covariance: Array
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


def deviations_of(jacobian: Array, covariance: Array) -> Array:
    """How uncertain places are (1 sigma, px), (n,): the larger axis of each one's ellipse."""
    spread = jacobian @ covariance @ jacobian.swapaxes(-1, -2)
    mean = 0.5 * (spread[:, 0, 0] + spread[:, 1, 1])
    half = np.hypot(0.5 * (spread[:, 0, 0] - spread[:, 1, 1]), spread[:, 0, 1])
    return np.asarray(np.sqrt(np.maximum(mean + half, 0.0)))


_MIN = np.array((-np.inf, -5.0, -1e5, -1e5, -1.4, -1.4, 0.0, -0.6))
_MAX = np.array((np.inf, 12.0, 1e5, 1e5, 1.4, 1.4, 20.0, 0.3))
"""What parameters can become when nothing has been seen for long."""
SHARED: Array = np.zeros(COUNT)
SHARED[[ROLL, SCALE, PITCH, YAW, FOCAL]] = 1.0
SETTLED = 5e-3
"""rad, and logarithms: after a step this small the next one would be a thousandth of it."""
_MAX_STEP = 0.5  # rad, and logarithms


def columns_of(markers: NDArray[np.intp]) -> NDArray[np.intp]:
    """Where x and y of some markers (..., k) are among those of all, (..., 2 k)."""
    pairs = 2 * markers[..., None] + (0, 1)
    return np.asarray(pairs.reshape(*markers.shape[:-1], 2 * markers.shape[-1]))


def limited(step: Array) -> tuple[Array, float]:
    """Gauss-Newton steps (m, 8) no longer than they may be, and how long the longest was."""
    longest = np.abs(step * SHARED)
    largest = float(longest.max())
    if largest > _MAX_STEP:
        longest = longest.max(axis=1)
        step = step * np.minimum(1.0, _MAX_STEP / np.maximum(longest, 1e-9))[:, None]
    return step, largest


def possible(parameters: Array) -> Array:
    """Parameters (m, 8) within what they can become."""
    return np.asarray(np.minimum(np.maximum(parameters, _MIN), _MAX))


_THREE_PAIRS = ((0, 1), (0, 2), (1, 2))
_DEPTH_ITERATIONS = 6
_MAX_DEPTH_STEP = 0.3
"""Of a depth, by its own length."""
_MIN_DEPTH = 0.3  # Least distance of a marker over that of the first one, to begin with


def views_of_three(
    shape: WeakPerspective, triple: tuple[int, int, int], places: Complex, focal: float
) -> Array:
    """Views in which three markers are seen at given places.

    Args:
        shape: the rig.
        triple: three markers that do not lie on one line.
        places: (t, 3), x + iy, px.
        focal: length, px.

    Returns:
        (2 t, 8), see `WeakPerspective.project`: all of the first poses, then the others. Where
        there is none, a view that does not show the markers there.
    """
    points = shape.points[list(triple)]
    seen = (places - complex(*shape.centre)).T / focal
    depths = _orthographic_depths(points, seen)
    seen = np.concatenate((seen, seen), axis=1)
    depths = _perspective_depths(points, seen, depths)
    placed = np.array((seen.real * depths, seen.imag * depths, depths))
    # Columns: where the rotation takes two edges and their normal.
    edges, turned = points[1:] - points[0], placed[:, 1:] - placed[:, :1]
    before = np.vstack((edges, np.cross(*edges))).T
    normal = np.cross(turned[:, 0], turned[:, 1], axis=0)[:, None]
    rotation = np.einsum('iet,ek->ikt', np.hstack((turned, normal)), np.linalg.inv(before))
    x, y, distance = placed[:, 0] - np.einsum('ikt,k->it', rotation, points[0])
    distance = np.maximum(distance, 1e-3)
    views = np.zeros((seen.shape[1], COUNT))
    views[:, ROLL] = np.arctan2(-rotation[0, 1], rotation[1, 1])
    views[:, PITCH] = np.arcsin(np.clip(rotation[2, 1], -1.0, 1.0))
    views[:, YAW] = np.arctan2(-rotation[2, 0], rotation[2, 2])
    views[:, SCALE] = np.log(focal / distance)
    views[:, X] = focal * x / distance + shape.centre[0]
    views[:, Y] = focal * y / distance + shape.centre[1]
    views[:, FOCAL] = math.log(focal)
    return views


def _orthographic_depths(points: Array, seen: Complex) -> Array:
    """Depths (3, 2 t) of points (3, 3) seen (3, t) about from behind, by Alter's solution.

    The second half of them is the mirror image of the first half.
    """
    edges = points[1:] - points[0]
    first, second = (edges * edges).sum(axis=1)
    between = float(edges[0] @ edges[1])
    flat = np.abs(edges[:, 0] + 1j * edges[:, 1]).sum()
    size = np.abs(seen[1:] - seen[0]).sum(axis=0) / flat
    u, v = seen[1:] * np.maximum(1.0 + edges[:, 2:] * size, _MIN_DEPTH) - seen[0]
    u_squared, v_squared = np.abs(u) ** 2, np.abs(v) ** 2
    across = (u * v.conj()).real
    # Depths p, q and scale s: s^2 first = |u|^2 + p^2, s^2 second = |v|^2 + q^2 and
    # s^2 between = across + p q; so a s^4 - 2 b s^2 + c = 0.
    a = first * second - between**2
    b = 0.5 * (first * v_squared + second * u_squared) - between * across
    c = u_squared * v_squared - across**2
    squared = np.maximum((b + np.sqrt(np.maximum(b * b - a * c, 0.0))) / a, 1e-12)
    p = np.sqrt(np.maximum(squared * first - u_squared, 0.0))
    q = np.sqrt(np.maximum(squared * second - v_squared, 0.0))
    q = np.where(squared * between >= across, q, -q)
    away = np.array((0.0 * p, p, q))
    away = np.maximum(1.0 + np.concatenate((away, -away), axis=1), _MIN_DEPTH)
    return np.asarray(away / np.tile(np.sqrt(squared), 2))


def _perspective_depths(points: Array, seen: Complex, depths: Array) -> Array:
    """Depths (3, n) at which points (3, 3) seen (3, n) have their distances, by Newton's method."""
    squares = [float(((points[i] - points[j]) ** 2).sum()) for i, j in _THREE_PAIRS]
    length = 1.0 + np.abs(seen) ** 2
    cosines = [1.0 + (seen[i] * seen[j].conj()).real for i, j in _THREE_PAIRS]
    for _ in range(_DEPTH_ITERATIONS):
        # The derivatives are a, b, 0; c, 0, d; 0, e, f, all times two.
        (a, b, p), (c, d, q), (e, f, r) = (
            (
                length[i] * depths[i] - cosine * depths[j],
                length[j] * depths[j] - cosine * depths[i],
                0.5 * (square + 2.0 * cosine * depths[i] * depths[j])
                - 0.5 * (length[i] * depths[i] ** 2 + length[j] * depths[j] ** 2),
            )
            for (i, j), cosine, square in zip(_THREE_PAIRS, cosines, squares, strict=True)
        )
        determinant = -a * d * e - b * c * f
        determinant = np.where(np.abs(determinant) < 1e-9, 1e-9, determinant)
        step = np.array(
            (
                b * d * r - p * d * e - b * q * f,
                a * q * f - a * d * r - p * c * f,
                p * c * e - a * q * e - b * c * r,
            )
        )
        most = _MAX_DEPTH_STEP * depths
        depths = depths + np.minimum(np.maximum(step / determinant, -most), most)
    return depths
