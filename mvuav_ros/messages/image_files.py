"""Image files: their size from the header, before anything is decompressed, and their pixels."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from contextlib import suppress
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.image import Image, ImageError

MAX_PIXELS = 1 << 26
"""64 megapixels: beyond this a header is taken for damaged, not for a camera's."""

_PNG_START = b'\x89PNG\r\n\x1a\n\0\0\0\rIHDR'
_JPEG_START = b'\xff\xd8'
_JPEG_FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_JPEG_WITHOUT_LENGTH = frozenset({0x01, *range(0xD0, 0xD8)})
_JPEG_SCAN, _JPEG_END = 0xDA, 0xD9
_MAX_SEGMENTS = 10_000
_TIFF_ORDERS = {b'II*\0': '<', b'MM\0*': '>'}
_TIFF_SIZES = {3: 'H', 4: 'I'}
_TIFF_KIND, _TIFF_WIDTH, _TIFF_HEIGHT = 254, 256, 257
_TIFF_REDUCED, _TIFF_MASK = 1, 4
"""Bits of the kind."""


def compressed_size(data: Any) -> tuple[int, int] | None:
    """Width and height of a JPEG, PNG, WebP or TIFF in pixels; None of anything else.

    ``data`` are bytes, an array.array or a flat uint8 array; they are not copied.
    """
    view = memoryview(data).cast('B') if len(data) else memoryview(b'')
    head = bytes(view[:30])
    with suppress(struct.error):  # it ends too early
        if head.startswith(_PNG_START):
            width, height = struct.unpack_from('>II', head, len(_PNG_START))
            return width, height
        if head.startswith(_JPEG_START):
            return _jpeg_size(view)
        if head[:4] == b'RIFF' and head[8:12] == b'WEBP':
            return _webp_size(head)
    tags = next(_tiff_directories(view), {})
    if {_TIFF_WIDTH, _TIFF_HEIGHT} <= tags.keys():
        return tags[_TIFF_WIDTH], tags[_TIFF_HEIGHT]
    return None


def _webp_size(head: bytes) -> tuple[int, int] | None:
    """By the first chunk: lossy, lossless, or the canvas of the extended format."""
    kind, body = head[12:16], head[20:30]
    if len(body) < 10:
        return None
    if kind == b'VP8X':
        return int.from_bytes(body[4:7], 'little') + 1, int.from_bytes(body[7:10], 'little') + 1
    if kind == b'VP8L':
        bits = int.from_bytes(body[1:5], 'little')
        return (bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1
    if kind == b'VP8 ':
        width, height = struct.unpack_from('<HH', body, 6)
        return width & 0x3FFF, height & 0x3FFF
    return None


def tiff_images(data: Any) -> int:
    """The number of images in a TIFF, without reduced copies and masks; 0 of anything else."""
    view = memoryview(data).cast('B') if len(data) else memoryview(b'')
    kinds = [tags.get(_TIFF_KIND, 0) for tags in _tiff_directories(view)]
    return sum(not kind & (_TIFF_REDUCED | _TIFF_MASK) for kind in kinds)


def _tiff_directories(view: memoryview) -> Iterator[dict[int, int]]:
    """Each image's whole numbers by their tags, as far as they can be read; none of no TIFF."""
    order = _TIFF_ORDERS.get(bytes(view[:4]))
    if order is None:
        return
    place = 4
    for _ in range(_MAX_SEGMENTS):
        found: dict[int, int] = {}
        try:
            (offset,) = struct.unpack_from(f'{order}I', view, place)
            if offset == 0:
                return
            (count,) = struct.unpack_from(f'{order}H', view, offset)
            place = offset + 2 + 12 * count
            for entry in range(offset + 2, place, 12):
                tag, kind = struct.unpack_from(f'{order}HH', view, entry)
                if kind in _TIFF_SIZES:
                    (found[tag],) = struct.unpack_from(order + _TIFF_SIZES[kind], view, entry + 8)
        except struct.error:
            return
        yield found


def _jpeg_size(view: memoryview) -> tuple[int, int] | None:
    position = len(_JPEG_START)
    for _ in range(_MAX_SEGMENTS):
        if position + 4 > len(view) or view[position] != 0xFF:
            return None
        marker = view[position + 1]
        if marker == 0xFF:
            position += 1
            continue
        if marker in _JPEG_WITHOUT_LENGTH:
            position += 2
            continue
        if marker in (_JPEG_SCAN, _JPEG_END):
            return None
        if marker in _JPEG_FRAMES:
            height, width = struct.unpack_from('>HH', view, position + 5)
            return width, height
        position += 2 + int.from_bytes(view[position + 2 : position + 4], 'big')
    return None


def decode_image_file(data: NDArray[np.uint8]) -> Image:
    """As `decode_file_bytes`, but not of a file whose header claims too many pixels.

    A photograph stands upright, as its EXIF tag says.

    Raises:
        ImageError: the data does not decode.
    """
    size = compressed_size(data)
    if size is not None:
        check_size(*size)
    # With IMREAD_UNCHANGED, which keeps alpha, OpenCV does not look at the tag.
    is_jpeg = bytes(data[:2]) == b'\xff\xd8'
    return decode_file_bytes(data, cv2.IMREAD_ANYCOLOR | cv2.IMREAD_ANYDEPTH if is_jpeg else -1)


def check_size(width: int, height: int) -> None:
    """Raise ImageError of a size (px) that no camera has."""
    if width <= 0 or height <= 0:
        raise ImageError(f'the image is empty ({width} x {height})')
    if width * height > MAX_PIXELS:
        raise ImageError(f'{width} x {height} is more than {MAX_PIXELS >> 20} megapixels')


def decode_file_bytes(data: NDArray[np.uint8], flags: int = cv2.IMREAD_UNCHANGED) -> Image:
    """Decode the bytes of an image file; colours, alpha and 16 bits are kept.

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
    colours = {3: 'bgr', 4: 'bgra'}.get(pixels.shape[2], '') if pixels.ndim == 3 else 'mono'
    return Image(pixels, f'{colours}{16 if pixels.dtype == np.uint16 else 8}')
