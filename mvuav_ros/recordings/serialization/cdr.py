"""Results as CDR, the bytes in which DDS carries and bags keep a message.

By way of rclpy's objects a frame's results take longer than finding the markers, and the padding
holds chance bytes of memory. Written field by field they take a quarter of that, and the same
frame gives the same bytes, live and in a file.
"""

from __future__ import annotations

import struct
from functools import lru_cache

_ENCAPSULATION = b'\0\1\0\0'
"""Plain CDR, little endian."""
_LENGTH = struct.Struct('<I')
_STAMP = struct.Struct('<iI')
_SIZES = {'B': 1, 'f': 4, 'i': 4, 'I': 4, 'd': 8, 'Q': 8}


class CdrWriter:
    """Writes the fields of a message in their order; padding is zero."""

    __slots__ = ('_data',)

    def __init__(self, start: bytes = _ENCAPSULATION) -> None:
        """Begin a message.

        Args:
            start: what it begins with, such as a `cdr_header`.
        """
        self._data = bytearray(start)

    def numbers(self, layout: str, *values: float) -> None:
        """Numbers of one size, such as ``II`` or ``3d``, aligned to it."""
        data = self._data
        if excess := (len(data) - len(_ENCAPSULATION)) % _SIZES[layout[-1]]:
            data += bytes(_SIZES[layout[-1]] - excess)
        data += struct.pack('<' + layout, *values)

    def text(self, text: str) -> None:
        """A string."""
        encoded, data = text.encode(), self._data
        data += bytes(-len(data) % 4)
        data += _LENGTH.pack(len(encoded) + 1)
        data += encoded
        data += b'\0'

    def octets(self, octets: bytes) -> None:
        """A sequence of bytes: their number, and they."""
        self.numbers('I', len(octets))
        self._data += octets

    def written(self, octets: bytes) -> None:
        """Fields that have been written elsewhere, which need an alignment to 4 bytes at most."""
        self._data += bytes(-len(self._data) % 4)
        self._data += octets

    def message(self) -> bytes:
        """All of it, filled up to whole words as DDS hands it on and `ros2 bag record` keeps it."""
        return bytes(self._data) + bytes(-len(self._data) % 4)

    def beginning(self) -> bytes:
        """All of it as it is, for more to come behind it."""
        return bytes(self._data)

    def fields(self) -> bytes:
        """What has been written, to become part of another message."""
        return without_encapsulation(self.beginning())


def cdr_header(stamp_ns: int, frame_id: str) -> bytes:
    """The beginning of a message whose first field is a std_msgs/Header."""
    return _ENCAPSULATION + _STAMP.pack(*divmod(stamp_ns, 1_000_000_000)) + _text(frame_id)


def stamped_doubles(header: bytes, *values: float) -> bytes:
    """A message of a header and doubles, such as PointStamped and PoseWithCovarianceStamped."""
    padding = bytes((len(_ENCAPSULATION) - len(header)) % 8)
    return b''.join((header, padding, struct.pack(f'<{len(values)}d', *values)))


@lru_cache(maxsize=8)
def _text(text: str) -> bytes:
    writer = CdrWriter(b'')
    writer.text(text)
    return writer.beginning()


def without_encapsulation(message: bytes) -> bytes:
    """A message's fields, to become part of another one."""
    return message[len(_ENCAPSULATION) :]
