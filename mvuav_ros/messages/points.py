"""Structured NumPy arrays to sensor_msgs/PointCloud2 and back."""

from __future__ import annotations

import array

import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import Header

_DATATYPES = {np.dtype(np.float32): PointField.FLOAT32, np.dtype(np.uint8): PointField.UINT8}


def point_fields(dtype: np.dtype[np.void]) -> list[PointField]:
    """The fields of a structured dtype of float32 and uint8 members."""
    assert dtype.fields is not None
    return [
        PointField(name=name, offset=offset, datatype=_DATATYPES[member], count=1)
        for name, (member, offset, *_) in dtype.fields.items()
    ]


def encode_points(
    points: NDArray[np.void], fields: list[PointField], header: Header
) -> PointCloud2:
    """One row per point; ``is_dense`` says whether every x, y and z is a number."""
    data = array.array('B')
    data.frombytes(points.tobytes())
    position = np.array([points['x'], points['y'], points['z']])
    message = PointCloud2(
        header=header,
        height=1,
        width=len(points),
        fields=fields,
        is_bigendian=False,
        point_step=points.dtype.itemsize,
        row_step=points.dtype.itemsize * len(points),
        is_dense=bool(np.isfinite(position).all()),
    )
    message.data = data
    return message


def decode_points(message: PointCloud2) -> NDArray[np.void]:
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
