"""Least squares of what all views share and of a pose in each; and which views differ.

Source: Triggs, McLauchlan, Hartley and Fitzgibbon, Bundle adjustment - a modern synthesis, 1999.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_MAX_STEPS = 30
_PARTS = (1.0, 0.3, 0.1, 0.03)  # of a step, which are tried
_SETTLED = 1e-9  # part of the squares: no step follows one that makes them less by no more


class Equations(NamedTuple):
    """What one view says, linearized."""

    residuals: Array  # (2n,), seen minus projected, px
    by_pose: Array  # (2n, 6), derivatives of what is projected
    by_shared: Array  # (2n, s), by the unknowns that all views share


def eliminate_poses(views: Iterable[Equations]) -> tuple[Array, Array, list[tuple[Array, Array]]]:
    """Solve each view for its pose: the unknowns of one meet those of no other.

    Returns:
        Normal equations of what is shared, (s, s) and (s,); and of each pose its step by itself
        (6,), and by that of what is shared (6, s).
    """
    information, gradient, poses = np.zeros(()), np.zeros(()), []
    for residuals, by_pose, by_shared in views:
        inverse = np.linalg.pinv(by_pose)
        rest = by_shared - by_pose @ (inverse @ by_shared)
        information = information + rest.T @ rest
        gradient = gradient + rest.T @ residuals
        poses.append((inverse @ residuals, inverse @ by_shared))
    return information, gradient, poses


def adjust(
    look: Callable[[int, Array, Array], Equations],
    shared: Array,
    poses: Sequence[Array],
    bound: float = math.inf,
    gauge: Callable[[Array], Array] | None = None,
) -> tuple[Array, list[Array], float]:
    """Gauss and Newton's steps, or a part of one, until the residuals fall no more.

    Args:
        look: gives the equations of a view by its number, what is shared, and the pose.
        shared: (s,), to begin with.
        poses: likewise, (6,) of each view.
        bound: px, from where on residuals count less and less (Cauchy's function).
        gauge: (s, g), orthonormal: directions at a place that change no view, and are held.

    Returns:
        What is shared, the poses, and the squares before the last step, px².
    """
    poses = list(poses)
    views = [look(number, shared, pose) for number, pose in enumerate(poses)]
    left = _squares(views, bound)
    for _ in range(_MAX_STEPS):
        before = left
        weighed = (_weighed(view, bound) for view in views)
        information, gradient, eliminated = eliminate_poses(weighed)
        if gauge is not None:
            held = gauge(shared)
            information = information + float(np.trace(information)) * held @ held.T
        step = np.linalg.lstsq(information, gradient, rcond=1e-14)[0]
        for part in _PARTS:
            moved = [
                pose + part * (own - along @ step)
                for pose, (own, along) in zip(poses, eliminated, strict=True)
            ]
            views = [look(number, shared + part * step, pose) for number, pose in enumerate(moved)]
            left = _squares(views, bound)
            if left < before:
                shared, poses = shared + part * step, moved
                break
        if not left < before * (1.0 - _SETTLED):
            break
    return shared, poses, before


def _each(view: Equations) -> Array:
    """(n,), the squares of the points' residuals, px²."""
    x, y = view.residuals.reshape(-1, 2).T
    return x * x + y * y


def _squares(views: Iterable[Equations], bound: float) -> float:
    each = np.concatenate([_each(view) for view in views])
    if math.isfinite(bound):
        each = np.log1p(each / bound**2) * bound**2
    total = float(each.sum())
    return total if math.isfinite(total) else math.inf


def _weighed(view: Equations, bound: float) -> Equations:
    weight = np.repeat(1.0 / np.sqrt(1.0 + _each(view) / bound**2), 2)[:, None]
    return Equations(weight[:, 0] * view.residuals, weight * view.by_pose, weight * view.by_shared)


def farthest_first(vectors: Array, first: int, most: int, apart: float = 0.0) -> list[int]:
    """Which of (n, k) vectors differ: after the first always the one farthest from all chosen.

    They are ``most`` at most, and ``apart`` at least from one another.
    """
    chosen = [first]
    distance = np.linalg.norm(vectors - vectors[first], axis=1)
    while len(chosen) < most and distance.max() >= apart:
        chosen.append(int(distance.argmax()))
        distance = np.minimum(distance, np.linalg.norm(vectors - vectors[chosen[-1]], axis=1))
    return chosen
