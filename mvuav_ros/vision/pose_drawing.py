"""A body's axes and where its lights should be, drawn into a canvas."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.pose import Pose
from mvuav_ros.vision.rig import MarkerRig

_AXES = ((60, 60, 255), (80, 220, 80), (255, 140, 60))
"""Red x forward, green y left, blue z up; blue first, as OpenCV has them."""
_CROSS = (255, 255, 255)
_AXIS_PART = 0.4
"""Length of an axis, in reaches of the body."""
_NEAREST = 0.1
_SHIFT = 4


def draw_pose(image: NDArray[np.uint8], pose: Pose, camera: CameraModel, rig: MarkerRig) -> None:
    """Draw the axes at the body's dock point, and a cross at each light's reprojection.

    The image (height, width, 3), blue first, is drawn on.
    """
    origin = np.array(rig.dock)
    length = _AXIS_PART * rig.reach
    tips = origin + length * np.eye(3)
    points = np.vstack((origin, tips)) @ pose.rotation.T + pose.translation
    if points[:, 2].min() > _NEAREST:
        pixels = camera.project(points)
        if np.abs(pixels).max() < 2.0**20:
            start, *ends = (np.round(pixels * 2**_SHIFT)).astype(int).tolist()
            for end, color in zip(ends, _AXES, strict=True):
                cv2.line(image, start, end, color, 2, cv2.LINE_AA, _SHIFT)
    for x, y in pose.reprojections.tolist():
        if abs(x) < 2**20 and abs(y) < 2**20:
            cv2.drawMarker(image, (round(x), round(y)), _CROSS, cv2.MARKER_TILTED_CROSS, 7, 1)
