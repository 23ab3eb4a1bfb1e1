"""The synthetic flight to and over a runway."""

from __future__ import annotations

import math
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.simulation.exposure import apply_gain, motion_blur
from mvuav_ros.simulation.flight import Flight, SimulatedFrame, Stream
from mvuav_ros.simulation.ground import GroundPainter, load_ground
from mvuav_ros.simulation.runway_truth import (
    CameraPose,
    RunwayTruth,
    horizon,
    true_lines,
    vanishing_point,
)
from mvuav_ros.simulation.settings import RunwaySettings
from mvuav_ros.simulation.sky import Panorama
from mvuav_ros.simulation.waves import random_wave
from mvuav_ros.vision.frames import OPTICAL_FROM_BODY, Matrix, from_rpy, rpy
from mvuav_ros.vision.image import Image

GLIDE = math.tan(math.radians(3.5))
AIMING_POINT = 150.0
"""Where the glide path meets the runway, m from the near end."""
FLARE_HEIGHT = 8.0
LOW_PASS_HEIGHT = 22.0
S_TURN_HEIGHT = 70.0
S_TURN_AMPLITUDE = 18.0
S_TURN_PERIOD = 14.0
CAPTURE_SECONDS = 6.0
"""Time in which an approach loses 63 % of its lateral offset."""
_GRAVITY = 9.81
_STEP = 1e-3


class RunwayPath:
    """The camera's pose as a function of time; the aircraft banks for its own turns."""

    def __init__(self, settings: RunwaySettings, rng: np.random.Generator) -> None:
        self._settings = settings
        self._wander_y = random_wave(rng, [(0.8, 0.07), (0.25, 0.19)])
        self._wander_z = random_wave(rng, [(0.5, 0.09), (0.15, 0.23)])
        self._wobble = tuple(
            random_wave(rng, [(math.radians(a), 0.13), (math.radians(0.4 * a), 0.37)])
            for a in (1.6, 0.5, 0.6)
        )

    def pose(self, time: float, shaken: Matrix | None = None) -> CameraPose:
        """Where the camera is at a time (s); ``shaken`` from its steady optical frame if it is."""
        settings = self._settings
        position = np.array((self._x(time), self._y(time), self._z(time)))
        drift = (self._y(time + _STEP) - self._y(time - _STEP)) / (2 * _STEP)
        turn = (self._y(time + _STEP) - 2 * self._y(time) + self._y(time - _STEP)) / _STEP**2
        roll, pitch, yaw = (wave(time) for wave in self._wobble)
        # To the left means y grows, which a left bank does: negative roll.
        roll -= math.atan(turn / _GRAVITY)
        pitch += math.radians(settings.camera_pitch_deg)
        if settings.speed > 0.0:
            yaw += math.atan(drift / settings.speed)
        rotation = from_rpy(roll, pitch, yaw) @ OPTICAL_FROM_BODY.T
        if shaken is not None:
            rotation = rotation @ shaken.T
            roll, pitch, yaw = rpy(rotation @ OPTICAL_FROM_BODY)
        return CameraPose(position, roll, pitch, yaw, rotation)

    def _x(self, time: float) -> float:
        return self._settings.speed * time - self._settings.start_distance

    def _y(self, time: float) -> float:
        offset = self._settings.lateral_offset
        if self._settings.motion == 's_turn':
            turn = 2 * math.pi * time / S_TURN_PERIOD
            return offset + S_TURN_AMPLITUDE * math.sin(turn) + self._wander_y(time)
        return offset * math.exp(-time / CAPTURE_SECONDS) + self._wander_y(time)

    def _z(self, time: float) -> float:
        wander = self._wander_z(time)
        if self._settings.motion == 's_turn':
            return S_TURN_HEIGHT + wander
        if self._settings.motion == 'low_pass':
            return LOW_PASS_HEIGHT + wander
        glide = (AIMING_POINT - self._x(time)) * GLIDE
        # A smooth maximum of the glide path and the height of the flare.
        above = glide - FLARE_HEIGHT
        return FLARE_HEIGHT + 0.5 * (above + math.hypot(above, 3.0)) + 0.5 * wander


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
            self._gain(time),
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
