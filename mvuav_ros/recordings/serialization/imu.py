"""sensor_msgs/Imu to the vision library's attitude; imports no ROS."""

from __future__ import annotations

from typing import Any

from mvuav_ros.vision.approach.attitude import Attitude


def decode_imu(message: Any) -> Attitude | None:
    """The orientation, or None where the message says that it has none (REP 145), or a wrong one.

    Takes ROS and rosbags messages.
    """
    if float(message.orientation_covariance[0]) == -1.0:
        return None
    given = message.orientation
    attitude = Attitude(float(given.x), float(given.y), float(given.z), float(given.w))
    return attitude if attitude.valid else None
