"""The synthetic flight to a runway."""

from __future__ import annotations

import math
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.simulation.exposure import apply_gain, motion_blur
from mvuav_ros.simulation.flight import Flight, SimulatedFrame, Stream
from mvuav_ros.simulation.ground import GroundPainter, load_ground
from mvuav_ros.simulation.runway_path import RunwayPath
from mvuav_ros.simulation.runway_truth import (
    CameraPose,
    RunwayTruth,
    horizon,
    true_lines,
    vanishing_point,
)
from mvuav_ros.simulation.settings import RunwaySettings
from mvuav_ros.simulation.sky import Panorama
from mvuav_ros.vision.image import Image


class RunwayFlight(Flight[RunwayTruth]):
    """Images (bgr8) of a runway ahead, with truth.

    Attributes:
        settings: what was asked for.
    """

    def __init__(self, settings: RunwaySettings | None = None) -> None:
        self.settings = settings or RunwaySettings()
        super().__init__(self.settings, self.settings.camera())
        self._path = RunwayPath(self.settings, self._rng(Stream.MOTION))

    def truth_at(self, time: float) -> RunwayTruth:
        """What is true at any time (s)."""
        pose = self.pose(time)
        return RunwayTruth(
            time,
            true_lines(self.camera, pose, self.settings.runway_width, self.settings.runway_length),
            vanishing_point(self.camera, pose),
            horizon(self.camera, pose),
            pose,
            self._gain.at(time),
            self.camera,
        )

    def pose(self, time: float) -> CameraPose:
        """The camera, which may shake, in the runway's frame at a time (s)."""
        return self._path.pose(time, None if self._shake.still else self._shake.rotation(time))

    def frame(self, index: int) -> SimulatedFrame[RunwayTruth]:
        """Draw frame ``index``, dropped or not."""
        time = self.seen_at(index)
        truth = self.truth_at(time)
        image: NDArray[np.uint8] = self._panorama.view(truth.pose)
        self._painter.paint(image, truth.pose)
        image = motion_blur(image, *self._smear(time))
        image = apply_gain(image, truth.gain)
        image = self._exposed(image, time)
        return SimulatedFrame(self.stamp_ns(index), Image(image, 'bgr8'), truth)

    def _smear(self, time: float) -> tuple[float, float]:
        """How far the vanishing point moves during the exposure, px."""
        half = 0.5 * self.settings.exposure
        x1, y1 = vanishing_point(self.camera, self.pose(time - half))
        x2, y2 = vanishing_point(self.camera, self.pose(time + half))
        dx, dy = x2 - x1, y2 - y1
        return (dx, dy) if math.isfinite(dx + dy) else (0.0, 0.0)

    @cached_property
    def _painter(self) -> GroundPainter:
        s = self.settings
        ground = load_ground(s.runway_width, s.runway_length, s.detail, s.seed)
        return GroundPainter(ground, self.camera, s.visibility)

    @cached_property
    def _panorama(self) -> Panorama:
        return Panorama(self.camera, self.settings.detail, self._rng(Stream.BACKGROUND))
