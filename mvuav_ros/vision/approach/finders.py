"""From a frame to the track of the target in it: the horizon first, then what lies below it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.approach.attitude import HorizonLine
from mvuav_ros.vision.approach.derotation import Derotation
from mvuav_ros.vision.approach.edges import LevelledFrame
from mvuav_ros.vision.approach.followed_strip import FollowedStrip
from mvuav_ros.vision.approach.horizon import Horizon, HorizonFinder
from mvuav_ros.vision.approach.road.features import shrink
from mvuav_ros.vision.approach.road.targets import TARGETS
from mvuav_ros.vision.approach.road.tracker import Tracker
from mvuav_ros.vision.approach.runway.evidence import shrink_levels
from mvuav_ros.vision.approach.runway.probability import Report
from mvuav_ros.vision.approach.runway.tracker import RunwayTracker, SearchRange
from mvuav_ros.vision.approach.runway.tuning import TUNING
from mvuav_ros.vision.point_operations import Pixels

_FROZEN = 50
"""Frames that are all the same, from which a picture is frozen and shows nothing: two seconds."""
_AFRESH = 10
"""Frames between two looks for the horizon at any slope."""
_NEAR_HORIZON = 10.0
"""Px of the working image between the runway's vanishing point and a horizon seen in the image, up
to which the two are taken for the same."""
_WHOLE, _ABOVE = (0.03, 0.65), -0.4
"""Share of the height in which vanishing points are looked for without a horizon, and up to which
they are where none may be in view."""


@dataclass(frozen=True)
class Found:
    """What a frame shows.

    Attributes:
        track: of the target, if there is one.
        confidence: of the track.
        level: the frame's derotation.
        horizon_row: on the levelled working image, if it is known.
        unchanged: frames before this one that were the same, if they were counted.
    """

    track: FollowedStrip | None
    confidence: float
    level: Derotation
    horizon_row: float | None
    unchanged: int = 0


class _ImageHorizon:
    """The horizon as the image shows it, followed from frame to frame."""

    def __init__(self) -> None:
        self._finder: HorizonFinder | None = None
        self._last: Horizon | None = None
        self._frames = 0

    def find(self, pixels: NDArray[np.uint8]) -> Horizon | None:
        """In a working image, (height, width, 3) uint8; None without one."""
        if self._finder is None:
            self._finder = HorizonFinder(*pixels.shape[:2])
        near = None if self._frames % _AFRESH == 0 else self._last
        self._frames += 1
        horizon = self._finder.find(pixels, near)
        self._last = horizon if horizon.trusted else None
        return self._last


class RunwayFinder:
    """Finds a runway, with or without attitude."""

    def __init__(self) -> None:
        self._tracker = RunwayTracker()
        self._horizon = _ImageHorizon()

    def step(self, image: Pixels, attitude: HorizonLine | None) -> Found:
        """Take in the next frame; ``attitude`` is where the horizon is, if that is known."""
        pixels, factor = shrink_levels(image)
        height, width = pixels.shape[:2]
        if attitude is not None:
            level = Derotation(width, height, factor, attitude.slope)
            at = level.row_of((attitude.row + 0.5) / factor - 0.5)
            row: float | None = at
            reach = TUNING.attitude_reach
            ranges = [SearchRange(level.slope, at - reach, at + reach)]
            known: tuple[float, float] | None = (at, TUNING.attitude_sigma)
        else:
            level, ranges, seen = self._from_image(pixels, factor)
            row, known = seen, self._agreed(seen)
        frame = LevelledFrame(image, level)
        track = self._tracker.step(frame, pixels, ranges, known, attitude=attitude is not None)
        unchanged = self._tracker.unchanged
        confidence = 0.0 if unchanged > _FROZEN else self._tracker.confidence
        return Found(track, confidence, level, row, unchanged)

    @property
    def report(self) -> Report | None:
        """What the newest confidence was made of; None without a track."""
        return self._tracker.report

    def _from_image(
        self, pixels: NDArray[Any], factor: int
    ) -> tuple[Derotation, list[SearchRange], float | None]:
        """Derotation, hypotheses, and the row of the horizon if one is seen."""
        height, width = pixels.shape[:2]
        levels = np.clip(pixels, 0, 255).astype(np.uint8)
        colour = cv2.cvtColor(levels, cv2.COLOR_GRAY2BGR) if levels.ndim == 2 else levels
        horizon = self._horizon.find(np.asarray(colour, np.uint8))
        whole = SearchRange(0.0, _WHOLE[0] * height, _WHOLE[1] * height)
        beyond = SearchRange(0.0, _ABOVE * height, _WHOLE[0] * height)
        if horizon is None:
            return Derotation(width, height, factor, 0.0), [whole, beyond], None
        level = Derotation(width, height, factor, horizon.slope)
        row = level.row_of(horizon.row)
        above, below = TUNING.horizon_reach
        near = SearchRange(level.slope, row - above, row + below)
        return level, [near, whole, beyond], row

    def _agreed(self, row: float | None) -> tuple[float, float] | None:
        """The seen horizon where the runway's edges meet at it; a cloud's edge is none."""
        best = self._tracker.best
        if row is None or best is None:
            return None
        apart = abs(best.shape.vanishing_point[1] - row)
        return (row, TUNING.image_horizon_sigma) if apart < _NEAR_HORIZON else None


class StripFinder:
    """Finds the lane of a road, or a pipeline."""

    def __init__(self, target: str) -> None:
        self._target = TARGETS[target]
        self._tracker: Tracker | None = None
        self._horizon = _ImageHorizon()

    def step(self, image: Pixels, attitude: HorizonLine | None) -> Found:
        """Take in the next frame; ``attitude`` is where the horizon is, if that is known."""
        pixels, factor = shrink(image)
        height, width = pixels.shape[:2]
        horizon: HorizonLine | Horizon | None = None
        if not self._target.look.painted:
            horizon = self._horizon.find(pixels) if attitude is None else attitude
        slope, row = 0.0, None
        if horizon is not None:
            slope, row = horizon.slope, horizon.row
            if horizon is attitude:
                row = (row + 0.5) / factor - 0.5
        level = Derotation(width, height, factor, slope)
        level_row = None if row is None else level.row_of(row)
        if self._tracker is None:
            self._tracker = Tracker(self._target, height, width)
        track = self._tracker.step(LevelledFrame(image, level), pixels, level_row)
        return Found(track, 0.0 if track is None else track.confidence, level, level_row)
