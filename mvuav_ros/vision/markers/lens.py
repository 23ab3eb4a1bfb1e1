"""From an image's pixels to those of a camera without distortion, and back."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.camera import CalibrationError, CameraModel

Array = NDArray[np.float64]


class Lens:
    """From the pixels of an image to those of a camera without distortion, and back."""

    def __init__(self, size: tuple[int, int], camera: CameraModel | None = None) -> None:
        """For images of a size (px); a camera that is not calibrated for them is not used."""
        if camera is not None:
            try:
                camera.check(*size)
            except CalibrationError:
                camera = None
        self._camera = camera
        # px, of that camera; None where the camera is not calibrated, whose pixels are taken as
        # they are.
        self.focal: float | None = None
        # (2,), its principal point, px.
        self.centre: Array = np.array((0.5 * (size[0] - 1), 0.5 * (size[1] - 1)))
        self.half_diagonal = math.hypot(*size) / 2
        if camera is not None:
            matrix = camera.matrix
            self.focal = math.sqrt(matrix[0, 0] * matrix[1, 1])
            self.centre = matrix[:2, 2].copy()

    def to_ideal(self, pixels: Array) -> Array:
        """(n, 2) px of the image as px without distortion."""
        camera = self._camera
        if camera is None or self.focal is None or not len(pixels):
            return pixels
        return np.asarray(camera.undistort(pixels) * self.focal + self.centre)

    def to_image(self, ideal: Array) -> Array:
        """(n, 2) px without distortion as px of the image."""
        camera = self._camera
        if camera is None or self.focal is None or not len(ideal):
            return ideal
        rays = np.column_stack(((ideal - self.centre) / self.focal, np.ones(len(ideal))))
        # Nothing is seen beyond anyway.
        np.clip(rays[:, :2], -camera.widest, camera.widest, out=rays[:, :2])
        return camera.project(rays)
