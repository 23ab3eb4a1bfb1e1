"""Two markers whose lights have run together into one."""

from __future__ import annotations

import math

import numpy as np

from mvuav_ros.vision.markers.centroid import Detection
from mvuav_ros.vision.markers.view.weak_perspective import COUNT, Array, ViewState, WeakPerspective

PLACE_NOISE = 0.5
"""px (1 sigma): of a joined light's middle, and of a marker's place in its view."""
GATE = 16.0
"""Squared distance over variance at which the light is something else."""
SURE_SIDE = 2.0
"""Deviations that the two must lie apart, so that it is clear which is on which side."""


def offset_in(
    spot: Detection, areas: tuple[float, float], places: Array, spread: Array
) -> Array | None:
    """From the first to the second of two markers that make up one light.

    The light's place is the mean of theirs, weighted by their areas. What is wrong with the
    expected places is mostly wrong with both alike, and that the light's place takes out (a
    Kalman filter's update).

    Args:
        spot: the light.
        areas: of the markers, px.
        places: (2, 2), expected, px.
        spread: (4, 4), the places' covariance, px².

    Returns:
        (2,), px, or None where the light is not where it should be, or the sides are not sure.
    """
    share = areas[0] / (areas[0] + areas[1])
    middle = np.hstack((share * np.eye(2), (1.0 - share) * np.eye(2)))
    spread = spread + PLACE_NOISE**2 * np.eye(4)
    innovation = np.array((spot.x, spot.y)) - middle @ places.ravel()
    variance = middle @ spread @ middle.T + PLACE_NOISE**2 * np.eye(2)
    if innovation @ np.linalg.solve(variance, innovation) > GATE:
        return None
    gain = spread @ middle.T @ np.linalg.inv(variance)
    updated = (places.ravel() + gain @ innovation).reshape(2, 2)
    spread = spread - gain @ middle @ spread
    apart = np.hstack((-np.eye(2), np.eye(2)))
    offset = np.asarray(updated[1] - updated[0])
    widest = math.sqrt(max(float(np.linalg.eigvalsh(apart @ spread @ apart.T)[-1]), 0.0))
    return offset if math.hypot(*offset) > SURE_SIDE * widest else None


def offset_by_view(
    spot: Detection,
    areas: tuple[float, float],
    shape: WeakPerspective,
    view: ViewState,
    pair: tuple[int, int],
) -> Array | None:
    """The same of two markers of a rig, whose places a view tells."""
    places, jacobian = shape.linearize(view.parameters)
    slopes = jacobian[list(pair)].reshape(4, COUNT)
    return offset_in(spot, areas, places[list(pair)], slopes @ view.covariance @ slopes.T)


def touching(first: float, second: float) -> float:
    """The distance of two centres, px, up to which lights of such areas (px) may run together."""
    return math.sqrt(first / math.pi) + math.sqrt(second / math.pi) + 3.0
