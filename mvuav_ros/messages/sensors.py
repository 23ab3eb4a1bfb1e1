"""What sensors say as messages: headers, sensor_msgs/CameraInfo and sensor_msgs/Imu."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any

from mvuav_ros.vision.approach.attitude import Attitude
from mvuav_ros.vision.camera import CameraModel

if TYPE_CHECKING:  # reading needs no ROS
    from sensor_msgs.msg import CameraInfo, Imu
    from std_msgs.msg import Header


@cache
def type_name(kind: type) -> str:
    """A message class as ``pkg/msg/Type``."""
    return f'{kind.__module__.split(".")[0]}/msg/{kind.__name__}'


def normalised_type(name: str) -> str:
    """'pkg/Type' as 'pkg/msg/Type'; other names unchanged."""
    parts = name.split('/')
    return f'{parts[0]}/msg/{parts[1]}' if len(parts) == 2 else name


def stamp_ns_of(header: Any) -> int:
    """The stamp of a std_msgs/Header, ns."""
    return int(header.stamp.sec) * 1_000_000_000 + int(header.stamp.nanosec)


def is_rectified_topic(topic: str) -> bool:
    """Whether a topic's name says that its images are rectified, as image_proc's does."""
    words = topic.split('/')
    return any(word.startswith('image_rect') for word in words[-2:])


def decode_camera_info(message: Any, image_topic: str = '') -> CameraModel:
    """The calibration of a sensor_msgs/CameraInfo, usable or not (see `CameraModel.check`).

    It is that of the images as they are: cut to the region of interest, binned, and rectified if
    the name of their topic says so.
    """
    camera = CameraModel(
        width=int(message.width),
        height=int(message.height),
        k=tuple(map(float, message.k)),
        d=tuple(map(float, message.d)),
        distortion_model=str(message.distortion_model),
        r=tuple(map(float, message.r)),
        p=tuple(map(float, message.p)),
        is_rectified=is_rectified_topic(image_topic),
    )
    roi = message.roi
    if roi.width and roi.height:
        part = roi.x_offset, roi.y_offset, roi.width, roi.height
        if part != (0, 0, camera.width, camera.height):
            camera = camera.cropped(*map(int, part))
    binning = max(int(message.binning_x), 1), max(int(message.binning_y), 1)
    return camera if binning == (1, 1) else camera.binned(*binning)


def decode_imu(message: Any) -> Attitude | None:
    """The orientation of a sensor_msgs/Imu; None where it says that it has none, or a wrong one.

    That it has none, it says as REP 145 has it.
    """
    if float(message.orientation_covariance[0]) == -1.0:
        return None
    given = message.orientation
    attitude = Attitude(float(given.x), float(given.y), float(given.z), float(given.w))
    return attitude if attitude.valid else None


CAMERA_INFO = 'sensor_msgs/msg/CameraInfo'
IMU = 'sensor_msgs/msg/Imu'

_UNKNOWN = [-1.0, *[0.0] * 8]
"""REP 145."""


def make_header(stamp_ns: int, frame_id: str) -> Header:
    """The header of a message from its stamp (ns) and frame."""
    from builtin_interfaces.msg import Time
    from std_msgs.msg import Header

    sec, nanosec = divmod(stamp_ns, 1_000_000_000)
    return Header(stamp=Time(sec=sec, nanosec=nanosec), frame_id=frame_id)


def encode_camera_info(camera: CameraModel, header: Header) -> CameraInfo:
    """A calibration as a message; without a rectification it is that of an undistorted image."""
    from sensor_msgs.msg import CameraInfo

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
    from geometry_msgs.msg import Quaternion
    from sensor_msgs.msg import Imu

    x, y, z, w = orientation
    return Imu(
        header=header,
        orientation=Quaternion(x=x, y=y, z=z, w=w),
        angular_velocity_covariance=list(_UNKNOWN),
        linear_acceleration_covariance=list(_UNKNOWN),
    )
