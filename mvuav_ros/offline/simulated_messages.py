"""Messages of a simulated flight: its images, calibration, attitude and truth."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped, Vector3Stamped
from numpy.typing import NDArray
from rclpy.serialization import serialize_message
from sensor_msgs.msg import CameraInfo, Image, Imu, PointCloud2

from mvuav_ros.messages.cdr import CdrWriter, PointLayout, cdr_header
from mvuav_ros.messages.images import serialize_image
from mvuav_ros.messages.marker_messages import POINT
from mvuav_ros.messages.runway_messages import LINE
from mvuav_ros.messages.sensors import encode_camera_info, encode_imu, make_header, type_name
from mvuav_ros.parameters.runway_detector import RunwayDetectorParameters
from mvuav_ros.simulation.flight import SimulatedFrame
from mvuav_ros.simulation.runway_flight import RunwayTruth, measured_attitude
from mvuav_ros.simulation.tanker_flight import TankerTruth
from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.frames import OPTICAL_FROM_BODY, quaternion
from mvuav_ros.vision.markers.results import MarkerState

Message = tuple[str, str, bytes]
"""Topic, type and CDR."""
_POINTS, _LINES = PointLayout(POINT), PointLayout(LINE)


def simulated_messages(
    frame: SimulatedFrame[Any], camera: CameraModel, frame_id: str, seed: int = 0
) -> Iterator[Message]:
    """All messages of one frame; the seed is the flight's, for its attitude sensor's errors.

    The frame of the camera is that of the body as well.
    """
    header = make_header(frame.stamp_ns, frame_id)
    info = encode_camera_info(camera, header)
    yield '/camera_info', type_name(CameraInfo), serialize_message(info)
    if isinstance(frame.truth, RunwayTruth):
        attitude = measured_attitude(frame.truth.pose, seed, frame.stamp_ns)
        yield '/imu', type_name(Imu), serialize_message(encode_imu(attitude, header))
    image = serialize_image(frame.image, cdr_header(frame.stamp_ns, frame_id))
    yield '/image_raw', type_name(Image), image
    yield from truth_messages(frame, frame_id)


def truth_messages(frame: SimulatedFrame[Any], frame_id: str) -> Iterator[Message]:
    """What is true of one frame, in the form of the nodes' own results."""
    header, truth = cdr_header(frame.stamp_ns, frame_id), frame.truth
    yield '/truth/pose', type_name(PoseStamped), _encode_pose(truth, frame.stamp_ns, frame_id)
    if isinstance(truth, TankerTruth):
        yield '/truth/markers', type_name(PointCloud2), _encode_markers(truth, header)
        yield '/truth/rpy', type_name(Vector3Stamped), _encode_rpy(truth, header)
    elif isinstance(truth, RunwayTruth):
        yield '/truth/lines', type_name(PointCloud2), _encode_lines(truth, header)


def _encode_markers(truth: TankerTruth, header: bytes) -> bytes:
    """As ``~/markers``; a light that cannot be seen has state 2 (predicted) and its true place."""
    points = _unknown(len(truth.markers), POINT)
    for index, (row, marker) in enumerate(zip(points, truth.markers, strict=True)):
        row['x'], row['y'], row['z'] = marker.x, marker.y, marker.x * 0.0
        row['vx'], row['vy'] = marker.vx, marker.vy
        row['label'] = index
        row['state'] = MarkerState.DETECTED if marker.visible else MarkerState.PREDICTED
    return _POINTS.encode(points.tolist(), header)


def _encode_rpy(truth: TankerTruth, header: bytes) -> bytes:
    """As ``~/rpy``: x is the roll between the wings as projected, rad."""
    writer = CdrWriter(header)
    writer.numbers('3d', truth.roll, math.nan, math.nan)
    return writer.message()


def _encode_lines(truth: RunwayTruth, header: bytes) -> bytes:
    """As ``~/line_params``: left edge, right edge, centreline, far end, near end."""
    lines = _unknown(len(truth.lines), LINE)
    for row, line in zip(lines, truth.lines, strict=True):
        row['x'], row['y'], row['z'] = line.x1, line.y1, line.x1 * 0.0
        row['x2'], row['y2'] = line.x2, line.y2
        row['rho'] = row['rho_raw'] = line.rho
        row['theta'] = row['theta_raw'] = line.theta
        row['role'] = line.role
    return _LINES.encode(lines.tolist(), header)


def _encode_pose(truth: TankerTruth | RunwayTruth, stamp_ns: int, frame_id: str) -> bytes:
    """A PoseStamped (m), as the nodes' ``~/pose``.

    The tanker in the camera's optical frame, or the camera's body axes in the runway's frame.
    """
    if isinstance(truth, TankerTruth):
        position, rotation = truth.translation, truth.rotation
    else:
        position, rotation = truth.pose.position, truth.pose.rotation @ OPTICAL_FROM_BODY
        frame_id = RunwayDetectorParameters().runway_frame
    writer = CdrWriter(cdr_header(stamp_ns, frame_id))
    writer.numbers('7d', *position, *quaternion(rotation))
    return writer.message()


def _unknown(count: int, dtype: np.dtype[np.void]) -> NDArray[np.void]:
    """Rows with NaN in every floating-point field and 0 in the others."""
    rows = np.zeros(count, dtype)
    for name, (member, *_) in (dtype.fields or {}).items():
        if np.issubdtype(member, np.floating):
            rows[name] = np.nan
    return rows
