"""Poses as messages: ``~/pose``, and ``/tf`` where tf2_msgs is installed."""

from __future__ import annotations

import importlib
import importlib.util
import math
from typing import Any

from mvuav_ros.recordings.serialization.cdr import CdrWriter, without_encapsulation
from mvuav_ros.vision.pose import Pose

TF_TYPE: Any = None
"""The message of ``/tf``; None where tf2_msgs is not installed."""
if importlib.util.find_spec('tf2_msgs') is not None:
    TF_TYPE = importlib.import_module('tf2_msgs.msg').TFMessage


def encode_pose(pose: Pose | None, header: bytes) -> bytes:
    """A PoseWithCovarianceStamped: the body in the camera's optical frame (m, rad).

    All NaN where there is no pose.
    """
    writer = CdrWriter(header)
    if pose is None:
        writer.numbers('43d', *[math.nan] * 43)
    else:
        writer.numbers('7d', *pose.translation.tolist(), *pose.quaternion)
        writer.numbers('36d', *pose.covariance.ravel().tolist())
    return writer.message()


def encode_transform(pose: Pose, header: bytes, child_frame: str) -> bytes:
    """A TFMessage: from the camera's frame to the body's."""
    writer = CdrWriter()
    transforms = 1
    writer.numbers('I', transforms)
    writer.written(without_encapsulation(header))
    writer.text(child_frame)
    writer.numbers('7d', *pose.translation.tolist(), *pose.quaternion)
    return writer.message()
