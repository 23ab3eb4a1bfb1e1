"""sensor_msgs Image and CompressedImage to images, without cv_bridge.

Works on any object with the message's fields (rclpy's, rosbags'), so it imports no ROS.
"""

from __future__ import annotations

import sys
from typing import Any, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.recordings.serialization.compressed_size import compressed_size
from mvuav_ros.vision.image import ENCODINGS, Image, ImageError

MAX_PIXELS = 1 << 26
"""64 megapixels: beyond this a header is taken for damaged, not for a camera's."""


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


def decode_image(message: ImageMessage) -> Image:
    """View the message's pixels; they are copied only where 16 bits have the other byte order.

    The image shares memory with ``message.data`` and is not to be written to.

    Raises:
        ImageError: the fields contradict each other, or the encoding is not known.
    """
    height, width, step = int(message.height), int(message.width), int(message.step)
    layout = ENCODINGS.get(message.encoding)
    if layout is None:
        raise ImageError(f'unknown encoding {message.encoding[:40]!r}')
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
    if len(data) != step * height:
        raise ImageError(
            f'{width} x {height} {message.encoding} with step {step} needs {step * height} '
            f'bytes, the message has {len(data)}'
        )
    dtype = np.dtype(layout.dtype)
    strides: tuple[int, ...] = (step, layout.pixel_bytes)
    shape: tuple[int, ...] = (height, width)
    if layout.channels > 1:
        strides, shape = (*strides, dtype.itemsize), (*shape, layout.channels)
    pixels: NDArray[Any] = np.ndarray(shape, dtype, data.data, strides=strides)
    if dtype.itemsize > 1 and bool(message.is_bigendian) != (sys.byteorder == 'big'):
        pixels = pixels.byteswap()
    return Image(pixels, message.encoding)


def decode_compressed_image(message: CompressedImageMessage) -> Image:
    """Decompress a JPEG or PNG message.

    Grey stays ``mono8`` or ``mono16``; colour becomes ``bgr8`` or ``bgra8``. The size is read from
    the file's header first: a few hundred bytes can claim to be gigabytes of pixels.

    Raises:
        ImageError: the format is another one, or the data does not decode.
    """
    kind = message.format.lower()
    if 'compresseddepth' in kind or not any(name in kind for name in ('jpeg', 'jpg', 'png')):
        raise ImageError(f'compressed format {message.format[:40]!r} is neither jpeg nor png')
    data = _bytes_of(message.data)
    size = compressed_size(data)
    if size is None:
        raise ImageError(f'{len(data)} bytes of compressed data do not decode: no JPEG or PNG')
    width, height = size
    if width == 0 or height == 0:
        raise ImageError(f'the image is empty ({width} x {height})')
    if width * height > MAX_PIXELS:
        raise ImageError(f'{width} x {height} is more than {MAX_PIXELS >> 20} megapixels')
    return decode_file_bytes(data)


def decode_file_bytes(data: NDArray[np.uint8]) -> Image:
    """Decode the bytes of an image file; colours, alpha and 16-bit grey are kept.

    Raises:
        ImageError: the data does not decode.
    """
    pixels: NDArray[Any] | None
    try:
        pixels = cv2.imdecode(data, cv2.IMREAD_UNCHANGED) if len(data) else None
    except cv2.error as error:
        raise ImageError(f'{len(data)} bytes of compressed data: {error.err}') from error
    if pixels is None:
        raise ImageError(f'{len(data)} bytes of compressed data do not decode')
    if pixels.ndim == 3 and pixels.dtype == np.uint16:
        pixels = np.right_shift(pixels, 8).astype(np.uint8)
    if pixels.ndim == 2:
        encoding = 'mono16' if pixels.dtype == np.uint16 else 'mono8'
    else:
        encoding = 'bgra8' if pixels.shape[2] == 4 else 'bgr8'
    return Image(pixels, encoding)


def _bytes_of(data: Any) -> NDArray[np.uint8]:
    """``data`` (array.array, bytes or uint8 array) as a flat uint8 array, not copied."""
    return np.frombuffer(data, np.uint8) if len(data) else np.empty(0, np.uint8)
