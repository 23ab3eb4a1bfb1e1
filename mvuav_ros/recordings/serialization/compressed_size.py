"""The size of a JPEG or PNG from its header, before anything is decompressed or allocated."""

from __future__ import annotations

import struct
from typing import Any

_PNG_START = b'\x89PNG\r\n\x1a\n\0\0\0\rIHDR'
_JPEG_START = b'\xff\xd8'
_JPEG_FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_JPEG_WITHOUT_LENGTH = frozenset({0x01, *range(0xD0, 0xD8)})
_JPEG_SCAN, _JPEG_END = 0xDA, 0xD9
_MOST_SEGMENTS = 10_000


def compressed_size(data: Any) -> tuple[int, int] | None:
    """Width and height of a JPEG or PNG in pixels; None of anything else.

    Args:
        data: the file's bytes, as bytes, array.array or a flat uint8 array; not copied.
    """
    view = memoryview(data).cast('B') if len(data) else memoryview(b'')
    if bytes(view[: len(_PNG_START)]) == _PNG_START:
        return _unpack('>II', view, len(_PNG_START))
    if bytes(view[:2]) == _JPEG_START:
        return _jpeg_size(view)
    return None


def _jpeg_size(view: memoryview) -> tuple[int, int] | None:
    position = len(_JPEG_START)
    for _ in range(_MOST_SEGMENTS):
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
            size = _unpack('>HH', view, position + 5)
            return None if size is None else (size[1], size[0])
        position += 2 + int.from_bytes(view[position + 2 : position + 4], 'big')
    return None


def _unpack(layout: str, view: memoryview, offset: int) -> tuple[int, int] | None:
    if offset + struct.calcsize(layout) > len(view):
        return None
    first, second = struct.unpack_from(layout, view, offset)
    return first, second
