"""The simulator's camera: a pinhole with lens distortion, and where it is over the ground."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.parameters.declaration import ParameterError
from mvuav_ros.vision.frames import Matrix, Vector, read_only

Distortion = tuple[float, float, float, float, float]
NO_DISTORTION: Distortion = (0.0, 0.0, 0.0, 0.0, 0.0)
_MAX_COEFFICIENT = 1e6  # of any distortion that a lens might have, and far below what overflows


@dataclass(frozen=True)
class PinholeCamera:
    """A camera in its optical frame: x right, y down, z forward (m).

    Pixels: (0, 0) is the centre of the top-left one. ``distortion`` holds k1, k2, p1, p2, k3 of
    sensor_msgs/CameraInfo's ``plumb_bob``, which are OpenCV's first five coefficients.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: Distortion = NO_DISTORTION

    @classmethod
    def with_field_of_view(
        cls, width: int, height: int, fov_deg: float, distortion: Distortion = NO_DISTORTION
    ) -> PinholeCamera:
        """Square pixels, the axis in the middle of the image.

        The field of view is the horizontal one without distortion, from edge to edge of the frame.

        Raises:
            ParameterError: the distortion folds the image onto itself.
        """
        focal = 0.5 * width / math.tan(math.radians(0.5 * fov_deg))
        camera = cls(width, height, focal, focal, 0.5 * (width - 1), 0.5 * (height - 1), distortion)
        x, y = 0.5 * width / focal, 0.5 * height / focal
        if camera._fold <= x * x + y * y:
            reason = 'folds the image onto itself within the field of view'
            raise ParameterError('distortion', reason)
        return camera

    @cached_property
    def matrix(self) -> Matrix:
        """K, (3, 3), px."""
        rows = [(self.fx, 0.0, self.cx), (0.0, self.fy, self.cy), (0.0, 0.0, 1.0)]
        return read_only(np.array(rows))

    def project(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Where points (n, 3), m, in the optical frame are seen.

        Returns:
            (n, 2), px; NaN for points that are not in front of the camera, or farther from its
            axis than where its distortion would turn back.
        """
        depth = points[:, 2]
        k1, k2, p1, p2, k3 = self.distortion
        with np.errstate(divide='ignore', invalid='ignore'):
            x, y = points[:, 0] / depth, points[:, 1] / depth
            seen = (depth > 0.0) & (x * x + y * y < self._fold)
        if any(self.distortion):
            r2 = x * x + y * y
            radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
            x, y = (
                x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
                y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
            )
        pixels = np.column_stack((self.fx * x + self.cx, self.fy * y + self.cy))
        pixels[~seen] = np.nan
        return pixels

    def contains(self, pixels: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Whether (n, 2) px lie on the frame's pixels; NaN does not."""
        x, y = pixels[:, 0], pixels[:, 1]
        inside = (x >= -0.5) & (x < self.width - 0.5) & (y >= -0.5) & (y < self.height - 0.5)
        return np.asarray(inside, bool)

    @cached_property
    def _fold(self) -> float:
        """Square of the tangent off the axis from where on the image would be folded back."""
        k1, k2, _, _, k3 = self.distortion
        roots = np.roots((7 * k3, 5 * k2, 3 * k1, 1.0))
        return float(roots.real[(roots.imag == 0.0) & (roots.real > 0.0)].min(initial=math.inf))


class CameraPose(NamedTuple):
    """The camera in the runway's frame.

    The frame: origin on the centreline at the near end, x along the centreline towards the far
    end, y left, z up.

    Angles are rad, as in REP-103.
    """

    position: Vector  # (3,), m
    roll: float  # right wing down positive
    pitch: float  # positive looking down
    yaw: float  # positive looking left of the runway's direction
    rotation: Matrix  # (3, 3), runway's from the camera's optical frame


def parse_distortion(text: str) -> Distortion:
    """Read ``k1, k2, p1, p2`` or ``k1, k2, p1, p2, k3``; nothing means no distortion.

    Raises:
        ParameterError: it is anything else.
    """
    if not text.strip():
        return NO_DISTORTION
    try:
        numbers = [float(word) for word in text.replace(',', ' ').split()]
    except ValueError:
        numbers = []
    if len(numbers) not in (4, 5) or not all(abs(number) < _MAX_COEFFICIENT for number in numbers):
        reason = f'takes k1, k2, p1, p2 and perhaps k3, not {text!r}'
        raise ParameterError('distortion', reason)
    k1, k2, p1, p2, k3 = (*numbers, 0.0)[:5]
    return k1, k2, p1, p2, k3
