"""Messages of a simulated flight: its images, calibration, attitude and truth."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from geometry_msgs.msg import PoseStamped, Vector3Stamped
from rclpy.serialization import serialize_message
from sensor_msgs.msg import CameraInfo, Image, Imu, PointCloud2

from mvuav_ros.messages.cdr import PointLayout, cdr_header, stamped_doubles
from mvuav_ros.messages.images import OPTICAL_FRAME, serialize_image
from mvuav_ros.messages.marker_messages import POINT
from mvuav_ros.messages.runway_messages import LINE
from mvuav_ros.messages.sensors import encode_camera_info, encode_imu, make_header, type_name
from mvuav_ros.parameters.runway_detector import RunwayDetectorParameters
from mvuav_ros.simulation.flight import SimulatedFrame
from mvuav_ros.simulation.runway_flight import RunwayTruth, measured_attitude
from mvuav_ros.simulation.tanker_flight import TankerTruth
from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.frames import OPTICAL_FROM_BODY, Matrix, Vector, quaternion
from mvuav_ros.vision.markers.marker_results import MarkerState

Message = tuple[str, str, bytes]
"""Topic, type and CDR."""
_POINTS, _LINES = PointLayout(POINT), PointLayout(LINE)


def simulated_messages(
    frame: SimulatedFrame[Any], camera: CameraModel, seed: int
) -> Iterator[Message]:
    """All messages of one frame; the seed is the flight's, for its attitude sensor's errors.

    The frame of the camera is that of the body as well.
    """
    header = make_header(frame.stamp_ns, OPTICAL_FRAME)
    info = encode_camera_info(camera, header)
    yield '/camera_info', type_name(CameraInfo), serialize_message(info)
    if isinstance(frame.truth, RunwayTruth):
        attitude = measured_attitude(frame.truth.pose, seed, frame.stamp_ns)
        yield '/imu', type_name(Imu), serialize_message(encode_imu(attitude, header))
    image = serialize_image(frame.image, cdr_header(frame.stamp_ns, OPTICAL_FRAME))
    yield '/image_raw', type_name(Image), image
    yield from truth_messages(frame)


def truth_messages(frame: SimulatedFrame[Any]) -> Iterator[Message]:
    """What is true of one frame, in the form of the nodes' own results."""
    header, truth = cdr_header(frame.stamp_ns, OPTICAL_FRAME), frame.truth
    if isinstance(truth, TankerTruth):
        position, rotation = truth.translation, truth.rotation
        yield '/truth/pose', type_name(PoseStamped), _encode_pose(position, rotation, header)
        yield '/truth/markers', type_name(PointCloud2), _encode_markers(truth, header)
        rpy = stamped_doubles(header, truth.roll, math.nan, math.nan)
        yield '/truth/rpy', type_name(Vector3Stamped), rpy
    elif isinstance(truth, RunwayTruth):
        position, rotation = truth.pose.position, truth.pose.rotation @ OPTICAL_FROM_BODY
        above = cdr_header(frame.stamp_ns, RunwayDetectorParameters().runway_frame)
        yield '/truth/pose', type_name(PoseStamped), _encode_pose(position, rotation, above)
        yield '/truth/lines', type_name(PointCloud2), _encode_lines(truth, header)


def _encode_pose(position: Vector, rotation: Matrix, header: bytes) -> bytes:
    """A PoseStamped (m), as the nodes' ``~/pose``.

    The tanker in the camera's optical frame, or the camera's body axes in the runway's frame.
    """
    return stamped_doubles(header, *position, *quaternion(rotation))


def _encode_markers(truth: TankerTruth, header: bytes) -> bytes:
    """As ``~/markers``; a light that cannot be seen has state 2 (predicted) and its true place."""
    unknown = math.nan
    rows = []
    for label, light in enumerate(truth.markers):
        state = MarkerState.DETECTED if light.visible else MarkerState.PREDICTED
        place = (light.x, light.y, light.x * 0.0, light.vx, light.vy)
        rows.append((*place, *(unknown, unknown, unknown), label, state, unknown))
    return _POINTS.encode(rows, header)


def _encode_lines(truth: RunwayTruth, header: bytes) -> bytes:
    """As ``~/line_params``: left edge, right edge, centreline, far end, near end."""
    votes = confidence = math.nan
    flags = 0
    rows = []
    for line in truth.lines:
        ends, form = (line.x1, line.y1, line.x1 * 0.0, line.x2, line.y2), (line.rho, line.theta)
        rows.append((*ends, *form, votes, *form, flags, line.role, confidence))
    return _LINES.encode(rows, header)
