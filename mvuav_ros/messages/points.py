"""Rows of numbers to sensor_msgs/PointCloud2, and back, however its fields lie."""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.messages.cdr import CdrWriter
from mvuav_ros.messages.untrusted import MalformedMessageError

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


_DENSE = {False: b'\0', True: b'\1'}
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
        writer = CdrWriter()
        writer.numbers('I', len(members))
        for name, member, offset in members:
            writer.text(name)
            writer.numbers('I', offset)
            writer.numbers('B', _DATATYPES[member])
            count = 1
            writer.numbers('I', count)
        is_bigendian = False
        writer.numbers('B', is_bigendian)
        self._fields = writer.fields()
        self._starts: dict[int, bytes] = {}

    def encode(self, rows: Sequence[Sequence[float]], header: bytes) -> bytes:
        """A PointCloud2 in CDR: a row per point, with a number for each field.

        ``is_dense`` says whether every x, y and z is a number.
        """
        pack, finite = self._row.pack, math.isfinite
        is_dense = all(finite(x) and finite(y) and finite(z) for x, y, z, *_ in rows)
        start = self._starts.get(len(rows)) or self._start(len(rows))
        points = b''.join([pack(*row) for row in rows])
        end = _DENSE[is_dense] + bytes(-(len(points) + 1) % 4)
        return b''.join((header, bytes(-len(header) % 4), start, points, end))

    def _start(self, rows: int) -> bytes:
        """All between the header and as many rows: the same from message to message."""
        writer = CdrWriter(b'')
        writer.numbers('II', 1, rows)
        writer.written(self._fields)
        writer.numbers('II', self._row.size, self._row.size * rows)
        writer.numbers('I', self._row.size * rows)
        self._starts[rows] = writer.beginning()
        return self._starts[rows]


decode_points = view_points
