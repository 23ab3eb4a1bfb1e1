"""Views fitted to named lights: Gauss-Newton steps from a prior, many at once."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.markers.view import (
    COUNT,
    FOCAL,
    PITCH,
    ROLL,
    SCALE,
    YAW,
    Array,
    ViewState,
    WeakPerspective,
)

_POSSIBLE = (
    np.array((-np.inf, -5.0, -1e5, -1e5, -1.4, -1.4, 0.0, -0.6)),
    np.array((np.inf, 12.0, 1e5, 1e5, 1.4, 1.4, 20.0, 0.3)),
)
"""What parameters can become when nothing has been seen for long."""
_SHARED = [ROLL, SCALE, PITCH, YAW, FOCAL]
SETTLED = 5e-3
"""rad, and logarithms: after a step this small the next one would be a thousandth of it."""
LONGEST_STEP = 0.5
"""rad, and logarithms."""


class NamedPlaces(NamedTuple):
    """Where some markers are seen, in m ways of naming lights.

    Attributes:
        markers: (m, k).
        places: (m, k, 2), px, without distortion.
        deviation: (m, k) or what broadcasts to it: of a place from what the rig says (1 sigma, px
            per axis).
        noise: what a place's surprise is held against, where some are given larger deviations
            than they have; the deviation if None.
    """

    markers: NDArray[np.intp]
    places: Array
    deviation: Array
    noise: float | None = None


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
    seen: NamedPlaces,
    starts: Array | None = None,
    iterations: int = 6,
) -> Fits:
    """Views after looking at some of the markers.

    Args:
        shape: the rig.
        prior: parameters (m or 1, 8) and their covariance (m or 1, 8, 8) before.
        seen: the markers.
        starts: (m, 8), where to begin; the prior if None.
        iterations: at most.
    """
    m, k = seen.markers.shape
    mean = prior[0]
    weight = inverse(prior[1])
    parameters = np.repeat(mean, m // len(mean), axis=0) if starts is None else starts
    precision = 1.0 / np.broadcast_to(seen.deviation, (m, k))
    for _ in range(iterations):
        residual, jacobian = _residual(shape, parameters, seen)
        normal, towards = _normal_equations(residual, jacobian, precision)
        covariance = inverse(normal + weight)
        towards = towards + (weight @ (mean - parameters)[..., None])[..., 0]
        step = (covariance @ towards[..., None])[..., 0]
        longest = np.abs(step[:, _SHARED]).max(axis=1)
        if longest.max() > LONGEST_STEP:
            step *= np.minimum(1.0, LONGEST_STEP / np.maximum(longest, 1e-9))[:, None]
        parameters = np.clip(parameters + step, *_POSSIBLE)
        if longest.max() < SETTLED:
            residual = residual - (jacobian @ step[:, None, :, None])[..., 0]
            break
    else:
        residual, jacobian = _residual(shape, parameters, seen)
    away = parameters - mean
    weighted = ((residual * precision[..., None]) ** 2).sum(axis=(1, 2))
    cost = weighted + (away[:, None] @ weight @ away[..., None])[:, 0, 0]
    surprise = _surprise(residual, jacobian, covariance, 1.0 / precision, seen.noise)
    misfit = np.sqrt((residual * residual).sum(axis=(1, 2)) / max(k, 1))
    return Fits(parameters, covariance, cost, misfit, surprise)


def inverse(matrices: Array) -> Array:
    """Inverses of positive matrices (m, n, n) whose rows are of very different sizes."""
    size = 1.0 / np.sqrt(np.maximum(np.diagonal(matrices, axis1=1, axis2=2), 1e-300))
    sizes = size[:, :, None] * size[:, None, :]
    try:
        inverses = np.linalg.inv(matrices * sizes) * sizes
    except np.linalg.LinAlgError:
        inverses = np.linalg.pinv(matrices * sizes, hermitian=True) * sizes
    return np.asarray(0.5 * (inverses + inverses.transpose(0, 2, 1)))


def _residual(shape: WeakPerspective, parameters: Array, seen: NamedPlaces) -> tuple[Array, Array]:
    places, jacobian = shape.linearize(parameters)
    rows = np.arange(len(parameters))[:, None]
    return seen.places - places[rows, seen.markers], jacobian[rows, seen.markers]


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
    most = 0.99 * np.sqrt(a * d)
    b = np.clip(-share[..., 0, 1], -most, most)
    inverted = np.stack((d, -b, -b, a), axis=-1).reshape(*a.shape, 2, 2)
    inverted /= (a * d - b * b)[..., None, None]
    apart = (inverted @ residual[..., None])[..., 0]
    variance = inverted @ told
    own = deviation**2 if noise is None else np.full_like(deviation, noise * noise)
    a, d = variance[..., 0, 0] + own, variance[..., 1, 1] + own
    b = 0.5 * (variance[..., 0, 1] + variance[..., 1, 0])
    x, y = apart[..., 0], apart[..., 1]
    return np.asarray((d * x * x - 2 * b * x * y + a * y * y) / (a * d - b * b))
