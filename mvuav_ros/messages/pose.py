"""Poses as messages: ``~/pose``, and ``/tf`` where tf2_msgs is installed."""

from __future__ import annotations

import importlib
import importlib.util
import math
from typing import Any

from geometry_msgs.msg import (
    Point,
    PoseWithCovariance,
    PoseWithCovarianceStamped,
    Quaternion,
    Transform,
    TransformStamped,
    Vector3,
)
from geometry_msgs.msg import Pose as PoseMessage
from std_msgs.msg import Header

from mvuav_ros.vision.pose import Pose

TF_TYPE: Any = None
"""The message of ``/tf``; None where tf2_msgs is not installed."""
if importlib.util.find_spec('tf2_msgs') is not None:
    TF_TYPE = importlib.import_module('tf2_msgs.msg').TFMessage


def encode_pose(pose: Pose | None, header: Header) -> PoseWithCovarianceStamped:
    """The body in the camera's optical frame (m, rad); all NaN where there is no pose."""
    if pose is None:
        unknown = math.nan
        return PoseWithCovarianceStamped(
            header=header,
            pose=PoseWithCovariance(
                pose=PoseMessage(
                    position=Point(x=unknown, y=unknown, z=unknown),
                    orientation=Quaternion(x=unknown, y=unknown, z=unknown, w=unknown),
                ),
                covariance=[unknown] * 36,
            ),
        )
    x, y, z = pose.translation.tolist()
    qx, qy, qz, qw = pose.quaternion
    return PoseWithCovarianceStamped(
        header=header,
        pose=PoseWithCovariance(
            pose=PoseMessage(
                position=Point(x=x, y=y, z=z), orientation=Quaternion(x=qx, y=qy, z=qz, w=qw)
            ),
            covariance=pose.covariance.ravel(),
        ),
    )


def encode_transform(pose: Pose, header: Header, child_frame: str) -> Any:
    """The transform from the camera's frame to the body's; only where there is `TF_TYPE`."""
    x, y, z = pose.translation.tolist()
    qx, qy, qz, qw = pose.quaternion
    transform = TransformStamped(
        header=header,
        child_frame_id=child_frame,
        transform=Transform(
            translation=Vector3(x=x, y=y, z=z), rotation=Quaternion(x=qx, y=qy, z=qz, w=qw)
        ),
    )
    return TF_TYPE(transforms=[transform])
