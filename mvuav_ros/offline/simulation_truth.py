"""What is true of a synthetic flight, in the form of the nodes' own results."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mvuav_ros.processing.messages.markers import POINT
from mvuav_ros.processing.messages.points import PointLayout
from mvuav_ros.processing.messages.runway import LINE
from mvuav_ros.recordings.serialization.cdr import CdrWriter
from mvuav_ros.simulation.runway_truth import RunwayTruth
from mvuav_ros.simulation.tanker_truth import TankerTruth
from mvuav_ros.vision.markers.results import MarkerState

_POINTS, _LINES = PointLayout(POINT), PointLayout(LINE)


def encode_true_markers(truth: TankerTruth, header: bytes) -> bytes:
    """As ``~/markers``; a light that cannot be seen has state 2 (predicted) and its true place."""
    points = _unknown(len(truth.markers), POINT)
    for index, (row, marker) in enumerate(zip(points, truth.markers, strict=True)):
        row['x'], row['y'], row['z'] = marker.x, marker.y, marker.x * 0.0
        row['vx'], row['vy'] = marker.vx, marker.vy
        row['label'] = index
        row['state'] = MarkerState.DETECTED if marker.visible else MarkerState.PREDICTED
    return _POINTS.encode(points.tolist(), header)


def encode_true_rpy(truth: TankerTruth, header: bytes) -> bytes:
    """As ``~/rpy``: x is the roll between the wings as projected, rad."""
    writer = CdrWriter(header)
    writer.numbers('3d', truth.roll, math.nan, math.nan)
    return writer.message()


def encode_true_lines(truth: RunwayTruth, header: bytes) -> bytes:
    """As ``~/line_params``: left edge, right edge, centreline, far end, near end."""
    lines = _unknown(len(truth.lines), LINE)
    for row, line in zip(lines, truth.lines, strict=True):
        row['x'], row['y'], row['z'] = line.x1, line.y1, line.x1 * 0.0
        row['x2'], row['y2'] = line.x2, line.y2
        row['rho'] = row['rho_raw'] = line.rho
        row['theta'] = row['theta_raw'] = line.theta
        if 'role' in (LINE.names or ()):
            row['role'] = line.role
    return _LINES.encode(lines.tolist(), header)


def encode_true_pose(truth: TankerTruth | RunwayTruth, header: bytes) -> bytes:
    """A PoseStamped (m): the tanker in the camera's frame, or the camera in the runway's."""
    if isinstance(truth, TankerTruth):
        position, rotation = truth.translation, truth.rotation
    else:
        position, rotation = truth.pose.position, truth.pose.rotation
    writer = CdrWriter(header)
    writer.numbers('7d', *position, *Rotation.from_matrix(rotation).as_quat())
    return writer.message()


def _unknown(count: int, dtype: np.dtype[np.void]) -> NDArray[np.void]:
    """Rows with NaN in every floating-point field and 0 in the others."""
    rows = np.zeros(count, dtype)
    for name, (member, *_) in (dtype.fields or {}).items():
        if np.issubdtype(member, np.floating):
            rows[name] = np.nan
    return rows
