"""Camera vibration (the four conditions of the thesis's Table 5.4) and other random motion.

Both are sums of sines whose phases come from a seed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from mvuav_ros.vision.frames import Matrix, about_x, about_y, about_z

Wave = Callable[[float], float]  # a value by the time (s)


def random_wave(rng: np.random.Generator, terms: Iterable[tuple[float, float]]) -> Wave:
    """A sum of sines, whose unit is their amplitudes': (amplitude, Hz) with random phases."""
    sines = [(a, f, float(rng.uniform(0.0, 2 * math.pi))) for a, f in terms]
    return lambda time: sum(a * math.sin(2 * math.pi * f * time + p) for a, f, p in sines)


ROLL_DEG_PER_MAGNITUDE = 21.6
"""Degrees of roll for one unit of Table 5.4's magnitude. The thesis measured accelerations and says
nothing of angles, so this one number is chosen: with it the true roll swings at vibration 1 by
0.084 degrees RMS, the mean of that row of Table 5.5. Vibrations 2 and 3 follow from Table 5.4."""
POINTING_DEG_PER_MAGNITUDE = 10.0
"""The same for pitch and yaw, which no table of the thesis has: the primary swings by 0.5, 1.2
and 1.3 px in the lab view of 640 px (0.103 degrees per pixel)."""
HARMONIC = 0.5
"""Amplitude of a harmonic at the primary's own frequency, relative to it. Table 5.4 lists the
frequencies of harmonics and not their magnitudes; farther away they fall with the ratio of the
frequencies."""


@dataclass(frozen=True)
class Vibration:
    """How the camera's attitude swings about the steady one."""

    primary_hz: float  # the strongest frequency
    magnitude: float  # of the primary, in the unit of Table 5.4
    harmonics_hz: tuple[float, ...]  # further frequencies, above and below the primary

    @property
    def terms(self) -> tuple[tuple[float, float], ...]:
        """Each frequency (Hz) with its amplitude relative to the primary's."""
        harmonics = [
            (hz, HARMONIC * min(hz, self.primary_hz) / max(hz, self.primary_hz))
            for hz in self.harmonics_hz
        ]
        return ((self.primary_hz, 1.0), *harmonics)


VIBRATIONS = (
    Vibration(0.0, 0.0, ()),
    Vibration(11.06, 0.005248, (22.12, 33.11, 66.58)),
    Vibration(14.21, 0.01204, (28.42, 64.01)),
    Vibration(16.63, 0.01378, (8.31, 24.98, 33.22, 41.78, 49.88, 58.26, 66.54)),
)
"""Settings none, 1, 2, 3: the frequencies and magnitudes of Table 5.4. Its 39.4 Hz of the resting
camera is the noise of its inertial sensor, as the thesis says, and moves nothing here."""


class Shake:
    """One vibration with phases from a seed, as a function of time."""

    def __init__(self, vibration: Vibration, gain: float, rng: np.random.Generator) -> None:
        self._still = gain * vibration.magnitude == 0.0
        self._waves = []
        for scale in (*[POINTING_DEG_PER_MAGNITUDE] * 2, ROLL_DEG_PER_MAGNITUDE):
            amplitude = math.radians(scale * vibration.magnitude) * gain
            terms = [(amplitude * relative, hz) for hz, relative in vibration.terms]
            self._waves.append(random_wave(rng, terms))

    def angles(self, time: float) -> tuple[float, float, float]:
        """Pitch, yaw and roll of the shaken camera at a time (s), rad."""
        pitch, yaw, roll = (wave(time) for wave in self._waves)
        return pitch, yaw, roll

    def rotation(self, time: float) -> Matrix | None:
        """Shaken from steady optical frame at a time (s); None where it never moves."""
        if self._still:
            return None
        pitch, yaw, roll = self.angles(time)
        return about_z(roll) @ about_y(yaw) @ about_x(pitch)
