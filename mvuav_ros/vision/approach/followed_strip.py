"""A strip on the ground followed from frame to frame: its two edges and its ends."""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np

from mvuav_ros.vision.approach.derotation import Derotation
from mvuav_ros.vision.approach.edges import Edges, Strip
from mvuav_ros.vision.approach.shape import Shape

_END_MEMORY = 0.6
"""Share of the newest frame in where the ends are."""


class FollowedStrip:
    """What both kinds of tracks are.

    Attributes:
        shape: its edges.
        far: rows from the vanishing point to the far end, px of the working image; smoothed.
        near: likewise to the near end.
        near_seen: the same in the newest frame alone.
        open_end: its near end is out of sight.
        age: frames.
        misses: looks in a row in which it was not seen.
        points: of the edges in the newest frame, if seen.
    """

    MOST_MISSES: ClassVar[int]

    def __init__(self, strip: Strip) -> None:
        self.shape = Shape(strip)
        self.far, self.near = float(strip[4]), float(strip[5])
        self.near_seen = self.near
        self.open_end = False
        self.age = self.misses = 0
        self.points: Edges | None = None

    @property
    def lost(self) -> bool:
        """It has not been seen for too long."""
        return self.misses > self.MOST_MISSES

    def give_up(self) -> None:
        """Count it as lost."""
        self.misses = self.MOST_MISSES + 1

    def strip(self) -> Strip:
        """(6,) where it is."""
        return np.array([*self.shape.vanishing_point, *self.shape.slopes, self.far, self.near])

    def turn(self, old: Derotation, new: Derotation) -> None:
        """Go over to another derotation."""
        self.shape.turn(old, new)

    def follow_ends(self, far: float, near: float) -> None:
        """Take in where the ends are in the newest frame, rows below the vanishing point."""
        if not math.isfinite(near):
            return
        share = max(_END_MEMORY, 1.0 / self.age)
        self.near_seen = near
        self.near += share * (near - self.near)
        self.far += share * (far - self.far)
        self.near = max(self.near, self.far + 3.0)
