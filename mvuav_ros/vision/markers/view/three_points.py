"""Views of a rig from three of its markers: two for each way of naming three lights.

Three points seen with scaled orthography have two poses in closed form, one the mirror image of
the other in depth (T. D. Alter, "3-D Pose from 3 Points Using Weak-Perspective", IEEE PAMI 16,
1994). From both, Newton's method leads to poses seen in perspective (the equations of J. A.
Grunert, 1841: the three points lie on three rays, at known distances from each other).
"""

from __future__ import annotations

import math

import numpy as np

from mvuav_ros.vision.markers.view.weak_perspective import (
    COUNT,
    FOCAL,
    PITCH,
    ROLL,
    SCALE,
    YAW,
    Array,
    Complex,
    WeakPerspective,
    X,
    Y,
)

_PAIRS = ((0, 1), (0, 2), (1, 2))
_ITERATIONS = 6
_LONGEST_STEP = 0.3
"""Of a depth, by its own length."""
_NEAREST = 0.3  # Least distance of a marker over that of the first one, to begin with


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
    u, v = seen[1:] * np.maximum(1.0 + edges[:, 2:] * size, _NEAREST) - seen[0]
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
    away = np.maximum(1.0 + np.concatenate((away, -away), axis=1), _NEAREST)
    return np.asarray(away / np.tile(np.sqrt(squared), 2))


def _perspective_depths(points: Array, seen: Complex, depths: Array) -> Array:
    """Depths (3, n) at which points (3, 3) seen (3, n) have their distances, by Newton's method."""
    squares = [float(((points[i] - points[j]) ** 2).sum()) for i, j in _PAIRS]
    length = 1.0 + np.abs(seen) ** 2
    cosines = [1.0 + (seen[i] * seen[j].conj()).real for i, j in _PAIRS]
    for _ in range(_ITERATIONS):
        # The derivatives are a, b, 0; c, 0, d; 0, e, f, all times two.
        (a, b, p), (c, d, q), (e, f, r) = (
            (
                length[i] * depths[i] - cosine * depths[j],
                length[j] * depths[j] - cosine * depths[i],
                0.5 * (square + 2.0 * cosine * depths[i] * depths[j])
                - 0.5 * (length[i] * depths[i] ** 2 + length[j] * depths[j] ** 2),
            )
            for (i, j), cosine, square in zip(_PAIRS, cosines, squares, strict=True)
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
        most = _LONGEST_STEP * depths
        depths = depths + np.minimum(np.maximum(step / determinant, -most), most)
    return depths
