"""Where attitude says that the horizon is."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.frames import OPTICAL_FROM_BODY, from_rpy

_STEEPEST = math.radians(80.0)
"""Rad, of the camera's axis against the level; beyond, the horizon is nowhere near the image."""
_BESIDE = 0.05
"""Tangent of the angle between the two points of the horizon from which its slope is taken."""


@dataclass(frozen=True)
class HorizonLine:
    """A straight horizon on the frame: y = row + (x - middle column) tan(slope).

    Attributes:
        row: where it crosses the frame's middle column, px.
        slope: rad, right end down positive; the camera's roll is its negative.
    """

    row: float
    slope: float


@dataclass(frozen=True)
class Attitude:
    """Orientation of the body (x forward, y left, z up) in a level world with z up (REP 103).

    It is a unit quaternion.

    Examples:
        >>> Attitude.from_roll_pitch(0.0, 0.0).w
        1.0
    """

    x: float
    y: float
    z: float
    w: float

    @classmethod
    def from_roll_pitch(cls, roll: float, pitch: float) -> Attitude:
        """Of REP 103's angles, rad: right wing down and nose down are positive."""
        cos_roll, sin_roll = math.cos(roll / 2), math.sin(roll / 2)
        cos_pitch, sin_pitch = math.cos(pitch / 2), math.sin(pitch / 2)
        return cls(
            sin_roll * cos_pitch, cos_roll * sin_pitch, -sin_roll * sin_pitch, cos_roll * cos_pitch
        )

    @property
    def valid(self) -> bool:
        """It is a unit quaternion, to within rounding."""
        length = math.hypot(self.x, self.y, self.z, self.w)
        return math.isfinite(length) and abs(length - 1.0) < 0.02

    @property
    def up(self) -> NDArray[np.float64]:
        """The world's upward direction in the body's axes."""
        x, y, z, w = self.x, self.y, self.z, self.w
        return np.array([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)])


def mount_matrix(rpy_deg: tuple[float, float, float]) -> NDArray[np.float64]:
    """Body axes from the camera's own (x forward, y left, z up), turned about fixed axes."""
    roll, pitch, yaw = (math.radians(angle) for angle in rpy_deg)
    return from_rpy(roll, pitch, yaw)


def horizon_from(
    attitude: Attitude, camera: CameraModel, mount: NDArray[np.float64]
) -> HorizonLine | None:
    """The horizon that a calibrated camera sees, which `mount_matrix` has put on the body.

    None where the camera looks steeply up or down, or the attitude is none.
    """
    if not attitude.valid:
        return None
    up = OPTICAL_FROM_BODY @ (mount.T @ attitude.up)
    axis = np.array([0.0, 0.0, 1.0])
    level = axis - (axis @ up) * up
    if np.linalg.norm(level) < math.cos(_STEEPEST):
        return None
    level /= np.linalg.norm(level)
    right = np.cross(level, up)
    rays = np.stack([level - _BESIDE * right, level + _BESIDE * right])
    if (rays[:, 2] <= 0).any():
        return None
    (x1, y1), (x2, y2) = camera.project(rays)
    if x2 <= x1:
        return None
    slope = (y2 - y1) / (x2 - x1)
    row = y1 + slope * (0.5 * (camera.width - 1) - x1)
    return HorizonLine(float(row), math.atan(slope))
