"""The refuelling boom, which swings out in front of a light when the schedule says so."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.simulation.schedule import Interval
from mvuav_ros.vision.point_operations import Pixels

TRAVEL = 0.25
"""Seconds in which the boom extends and retracts; it turns while it is short."""
TURN = 1.0
REST = 0.35
"""Length at rest, in distances from its pivot to the farthest light; no light is that close."""
SHADE = 24.0
_SHIFT = 4


@dataclass(frozen=True)
class Boom:
    """A straight bar in the image, from the pivot (2,) to the tip (2,), px."""

    pivot: NDArray[np.float64]
    tip: NDArray[np.float64]
    half_width: float

    def distance(self, point: NDArray[np.float64]) -> float:
        """How far a point (px) lies outside the bar; negative inside."""
        along = self.tip - self.pivot
        length = float(np.hypot(*along))
        if length == 0.0:
            return math.inf
        along = along / length
        offset = point - self.pivot
        forward = float(offset @ along)
        across = abs(float(offset[0] * along[1] - offset[1] * along[0]))
        return max(forward - length, -forward, across - self.half_width)

    def paint(self, image: Pixels) -> None:
        """Paint it into an 8-bit image, in place."""
        along = self.tip - self.pivot
        length = float(np.hypot(*along))
        if not math.isfinite(length) or length < 1.0:
            return
        side = np.array((-along[1], along[0])) * (self.half_width / length)
        gray = image.ndim == 2
        for width, factor in ((1.0, 1.0), (0.45, 1.7)):
            out = width * side
            corners = np.array([self.pivot - out, self.pivot + out, self.tip + out, self.tip - out])
            limit = 2.0**24
            places = np.rint(np.clip(corners * 2**_SHIFT, -limit, limit)).astype(np.int32)
            shade = SHADE * factor
            color = (shade,) if gray else (1.1 * shade, shade, 0.95 * shade)
            cv2.fillConvexPoly(image, places, color, cv2.LINE_AA, _SHIFT)


def place_boom(
    pivot: NDArray[np.float64],
    down: NDArray[np.float64],
    lights: dict[str, NDArray[np.float64]],
    schedule: tuple[Interval, ...],
    time: float,
    half_width: float,
) -> Boom:
    """Where the boom is at a time (s).

    Between two entries, which do not overlap, it rests, pointing ``down``; before an entry it
    turns towards the light, then extends, so that it covers the light during the whole of the
    interval. Places and lengths are px in the image.
    """
    lengths = [float(np.hypot(*(place - pivot))) for place in lights.values()]
    rest_angle = math.atan2(down[1], down[0])
    rest_length = min(REST * max(lengths), 0.6 * min(lengths))
    angle, length = rest_angle, rest_length
    for interval in schedule:
        outside = max(interval.start - time, time - interval.end, 0.0)
        if outside >= TRAVEL + TURN:
            continue
        target = lights[interval.marker] - pivot
        turn = math.remainder(math.atan2(target[1], target[0]) - rest_angle, 2 * math.pi)
        reached = float(np.hypot(*target)) + 3.0 * half_width
        extended = 1.0 - min(outside / TRAVEL, 1.0)
        turned = 1.0 - max(outside - TRAVEL, 0.0) / TURN
        angle = rest_angle + turn * turned
        length = rest_length + (reached - rest_length) * extended
        if outside == 0.0:
            break
    tip = pivot + length * np.array((math.cos(angle), math.sin(angle)))
    return Boom(pivot, tip, half_width)
