"""Rows of numbers to sensor_msgs/PointCloud2, and back."""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.recordings.serialization.cdr import CdrWriter

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

    def encode(self, rows: Sequence[Sequence[float]], header: bytes) -> bytes:
        """A PointCloud2 in CDR: one row per point.

        ``is_dense`` says whether every x, y and z is a number.

        Args:
            rows: a number for each field.
            header: `cdr_header`.
        """
        pack, step, finite = self._row.pack, self._row.size, math.isfinite
        writer = CdrWriter(header)
        writer.numbers('II', 1, len(rows))
        writer.written(self._fields)
        writer.numbers('II', step, step * len(rows))
        writer.octets(b''.join([pack(*row) for row in rows]))
        writer.numbers('B', all(finite(x) and finite(y) and finite(z) for x, y, z, *_ in rows))
        return writer.message()


def decode_points(message: Any) -> NDArray[np.void]:
    """The rows of a PointCloud2 of float32 and uint8 fields as a structured array."""
    types = {number: dtype for dtype, number in _DATATYPES.items()}
    dtype = np.dtype(
        {
            'names': [field.name for field in message.fields],
            'formats': [types[field.datatype] for field in message.fields],
            'offsets': [field.offset for field in message.fields],
            'itemsize': message.point_step,
        }
    )
    return np.frombuffer(message.data, dtype, count=message.width * message.height)
