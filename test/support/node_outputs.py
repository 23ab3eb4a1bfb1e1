"""A processor's outputs, and images for it, as the messages that a subscriber gets."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from rclpy.serialization import deserialize_message
from sensor_msgs.msg import Image as RosImage

from mvuav_ros.messages.cdr import cdr_header
from mvuav_ros.messages.images import serialize_image
from mvuav_ros.processing.processor import Output, Processor
from mvuav_ros.vision.image import Image


def messages_of(processor: Processor, outputs: Iterable[Output]) -> dict[str, Any]:
    return {
        topic: deserialize_message(make(), processor.message_types[topic])
        for topic, make in outputs
    }


def image_of(image: Image, stamp_ns: int, frame_id: str) -> RosImage:
    return deserialize_message(serialize_image(image, cdr_header(stamp_ns, frame_id)), RosImage)
