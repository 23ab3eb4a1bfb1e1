"""What is true of a synthetic flight, in the form of the nodes' own results."""

from __future__ import annotations

import math

import numpy as np
from geometry_msgs.msg import Point, Pose, PoseStamped, Quaternion, Vector3, Vector3Stamped
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header

from mvuav_ros.messages.markers import POINT
from mvuav_ros.messages.points import encode_points, point_fields
from mvuav_ros.messages.runway import LINE
from mvuav_ros.simulation.runway_truth import RunwayTruth
from mvuav_ros.simulation.tanker_truth import TankerTruth
from mvuav_ros.vision.markers.model import MarkerState


def encode_true_markers(truth: TankerTruth, header: Header) -> PointCloud2:
    """As ``~/markers``; a light that cannot be seen has state 2 (predicted) and its true place."""
    points = _unknown(len(truth.markers), POINT)
    for index, (row, marker) in enumerate(zip(points, truth.markers, strict=True)):
        row['x'], row['y'], row['z'] = marker.x, marker.y, marker.x * 0.0
        row['vx'], row['vy'] = marker.vx, marker.vy
        row['label'] = index
        row['state'] = MarkerState.DETECTED if marker.visible else MarkerState.PREDICTED
    return encode_points(points, point_fields(POINT), header)


def encode_true_rpy(truth: TankerTruth, header: Header) -> Vector3Stamped:
    """As ``~/rpy``: x is the roll between the wings as projected, rad."""
    return Vector3Stamped(header=header, vector=Vector3(x=truth.roll, y=math.nan, z=math.nan))


def encode_true_lines(truth: RunwayTruth, header: Header) -> PointCloud2:
    """As ``~/line_params``: left edge, right edge, centreline, far end, near end."""
    lines = _unknown(len(truth.lines), LINE)
    for row, line in zip(lines, truth.lines, strict=True):
        row['x'], row['y'], row['z'] = line.x1, line.y1, line.x1 * 0.0
        row['x2'], row['y2'] = line.x2, line.y2
        row['rho'] = row['rho_raw'] = line.rho
        row['theta'] = row['theta_raw'] = line.theta
        if 'role' in (LINE.names or ()):
            row['role'] = line.role
    return encode_points(lines, point_fields(LINE), header)


def encode_true_pose(truth: TankerTruth | RunwayTruth, header: Header) -> PoseStamped:
    """The tanker in the camera's optical frame, or the camera in the runway's frame; m."""
    if isinstance(truth, TankerTruth):
        position, rotation = truth.translation, truth.rotation
    else:
        position, rotation = truth.pose.position, truth.pose.rotation
    x, y, z = (float(value) for value in position)
    qx, qy, qz, qw = (float(value) for value in Rotation.from_matrix(rotation).as_quat())
    return PoseStamped(
        header=header,
        pose=Pose(position=Point(x=x, y=y, z=z), orientation=Quaternion(x=qx, y=qy, z=qz, w=qw)),
    )


def _unknown(count: int, dtype: np.dtype[np.void]) -> NDArray[np.void]:
    """Rows with NaN in every floating-point field and 0 in the others."""
    rows = np.zeros(count, dtype)
    for name, (member, *_) in (dtype.fields or {}).items():
        if np.issubdtype(member, np.floating):
            rows[name] = np.nan
    return rows
