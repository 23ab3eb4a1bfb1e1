"""CDR, the bytes in which DDS carries and bags keep a message.

By way of rclpy's objects a frame's results take longer than finding the markers, and the padding
holds chance bytes of memory. Written field by field they take a quarter of that, and the same
frame gives the same bytes, live and in a file.
"""

from __future__ import annotations

import struct
from functools import lru_cache

from mvuav_ros.vision.image import ImageError

_ENCAPSULATION = b'\0\1\0\0'  # Plain CDR, little endian
MAX_NAME = 1024
"""Bytes; a longer frame_id or encoding is damage, and is not carried on into every result."""
_BIG_ENDIAN, _LITTLE_ENDIAN = (0, 6), (1, 7)  # Second byte of plain CDR, version 1 and 2
_LENGTH = struct.Struct('<I')
_STAMP = struct.Struct('<iI')
_SIZES = {'B': 1, 'f': 4, 'i': 4, 'I': 4, 'd': 8, 'Q': 8}


class CdrWriter:
    """Writes the fields of a message in their order; padding is zero."""

    __slots__ = ('_data',)

    def __init__(self, start: bytes = _ENCAPSULATION) -> None:
        """Begin a message with some bytes, such as a `cdr_header`."""
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


class CdrReader:
    """Walks through a message's CDR bytes; alignment counts from the end of the encapsulation."""

    def __init__(self, message: bytes | memoryview) -> None:
        if len(message) < len(_ENCAPSULATION) or message[0] != 0:
            raise ImageError(f'{len(message)} bytes are no CDR message')
        if message[1] in _LITTLE_ENDIAN:
            self._order = '<'
        elif message[1] in _BIG_ENDIAN:
            self._order = '>'
        else:
            raise ImageError(f'CDR representation {message[1]} is not known')
        self._view = memoryview(message)
        self._position = len(_ENCAPSULATION)

    def numbers(self, layout: str) -> tuple[int, ...]:
        """Numbers of one size each aligned to it, such as ``II``."""
        size = _SIZES[layout[0]]
        position = self._position + -(self._position - len(_ENCAPSULATION)) % size
        self._position = position + size * len(layout)
        try:
            return struct.unpack_from(self._order + layout, self._view, position)
        except struct.error:
            raise ImageError(f'the message ends after {len(self._view)} bytes') from None

    def text(self, name: str) -> str:
        """A string, `MAX_NAME` at most; ``name`` is for the error."""
        (length,) = self.numbers('I')
        if length > MAX_NAME:
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
