"""Images straight from and to the bytes of DDS, in CDR.

rclpy copies an image twice more and builds Python objects for it when it makes a message of it.
A raw subscription and the views below leave the pixels where rclpy put the bytes; everything else
of the message is looked at before it is believed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from mvuav_ros.recordings.serialization.cdr import CdrReader, CdrWriter
from mvuav_ros.vision.image import Image


@dataclass(slots=True)
class SerializedImage:
    """The fields of a sensor_msgs/Image, ``data`` being a view."""

    stamp_ns: int
    frame_id: str
    height: int
    width: int
    encoding: str
    is_bigendian: int
    step: int
    data: Any


@dataclass(slots=True)
class SerializedCompressedImage:
    """The fields of a sensor_msgs/CompressedImage, ``data`` being a view."""

    stamp_ns: int
    frame_id: str
    format: str
    data: Any


def stamp_ns_in(message: bytes) -> int:
    """The stamp (ns) of any serialized message that begins with a header.

    Raises:
        ImageError: the bytes are no such message.
    """
    return CdrReader(message).header()[0]


def view_image(message: bytes | memoryview) -> SerializedImage:
    """Read a serialized sensor_msgs/Image without copying its pixels.

    Raises:
        ImageError: the bytes are no such message.
    """
    reader = CdrReader(message)
    stamp_ns, frame_id = reader.header()
    height, width = reader.numbers('II')
    encoding = reader.text('encoding')
    (is_bigendian,) = reader.numbers('B')
    (step,) = reader.numbers('I')
    return SerializedImage(
        stamp_ns, frame_id, height, width, encoding, is_bigendian, step, reader.octets()
    )


def view_compressed_image(message: bytes | memoryview) -> SerializedCompressedImage:
    """Read a serialized sensor_msgs/CompressedImage without copying its data.

    Raises:
        ImageError: the bytes are no such message.
    """
    reader = CdrReader(message)
    stamp_ns, frame_id = reader.header()
    return SerializedCompressedImage(stamp_ns, frame_id, reader.text('format'), reader.octets())


def serialize_image(image: Image, header: bytes) -> bytes:
    """An image as a serialized sensor_msgs/Image behind a `cdr_header`, its pixels copied once.

    rclpy publishes the bytes as they are; by way of a message object the pixels are copied three
    times before they reach DDS. They are little endian and without row padding.
    """
    pixels = np.ascontiguousarray(image.pixels)
    data = pixels.data.cast('B')
    writer = CdrWriter(header)
    writer.numbers('II', image.height, image.width)
    writer.text(image.encoding)
    is_bigendian = False
    writer.numbers('B', is_bigendian)
    writer.numbers('II', pixels.strides[0], len(data))
    start = writer.beginning()
    return b''.join((start, data, bytes(-(len(start) + len(data)) % 4)))


def serialize_compressed_image(kind: str, data: bytes, header: bytes) -> bytes:
    """A serialized sensor_msgs/CompressedImage of a kind such as ``jpeg`` behind a `cdr_header`."""
    writer = CdrWriter(header)
    writer.text(kind)
    writer.octets(data)
    return writer.message()
