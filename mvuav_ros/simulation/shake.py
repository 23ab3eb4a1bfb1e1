"""Camera vibration: the thesis's four settings (Table 5.4)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mvuav_ros.simulation.waves import random_wave
from mvuav_ros.vision.frames import Matrix, about_x, about_y, about_z


@dataclass(frozen=True)
class Vibration:
    """How the camera's attitude swings about the steady one.

    Attributes:
        base_hz: lowest frequency.
        harmonics: multiple of the base and amplitude relative to the base's.
        pointing_deg: amplitude of the base in yaw and in pitch.
        roll_deg: amplitude of the base in roll.
    """

    base_hz: float
    harmonics: tuple[tuple[int, float], ...]
    pointing_deg: float
    roll_deg: float


STEADY = Vibration(0.0, (), 0.0, 0.0)

VIBRATIONS = (
    STEADY,
    Vibration(1.5, ((1, 1.0), (2, 0.5), (3, 0.25)), 0.05, 0.05),
    Vibration(2.5, ((1, 1.0), (2, 0.5), (3, 0.25)), 0.10, 0.10),
    Vibration(4.0, ((1, 1.0), (2, 0.5), (3, 0.25)), 0.20, 0.20),
)
"""Settings none, 1, 2, 3. Table 5.4 varies base frequency, harmonics and amplitude; its numbers
are not at hand, so these are ours: a few hertz as of a hand or a light airframe, all harmonics
below the 15 Hz that 30 frames/s can show. In the lab view of 640 px (0.103 degrees per pixel)
the base's amplitude is 0.5, 1.0 and 1.9 px."""


class Shake:
    """One vibration with phases from a seed, as a function of time."""

    def __init__(self, vibration: Vibration, gain: float, rng: np.random.Generator) -> None:
        self._still = vibration == STEADY or gain == 0.0
        pitch, yaw, roll = (
            random_wave(
                rng,
                [
                    (math.radians(amplitude) * gain * relative, vibration.base_hz * multiple)
                    for multiple, relative in vibration.harmonics
                ],
            )
            for amplitude in (
                vibration.pointing_deg,
                vibration.pointing_deg,
                vibration.roll_deg,
            )
        )
        self._pitch, self._yaw, self._roll = pitch, yaw, roll

    @property
    def still(self) -> bool:
        """Whether it never moves."""
        return self._still

    def rotation(self, time: float) -> Matrix:
        """Shaken from steady optical frame at a time (s)."""
        if self._still:
            return np.eye(3)
        return (
            about_z(self._roll.at(time))
            @ about_y(self._yaw.at(time))
            @ about_x(self._pitch.at(time))
        )
