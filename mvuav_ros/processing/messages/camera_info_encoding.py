"""The vision library's camera to sensor_msgs/CameraInfo."""

from __future__ import annotations

from sensor_msgs.msg import CameraInfo
from std_msgs.msg import Header

from mvuav_ros.vision.camera import CameraModel


def encode_camera_info(camera: CameraModel, header: Header) -> CameraInfo:
    """A calibration as a message, without rectification."""
    fx, _, cx, _, fy, cy, *_ = camera.k
    return CameraInfo(
        header=header,
        width=camera.width,
        height=camera.height,
        distortion_model=camera.distortion_model,
        d=list(camera.d),
        k=list(camera.k),
        r=[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        p=[fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
    )
