"""Lights that have stood about without a name: no markers that return."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from mvuav_ros.vision.markers.centroid import Detection
from mvuav_ros.vision.markers.identity.assignment import Expectation

STRANGE = 3
"""Frames without a name after which a light is a stranger."""
REMEMBERED = 150
"""Frames for which lights may be strangers after one has been seen."""
STRANGER_STEP = 8.0
"""px that a stranger may move in a frame, as the camera shakes."""


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
        return any(
            age >= STRANGE and abs(x - spot.x) < STRANGER_STEP and abs(y - spot.y) < STRANGER_STEP
            for x, y, age in self._seen
        )

    def is_stranger(self, spot: Detection) -> bool:
        """Whether a light was there already while all markers were elsewhere."""
        return any(
            abs(x - spot.x) < STRANGER_STEP and abs(y - spot.y) < STRANGER_STEP
            for x, y in self._strangers
        )

    def update(
        self, spots: Sequence[Detection], expected: Mapping[int, Expectation] | None
    ) -> None:
        """Take the lights of a frame that got no name.

        Args:
            spots: those lights.
            expected: where the markers without a light should be; what lies far from all of them
                is none. None where the body is out of sight: then only what was clutter before
                is followed.
        """
        seen = []
        for spot in spots:
            ages = [
                age
                for x, y, age in self._seen
                if abs(x - spot.x) < STRANGER_STEP and abs(y - spot.y) < STRANGER_STEP
            ]
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


def _may_be_at(spot: Detection, place: Expectation) -> bool:
    reach = STRANGER_STEP + 4.0 * place.deviation
    return math.hypot(spot.x - place.x, spot.y - place.y) < reach
