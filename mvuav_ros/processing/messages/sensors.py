"""What sensors say as messages: headers, sensor_msgs/CameraInfo and sensor_msgs/Imu."""

from __future__ import annotations

from builtin_interfaces.msg import Time
from geometry_msgs.msg import Quaternion
from sensor_msgs.msg import CameraInfo, Imu
from std_msgs.msg import Header

from mvuav_ros.vision.camera import CameraModel

_UNKNOWN = [-1.0, *[0.0] * 8]
"""REP 145."""


def make_header(stamp_ns: int, frame_id: str) -> Header:
    """The header of a message from its stamp (ns) and frame."""
    sec, nanosec = divmod(stamp_ns, 1_000_000_000)
    return Header(stamp=Time(sec=sec, nanosec=nanosec), frame_id=frame_id)


def encode_camera_info(camera: CameraModel, header: Header) -> CameraInfo:
    """A calibration as a message; without a rectification it is that of an undistorted image."""
    fx, _, cx, _, fy, cy, *_ = camera.k
    return CameraInfo(
        header=header,
        width=camera.width,
        height=camera.height,
        distortion_model=camera.distortion_model,
        d=list(camera.d),
        k=list(camera.k),
        r=list(camera.r or (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)),
        p=list(camera.p or (fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0)),
    )


def encode_imu(orientation: tuple[float, ...], header: Header) -> Imu:
    """The body's orientation in a level world (x, y, z, w), without rates and accelerations."""
    x, y, z, w = orientation
    return Imu(
        header=header,
        orientation=Quaternion(x=x, y=y, z=z, w=w),
        angular_velocity_covariance=list(_UNKNOWN),
        linear_acceleration_covariance=list(_UNKNOWN),
    )
