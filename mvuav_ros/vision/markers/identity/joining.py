"""Two markers whose lights have run together into one."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from mvuav_ros.vision.markers.centroid import Detection
from mvuav_ros.vision.markers.identity.appearance import AppearanceModel
from mvuav_ros.vision.markers.identity.assignment import Expectation

PLACE_NOISE = 0.5  # px (1 sigma): of a joined light's middle, and of a marker's place in its view
GATE = 16.0  # Squared distance over variance at which the light is something else
SURE_SIDE = 2.0
"""Deviations that the two must lie apart, so that it is clear which is on which side."""


def offset_in(
    spot: Detection, areas: tuple[float, float], first: Expectation, second: Expectation
) -> tuple[float, float] | None:
    """From the first to the second of two markers that make up one light.

    The light's place is the mean of theirs, weighted by their areas. What is wrong with the
    expected places is mostly wrong with both alike, and that the light's place takes out (a
    Kalman filter's update).

    Returns:
        px, or None where the light is not where it should be, the sides are not sure, or the two
        would not touch.
    """
    places = np.array((first.x, first.y, second.x, second.y))
    spread = np.diag(np.repeat((first.deviation**2, second.deviation**2), 2))
    share = areas[0] / (areas[0] + areas[1])
    middle = np.hstack((share * np.eye(2), (1.0 - share) * np.eye(2)))
    spread = spread + PLACE_NOISE**2 * np.eye(4)
    innovation = np.array((spot.x, spot.y)) - middle @ places
    variance = middle @ spread @ middle.T + PLACE_NOISE**2 * np.eye(2)
    if innovation @ np.linalg.solve(variance, innovation) > GATE:
        return None
    gain = spread @ middle.T @ np.linalg.inv(variance)
    x0, y0, x1, y1 = (places + gain @ innovation).tolist()
    spread = spread - gain @ middle @ spread
    apart = np.hstack((-np.eye(2), np.eye(2)))
    widest = math.sqrt(max(float(np.linalg.eigvalsh(apart @ spread @ apart.T)[-1]), 0.0))
    touching = sum(math.sqrt(area / math.pi) for area in areas) + 3.0
    if not SURE_SIDE * widest < math.hypot(x1 - x0, y1 - y0) <= touching:
        return None
    return x1 - x0, y1 - y0


def is_joined(
    index: int,
    spot: Detection,
    looks: Sequence[AppearanceModel],
    expected: Mapping[int, Expectation],
) -> bool:
    """Whether a spot is probably this marker and another of those expected together."""
    if not looks[index].may_be_joined(spot):
        return False
    return any(
        math.hypot(spot.x - place.x, spot.y - place.y) < spot.radius + looks[other].radius + 3.0
        for other, place in expected.items()
        if other != index
    )
