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

MAX_PIXELS = 1 << 26  # 64 megapixels: beyond this a header is taken for damaged, not for a camera's


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
    _check_size(*size)
    return size


def decode_image_file(data: NDArray[np.uint8]) -> Image:
    """As `decode_file_bytes`, but not of a file whose header claims too many pixels.

    A photograph stands upright, as its EXIF tag says.

    Raises:
        ImageError: the data does not decode.
    """
    size = compressed_size(data)
    if size is not None:
        _check_size(*size)
    # With IMREAD_UNCHANGED, which keeps alpha, OpenCV does not look at the tag.
    is_jpeg = bytes(data[:2]) == b'\xff\xd8'
    return decode_file_bytes(data, cv2.IMREAD_ANYCOLOR | cv2.IMREAD_ANYDEPTH if is_jpeg else -1)


def _check_size(width: int, height: int) -> None:
    if width == 0 or height == 0:
        raise ImageError(f'the image is empty ({width} x {height})')
    if width * height > MAX_PIXELS:
        raise ImageError(f'{width} x {height} is more than {MAX_PIXELS >> 20} megapixels')


def decode_file_bytes(data: NDArray[np.uint8], flags: int = cv2.IMREAD_UNCHANGED) -> Image:
    """Decode the bytes of an image file; colours, alpha and 16-bit grey are kept.

    Raises:
        ImageError: the data does not decode.
    """
    pixels: NDArray[Any] | None
    try:
        pixels = cv2.imdecode(data, flags) if len(data) else None
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


def _unknown_encoding(name: str) -> str:
    if name.startswith(_MEASURED):
        return f'{name[:40]} holds measured values without a full scale, such as distances'
    return f'unknown encoding {name[:40]!r}'


def _bytes_of(data: Any) -> NDArray[np.uint8]:
    """``data`` (array.array, bytes or uint8 array) as a flat uint8 array, not copied."""
    return np.frombuffer(data, np.uint8) if len(data) else np.empty(0, np.uint8)
