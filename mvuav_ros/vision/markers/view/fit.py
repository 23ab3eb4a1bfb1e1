"""Views fitted to named lights: Gauss-Newton steps from a prior, many at once."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.markers.view.weak_perspective import (
    COUNT,
    FOCAL,
    PITCH,
    ROLL,
    SCALE,
    YAW,
    Array,
    Complex,
    ViewState,
    WeakPerspective,
)

_LEAST = np.array((-np.inf, -5.0, -1e5, -1e5, -1.4, -1.4, 0.0, -0.6))
_MOST = np.array((np.inf, 12.0, 1e5, 1e5, 1.4, 1.4, 20.0, 0.3))
"""What parameters can become when nothing has been seen for long."""
_SHARED: Array = np.zeros(COUNT)
_SHARED[[ROLL, SCALE, PITCH, YAW, FOCAL]] = 1.0
SETTLED = 5e-3
"""rad, and logarithms: after a step this small the next one would be a thousandth of it."""
_LONGEST_STEP = 0.5  # rad, and logarithms
_SINGULAR = 1e-16  # Determinant of what other markers tell of a place over what all tell, at least


class NamedPlaces(NamedTuple):
    """Where some markers are seen, in m ways of naming lights."""

    markers: NDArray[np.intp]  # (m, k)
    places: Array  # (m, k, 2), px, without distortion
    deviation: float  # of a place from what the rig says (1 sigma, px per axis)


@dataclass(frozen=True, eq=False)
class Fits:
    """Views fitted to several ways of naming markers."""

    parameters: Array  # (m, 8), see `WeakPerspective.project`
    covariance: Array  # (m, 8, 8)
    cost: Array  # (m,), squared residuals and squared distance from the prior, over their variances
    misfit: Array  # (m,), px, root mean square of the markers' distances
    # (m, k), for each marker how far it lies from where all others put it: squared distance over
    # variance.
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

    The prior is a view (1, 8) and its covariance (1, 8, 8); the steps begin at the starts (m, 8),
    or at the prior.
    """
    m, k = seen.markers.shape
    mean, weight = prior[0], inverse(prior[1])[0]
    parameters = np.repeat(mean, m, axis=0) if starts is None else starts
    columns = columns_of(seen.markers)
    places = seen.places.reshape(len(seen.places), 2 * k)
    precision = 1.0 / seen.deviation**2
    for _ in range(iterations):
        residual, slopes = _residual(shape, parameters, places, columns)
        weighted = precision * slopes
        covariance = inverse(weighted @ slopes.transpose(0, 2, 1) + weight)
        towards = (weighted @ residual[..., None])[..., 0] + (mean - parameters).dot(weight)
        step, largest = limited((covariance @ towards[..., None])[..., 0])
        parameters = possible(parameters + step)
        if largest < SETTLED:
            residual = residual - (step[:, None] @ slopes)[:, 0]
            break
    else:
        residual, slopes = _residual(shape, parameters, places, columns)
    away = parameters - mean
    squares = (residual * residual).sum(axis=1)
    cost = precision * squares + (away.dot(weight) * away).sum(axis=1)
    jacobian = slopes.reshape(m, COUNT, k, 2).transpose(0, 2, 3, 1)
    share = precision * (jacobian @ covariance[:, None] @ jacobian.transpose(0, 1, 3, 2))
    deviator = -0.5 * (share[..., 0, 0] - share[..., 1, 1]) - 1j * share[..., 0, 1]
    left = 1.0 - 0.5 * (share[..., 0, 0] + share[..., 1, 1]), deviator
    surprise = surprise_of(residual, left, seen.deviation**2, seen.deviation**2)
    return Fits(parameters, covariance, cost, np.sqrt(squares / max(k, 1)), surprise)


def columns_of(markers: NDArray[np.intp]) -> NDArray[np.intp]:
    """Where x and y of some markers (..., k) are among those of all, (..., 2 k)."""
    pairs = 2 * markers[..., None] + (0, 1)
    return np.asarray(pairs.reshape(*markers.shape[:-1], 2 * markers.shape[-1]))


def limited(step: Array) -> tuple[Array, float]:
    """Gauss-Newton steps (m, 8) no longer than they may be, and how long the longest was."""
    longest = np.abs(step * _SHARED)
    largest = float(longest.max())
    if largest > _LONGEST_STEP:
        longest = longest.max(axis=1)
        step = step * np.minimum(1.0, _LONGEST_STEP / np.maximum(longest, 1e-9))[:, None]
    return step, largest


def possible(parameters: Array) -> Array:
    """Parameters (m, 8) within what they can become."""
    return np.asarray(np.minimum(np.maximum(parameters, _LEAST), _MOST))


def inverse(matrices: Array) -> Array:
    """Inverses of positive matrices (m, n, n) whose rows are of very different sizes."""
    size = 1.0 / np.sqrt(np.maximum(np.diagonal(matrices, axis1=1, axis2=2), 1e-300))
    sizes = size[:, :, None] * size[:, None, :]
    try:
        inverses = np.linalg.inv(matrices * sizes) * sizes
    except np.linalg.LinAlgError:
        inverses = np.linalg.pinv(matrices * sizes, hermitian=True) * sizes
    return np.asarray(0.5 * (inverses + inverses.transpose(0, 2, 1)))


def _residual(
    shape: WeakPerspective, parameters: Array, places: Array, columns: NDArray[np.intp]
) -> tuple[Array, Array]:
    expected, slopes = shape.linearize_all(parameters)
    if len(columns) == 1:
        return places - expected[:, columns[0]], slopes[:, :, columns[0]]
    expected = np.take_along_axis(expected, columns, axis=1)
    return places - expected, np.take_along_axis(slopes, columns[:, None], axis=2)


def surprise_of(
    residual: Array, left: tuple[Array, Complex], variance: Array | float, own: float
) -> Array:
    """How far markers lie from where all the others put them: squared distance over variance.

    A marker's place by the others follows from that by all: its residual r and the place's
    covariance h become m⁻¹ r and (m⁻¹ - I) v, with v the variance at which it took part and
    m = I - h / v. A symmetric matrix is given by half its trace t and d = (xx - yy) / 2 + i xy:
    with points as complex numbers, it takes z to t z + d z*.

    Args:
        residual: (m, 2 k), px.
        left: m, (m, k) each.
        variance: v, (m, k) or one for all, px².
        own: of a marker's place, px².
    """
    trace, deviator = left
    size = deviator.real * deviator.real + deviator.imag * deviator.imag
    determinant = np.maximum(trace * trace - size, _SINGULAR)
    points = np.ascontiguousarray(residual).view(np.complex128)
    apart = trace * points - deviator * points.conj()
    spread = variance * trace + (own - variance) * determinant
    inside = spread * apart + (variance * deviator) * apart.conj()
    square = apart.real * inside.real + apart.imag * inside.imag
    return np.asarray(square / (determinant * (spread * spread - (variance * variance) * size)))
