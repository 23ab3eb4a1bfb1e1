"""A body's pose as a message: ``~/pose`` of ``marker_tracker``."""

from __future__ import annotations

import math

from mvuav_ros.recordings.serialization.cdr import CdrWriter
from mvuav_ros.vision.pose import Pose


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
