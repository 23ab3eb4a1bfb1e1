"""Message types as ROS 2 Jazzy defines them."""

from __future__ import annotations

from functools import cache

from rosbags.typesys import Stores, TypesysError, get_typestore
from rosbags.typesys.store import Typestore

from mvuav_ros.recordings.recording import Schema


@cache
def typestore() -> Typestore:
    """Jazzy's own types; made once, as that takes some time."""
    return get_typestore(Stores.ROS2_JAZZY)


@cache
def schema_of(type_name: str) -> Schema | None:
    """The definition of a type 'pkg/msg/Type', None if it is not Jazzy's."""
    try:
        text, _ = typestore().generate_msgdef(type_name, ros_version=2)
    except TypesysError:
        return None
    return Schema('ros2msg', text)


@cache
def type_hash(type_name: str) -> str:
    """The hash of a type's definition as ROS 2 makes it, '' if the type is not Jazzy's."""
    try:
        return typestore().hash_rihs01(type_name)
    except KeyError:
        return ''
