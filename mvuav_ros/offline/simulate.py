"""A simulated frame as the messages of a recording: image, calibration and truth."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from geometry_msgs.msg import PoseStamped, Vector3Stamped
from rclpy.serialization import serialize_message
from sensor_msgs.msg import CameraInfo, Image, Imu, PointCloud2

from mvuav_ros.offline.simulation_truth import (
    encode_true_lines,
    encode_true_markers,
    encode_true_pose,
    encode_true_rpy,
)
from mvuav_ros.processing.messages.camera_info_encoding import encode_camera_info
from mvuav_ros.processing.messages.header import make_header
from mvuav_ros.processing.messages.imu_encoding import encode_imu
from mvuav_ros.recordings.serialization.cdr import cdr_header
from mvuav_ros.recordings.serialization.serialized_image import serialize_image
from mvuav_ros.recordings.serialization.type_name import type_name
from mvuav_ros.simulation.attitude_sensor import measured_attitude
from mvuav_ros.simulation.flight import SimulatedFrame
from mvuav_ros.simulation.runway_truth import RunwayTruth
from mvuav_ros.simulation.tanker_truth import TankerTruth
from mvuav_ros.vision.camera import CameraModel


def truth_messages(
    frame: SimulatedFrame[Any], camera: CameraModel, frame_id: str, seed: int = 0
) -> Iterator[tuple[str, str, bytes]]:
    """Topic, type and CDR bytes of each message of one frame.

    Args:
        frame: of a flight.
        camera: its calibration.
        frame_id: of the camera, which is the body as well.
        seed: of the flight, for the errors of its attitude sensor.
    """
    header = cdr_header(frame.stamp_ns, frame_id)
    info = encode_camera_info(camera, make_header(frame.stamp_ns, frame_id))
    truth = frame.truth
    yield '/camera_info', type_name(CameraInfo), serialize_message(info)
    if isinstance(truth, RunwayTruth):
        attitude = measured_attitude(truth.pose, seed, frame.stamp_ns)
        imu = encode_imu(attitude, make_header(frame.stamp_ns, frame_id))
        yield '/imu', type_name(Imu), serialize_message(imu)
    yield '/image_raw', type_name(Image), serialize_image(frame.image, header)
    yield '/truth/pose', type_name(PoseStamped), encode_true_pose(truth, header)
    if isinstance(truth, TankerTruth):
        yield '/truth/markers', type_name(PointCloud2), encode_true_markers(truth, header)
        yield '/truth/rpy', type_name(Vector3Stamped), encode_true_rpy(truth, header)
    elif isinstance(truth, RunwayTruth):
        yield '/truth/lines', type_name(PointCloud2), encode_true_lines(truth, header)
