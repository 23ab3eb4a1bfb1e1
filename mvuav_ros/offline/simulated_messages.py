"""Messages of a simulated flight: its images, calibration, attitude and truth."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from geometry_msgs.msg import PoseStamped, Vector3Stamped
from sensor_msgs.msg import PointCloud2

from mvuav_ros.messages.cdr import PointLayout, cdr_header, stamped_doubles
from mvuav_ros.messages.images import IMAGE, OPTICAL_FRAME, serialize_image
from mvuav_ros.messages.marker_messages import encode_markers
from mvuav_ros.messages.runway_messages import LINE
from mvuav_ros.messages.sensors import (
    CAMERA_INFO,
    IMU,
    encode_camera_info,
    encode_imu,
    type_name,
)
from mvuav_ros.parameters.runway_detector import RunwayDetectorParameters
from mvuav_ros.simulation.flight import SimulatedFrame
from mvuav_ros.simulation.runway_flight import ATTITUDE_SIGMA, RunwayTruth, measured_attitude
from mvuav_ros.simulation.tanker_flight import TankerTruth
from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.frames import OPTICAL_FROM_BODY, quaternion
from mvuav_ros.vision.markers.marker_results import Marker, MarkerResult, MarkerState

Message = tuple[str, str, bytes]
"""Topic, type and CDR."""
_LINES = PointLayout(LINE)


def simulated_messages(
    frame: SimulatedFrame[Any], camera: CameraModel, seed: int
) -> Iterator[Message]:
    """All messages of one frame; the seed is the flight's, for its attitude sensor's errors.

    The frame of the camera is that of the body as well.
    """
    header = cdr_header(frame.stamp_ns, OPTICAL_FRAME)
    yield '/camera_info', CAMERA_INFO, encode_camera_info(camera, header)
    if isinstance(frame.truth, RunwayTruth):
        attitude = measured_attitude(frame.truth.pose, seed, frame.stamp_ns)
        yield '/imu', IMU, encode_imu(attitude, ATTITUDE_SIGMA, header)
    yield '/image_raw', IMAGE, serialize_image(frame.image, header)
    yield from truth_messages(frame.stamp_ns, frame.truth)


def truth_messages(stamp_ns: int, truth: TankerTruth | RunwayTruth) -> Iterator[Message]:
    """What is true of one frame, in the form of the nodes' own results.

    The pose is that of the tanker in the camera's optical frame (m), or of the camera's body axes
    in the runway's frame.
    """
    header = cdr_header(stamp_ns, OPTICAL_FRAME)
    if isinstance(truth, TankerTruth):
        pose = stamped_doubles(header, *truth.translation, *quaternion(truth.rotation))
        yield '/truth/pose', type_name(PoseStamped), pose
        yield '/truth/markers', type_name(PointCloud2), _true_markers(truth, header)
        rpy = stamped_doubles(header, truth.roll, math.nan, math.nan)
        yield '/truth/rpy', type_name(Vector3Stamped), rpy
    else:
        above = cdr_header(stamp_ns, RunwayDetectorParameters().runway_frame)
        rotation = truth.pose.rotation @ OPTICAL_FROM_BODY
        pose = stamped_doubles(above, *truth.pose.position, *quaternion(rotation))
        yield '/truth/pose', type_name(PoseStamped), pose
        yield '/truth/lines', type_name(PointCloud2), _encode_lines(truth, header)


def _true_markers(truth: TankerTruth, header: bytes) -> bytes:
    """As ``~/markers``; a light that cannot be seen has state 2 (predicted) and its true place."""
    markers = []
    for label, light in enumerate(truth.markers):
        state = MarkerState.DETECTED if light.visible else MarkerState.PREDICTED
        markers.append(Marker(label, state, light.x, light.y, light.vx, light.vy))
    return encode_markers(MarkerResult(tuple(markers)), header)


def _encode_lines(truth: RunwayTruth, header: bytes) -> bytes:
    """As ``~/line_params``: left edge, right edge, centreline, far end, near end."""
    rows = []
    for line in truth.lines:
        ends, form = (line.x1, line.y1, line.x1 * 0.0, line.x2, line.y2), (line.rho, line.theta)
        flags = 0
        rows.append((*ends, *form, math.nan, *form, flags, line.role, math.nan))
    return _LINES.encode(rows, header)
