"""A simulated frame as the messages of a recording: picture, calibration and truth."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from rclpy.serialization import serialize_message

from mvuav_ros.messages.camera_info_encoding import encode_camera_info
from mvuav_ros.messages.header import make_header
from mvuav_ros.messages.image_encoding import encode_image
from mvuav_ros.messages.truth import (
    encode_true_lines,
    encode_true_markers,
    encode_true_pose,
    encode_true_rpy,
)
from mvuav_ros.simulation.flight import SimulatedFrame
from mvuav_ros.simulation.tanker_truth import TankerTruth
from mvuav_ros.vision.camera_model import CameraModel


def truth_messages(
    frame: SimulatedFrame[Any], camera: CameraModel, frame_id: str
) -> Iterator[tuple[str, str, bytes]]:
    """Topic, type and CDR bytes of each message of one frame."""
    header = make_header(frame.stamp_ns, frame_id)
    truth = frame.truth
    messages = {
        '/camera_info': encode_camera_info(camera, header),
        '/image_raw': encode_image(frame.picture, header),
        '/truth/pose': encode_true_pose(truth, header),
    }
    if isinstance(truth, TankerTruth):
        messages['/truth/markers'] = encode_true_markers(truth, header)
        messages['/truth/rpy'] = encode_true_rpy(truth, header)
    else:
        messages['/truth/lines'] = encode_true_lines(truth, header)
    for topic, message in messages.items():
        kind = type(message)
        type_name = f'{kind.__module__.split(".")[0]}/msg/{kind.__name__}'
        yield topic, type_name, serialize_message(message)
