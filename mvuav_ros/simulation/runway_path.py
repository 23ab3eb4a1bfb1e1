"""How an aircraft flies to and over the runway."""

from __future__ import annotations

import math

import numpy as np

from mvuav_ros.simulation.runway_truth import CameraPose
from mvuav_ros.simulation.settings import RunwaySettings
from mvuav_ros.simulation.waves import random_wave
from mvuav_ros.vision.frames import OPTICAL_FROM_BODY, Matrix, from_rpy, rpy

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
        roll, pitch, yaw = (wave.at(time) for wave in self._wobble)
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
            return offset + S_TURN_AMPLITUDE * math.sin(turn) + self._wander_y.at(time)
        return offset * math.exp(-time / CAPTURE_SECONDS) + self._wander_y.at(time)

    def _z(self, time: float) -> float:
        wander = self._wander_z.at(time)
        if self._settings.motion == 's_turn':
            return S_TURN_HEIGHT + wander
        if self._settings.motion == 'low_pass':
            return LOW_PASS_HEIGHT + wander
        glide = (AIMING_POINT - self._x(time)) * GLIDE
        # A smooth maximum of the glide path and the height of the flare.
        above = glide - FLARE_HEIGHT
        return FLARE_HEIGHT + 0.5 * (above + math.hypot(above, 3.0)) + 0.5 * wander
