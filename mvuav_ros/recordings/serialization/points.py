"""sensor_msgs/PointCloud2 as rows, however its fields lie."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.recordings.errors import MalformedMessageError

_NUMBERS = {1: 'i1', 2: 'u1', 3: 'i2', 4: 'u2', 5: 'i4', 6: 'u4', 7: 'f4', 8: 'f8'}
"""NumPy's names of sensor_msgs/PointField's datatypes."""
_MOST_FIELDS = 256


def view_points(message: Any) -> NDArray[np.void]:
    """The points of a PointCloud2 as a structured array that looks into its data.

    Of a field that is an array it is the first number.
    Fields may lie in any order but not over each other: so the values are never more than the
    bytes of the message.

    Raises:
        MalformedMessageError: its fields are not like that, or its data are too few.
    """
    end = 0
    if len(message.fields) > _MOST_FIELDS:
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
