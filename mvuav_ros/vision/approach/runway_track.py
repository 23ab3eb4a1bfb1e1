"""One possible runway followed from frame to frame."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.approach.appearance import FEATURES
from mvuav_ros.vision.approach.candidates import Candidates, LevelledImage, describe_strips, to_level
from mvuav_ros.vision.approach.derotation import Derotation, turn_edge
from mvuav_ros.vision.approach.edges import EdgePoints
from mvuav_ros.vision.approach.probability import evidence_weights
from mvuav_ros.vision.approach.runway_edges import EdgeLook
from mvuav_ros.vision.approach.shape import Shape

_DEEPEST = 28.0
"""Px of a pyramid level: a near end below that is measured on the next one."""
_MEMORY, _END_MEMORY = 0.15, 0.6
_MOST_MISSES = 10
_MISSED = -4.0
"""Log odds of a frame in which nothing is there."""
_SIDE_MARGIN, _LEAST_MARGIN, _ABOVE, _BELOW = 1.6, 36.0, 24.0, 2.7
_PAINT = FEATURES.index('paint')
_STEPS = (FEATURES.index('brightness'), FEATURES.index('colour'))
_OPEN = FEATURES.index('open_end')


class RunwayTrack:
    """A shape, how likely it is, and where it ends.

    Attributes:
        shape: its edges.
        far: rows from the vanishing point to the far end, px of the working image.
        near: likewise to the near end; smoothed.
        near_seen: the same in the newest frame alone.
        open_end: its near end is out of sight.
        log_odds: that it is a runway, averaged over the last frames.
        age: frames.
        misses: frames in a row in which it was not seen.
        points: of the left and the right edge in the newest frame, if seen.
    """

    def __init__(self, strip: NDArray[np.float64], log_odds: float) -> None:
        """Begin with a candidate, (6,) as `strip_search.Strips`."""
        self.shape = Shape(strip[:4], float(strip[5]))
        self.far, self.near = float(strip[4]), float(strip[5])
        self.near_seen = self.near
        self.open_end = False
        self.log_odds = log_odds
        self.age = 0
        self.misses = 0
        self.points: tuple[EdgePoints, EdgePoints] | None = None
        self._look = EdgeLook()

    @property
    def width(self) -> float:
        """At the near end, px of the working image."""
        left, right = self.shape.slopes
        return (right - left) * self.near

    @property
    def lost(self) -> bool:
        """It has not been seen for too long."""
        return self.misses > _MOST_MISSES

    def strip(self) -> NDArray[np.float64]:
        """(6,) as `strip_search.Strips`."""
        return np.array([*self.shape.as_array(), self.far, self.near])

    def turn(self, old: Derotation, new: Derotation) -> None:
        """Go over to another derotation."""
        shape = self.shape
        for first in (0, 2):
            place, slope = (float(v) for v in shape.state[first : first + 2])
            shape.state[first : first + 2] = turn_edge(place, slope, shape.reference, old, new)

    def step(
        self,
        image: NDArray[Any],
        working: LevelledImage,
        level: Derotation,
        horizon: tuple[float, float] | None,
    ) -> None:
        """Follow it into the next frame.

        Args:
            image: the frame.
            working: its levelled working image.
            level: of the frame.
            horizon: row of the vanishing point and its standard deviation, if known, px.
        """
        if self.age:
            self.shape.predict()
        self.age += 1
        seen = self._describe(working) if self._plausible(working) else None
        if seen is None:
            self._miss()
            return
        odds = float(evidence_weights().log_odds(seen.features)[0])
        self.log_odds += max(_MEMORY, 1.0 / self.age) * (odds - self.log_odds)
        self.misses = 0
        self._measure(image, level, seen, horizon)
        if not self._plausible(working):
            self.misses = _MOST_MISSES + 1

    def _miss(self) -> None:
        self.misses += 1
        self.points = None
        self.log_odds += _MEMORY * (_MISSED - self.log_odds)

    def _plausible(self, working: LevelledImage) -> bool:
        array = self.strip()
        if not np.isfinite(array).all():
            return False
        height, columns = working.size
        width = array[3] - array[2]
        return bool(
            0.05 < width < 8.0
            and abs(array[2] + array[3]) / 2 < 2.0 * width
            and -0.5 * columns < array[0] < 1.5 * columns
            and -0.3 * height < array[1] < height - 6
            and self.near > self.far
        )

    def _describe(self, working: LevelledImage) -> Candidates | None:
        level = max(0, math.ceil(math.log2(max(self.near, 1.0) / _DEEPEST)))
        strip = to_level(self.strip()[None], level)
        scale = 2**level
        x, y, left, right, _, near = (float(v) for v in strip[0])
        edges = x + left * near, x + right * near, x
        margin = max(_SIDE_MARGIN * (right - left) * near, _LEAST_MARGIN)
        box = (
            min(edges) - margin,
            y - _ABOVE,
            max(edges) + margin,
            y + _BELOW * near + 4,
        )
        part, (column, row) = working.cut(level, box)
        if part is None:
            return None
        strip[:, 0] -= column
        strip[:, 1] -= row
        found = describe_strips(part, strip, level, working.scene_of_part(level, column, row))
        if not len(found.strips):
            return None
        found.strips[:, :2] += np.array([column, row]) * scale
        return found

    def _measure(
        self,
        image: NDArray[Any],
        level: Derotation,
        seen: Candidates,
        horizon: tuple[float, float] | None,
    ) -> None:
        strip, features = seen.strips[0], seen.features[0]
        shape = self.shape
        lead = float(features[_PAINT] - features[_STEPS[0]] - features[_STEPS[1]])
        # Where the evidence is in the small image says where to look in the frame.
        span = float(strip[4]), float(strip[5])
        left, right = self._look.find(image, level, strip[:4], span, lead)
        shape.move_reference(float(strip[1] + 0.7 * strip[5] + 0.3 * strip[4]))
        row, sigma = horizon if horizon is not None else (None, 1.0)
        shape.update(left, right, row, sigma)
        self.points = left, right
        share = max(_END_MEMORY, 1.0 / self.age)
        self.far += share * (float(strip[4]) - self.far)
        self.near_seen = float(strip[5])
        self.near += share * (self.near_seen - self.near)
        self.near = max(self.near, self.far + 3.0)
        self.open_end = bool(features[_OPEN] > 0.5)
