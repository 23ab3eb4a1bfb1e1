"""Lights that were found to be none of the marker whose name they had."""

from __future__ import annotations

import math
from collections.abc import Mapping

from mvuav_ros.vision.markers.centroid import Detection
from mvuav_ros.vision.markers.identity.assignment import Expectation

REMEMBERED = 45
"""Frames for which a light is not taken for that marker again."""
STEP = 10.0
"""px that it may move in a frame."""
RELEASED = 2.0
"""Deviations within which it lies where the others put the marker: then it is the marker."""
SURE = 5.0
"""px (1 sigma): how well that place must be known."""


class Rejections:
    """For each marker the light that others contradicted, followed by its place.

    Without this the light would get the name back in the next frame, as it is still near.
    """

    def __init__(self) -> None:
        self._lights: dict[int, tuple[Detection, int]] = {}

    def __bool__(self) -> bool:
        """Whether any light is remembered."""
        return bool(self._lights)

    def add(self, marker: int, light: Detection) -> None:
        """This light is not that marker."""
        self._lights[marker] = light, REMEMBERED

    def clear(self) -> None:
        """All names are new."""
        self._lights.clear()

    def concern(self, marker: int, light: Detection) -> bool:
        """Whether this is the light that was not that marker."""
        return marker in self._lights and _apart(self._lights[marker][0], light) < STEP

    def follow(self, lights: list[Detection], expected: Mapping[int, Expectation]) -> None:
        """Go on to the next frame's lights.

        Args:
            lights: px without distortion.
            expected: where the markers without a light should be.
        """
        kept: dict[int, tuple[Detection, int]] = {}
        for marker, (light, left) in self._lights.items():
            near = min(lights, key=lambda other: _apart(light, other), default=light)
            near = near if _apart(light, near) < STEP else light
            place = expected.get(marker)
            if place is not None and place.deviation < SURE:
                away = math.hypot(near.x - place.x, near.y - place.y)
                if away < RELEASED * place.deviation:
                    continue
            if left > 1 and place is not None:
                kept[marker] = near, left - 1
        self._lights = kept


def _apart(a: Detection, b: Detection) -> float:
    return math.hypot(a.x - b.x, a.y - b.y)
