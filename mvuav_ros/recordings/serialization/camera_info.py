"""sensor_msgs/CameraInfo to the vision library's camera; imports no ROS."""

from __future__ import annotations

from typing import Any

from mvuav_ros.vision.camera import CameraModel


def decode_camera_info(message: Any) -> CameraModel:
    """The calibration as it is, usable or not (see `CameraModel.check`).

    Takes ROS and rosbags messages.
    """
    return CameraModel(
        width=int(message.width),
        height=int(message.height),
        k=tuple(float(value) for value in message.k),
        d=tuple(float(value) for value in message.d),
        distortion_model=str(message.distortion_model),
    )
