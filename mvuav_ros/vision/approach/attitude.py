"""Where attitude says that the horizon is, and the image turned until it is level."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.approach.tuning import ATTITUDE
from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.frames import OPTICAL_FROM_BODY, from_rpy
from mvuav_ros.vision.runway.normal_form import NormalForm


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
        >>> from mvuav_ros.vision.approach.attitude import Attitude
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


def is_upside_down(attitude: Attitude, mount: NDArray[np.float64]) -> bool:
    """Whether a camera on `mount_matrix` would see the ground above the sky: a wrong attitude."""
    up = OPTICAL_FROM_BODY @ (mount.T @ attitude.up)
    return bool(attitude.valid and up[1] > ATTITUDE.min_upside_down)


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
    if np.linalg.norm(level) < math.cos(ATTITUDE.max_pitch):
        return None
    level /= np.linalg.norm(level)
    right = np.cross(level, up)
    rays = np.stack([level - ATTITUDE.half_base * right, level + ATTITUDE.half_base * right])
    if (rays[:, 2] <= 0).any():
        return None
    (x1, y1), (x2, y2) = camera.project(rays)
    if x2 <= x1:
        return None
    slope = (y2 - y1) / (x2 - x1)
    row = y1 + slope * (0.5 * (camera.width - 1) - x1)
    return HorizonLine(float(row), math.atan(slope))


Box = tuple[int, int, int, int]
"""First column and row of a part of an image, and column and row after the last ones."""


@dataclass(frozen=True)
class Derotation:
    """A turn of the working image about its middle.

    Attributes:
        width: of the working image, px.
        height: likewise.
        factor: px of the frame per px of the working image.
        slope: rad, of the horizon on the frame, right end down positive.
    """

    width: int
    height: int
    factor: int
    slope: float

    @property
    def size(self) -> tuple[int, int]:
        """Height and width, px."""
        return self.height, self.width

    @property
    def centre(self) -> tuple[float, float]:
        """About which it is turned, px of the working image."""
        return 0.5 * (self.width - 1), 0.5 * (self.height - 1)

    def turned(self, pixels: NDArray[Any], box: Box | None = None) -> NDArray[Any]:
        """The working image, or a box of it, with a level horizon."""
        left, top, right, bottom = box or (0, 0, self.width, self.height)
        if self.slope == 0.0:
            return pixels[top:bottom, left:right]
        matrix = cv2.getRotationMatrix2D(self.centre, math.degrees(self.slope), 1.0)
        matrix[:, 2] -= left, top
        size = (right - left, bottom - top)
        return np.asarray(cv2.warpAffine(pixels, matrix, size, borderMode=cv2.BORDER_REPLICATE))

    def row_of(self, horizon_row: float) -> float:
        """The level horizon's row, of the row where the slanted one crosses the middle column."""
        _, middle = self.centre
        return middle + (horizon_row - middle) * math.cos(self.slope)

    def to_frame(self, x: Any, y: Any) -> tuple[Any, Any]:
        """Points on the frame, of points on the levelled working image."""
        centre_x, centre_y = self.centre
        cos, sin = self.factor * math.cos(self.slope), self.factor * math.sin(self.slope)
        first_x = self.factor * (centre_x + 0.5) - 0.5 - cos * centre_x + sin * centre_y
        first_y = self.factor * (centre_y + 0.5) - 0.5 - sin * centre_x - cos * centre_y
        return cos * x - sin * y + first_x, sin * x + cos * y + first_y


def line_through(x1: float, y1: float, x2: float, y2: float) -> NormalForm:
    """The line through two points."""
    theta = math.atan2(x2 - x1, -(y2 - y1))
    return NormalForm(x1 * math.cos(theta) + y1 * math.sin(theta), theta).normalised()


def turn_edge(
    p: float, slope: float, row: float, old: Derotation, new: Derotation
) -> tuple[float, float]:
    """An edge x = p + slope (y - row) of one level, described on another one."""
    angle = new.slope - old.slope
    if angle == 0.0:
        return p, slope
    cos, sin = math.cos(angle), math.sin(angle)
    centre_x, centre_y = new.centre
    dx, dy = p - centre_x, row - centre_y
    x, y = centre_x + cos * dx + sin * dy, centre_y - sin * dx + cos * dy
    across, down = cos * slope + sin, cos - sin * slope
    turned = across / down
    return x + turned * (row - y), turned


def turn_strips(strips: NDArray[np.float64], old: Derotation, new: Derotation) -> Any:
    """Strips, (n, 6), of one derotation described on another one."""
    if old.slope == new.slope:
        return strips
    turned = strips.copy()
    for strip in turned:
        x, y, left, right, far, near = (float(value) for value in strip)
        edges = [turn_edge(x + s * near, s, y + near, old, new) for s in (left, right)]
        (first, left), (second, right) = edges
        if right - left > 0.02:
            depth = (second - first) / (right - left)
            apex = first - left * depth, y + near - depth
            strip[:] = (*apex, left, right, depth * far / near, depth)
    return turned
