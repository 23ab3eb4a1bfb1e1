"""The raw images of one camera, whose messages differ in stamp and pixels alone."""

from __future__ import annotations

import struct
from typing import Any, NamedTuple

import numpy as np

from mvuav_ros.recordings.serialization.image_decoding import decode_image
from mvuav_ros.recordings.serialization.serialized_image import view_image
from mvuav_ros.vision.image import Image

_STAMP = struct.Struct('<iI')
_STAMP_AT, _STAMP_END = 4, 12
_NS = 1_000_000_000


class _Layout(NamedTuple):
    """What the messages of a camera have in common; `fields` stand between stamp and pixels."""

    size: int
    encapsulation: bytes
    fields: bytes
    frame_id: str
    encoding: str
    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    start: int
    strides: tuple[int, ...]


class RawImageDecoder:
    """Decodes a topic of sensor_msgs/Image.

    What stands before the pixels is read and judged only where the last message had it otherwise.
    """

    def __init__(self) -> None:
        self._layout: _Layout | None = None

    def decode(self, message: bytes) -> tuple[int, str, Image]:
        """The stamp (ns), the frame and the image of a message in CDR, its pixels not copied.

        Raises:
            ImageError: the message is damaged, or its image cannot be used.
        """
        layout = self._layout
        if layout is None or not _has(message, layout):
            return self._read(message)
        seconds, nanoseconds = _STAMP.unpack_from(message, _STAMP_AT)
        if nanoseconds >= _NS:
            return self._read(message)
        pixels: Any = np.ndarray(layout.shape, layout.dtype, message, layout.start, layout.strides)
        return seconds * _NS + nanoseconds, layout.frame_id, Image(pixels, layout.encoding)

    def _read(self, message: bytes) -> tuple[int, str, Image]:
        view = view_image(message)
        image = decode_image(view)
        octets, pixels = np.frombuffer(message, np.uint8), image.pixels
        is_little_endian = message[1] & 1
        if is_little_endian and np.may_share_memory(octets, pixels):
            start = pixels.ctypes.data - octets.ctypes.data
            self._layout = _Layout(
                size=len(message),
                encapsulation=message[:_STAMP_AT],
                fields=message[_STAMP_END:start],
                frame_id=view.frame_id,
                encoding=image.encoding,
                shape=pixels.shape,
                dtype=pixels.dtype,
                start=start,
                strides=pixels.strides,
            )
        return view.stamp_ns, view.frame_id, image


def _has(message: bytes, layout: _Layout) -> bool:
    return (
        len(message) == layout.size
        and message.startswith(layout.encapsulation)
        and message.startswith(layout.fields, _STAMP_END)
    )
