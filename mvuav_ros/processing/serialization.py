"""Messages as CDR bytes that depend on nothing but the message.

rclpy's serialization leaves chance bytes of memory in CDR's padding: the same recording would give
another file every time. rosbags pads with zeros, and takes rclpy's messages except for a few kinds
of values.
"""

from __future__ import annotations

import array
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from rclpy.serialization import serialize_message

from mvuav_ros.recording.schemas import schema_of, typestore

_Change = tuple[str, Callable[[Any], Any]]


def message_type(message: Any) -> str:
    """A message's type as ``pkg/msg/Type``."""
    kind: Any = type(message)
    return _type_name(kind)


def serialize(message: Any) -> bytes:
    """A message's CDR bytes with their header; the message is not to be used any more."""
    kind: Any = type(message)
    name = _type_name(kind)
    if schema_of(name) is None:
        return bytes(serialize_message(message))
    _changed(message)
    return bytes(typestore().serialize_cdr(message, name))


@cache
def _type_name(kind: Any) -> str:
    return f'{kind.__module__.split(".")[0]}/msg/{kind.__name__}'


def _changed(message: Any) -> Any:
    kind: Any = type(message)
    for slot, change in _changes(kind):
        setattr(message, slot, change(getattr(message, slot)))
    return message


@cache
def _changes(kind: Any) -> list[_Change]:
    """The fields of a message class whose values rosbags wants otherwise, and how."""
    changes: list[_Change] = []
    sample = kind()
    for name, type_name in kind.get_fields_and_field_types().items():
        slot = f'_{name}'
        value = getattr(sample, name)
        if type_name == 'octet':
            changes.append((slot, ord))
        elif isinstance(value, array.array):
            changes.append((slot, np.asarray))
        elif type_name.startswith('sequence<') and '/' in type_name:
            changes.append((slot, _change_each))
        elif hasattr(value, 'get_fields_and_field_types') and _changes(value.__class__):
            changes.append((slot, _changed))
    return changes


def _change_each(messages: list[Any]) -> list[Any]:
    for message in messages:
        _changed(message)
    return messages
