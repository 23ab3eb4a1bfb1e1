"""Images straight from and to the bytes of DDS, in CDR.

rclpy copies an image twice more and builds Python objects for it when it makes a message of it.
A raw subscription and the views below leave the pixels where rclpy put the bytes; everything else
of the message is looked at before it is believed.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Any

import numpy as np

from mvuav_ros.recordings.serialization.cdr import CdrWriter
from mvuav_ros.vision.image import Image, ImageError

LONGEST_NAME = 1024
"""Bytes; a longer frame_id or encoding is damage, and is not carried on into every result."""

_ENCAPSULATION = 4
_SIZES = {'B': 1, 'i': 4, 'I': 4, 'Q': 8}
_BIG_ENDIAN, _LITTLE_ENDIAN = (0, 6), (1, 7)
"""Second byte of plain CDR, version 1 and 2."""


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


class CdrReader:
    """Walks through a message's CDR bytes; alignment counts from the end of the encapsulation."""

    def __init__(self, message: bytes | memoryview) -> None:
        if len(message) < _ENCAPSULATION or message[0] != 0:
            raise ImageError(f'{len(message)} bytes are no CDR message')
        if message[1] in _LITTLE_ENDIAN:
            self._order = '<'
        elif message[1] in _BIG_ENDIAN:
            self._order = '>'
        else:
            raise ImageError(f'CDR representation {message[1]} is not known')
        self._view = memoryview(message)
        self._position = _ENCAPSULATION

    def numbers(self, layout: str) -> tuple[int, ...]:
        """Numbers of one size each aligned to it, such as ``II``."""
        size = _SIZES[layout[0]]
        position = self._position + -(self._position - _ENCAPSULATION) % size
        self._position = position + size * len(layout)
        try:
            return struct.unpack_from(self._order + layout, self._view, position)
        except struct.error:
            raise ImageError(f'the message ends after {len(self._view)} bytes') from None

    def text(self, name: str) -> str:
        """A string, `LONGEST_NAME` at most; ``name`` is for the error."""
        (length,) = self.numbers('I')
        if length > LONGEST_NAME:
            raise ImageError(f'{name} has {length} bytes')
        return str(self._take(length), 'utf-8', 'replace').split('\0', 1)[0]

    def octets(self) -> memoryview:
        """A sequence of bytes, as a view."""
        (length,) = self.numbers('I')
        return self._take(length)

    def _take(self, length: int) -> memoryview:
        end = self._position + length
        if end > len(self._view):
            raise ImageError(
                f'the message ends after {len(self._view)} bytes, its fields need {end}'
            )
        taken = self._view[self._position : end]
        self._position = end
        return taken

    def header(self) -> tuple[int, str]:
        """The stamp (ns) and frame of a std_msgs/Header."""
        (sec,) = self.numbers('i')
        (nanosec,) = self.numbers('I')
        if nanosec >= 1_000_000_000:
            raise ImageError(f'the stamp has {nanosec} nanoseconds in a second')
        return sec * 1_000_000_000 + nanosec, self.text('frame_id')


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
    """An image as a serialized sensor_msgs/Image, its pixels copied once.

    rclpy publishes the bytes as they are. By way of a message object the pixels are copied three
    times before they reach DDS.

    Args:
        image: is written little endian and without row padding.
        header: `cdr_header`.
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
    """A serialized sensor_msgs/CompressedImage.

    Args:
        kind: its format, such as ``jpeg``.
        data: the compressed image.
        header: `cdr_header`.
    """
    writer = CdrWriter(header)
    writer.text(kind)
    writer.octets(data)
    return writer.message()
