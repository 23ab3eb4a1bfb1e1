"""CDR, the bytes in which DDS carries and bags keep a message; rows of points, and statuses, in it.

By way of rclpy's objects a frame's results take longer than finding the markers, and the padding
holds chance bytes of memory.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from functools import lru_cache
from itertools import chain
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.messages.untrusted import MalformedMessageError
from mvuav_ros.vision.image import ImageError

_ENCAPSULATION = b'\0\1\0\0'  # Plain CDR, little endian
MAX_NAME = 1024
"""Bytes; a longer frame_id or encoding is damage, and is not carried on into every result."""
_ORDERS = {b'\0\0': '>', b'\0\1': '<', b'\0\6': '>', b'\0\7': '<'}
"""Of numbers, by how plain CDR of version 1 and 2 begins."""
_LENGTH = struct.Struct('<I')
_STAMP = struct.Struct('<iI')
STAMP_START, STAMP_END = len(_ENCAPSULATION), len(_ENCAPSULATION) + _STAMP.size
"""Where it is in a message that begins with a header, bytes."""
_STAMPS = {start: struct.Struct(f'{order}iI') for start, order in _ORDERS.items()}
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
        data = self._data
        data += bytes(-len(data) % 4)
        data += _text(text)

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


def cdr_header(stamp_ns: int, frame_id: str) -> bytes:
    """The beginning of a message whose first field is a std_msgs/Header."""
    return _ENCAPSULATION + _STAMP.pack(*divmod(stamp_ns, 1_000_000_000)) + _text(frame_id)


def stamped_doubles(header: bytes, *values: float) -> bytes:
    """A message of a header and doubles, such as PointStamped and PoseWithCovarianceStamped."""
    padding = bytes((len(_ENCAPSULATION) - len(header)) % 8)
    return b''.join((header, padding, struct.pack(f'<{len(values)}d', *values)))


@lru_cache(maxsize=512)
def _text(text: str) -> bytes:
    """A string where it begins at a whole word; most come in every frame."""
    encoded = text.encode()
    return b'%b%b\0' % (_LENGTH.pack(len(encoded) + 1), encoded)


def without_encapsulation(message: bytes) -> bytes:
    """A message's fields, to become part of another one."""
    return message[len(_ENCAPSULATION) :]


class CdrReader:
    """Walks through a message's CDR bytes; alignment counts from the end of the encapsulation."""

    def __init__(self, message: bytes | memoryview) -> None:
        start = bytes(message[:2])
        if len(message) < len(_ENCAPSULATION) or start not in _ORDERS:
            raise ImageError(f'{len(message)} bytes, {start.hex()} first, are no plain CDR message')
        self._order, self._view = _ORDERS[start], memoryview(message)
        self._position = len(_ENCAPSULATION)

    def numbers(self, layout: str) -> tuple[Any, ...]:
        """Numbers of one size each aligned to it, such as ``II`` or ``3d``."""
        size = _SIZES[layout[-1]]
        position = self._position + -(self._position - len(_ENCAPSULATION)) % size
        layout = self._order + layout
        try:
            self._position = position + struct.calcsize(layout)
            return struct.unpack_from(layout, self._view, position)
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
        """The stamp (ns) and frame of the std_msgs/Header with which the message begins."""
        stamp_ns = stamp_ns_in(self._view)
        self._position = STAMP_END
        return stamp_ns, self.text('frame_id')


def stamp_ns_in(message: bytes | memoryview) -> int:
    """The stamp (ns) of any message in CDR that begins with a header.

    Raises:
        ImageError: the bytes are no such message.
    """
    try:
        # Not by a `CdrReader`, as every image waits for this.
        sec, nanosec = _STAMPS[bytes(message[:2])].unpack_from(message, STAMP_START)
    except (KeyError, struct.error):
        raise ImageError(f'{len(message)} bytes are no plain CDR message with a stamp') from None
    if nanosec >= 1_000_000_000:
        raise ImageError(f'the stamp has {nanosec} nanoseconds in a second')
    return int(sec * 1_000_000_000 + nanosec)


_NUMBERS = {1: 'i1', 2: 'u1', 3: 'i2', 4: 'u2', 5: 'i4', 6: 'u4', 7: 'f4', 8: 'f8'}
"""NumPy's names of sensor_msgs/PointField's datatypes."""
_MAX_FIELDS = 256


def view_points(message: Any) -> NDArray[np.void]:
    """The points of a PointCloud2 as a structured array that looks into its data.

    Of a field that is an array it is the first number.
    Fields may lie in any order but not over each other: so the values are never more than the
    bytes of the message.

    Raises:
        MalformedMessageError: its fields are not like that, or its data are too few.
    """
    end = 0
    if len(message.fields) > _MAX_FIELDS:
        raise MalformedMessageError(f'it has {len(message.fields)} fields')
    for field in sorted(message.fields, key=lambda each: each.offset):
        if field.datatype not in _NUMBERS:
            raise MalformedMessageError(f'its field {field.name} is no number')
        if field.offset < end:
            raise MalformedMessageError(f'its field {field.name} lies over another one')
        end = field.offset + np.dtype(_NUMBERS[field.datatype]).itemsize * max(field.count, 1)
    if end > message.point_step or message.point_step == 0:
        raise MalformedMessageError(f'its points are longer than {message.point_step} bytes')
    count = message.width * message.height
    if count * message.point_step > len(message.data):
        raise MalformedMessageError(f'it lacks some of its {count} points')
    names = [field.name for field in message.fields]
    if len(set(names)) < len(names) or '' in names:
        raise MalformedMessageError('two of its fields have one name')
    order = '>' if message.is_bigendian else '<'
    dtype = np.dtype(
        {
            'names': names,
            'formats': [order + _NUMBERS[field.datatype] for field in message.fields],
            'offsets': [field.offset for field in message.fields],
            'itemsize': message.point_step,
        }
    )
    return np.frombuffer(message.data, dtype, count=count)


_DATATYPES = {np.dtype(np.float32): 7, np.dtype(np.uint8): 2}
"""FLOAT32 and UINT8 of sensor_msgs/PointField."""


class PointLayout:
    """The fields of a PointCloud2 whose rows begin with x, y and z."""

    def __init__(self, dtype: np.dtype[np.void]) -> None:
        """Prepare to write rows of a structured dtype of float32 and uint8 members."""
        assert dtype.fields is not None
        members = [(name, *field[:2]) for name, field in dtype.fields.items()]
        row, end = '<', 0
        for _, member, offset in members:
            row += f'{offset - end}x{member.char}'
            end = offset + member.itemsize
        self._row = struct.Struct(f'{row}{dtype.itemsize - end}x')
        writer = CdrWriter(b'')
        writer.numbers('I', len(members))
        for name, member, offset in members:
            writer.text(name)
            writer.numbers('I', offset)
            writer.numbers('B', _DATATYPES[member])
            writer.numbers('I', 1)  # count
        writer.numbers('B', False)  # is_bigendian
        self._fields = writer.beginning()
        self._starts: dict[int, bytes] = {}

    def encode(self, rows: Sequence[Sequence[float]], header: bytes) -> bytes:
        """A PointCloud2 in CDR: a row per point, with a number for each field.

        ``is_dense`` says whether every x, y and z is a number.
        """
        pack, finite = self._row.pack, math.isfinite
        is_dense = all(finite(x) and finite(y) and finite(z) for x, y, z, *_ in rows)
        start = self._starts.get(len(rows)) or self._start(len(rows))
        points = [pack(*row) for row in rows]
        return behind_header(header, b''.join((start, *points, bytes([is_dense]))))

    def _start(self, rows: int) -> bytes:
        """All between the header and as many rows: the same from message to message."""
        writer = CdrWriter(b'')
        writer.numbers('II', 1, rows)
        writer.written(self._fields)
        writer.numbers('II', self._row.size, self._row.size * rows)
        writer.numbers('I', self._row.size * rows)
        self._starts[rows] = writer.beginning()
        return self._starts[rows]


OK, WARN, ERROR = 0, 1, 2
"""Of diagnostic_msgs/DiagnosticStatus."""


class Status(NamedTuple):
    """A diagnostic_msgs/DiagnosticStatus, its values as text."""

    level: int
    name: str
    message: str
    values: dict[str, str]


def behind_header(header: bytes, fields: bytes) -> bytes:
    """A message of a `cdr_header` and fields that need an alignment to 4 bytes at most."""
    padding, end = bytes(-len(header) % 4), bytes(-len(fields) % 4)
    return b''.join((header, padding, fields, end))


def status_fields(statuses: Sequence[Status]) -> bytes:
    """A DiagnosticArray in CDR without its header; `behind_header` completes it."""
    data = bytearray(_LENGTH.pack(len(statuses)))
    for level, name, message, values in statuses:
        data.append(level)
        for text in (name, message, ''):  # no hardware_id
            data += bytes(-len(data) % 4)
            data += _text(text)
        data += bytes(-len(data) % 4)
        data += _LENGTH.pack(len(values))
        for text in chain.from_iterable(values.items()):
            data += bytes(-len(data) % 4)
            data += _text(text)
    return bytes(data)


def texts(**values: float | bool) -> dict[str, str]:
    """Values as a reader of ``ros2 topic echo`` sees them."""
    return {
        key: f'{value:.4f}' if isinstance(value, float) else str(value).lower()
        for key, value in values.items()
    }
