"""Fields of ROS messages, whatever library made them (rclpy, rosbags); imports no ROS."""

from __future__ import annotations

from functools import cache
from typing import Any

from mvuav_ros.vision.approach.attitude import Attitude
from mvuav_ros.vision.camera import CameraModel


@cache
def type_name(kind: type) -> str:
    """A message class as ``pkg/msg/Type``."""
    return f'{kind.__module__.split(".")[0]}/msg/{kind.__name__}'


def stamp_ns_of(header: Any) -> int:
    """The stamp of a std_msgs/Header, ns."""
    return int(header.stamp.sec) * 1_000_000_000 + int(header.stamp.nanosec)


def decode_camera_info(message: Any) -> CameraModel:
    """The calibration of a sensor_msgs/CameraInfo, usable or not (see `CameraModel.check`)."""
    return CameraModel(
        width=int(message.width),
        height=int(message.height),
        k=tuple(float(value) for value in message.k),
        d=tuple(float(value) for value in message.d),
        distortion_model=str(message.distortion_model),
    )


def decode_imu(message: Any) -> Attitude | None:
    """The orientation of a sensor_msgs/Imu; None where it says that it has none, or a wrong one.

    That it has none, it says as REP 145 has it.
    """
    if float(message.orientation_covariance[0]) == -1.0:
        return None
    given = message.orientation
    attitude = Attitude(float(given.x), float(given.y), float(given.z), float(given.w))
    return attitude if attitude.valid else None
