"""The messages that a bag holds of a frame which comes from none, as of a simulated flight."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import partial

from geometry_msgs.msg import PoseStamped, Vector3Stamped
from sensor_msgs.msg import PointCloud2

from mvuav_ros.messages.cdr import PointLayout, cdr_header, stamped_doubles
from mvuav_ros.messages.images import IMAGE, Frame, serialize_image
from mvuav_ros.messages.marker_messages import encode_markers
from mvuav_ros.messages.runway_messages import LINE
from mvuav_ros.messages.sensors import CAMERA_INFO, IMU, encode_camera_info, encode_imu, type_name
from mvuav_ros.parameters.runway_detector import RunwayDetectorParameters
from mvuav_ros.simulation.runway_flight import RunwayTruth
from mvuav_ros.simulation.tanker_flight import TankerTruth
from mvuav_ros.vision.frames import OPTICAL_FROM_BODY, quaternion
from mvuav_ros.vision.markers.marker_results import Marker, MarkerResult, MarkerState

Message = tuple[str, str, Callable[[], bytes]]
"""Topic, type, and what makes its CDR."""
_LINES = PointLayout(LINE)


def frame_messages(frame: Frame) -> Iterator[Message]:
    """What is known of a frame: its calibration, attitude, image and truth."""
    header = cdr_header(frame.stamp_ns, frame.frame_id)
    if frame.camera is not None:
        yield '/camera_info', CAMERA_INFO, partial(encode_camera_info, frame.camera, header)
    if frame.attitude is not None:
        sensor = cdr_header(frame.stamp_ns, frame.attitude.sensor)
        yield '/imu', IMU, partial(encode_imu, frame.attitude, sensor)
    yield '/image_raw', IMAGE, partial(serialize_image, frame.image, header)
    if isinstance(frame.truth, TankerTruth):
        yield from _tanker_messages(frame.truth, header)
    elif frame.truth is not None:
        yield from _runway_messages(frame.truth, frame.stamp_ns, header)


def _tanker_messages(truth: TankerTruth, header: bytes) -> Iterator[Message]:
    """In the form of the node's own results; the pose is in the camera's optical frame, m."""
    pose = *truth.translation, *quaternion(truth.rotation)
    yield '/truth/pose', type_name(PoseStamped), partial(stamped_doubles, header, *pose)
    yield '/truth/markers', type_name(PointCloud2), partial(_true_markers, truth, header)
    rpy = truth.roll, math.nan, math.nan
    yield '/truth/rpy', type_name(Vector3Stamped), partial(stamped_doubles, header, *rpy)


def _runway_messages(truth: RunwayTruth, stamp_ns: int, header: bytes) -> Iterator[Message]:
    """The same; the pose is that of the camera's body axes in the runway's frame."""
    above = cdr_header(stamp_ns, RunwayDetectorParameters().runway_frame)
    pose = *truth.pose.position, *quaternion(truth.pose.rotation @ OPTICAL_FROM_BODY)
    yield '/truth/pose', type_name(PoseStamped), partial(stamped_doubles, above, *pose)
    yield '/truth/lines', type_name(PointCloud2), partial(_encode_lines, truth, header)


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
