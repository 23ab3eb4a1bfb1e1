"""How a marker's light usually looks, and whether a spot looks like it."""

from __future__ import annotations

import math

from mvuav_ros.vision.markers.centroid import Detection

USUAL_AREA = (0.6, 1.6)
USUAL_SPREAD = 1.06
"""Area and spread over the light's usual ones within which nothing has happened to it."""
LIKELY_AREA = (0.3, 3.2)
LIKELY_SPREAD = 1.3
"""The same for a spot that may be the marker after all."""
JOINED_AREA, JOINED_SPREAD = 1.25, 1.1
"""From these on it may be the marker together with another one."""
_MEMORY = 0.8


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
