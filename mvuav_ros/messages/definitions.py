"""Message types as ROS 2 Jazzy defines them, and as ROS 1 bags do."""

from __future__ import annotations

import struct
from contextlib import suppress
from functools import cache, lru_cache
from typing import Any, NamedTuple

from rosbags.interfaces import Nodetype
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from mvuav_ros.messages.sensors import normalised_type
from mvuav_ros.messages.untrusted import MalformedMessageError

_VISION_MSGS = {
    'Point2D': 'float64 x\nfloat64 y',
    'Pose2D': 'Point2D position\nfloat64 theta',
    'BoundingBox2D': 'Pose2D center\nfloat64 size_x\nfloat64 size_y',
    'BoundingBox3D': 'geometry_msgs/Pose center\ngeometry_msgs/Vector3 size',
    'ObjectHypothesis': 'string class_id\nfloat64 score',
    'ObjectHypothesisWithPose': (
        'ObjectHypothesis hypothesis\ngeometry_msgs/PoseWithCovariance pose'
    ),
    **{
        f'Detection{n}': (
            'std_msgs/Header header\nObjectHypothesisWithPose[] results\n'
            f'BoundingBox{n} bbox\nstring id'
        )
        for n in ('2D', '3D')
    },
    **{
        f'Detection{n}Array': f'std_msgs/Header header\nDetection{n}[] detections'
        for n in ('2D', '3D')
    },
}
"""Fields of the messages of ~/detections, which rosbags does not know."""


@cache
def typestore() -> Typestore:
    """Jazzy's own types and `_VISION_MSGS`; made once, as that takes some time."""
    store = get_typestore(Stores.ROS2_JAZZY)
    for name, text in _VISION_MSGS.items():
        store.register(get_types_from_msg(text, f'vision_msgs/msg/{name}'))
    return store


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


_HEADER = 'std_msgs/msg/Header'
_HEADER_DEFINITION = 'builtin_interfaces/Time stamp\nstring frame_id\n'
# The longest that are known (Autoware's) have some thousand lines.
_MAX_DEFINITION = 1 << 17
_MAX_NUMBERS = 100_000
_MAX_DEPTH = 32
_PARSE_ERRORS = (TypesysError, KeyError, ValueError, SyntaxError, AssertionError, RecursionError)
_MISFITS = (IndexError, AssertionError, OverflowError, MemoryError, ValueError, struct.error)
"""What rosbags raises for bytes that are no message of a type."""


class UnknownTypeError(ValueError):
    """A definition that cannot be understood."""


class Ros1Type:
    """A type of a ROS 1 bag; ``schema`` defines what `to_cdr` returns, in ROS 2's words.

    The bag's own definition is used, as ROS 1 and ROS 2 define some types of the same name
    differently. Only the header loses its ``seq``, as ROS 2 has none.
    """

    def __init__(self, name: str, definition: str) -> None:
        self._name = name
        # A store per type: two topics' definitions may contradict each other.
        self._store = get_typestore(Stores.EMPTY)
        try:
            if len(definition) > _MAX_DEFINITION:
                raise ValueError('its definition is implausibly long')
            types: dict[str, Any] = dict(get_types_from_msg(definition, name))
            if _HEADER in types:
                types.update(get_types_from_msg(_HEADER_DEFINITION, _HEADER))
            for builtin in self._store.fielddefs:
                types.pop(builtin, None)
            _check_sizes({**self._store.fielddefs, **types})
            self._store.register(types)
            text, _ = self._store.generate_msgdef(name, ros_version=2)
            self._measured = self._store.get_msgdef(name).getsize_ros1_to_cdr
        except _PARSE_ERRORS as error:
            raise UnknownTypeError(name) from error
        self.schema = Schema('ros2msg', text)

    def to_cdr(self, data: bytes | memoryview) -> bytes | None:
        """A message converted; None where it is not of this type."""
        with suppress(SerdeError, *_MISFITS):
            return bytes(self._store.ros1_to_cdr(data, self._name))
        return None

    def fits(self, data: bytes | memoryview) -> bool:
        """Whether a message is of this type, which takes less time than to convert it."""
        with suppress(SerdeError, *_MISFITS):
            return bool(self._measured(data, 0, None, 0, self._store)[0] == len(data))
        return False


ros1_type = lru_cache(maxsize=1024)(Ros1Type)
"""Makes a type once, however many publishers a topic has; raises UnknownTypeError."""


def _check_sizes(types: dict[str, Any]) -> None:
    """Raise ValueError where a type is none of a message that somebody would record.

    A type that holds itself, or thousands of others, or a sequence of nothing would keep the
    generated converters busy forever.
    """
    known: dict[str, int] = {}
    for name in types:
        if _min_count((Nodetype.NAME, name), types, known) > _MAX_NUMBERS:
            raise ValueError(f'{name} is too complex')


def _min_count(field: Any, types: dict[str, Any], known: dict[str, int], depth: int = 0) -> int:
    """How many values a field holds at least; ``known`` are those of types by now."""
    kind, content = field
    if kind == Nodetype.BASE:
        return 1
    if kind == Nodetype.NAME:
        if content not in known:
            if depth == _MAX_DEPTH:
                raise ValueError(f'{content} contains itself, or is nested too deeply')
            parts = [part for _, part in types[content][1]]
            known[content] = sum(_min_count(part, types, known, depth + 1) for part in parts)
        return known[content]
    item, count = content
    if item[0] == Nodetype.BASE and item[1][0] != 'string':
        return 1
    least = _min_count(item, types, known, depth)
    if least == 0:
        raise ValueError('a sequence of empty elements')
    return least * count if kind == Nodetype.ARRAY else 1


def decode_message(type_name: str, data: bytes | memoryview) -> Any:
    """Decode a message that Jazzy knows, such as Image, CompressedImage or CameraInfo.

    The object has the message's ROS field names; sequences of numbers are read-only NumPy arrays
    that look into ``data``.

    Raises:
        MalformedMessageError: the bytes are not a message of that type.
    """
    try:
        # rosbags takes slices, which copies bytes but not a view.
        return typestore().deserialize_cdr(memoryview(data), normalised_type(type_name))
    except SerdeError as error:
        reason = str(error).rstrip('.')
        raise MalformedMessageError(f'it is no {type_name}: {reason}') from None
    except KeyError:
        raise MalformedMessageError(f'the type {type_name} is not known') from None


class Schema(NamedTuple):
    """A message definition as text; ``encoding`` is 'ros2msg' or 'ros2idl'."""

    encoding: str
    text: str
