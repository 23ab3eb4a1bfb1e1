"""How a rig's markers look to a camera: the view's parameters, fits, and three lights' views."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.markers.lights import Lens
from mvuav_ros.vision.rig import MarkerRig

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

ROLL, SCALE, X, Y, PITCH, YAW, FOCAL, BARREL = range(8)
"""Places in a view's parameters."""
COUNT = 8
KNOWN_FOCAL = 0.01  # Part by which a calibrated focal length may be wrong (1 sigma)
_TURNS: Complex = np.zeros((COUNT, 3), np.complex128)
"""Of a view: log of the scale plus i times the roll, less i times the yaw, i times the pitch."""
_TURNS[[SCALE, ROLL], 0], _TURNS[YAW, 1], _TURNS[PITCH, 2] = (1.0, 1j), -1j, 1j
_NEAREST = 0.05  # Least distance of a marker over the rig's: else it would be behind the camera
_MIN_AREA = 1e-3  # Twice that of three markers that are not on one line, in squared units
_EDGE_ON = 1e-6  # Of an area that is seen edge-on: what it counts beside others


class _Seen(NamedTuple):
    """Markers in m views: their image points are N / D, complex numbers from the image's centre.

    N is the turned point, px, plus the origin's place, and D its depth over the origin's.
    """

    turn: Complex  # (m, 1), of scale and roll
    pitch: Complex  # (m, 1)
    across: Array  # (m, n), and so on, of the points:
    ahead: Array
    down: Array
    depth: Array
    turned: Complex  # (m, n), px
    near: Array  # (m, 1), units per distance
    larger: Array  # (m, n), 1 / D
    image: Complex  # (m, n), px


@dataclass(frozen=True, eq=False)
class WeakPerspective:
    """A rig seen from behind: its markers' middle is the origin, and the farthest one is at 1."""

    points: Array  # (n, 3), x right, y down, z ahead
    lens: Lens
    # (n,), by how much the markers of a body that is not what its rig says are seen beside it:
    # x + iy in units of the scale, turned with the roll.
    offsets: Complex | None = None
    upright: float = 0.0  # rad, the roll of a level body before the camera as it is mounted
    _triangles: dict[int, list[tuple[int, int, int]]] = field(default_factory=dict, init=False)

    @classmethod
    def of(cls, rig: MarkerRig, lens: Lens, upright: float = 0.0) -> WeakPerspective:
        """The shape of a rig whose x axis points away from the camera."""
        x, y, z = rig.positions.T
        points = np.column_stack((-y, -z, x))
        points = points - points.mean(axis=0)
        size = float(np.hypot(np.hypot(*points.T[:2]), points.T[2]).max()) or 1.0
        return cls(points / size, lens, upright=upright)

    def with_offsets(self, view: ViewState, measured: Array) -> WeakPerspective:
        """The shape that shows the markers where they are (n, 2), px, in a view."""
        beside = measured - replace(self, offsets=None).project(view.parameters)
        turn = np.exp(complex(*view.parameters[[SCALE, ROLL]]))
        return replace(self, offsets=(beside[:, 0] + 1j * beside[:, 1]) / turn)

    def triangles(self, hidden: int) -> list[tuple[int, int, int]]:
        """Threes of markers, not on one line, of which some are left whichever so many are hidden.

        The largest as seen from behind of those that are left most often; of a body whose lights
        all lie in a plane that is seen edge-on from there, the largest.
        """
        if hidden in self._triangles:
            return self._triangles[hidden]
        flat = self.points[:, 0] + 1j * self.points[:, 1]
        threes = np.array([*combinations(range(len(flat)), 3)], np.intp).reshape(-1, 3)
        a, b, c = flat[threes].T
        areas = np.abs(((b - a).conjugate() * (c - a)).imag)
        first, second, third = self.points[threes.T]
        true = np.linalg.norm(np.cross(second - first, third - first), axis=1)
        areas = np.maximum(areas, _EDGE_ON * true)[true >= _MIN_AREA]
        threes = threes[true >= _MIN_AREA]
        outs = [{*out} for out in combinations(range(len(flat)), hidden)]
        shows = np.array([[out.isdisjoint(three) for out in outs] for three in threes.tolist()])
        # How often each way of hiding so many is still to be shown.
        left = np.full(len(outs), 2 if hidden else 1)
        chosen: list[tuple[int, int, int]] = []
        while len(threes) and left.any():
            shown = np.count_nonzero(shows & (left > 0), axis=1)
            most = np.flatnonzero(shown == shown.max())
            best = int(most[areas[most].argmax()])
            if not shown[best]:
                break
            first, second, third = threes[best].tolist()
            chosen.append((first, second, third))
            left -= shows[best] & (left > 0)
            shows[best] = False
        return self._triangles.setdefault(hidden, chosen)

    @cached_property
    def _max_nearness(self) -> float:
        """Logarithm of units per distance: with more, markers would be behind the camera."""
        return math.log(0.85 / max(0.35, -float(self.points[:, 2].min(initial=0.0))))

    def project(self, parameters: Array) -> Array:
        """Where the markers are seen, (..., n, 2) px.

        The parameters (..., 8) are roll (rad), log of the scale (px per unit), x and y of the
        origin (px), pitch and yaw away from straight behind (rad), log of the focal length (px:
        the less, the nearer the rig), and barrel (share by which the lens moves a point at half
        the image's diagonal; 0 where it is calibrated).
        """
        views = np.ascontiguousarray(parameters).reshape(-1, COUNT)
        seen = self._seen(views)
        image = seen.image
        if self.lens.focal is None:
            image = image + views[:, BARREL:] * self._cubic(image)
        if self.offsets is not None:
            image = image + self.offsets * seen.turn
        image = image + self.middle
        return image.view(np.float64).reshape(*parameters.shape[:-1], len(self.points), 2)

    def linearize(self, views: Array) -> tuple[Array, Array]:
        """Places of the markers (m, 2 n) in views (m, 8), and their slopes (m, 8, 2 n).

        By a parameter p a place N / D changes by (dN/dp - N / D dD/dp) / D; see `_Seen`.
        """
        seen = self._seen(views)
        turn, pitch, across, ahead, down, depth, turned, near, larger, image = seen
        moved = image * near
        is_free = views[:, SCALE, None] - views[:, FOCAL, None] <= self._max_nearness
        deeper = moved * (depth * is_free)
        slopes = np.zeros((len(views), COUNT, len(self.points)), np.complex128)
        slopes[:, ROLL] = 1j * turned
        slopes[:, SCALE] = turned - deeper
        slopes[:, X], slopes[:, Y] = 1.0, 1j
        slopes[:, PITCH] = -1j * turn * depth - moved * down
        slopes[:, YAW] = turn * (ahead + pitch.imag * 1j * across) + moved * (pitch.real * across)
        slopes[:, FOCAL] = deeper
        slopes *= larger[:, None]
        if self.lens.focal is None:
            image, slopes = self._bend(image, slopes, views[:, BARREL:])
        if self.offsets is not None:
            beside = self.offsets * turn
            image = image + beside
            slopes[:, ROLL] += 1j * beside
            slopes[:, SCALE] += beside
        image = image + self.middle
        return image.view(np.float64), slopes.view(np.float64)

    def _seen(self, views: Array) -> _Seen:
        """The markers in views (m, 8) before what the lens and offsets make of them."""
        px, py, pz = self.points.T
        turn, yaw, pitch = np.exp(views.dot(_TURNS)).T[..., None]
        flat = (px + 1j * pz) * yaw
        across, ahead = flat.real, flat.imag
        upright = (py + 1j * ahead) * pitch
        down, depth = upright.real, upright.imag
        turned = turn * (across + 1j * down)
        # The origin comes no nearer, whatever scale and focal length say.
        nearness = views[:, SCALE, None] - views[:, FOCAL, None]
        near = np.exp(np.minimum(nearness, self._max_nearness))
        larger = 1.0 / np.maximum(1.0 + near * depth, _NEAREST)
        origin = views[:, X : Y + 1].view(np.complex128) - self.middle
        image = (turned + origin) * larger
        return _Seen(turn, pitch, across, ahead, down, depth, turned, near, larger, image)

    def _bend(self, image: Complex, slopes: Complex, barrel: Array) -> tuple[Complex, Complex]:
        """Points (m, n) seen through a lens that is not calibrated, and their slopes (m, 8, n)."""
        # With k the barrel over half the diagonal squared, z becomes z (1 + k |z|²), and dz becomes
        # (1 + 2 k |z|²) dz + k z² dz*.
        cubic = self._cubic(image)
        bent = (barrel / self.lens.half_diagonal**2) * image
        slopes = (1.0 + 2.0 * (bent * image.conj()).real)[:, None] * slopes + (
            (bent * image)[:, None] * slopes.conj()
        )
        slopes[:, BARREL] = cubic
        return image + barrel * cubic, slopes

    def _cubic(self, image: Complex) -> Complex:
        """How far a barrel of 1 moves points from the image's centre."""
        return image * (image.real**2 + image.imag**2) / self.lens.half_diagonal**2

    @cached_property
    def middle(self) -> complex:
        """The lens's principal point, x + iy, px."""
        return complex(*self.lens.centre.tolist())


@dataclass(frozen=True, eq=False)
class ViewState:
    """An estimate of how a shape is seen."""

    parameters: Array  # (8,), see `WeakPerspective.project`
    covariance: Array  # (8, 8)
    rms_residual: float = 0.0  # px, of the markers it was fitted to

    @property
    def scale(self) -> float:
        """Pixels per unit of the shape."""
        return math.exp(float(self.parameters[SCALE]))


def deviations_of(slopes: Array, covariance: Array) -> Array:
    """How uncertain places with slopes (8, 2 n) are (1 sigma, px), (n,): the ellipses' axes."""
    spread = covariance @ slopes
    xx, yy = (slopes * spread).sum(axis=0).reshape(-1, 2).T
    xy = (slopes[:, ::2] * spread[:, 1::2]).sum(axis=0)
    larger = 0.5 * (xx + yy) + np.hypot(0.5 * (xx - yy), xy)
    return np.asarray(np.sqrt(np.maximum(larger, 0.0)))


_MIN = np.array((-np.inf, -5.0, -1e5, -1e5, -1.4, -1.4, 0.0, -0.6))
_MAX = np.array((np.inf, 12.0, 1e5, 1e5, 1.4, 1.4, 20.0, 0.3))
"""What parameters can become when nothing has been seen for long."""
SHARED: Array = np.zeros(COUNT)
SHARED[[ROLL, SCALE, PITCH, YAW, FOCAL]] = 1.0
SETTLED = 5e-3
"""rad, and logarithms: after a step this small the next one would be a thousandth of it."""
_MAX_STEP = 0.5  # rad, and logarithms


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


_FIRST, _SECOND = [0, 0, 1], [1, 2, 2]  # Of three markers, in pairs
_DEPTH_ITERATIONS = 6
_AT_ONCE = 2048  # Threes, whose arrays a processor's cache holds
_FLAT = 0.3  # Of a rig's size: depths of three seen from nearly straight above differ by less
_MAX_DEPTH_STEP = 0.3  # Of a depth, by its own length
_MIN_DEPTH = 0.3  # Least distance of a marker over that of the first one, to begin with


def views_of_three(
    shape: WeakPerspective,
    markers: NDArray[np.intp],
    places: Complex,
    focal: float,
    may_be: Callable[[Array], NDArray[np.bool_]],
) -> Array:
    """Views (v, 8) in which three markers are seen at given places, up to three for each three.

    The markers (t, 3) of a three do not lie on one line; their places (t, 3) are x + iy, px, for a
    focal length, px. Of the views that are about right only those that may be are worked out. Where
    there is none, a view does not show the markers there.
    """
    if len(markers) > _AT_ONCE:
        parts = [slice(i, i + _AT_ONCE) for i in range(0, len(markers), _AT_ONCE)]
        views = [views_of_three(shape, markers[p], places[p], focal, may_be) for p in parts]
        return np.concatenate(views)
    # Markers, axes, rows: the rows last, along which all is computed.
    points = np.ascontiguousarray(shape.points[markers].transpose(1, 2, 0))
    seen = (places - shape.middle).T / focal
    depths, rows = _orthographic_depths(points, seen)
    points, seen = points[..., rows], seen[:, rows]
    kept = may_be(_views_at(shape, points, seen, depths, focal))
    if not kept.any():
        return np.empty((0, COUNT))
    points, seen, depths = points[..., kept], seen[:, kept], depths[:, kept]
    return _views_at(shape, points, seen, _perspective_depths(points, seen, depths), focal)


def _views_at(
    shape: WeakPerspective, points: Array, seen: Complex, depths: Array, focal: float
) -> Array:
    """Views (v, 8) in which points (3, 3, v) seen (3, v), in focal lengths, have these depths."""
    placed = np.array((seen.real * depths, seen.imag * depths, depths))
    # The rotation takes two edges and their normal to where they are seen: with the reciprocal
    # vectors of the former.
    (a, b), (u, v) = points[1:] - points[0], (placed[:, 1:] - placed[:, :1]).transpose(1, 0, 2)
    normal = _cross(a, b)
    size = (normal * normal).sum(axis=0)
    rotation = u[:, None] * _cross(b, normal) + v[:, None] * _cross(normal, a)
    rotation = (rotation + _cross(u, v)[:, None] * normal) / size
    x, y, distance = placed[:, 0] - (rotation * points[0]).sum(axis=1)
    distance = np.maximum(distance, 1e-3)
    views = np.zeros((seen.shape[1], COUNT))
    views[:, ROLL] = np.arctan2(-rotation[0, 1], rotation[1, 1])
    views[:, PITCH] = np.arcsin(np.clip(rotation[2, 1], -1.0, 1.0))
    views[:, YAW] = np.arctan2(-rotation[2, 0], rotation[2, 2])
    views[:, SCALE] = np.log(focal / distance)
    views[:, X] = focal * x / distance + shape.middle.real
    views[:, Y] = focal * y / distance + shape.middle.imag
    views[:, FOCAL] = math.log(focal)
    return views


def _cross(a: Array, b: Array) -> Array:
    """Products of vectors (3, n)."""
    return np.array(
        (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])
    )


def _orthographic_depths(points: Array, seen: Complex) -> tuple[Array, NDArray[np.intp]]:
    """Depths (3, v) of points (3, 3, t) seen (3, t) about from behind, and whose they are, (v,).

    Alter's solution (1994) and its mirror image; and what lies between where three are seen from
    nearly straight above, as perspective has more than two solutions there.
    """
    edges = points[1:] - points[0]
    first, second = (edges * edges).sum(axis=1)
    between = (edges[0] * edges[1]).sum(axis=0)
    flat = np.hypot(edges[:, 0], edges[:, 1]).sum(axis=0)
    size = np.abs(seen[1:] - seen[0]).sum(axis=0) / flat
    u, v = seen[1:] * np.maximum(1.0 + edges[:, 2] * size, _MIN_DEPTH) - seen[0]
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
    every, flat = np.arange(len(squared)), np.flatnonzero(np.abs(away).max(axis=0) < _FLAT)
    rows = np.concatenate((every, every, flat))
    away = np.concatenate((away, -away, np.zeros((3, len(flat)))), axis=1)
    return np.maximum(1.0 + away, _MIN_DEPTH) / np.sqrt(squared)[rows], rows


def _perspective_depths(points: Array, seen: Complex, depths: Array) -> Array:
    """Depths (3, n) of points (3, 3, n) seen (3, n) by their distances, with Newton's method."""
    squares = ((points[_FIRST] - points[_SECOND]) ** 2).sum(axis=1)
    length = 1.0 + np.abs(seen) ** 2
    first, second = length[_FIRST], length[_SECOND]
    cosines = 1.0 + (seen[_FIRST] * seen[_SECOND].conj()).real
    for _ in range(_DEPTH_ITERATIONS):
        here, there = depths[_FIRST], depths[_SECOND]
        # The derivatives are a, b, 0; c, 0, d; 0, e, f, all times two.
        a, c, e = first * here - cosines * there
        b, d, f = second * there - cosines * here
        p, q, r = 0.5 * (squares + 2.0 * cosines * here * there) - 0.5 * (
            first * here**2 + second * there**2
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
