"""Lights that are no markers: those long without a name, and those that lost one."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from mvuav_ros.vision.markers.centroid import Detection
from mvuav_ros.vision.markers.identity.assignment import Expectation

STRANGE = 3  # Frames without a name after which a light is a stranger
REMEMBERED = 150  # Frames for which lights may be strangers after one has been seen
STRANGER_STEP = 8.0  # px that a stranger may move in a frame, as the camera shakes
REJECTED_FOR = 45  # Frames for which a light is not taken again for the marker that it was not
STEP = 10.0  # px that it may move in a frame
RELEASED = 2.0
"""Deviations within which it lies where the others put the marker: then it is the marker."""
SURE = 5.0  # px (1 sigma): how well that place must be known


class Clutter:
    """Lights that have stayed without a name for some frames: glares, not returning markers."""

    def __init__(self) -> None:
        self._seen: list[tuple[float, float, int]] = []
        self._strangers: list[tuple[float, float]] = []
        self._frames_without = REMEMBERED

    @property
    def is_about(self) -> bool:
        """Whether there was any within the last seconds."""
        return self._frames_without < REMEMBERED

    def include(self, spot: Detection) -> bool:
        """Whether a light has stood there, or close by, for long."""
        return any(age >= STRANGE and _is_beside(spot, x, y) for x, y, age in self._seen)

    def is_stranger(self, spot: Detection) -> bool:
        """Whether a light was there already while all markers were elsewhere."""
        return any(_is_beside(spot, x, y) for x, y in self._strangers)

    def update(
        self, spots: Sequence[Detection], expected: Mapping[int, Expectation] | None
    ) -> None:
        """Take the lights of a frame that got no name.

        What lies far from all places where markers without a light are expected is none. Where the
        body is out of sight (None), only what was clutter before is followed.
        """
        seen = []
        for spot in spots:
            ages = [age for x, y, age in self._seen if _is_beside(spot, x, y)]
            if expected is not None:
                near = any(_may_be_at(spot, place) for place in expected.values())
                ages.append(0 if near else max(ages, default=0) + STRANGE)
            if ages:
                seen.append((spot.x, spot.y, max(ages)))
        self._strangers = [
            (spot.x, spot.y) for spot in spots if expected == {} or self.is_stranger(spot)
        ]
        self._seen = seen
        strange = any(age >= STRANGE for *_, age in seen)
        self._frames_without = 0 if strange else self._frames_without + 1


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
        self._lights[marker] = light, REJECTED_FOR

    def clear(self) -> None:
        """All names are new."""
        self._lights.clear()

    def concern(self, marker: int, light: Detection) -> bool:
        """Whether this is the light that was not that marker."""
        return marker in self._lights and _apart(self._lights[marker][0], light) < STEP

    def follow(self, lights: list[Detection], expected: Mapping[int, Expectation]) -> None:
        """Go on to the next frame's lights; expected are the markers without one (px, ideal)."""
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


def _is_beside(spot: Detection, x: float, y: float) -> bool:
    return abs(x - spot.x) < STRANGER_STEP and abs(y - spot.y) < STRANGER_STEP


def _may_be_at(spot: Detection, place: Expectation) -> bool:
    reach = STRANGER_STEP + 4.0 * place.deviation
    return math.hypot(spot.x - place.x, spot.y - place.y) < reach


def _apart(a: Detection, b: Detection) -> float:
    return math.hypot(a.x - b.x, a.y - b.y)
