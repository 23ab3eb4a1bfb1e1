"""How the tanker moves before the camera: the thesis's trials and some harder flights."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from mvuav_ros.simulation.settings import TankerSettings
from mvuav_ros.simulation.waves import random_wave
from mvuav_ros.vision.frames import OPTICAL_FROM_BODY, Matrix, Vector, about_y, from_rpy
from mvuav_ros.vision.rig import MarkerRig

LAB_DISTANCE = 3.3
"""From the camera to the body's origin in the lab view, in units of the body's reach: at 60
degrees the wings then span somewhat more than half of the frame."""
LAB_ELEVATION = math.radians(4.0)
RECEIVER_DISTANCE = 1.5
"""From the camera to the dock point in the receiver view when not docking, in reaches."""
RECEIVER_ELEVATION = math.radians(30.0)
ROLL_SWEEP = math.radians(60.0)
ROLL_PERIOD = 10.0
CROSSING_PITCH_DEG = -7.65
SETTLED = 0.1
"""Part of a docking approach that is flown at the final distance."""


class BodyPose(NamedTuple):
    """A body in the camera's optical frame: rotation (3, 3) and translation (3,), m."""

    rotation: Matrix
    translation: Vector


@dataclass(frozen=True)
class Placement:
    """Where a motion puts the body, relative to flying straight ahead of the camera.

    Angles are rad, as `from_rpy` takes them; the offset is x ahead, y left, z up, in reaches;
    ``closeness`` runs from 0 to 1 during a docking approach.
    """

    roll: float = 0.0
    pitch: float = 0.0
    yaw: float = 0.0
    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    closeness: float = 0.0


Motion = Callable[[float], Placement]


class TankerMotion:
    """The body's pose as a function of time, for a camera that does not shake."""

    def __init__(
        self, settings: TankerSettings, rig: MarkerRig, duration: float, rng: np.random.Generator
    ) -> None:
        random = _RANDOM_MOTIONS.get(settings.motion)
        self._move = random(duration, rng) if random else _MOTIONS[settings.motion]
        self._roll = math.radians(settings.roll_deg)
        self._reach = rig.reach
        lab = settings.actual_view == 'lab'
        self._elevation = LAB_ELEVATION if lab else RECEIVER_ELEVATION
        docking = settings.motion == 'docking'
        # Seen from right behind, a turn about the origin stays in the middle of the frame.
        aim = rig.dock if docking or not lab else (0.0, 0.0, 0.0)
        self._aim = np.array(aim)
        usual = rig.reach * (LAB_DISTANCE if lab else RECEIVER_DISTANCE)
        self._start = settings.start_distance if docking else usual
        self._end = settings.end_distance if docking else usual

    def steady_frame(self) -> Matrix:
        """Steady optical frame from level axes (x ahead, y left, z up), (3, 3)."""
        return np.asarray(OPTICAL_FROM_BODY @ about_y(-self._elevation).T)

    def pose(self, time: float) -> BodyPose:
        """The body in the steady camera's optical frame at a time (s)."""
        placed = self._move(time)
        distance = self._start + (self._end - self._start) * placed.closeness
        # Wander that takes the same angle at any distance: a pilot steers closer when closer.
        scale = self._reach * min(1.0, distance / self._start)
        look = (math.cos(self._elevation), 0.0, math.sin(self._elevation))
        camera = self._aim - distance * np.array(look)
        offset = scale * np.array((placed.x, placed.y, placed.z))
        optical = self.steady_frame()
        body = from_rpy(placed.roll + self._roll, placed.pitch, placed.yaw)
        return BodyPose(optical @ body, optical @ (offset - camera))


def _sine(amplitude: float, period: float, time: float) -> float:
    return amplitude * math.sin(2 * math.pi * time / period)


def _roll(time: float) -> Placement:
    return Placement(roll=_sine(ROLL_SWEEP, ROLL_PERIOD, time))


def _translation(time: float) -> Placement:
    return Placement(x=_sine(0.15, 11.0, time), y=_sine(0.36, 8.0, time), z=_sine(0.22, 5.0, time))


def _roll_translation(time: float) -> Placement:
    moved = _translation(time)
    return replace(moved, z=0.6 * moved.z, roll=_roll(time).roll)


def _crossing(time: float) -> Placement:
    """A yaw at which one stabilizer passes its wing, then the other passes the other wing.

    The pitch sets how close (about 5 px in the lab view of 640 px): the tail lies 25 m behind
    the wings, so nose up lowers it.
    """
    return Placement(
        pitch=math.radians(CROSSING_PITCH_DEG), yaw=_sine(math.radians(42.0), 12.0, time)
    )


def _erratic(_duration: float, rng: np.random.Generator) -> Motion:
    """Like a model moved by hand: several incommensurate frequencies in every direction."""
    hand = [(0.14, 0.11), (0.07, 0.29), (0.035, 0.67)]
    tilt = [(0.10, 0.13), (0.05, 0.31), (0.02, 0.71)]
    x, y, z = (random_wave(rng, hand) for _ in range(3))
    roll, pitch, yaw = (random_wave(rng, tilt) for _ in range(3))
    return lambda t: Placement(roll(t), 0.5 * pitch(t), 0.5 * yaw(t), x(t), y(t), z(t))


def _docking(duration: float, rng: np.random.Generator) -> Motion:
    """Closing in ever more slowly, with a pilot's wander."""
    y, z = (random_wave(rng, [(0.02, 0.09), (0.008, 0.23)]) for _ in range(2))
    roll, pitch, yaw = (random_wave(rng, [(0.035, 0.07), (0.012, 0.31)]) for _ in range(3))

    def move(t: float) -> Placement:
        part = min(1.0, t / ((1.0 - SETTLED) * duration))
        closeness = math.sin(0.5 * math.pi * part)
        attitude = (roll(t), 0.4 * pitch(t), 0.4 * yaw(t))
        return Placement(*attitude, 0.0, y(t), z(t), closeness)

    return move


_MOTIONS: dict[str, Motion] = {
    'still': lambda time: Placement(),
    'translation': _translation,
    'roll': _roll,
    'roll_translation': _roll_translation,
    'roll_360': lambda time: Placement(roll=2 * math.pi * time / ROLL_PERIOD),
    'crossing': _crossing,
}
_RANDOM_MOTIONS = {'erratic': _erratic, 'docking': _docking}
"""Made for a duration (s) with a generator."""
