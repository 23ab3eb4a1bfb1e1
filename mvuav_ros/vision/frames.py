"""The frames of REP-103, and rotations between them.

Bodies and the world: x forward, y left, z up. A camera's optical frame: x right, y down, z ahead.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

Matrix = NDArray[np.float64]
Vector = NDArray[np.float64]
Array = TypeVar('Array', bound=NDArray[Any])

OPTICAL_FROM_BODY: Matrix = np.array([(0.0, -1.0, 0.0), (0.0, 0.0, -1.0), (1.0, 0.0, 0.0)])
"""The one matrix from a body's axes to the optical axes of a camera that looks along its x."""

NED_FROM_ENU: Matrix = np.array([(0.0, 1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, -1.0)])
FLU_FROM_FRD: Matrix = np.diag([1.0, -1.0, -1.0])
"""An aircraft's axes (x forward, y right, z down) as REP-103 has them."""


_GIMBAL_LOCK = 1e-9  # rad off straight up or down, below which rounding would decide roll and yaw
_MAX_OFF_ROTATION = 0.01  # of the products of a rotation's axes


def about_x(angle: float) -> Matrix:
    """Rotation by ``angle`` (rad) about x."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([(1.0, 0.0, 0.0), (0.0, c, -s), (0.0, s, c)])


def about_y(angle: float) -> Matrix:
    """Rotation by ``angle`` (rad) about y."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([(c, 0.0, s), (0.0, 1.0, 0.0), (-s, 0.0, c)])


def about_z(angle: float) -> Matrix:
    """Rotation by ``angle`` (rad) about z."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([(c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0)])


def from_rpy(roll: float, pitch: float, yaw: float) -> Matrix:
    """World from body for REP-103's fixed-axis angles (rad).

    Positive are: roll right wing down, pitch nose down, yaw nose left.
    """
    return about_z(yaw) @ about_y(pitch) @ about_x(roll)


def rpy(rotation: Matrix) -> tuple[float, float, float]:
    """The inverse of `from_rpy`; straight up or down roll and yaw are one turn, and yaw is 0."""
    pitch = math.asin(max(-1.0, min(1.0, -float(rotation[2, 0]))))
    if math.hypot(rotation[2, 1], rotation[2, 2]) < _GIMBAL_LOCK:
        return math.atan2(-rotation[1, 2], rotation[1, 1]), pitch, 0.0
    roll = math.atan2(rotation[2, 1], rotation[2, 2])
    return roll, pitch, math.atan2(rotation[1, 0], rotation[0, 0])


def given_rotation(matrix: Any) -> Matrix:
    """A copy of what a program gives as a rotation.

    Raises:
        ValueError: it is none.
    """
    given = np.array(matrix, np.float64)
    is_one = given.shape == (3, 3) and np.abs(given @ given.T - np.eye(3)).max() < _MAX_OFF_ROTATION
    if not (is_one and np.linalg.det(given) > 0.0):
        raise ValueError(f'not a (3, 3) rotation matrix: {given.tolist()!r:.200}')
    return given


def quaternion(rotation: Matrix) -> tuple[float, float, float, float]:
    """A rotation matrix as x, y, z, w with w >= 0 (Shepperd: the largest part first)."""
    m = rotation.tolist()
    parts = (m[0][0], m[1][1], m[2][2])
    trace = sum(parts)
    if trace > max(parts):
        s = 2.0 * math.sqrt(max(1.0 + trace, 0.0))
        return (m[2][1] - m[1][2]) / s, (m[0][2] - m[2][0]) / s, (m[1][0] - m[0][1]) / s, 0.25 * s
    i = parts.index(max(parts))
    j, k = (i + 1) % 3, (i + 2) % 3
    s = 2.0 * math.sqrt(max(1.0 + m[i][i] - m[j][j] - m[k][k], 0.0))
    q = [0.0, 0.0, 0.0]
    q[i], q[j], q[k] = 0.25 * s, (m[j][i] + m[i][j]) / s, (m[k][i] + m[i][k]) / s
    w = (m[k][j] - m[j][k]) / s
    sign = -1.0 if w < 0.0 else 1.0
    return sign * q[0], sign * q[1], sign * q[2], sign * w


def from_quaternion(x: float, y: float, z: float, w: float) -> Matrix:
    """The inverse of `quaternion`, of any length; NaN for 0."""
    return from_unit_quaternion(*np.array((x, y, z, w)) / (math.hypot(x, y, z, w) or math.nan))


def from_unit_quaternion(x: float, y: float, z: float, w: float) -> Matrix:
    """The inverse of `quaternion`; the length is taken for 1."""
    return np.array(
        [
            (1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
            (2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
            (2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)),
        ]
    )


@dataclass(frozen=True)
class Attitude:
    """Orientation of the body (x forward, y left, z up) in a level world with z up (REP 103).

    It is a unit quaternion; ``sigma`` is the standard deviation of roll and of pitch, rad. Where
    ``sensor`` names a frame, it is that frame's orientation (REP 145), as the sensor is mounted.

    Examples:
        >>> from mvuav_ros.vision.frames import Attitude
        >>> Attitude.from_roll_pitch(0.0, 0.0).w
        1.0
    """

    x: float
    y: float
    z: float
    w: float
    sigma: float = 0.0  # where none is stated
    sensor: str = field(default='', kw_only=True)

    @classmethod
    def from_roll_pitch(cls, roll: float, pitch: float) -> Attitude:
        """Of REP 103's angles, rad: right wing down and nose down are positive."""
        return cls(*quaternion(from_rpy(roll, pitch, 0.0)))

    @property
    def valid(self) -> bool:
        """It is a unit quaternion, to within rounding."""
        length = math.hypot(self.x, self.y, self.z, self.w)
        return math.isfinite(length) and abs(length - 1.0) < 0.02

    @property
    def up(self) -> Vector:
        """The world's upward direction in the body's axes."""
        x, y, z, w = self.x, self.y, self.z, self.w
        scale = 2.0 / max(x * x + y * y + z * z + w * w, 1e-12)
        return np.array(
            [scale * (x * z - w * y), scale * (y * z + w * x), 1 - scale * (x * x + y * y)]
        )


def east_north_up(
    position: Vector, rotation: Matrix, covariance: Matrix, heading_deg: float
) -> tuple[Vector, Matrix, Matrix]:
    """A vehicle's pose from a runway's axes (x along it, y left, z up) in east, north and up.

    Args:
        position: (3,), m.
        rotation: (3, 3), from the vehicle's axes.
        covariance: (6, 6), of the position and of small turns about the axes.
        heading_deg: the direction of landing, from true north, clockwise.

    Examples:
        >>> import numpy as np
        >>> east_north_up(np.array([-100.0, 0.0, 5.0]), np.eye(3), np.eye(6), 90.0)[0].round()
        array([-100.,    0.,    5.])
    """
    turn = about_z(math.radians(90.0 - heading_deg))
    both = np.kron(np.eye(2), turn)
    return turn @ position, turn @ rotation, both @ covariance @ both.T


def north_east_down(
    position: Vector, rotation: Matrix, covariance: Matrix
) -> tuple[Vector, Matrix, Vector, Vector]:
    """A pose in east, north and up as PX4 takes it (VehicleOdometry).

    Returns:
        Position in north, east and down, m; these axes from the forward-right-down body; the
        variances of the position (m²) and of turns about the body's axes (rad²), (3,) each.
    """
    turned = NED_FROM_ENU @ rotation @ FLU_FROM_FRD
    about_body = rotation @ FLU_FROM_FRD
    return (
        NED_FROM_ENU @ position,
        turned,
        np.diag(NED_FROM_ENU @ covariance[:3, :3] @ NED_FROM_ENU.T),
        np.diag(about_body.T @ covariance[3:, 3:] @ about_body),
    )


def read_only(array: Array) -> Array:
    """Forbid writing to what several frames share."""
    array.setflags(write=False)
    return array
