"""Attitude to sensor_msgs/Imu."""

from __future__ import annotations

from sensor_msgs.msg import Imu
from std_msgs.msg import Header

_UNKNOWN = [-1.0, *[0.0] * 8]


def encode_imu(orientation: tuple[float, ...], header: Header) -> Imu:
    """An orientation as a message without rates and accelerations (REP 145).

    Args:
        orientation: x, y, z, w of the body in a level world.
        header: of the message.
    """
    message = Imu(
        header=header,
        angular_velocity_covariance=list(_UNKNOWN),
        linear_acceleration_covariance=list(_UNKNOWN),
    )
    given = message.orientation
    given.x, given.y, given.z, given.w = orientation
    return message
