"""How a marker's light usually looks, and two that have run together into one."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from mvuav_ros.vision.markers.centroid import Detection
from mvuav_ros.vision.markers.identity.assignment import GATE, Expectation
from mvuav_ros.vision.markers.rig_view import Array

USUAL_AREA = (0.6, 1.6)
USUAL_SPREAD = 1.06
"""Area and spread over the light's usual ones within which nothing has happened to it."""
LIKELY_AREA = (0.3, 3.2)
LIKELY_SPREAD = 1.3
"""The same for a spot that may be the marker after all."""
JOINED_AREA, JOINED_SPREAD = 1.25, 1.1
"""From these on it may be the marker together with another one."""
_MEMORY = 0.8
PLACE_NOISE = 0.5  # px (1 sigma): of a joined light's middle, and of a marker's place in its view
SURE_SIDE = 2.0
"""Deviations that the two must lie apart, so that it is clear which is on which side."""


class AppearanceModel:
    """A light's usual area (px) and spread (see `Detection`), and its background's pull (px)."""

    __slots__ = ('area', 'pull', 'radius', 'spread')

    def __init__(self, spot: Detection) -> None:
        self.area = float(spot.area)
        self.spread = spot.spread
        self.radius = spot.radius
        self.pull: tuple[float, float] | None = None

    def learn(self, spot: Detection) -> None:
        """Follow slow changes, as of the distance."""
        _, _, area, spread = spot
        if spread:
            self.area += (1 - _MEMORY) * (area - self.area)
            self.spread += (1 - _MEMORY) * (spread - self.spread)
            self.radius = math.sqrt(self.area / math.pi)

    def is_usual(self, area: int, spread: float) -> bool:
        """Whether nothing has happened to the light."""
        usual = self.area
        return (
            USUAL_AREA[0] * usual <= area <= USUAL_AREA[1] * usual + 4
            and spread <= USUAL_SPREAD * self.spread + 1.0 / area
        )

    def is_likely(self, spot: Detection) -> bool:
        """Whether it may be the light."""
        # Of a light of few pixels one more or less is nothing.
        if not LIKELY_AREA[0] * self.area - 2 <= spot.area <= LIKELY_AREA[1] * self.area + 6:
            return False
        return spot.spread <= max(LIKELY_SPREAD * self.spread, 1.0) + 2.0 / spot.area

    def may_be_joined(self, spot: Detection) -> bool:
        """Whether it is large or long enough to be the light and another one."""
        return spot.area >= JOINED_AREA * self.area or spot.spread >= JOINED_SPREAD * self.spread


def offset_in(
    spot: Detection, areas: tuple[float, float], places: Array, spread: Array
) -> tuple[float, float] | None:
    """From the first to the second of two markers that make up one light.

    The light's place is the mean of theirs, weighted by their areas. What is wrong with the
    expected places is mostly wrong with both alike, and that the light's place takes out (a
    Kalman filter's update).

    Args:
        spot: the light.
        areas: of the markers, px.
        places: (4,), expected, px.
        spread: (4, 4), the places' covariance, px².

    Returns:
        px, or None where the light is not where it should be, or the sides are not sure.
    """
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
    sure = math.hypot(x1 - x0, y1 - y0) > SURE_SIDE * widest
    return (x1 - x0, y1 - y0) if sure else None


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
