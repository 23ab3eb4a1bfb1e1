"""Images as the bytes of DDS and of recordings, in CDR, without cv_bridge.

rclpy copies an image twice more and builds Python objects for it when it makes a message of it.
A raw subscription and the views below leave the pixels where rclpy put the bytes; everything else
of the message is looked at before it is believed.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.messages.cdr import CdrReader, CdrWriter
from mvuav_ros.messages.image_files import (
    MAX_PIXELS,
    check_size,
    compressed_size,
    decode_file_bytes,
)
from mvuav_ros.messages.sensors import normalised_type
from mvuav_ros.vision.image import ENCODINGS, Image, ImageError

IMAGE = 'sensor_msgs/msg/Image'
COMPRESSED_IMAGE = 'sensor_msgs/msg/CompressedImage'
FFMPEG_PACKET = 'ffmpeg_image_transport_msgs/msg/FFMPEGPacket'
COMPRESSED_VIDEO = 'foxglove_msgs/msg/CompressedVideo'

_TYPES = (IMAGE, COMPRESSED_IMAGE, FFMPEG_PACKET, COMPRESSED_VIDEO)
_CODECS = ('h264', 'hevc', 'vp8', 'vp9', 'av1', 'mpeg4', 'mjpeg')
_OTHER_NAMES = {'h265': 'hevc', 'libx264': 'h264', 'libx265': 'hevc', 'x264': 'h264'}
_MEASURED = ('32FC', '64FC', '32SC', '16SC', '8SC')


class ImageMessage(Protocol):
    """The fields of sensor_msgs/Image that describe the pixels."""

    height: int
    width: int
    encoding: str
    is_bigendian: Any
    step: int
    data: Any


class CompressedImageMessage(Protocol):
    """The fields of sensor_msgs/CompressedImage that describe the pixels."""

    format: str
    data: Any


@dataclass(slots=True)
class RawImage:
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
class CodedImage:
    """A sensor_msgs/CompressedImage, or a packet of a video; ``data`` is a view.

    ``format`` names the codec in the message's own way.
    """

    stamp_ns: int
    frame_id: str
    format: str
    data: Any
    is_video: bool


def is_image_type(type_name: str) -> bool:
    """Whether messages of that type are images, compressed or not, or packets of a video."""
    return normalised_type(type_name) in _TYPES


def codec_of(name: str) -> str:
    """FFmpeg's name of a codec that a message names in one way or another; '' if unknown."""
    name = name.lower().split(';')[0].strip()
    name = _OTHER_NAMES.get(name, name)
    # Encoders' names begin with the codec's: h264_nvenc.
    return next((codec for codec in _CODECS if name.split('_')[0] == codec), '')


def stamp_ns_in(message: bytes | memoryview) -> int:
    """The stamp (ns) of any serialized message that begins with a header.

    Raises:
        ImageError: the bytes are no such message.
    """
    return CdrReader(message).header()[0]


def view_image(message: bytes | memoryview) -> RawImage:
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
    return RawImage(
        stamp_ns, frame_id, height, width, encoding, is_bigendian, step, reader.octets()
    )


def view_coded_image(type_name: str, message: bytes | memoryview) -> CodedImage:
    """Read a serialized CompressedImage, FFMPEGPacket or CompressedVideo, its data not copied.

    Raises:
        ImageError: the bytes are no such message.
    """
    reader = CdrReader(message)
    stamp_ns, frame_id = reader.header()
    kind = normalised_type(type_name)
    if kind == COMPRESSED_VIDEO:
        data = reader.octets()
        return CodedImage(stamp_ns, frame_id, reader.text('format'), data, True)
    if kind == FFMPEG_PACKET:
        _width, _height = reader.numbers('ii')
        encoding = reader.text('encoding')
        _pts = reader.numbers('Q')
        _flags, _is_bigendian = reader.numbers('BB')
        return CodedImage(stamp_ns, frame_id, encoding, reader.octets(), True)
    name = reader.text('format')
    return CodedImage(stamp_ns, frame_id, name, reader.octets(), bool(codec_of(name)))


def decode_image(message: ImageMessage) -> Image:
    """View the message's pixels; copied only where 16 bits are not as this machine has them.

    The image shares memory with ``message.data`` and is not to be written to.

    Raises:
        ImageError: the fields contradict each other, or the encoding is not known.
    """
    height, width, step = int(message.height), int(message.width), int(message.step)
    layout = ENCODINGS.get(message.encoding)
    if layout is None:
        raise ImageError(_unknown_encoding(message.encoding))
    if height <= 0 or width <= 0:
        raise ImageError(f'the image is empty ({width} x {height})')
    if height * width > MAX_PIXELS:
        raise ImageError(f'{width} x {height} is more than {MAX_PIXELS >> 20} megapixels')
    if step < width * layout.pixel_bytes:
        raise ImageError(
            f'step {step} is too short for {width} px of {message.encoding} '
            f'({width * layout.pixel_bytes} bytes)'
        )
    data = _bytes_of(message.data)
    rows = height * 3 // 2 if layout.chroma_below else height
    if len(data) != step * rows:
        raise ImageError(
            f'{width} x {height} {message.encoding} with step {step} needs {step * rows} '
            f'bytes, the message has {len(data)}'
        )
    dtype = np.dtype(layout.dtype)
    strides: tuple[int, ...] = (step, layout.pixel_bytes)
    shape: tuple[int, ...] = (rows, width)
    if layout.channels > 1:
        strides, shape = (*strides, dtype.itemsize), (*shape, layout.channels)
    pixels: NDArray[Any] = np.ndarray(shape, dtype, data.data, strides=strides)
    if dtype.itemsize > 1 and bool(message.is_bigendian) != (sys.byteorder == 'big'):
        pixels = pixels.byteswap()
    elif step % dtype.itemsize:
        pixels = pixels.copy()  # OpenCV wants every number at its own multiple
    return Image(pixels, message.encoding)


def decode_compressed_image(message: CompressedImageMessage) -> Image:
    """Decompress a JPEG, PNG, WebP or TIFF message, whatever its ``format`` says.

    Grey stays ``mono8`` or ``mono16``; colour becomes ``bgr8`` or ``bgra8``.

    Raises:
        ImageError: it is something else, or the data does not decode.
    """
    check_compressed_image(message)
    return decode_file_bytes(_bytes_of(message.data))


def check_compressed_image(message: CompressedImageMessage) -> tuple[int, int]:
    """The width and height (px) that a compressed image claims to have.

    They are read from the file's header before anything is decompressed: a few hundred bytes can
    claim to be gigabytes of pixels.

    Raises:
        ImageError: it is no JPEG, PNG, WebP or TIFF, or too large.
    """
    if 'compresseddepth' in message.format.lower():
        raise ImageError('compressedDepth holds distances, not light')
    data = _bytes_of(message.data)
    size = compressed_size(data)
    if size is None:
        raise ImageError(
            f'{len(data)} bytes of compressed data do not decode: no JPEG, PNG, WebP or TIFF '
            f'(format {message.format[:40]!r})'
        )
    check_size(*size)
    return size


def _unknown_encoding(name: str) -> str:
    if name.startswith(_MEASURED):
        return f'{name[:40]} holds measured values without a full scale, such as distances'
    return f'unknown encoding {name[:40]!r}'


def _bytes_of(data: Any) -> NDArray[np.uint8]:
    """``data`` (array.array, bytes or uint8 array) as a flat uint8 array, not copied."""
    return np.frombuffer(data, np.uint8) if len(data) else np.empty(0, np.uint8)


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
