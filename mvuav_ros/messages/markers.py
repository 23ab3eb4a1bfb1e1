"""Marker results as messages: ``~/markers``, ``~/marker/<label>`` and ``~/rpy``."""

from __future__ import annotations

import math

import numpy as np
from geometry_msgs.msg import Point, PointStamped, Vector3, Vector3Stamped
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header

from mvuav_ros.messages.points import encode_points, point_fields
from mvuav_ros.vision.markers.model import Marker, MarkerResult
from mvuav_ros.vision.pose import Pose

POINT = np.dtype(
    [(name, np.float32) for name in ('x', 'y', 'z', 'vx', 'vy', 'ax', 'ay', 'area')]
    + [('label', np.uint8), ('state', np.uint8)]
)
_FIELDS = point_fields(POINT)
NUMBERED_POINT = np.dtype([*POINT.descr, ('id', np.float32)])
"""Rows of ``track_any``: as `POINT`, and the light's number, exact up to 16 million."""
_NUMBERED_FIELDS = point_fields(NUMBERED_POINT)


def encode_markers(result: MarkerResult, header: Header, *, numbered: bool = False) -> PointCloud2:
    """Every marker as one point: px, px/s, px/s², label and state (see INTERFACE in README).

    In ``track_any`` each row ends with the light's number.
    """
    rows = [
        (m.x, m.y, m.x * 0.0, m.vx, m.vy, m.ax, m.ay, m.area, m.label, m.state)
        for m in result.markers
    ]
    if numbered:
        numbers = [(*row, number) for row, number in zip(rows, result.ids, strict=True)]
        return encode_points(np.array(numbers, NUMBERED_POINT), _NUMBERED_FIELDS, header)
    return encode_points(np.array(rows, POINT), _FIELDS, header)


def encode_marker(marker: Marker, header: Header) -> PointStamped:
    """One marker's position, px."""
    return PointStamped(header=header, point=Point(x=marker.x, y=marker.y, z=0.0))


def encode_rpy(result: MarkerResult, header: Header, pose: Pose | None = None) -> Vector3Stamped:
    """Roll, pitch and yaw (rad).

    x is the roll in the picture where the body has wings, as without a pose; else the pose's. y
    and z are the pose's pitch and yaw, NaN without one.
    """
    roll, pitch, yaw = pose.rpy if pose is not None else (math.nan, math.nan, math.nan)
    if result.has_wings:
        roll = float(result.roll)
    return Vector3Stamped(header=header, vector=Vector3(x=roll, y=pitch, z=yaw))
