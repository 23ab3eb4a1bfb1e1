"""The camera's calibration as the vision library uses it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

# What sensor_msgs/CameraInfo calls them; OpenCV's coefficients are in the same order.
DISTORTION_MODELS = ('plumb_bob', 'rational_polynomial', '')


class CalibrationError(ValueError):
    """A calibration that cannot be used, with the reason."""


@dataclass(frozen=True)
class CameraModel:
    """A pinhole camera with lens distortion, as in sensor_msgs/CameraInfo.

    Attributes:
        width: of the images that it was calibrated with, px.
        height: of these images, px.
        k: the camera matrix, nine numbers, row-major, px.
        d: OpenCV's distortion coefficients, at most 14.
        distortion_model: ``plumb_bob``, ``rational_polynomial`` or empty.

    Examples:
        >>> from mvuav_ros import CameraModel
        >>> camera = CameraModel(640, 480, k=(600, 0, 320, 0, 600, 240, 0, 0, 1))
        >>> camera.check(640, 480)
        >>> camera.check(320, 240)  # doctest: +ELLIPSIS
        Traceback (most recent call last):
        mvuav_ros.vision.camera.CalibrationError: ...
    """

    width: int
    height: int
    k: tuple[float, ...]
    d: tuple[float, ...] = ()
    distortion_model: str = 'plumb_bob'

    @cached_property
    def matrix(self) -> NDArray[np.float64]:
        """K, (3, 3), px."""
        return np.array(self.k, np.float64).reshape(3, 3)

    @cached_property
    def distortion(self) -> NDArray[np.float64]:
        """Distortion coefficients, (n,); five zeros without distortion."""
        return np.array(self.d or (0.0,) * 5, np.float64)

    def check(self, width: int, height: int) -> None:
        """Make sure that images of that size (px) can be measured with this calibration.

        Raises:
            CalibrationError: it is all zeros (uncalibrated), of another size, or not a pinhole
                camera's.
        """
        if len(self.k) != 9 or not np.isfinite(self.k).all() or not np.isfinite(self.d).all():
            raise CalibrationError('camera_info contains values that are not finite')
        if self.k[0] <= 0 or self.k[4] <= 0:
            raise CalibrationError('camera_info is all zeros: the camera is not calibrated')
        if (self.width, self.height) != (width, height):
            raise CalibrationError(
                f'camera_info is for {self.width} x {self.height} px, '
                f'the images are {width} x {height} px'
            )
        if self.distortion_model not in DISTORTION_MODELS:
            raise CalibrationError(
                f'distortion model {self.distortion_model!r} is not one of '
                f'{", ".join(filter(None, DISTORTION_MODELS))}'
            )
