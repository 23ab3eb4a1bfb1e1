"""ROS 1 message types as their bag defines them, and their conversion to CDR."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore

from mvuav_ros.recordings.recording import Schema

_HEADER = 'std_msgs/msg/Header'
_HEADER_DEFINITION = 'builtin_interfaces/Time stamp\nstring frame_id\n'
# The longest that are known (Autoware's) have some thousand lines.
_LONGEST_DEFINITION = 1 << 17
_MOST_NUMBERS = 100_000
_DEEPEST = 32
_STRING = 'string'
_PARSE_ERRORS = (
    TypesysError,
    KeyError,
    ValueError,
    SyntaxError,
    AssertionError,
    RecursionError,
)
_TYPES_KEPT = 1024


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
            if len(definition) > _LONGEST_DEFINITION:
                raise ValueError('its definition is implausibly long')
            types: dict[str, Any] = dict(get_types_from_msg(definition, name))
            if _HEADER in types:
                types.update(get_types_from_msg(_HEADER_DEFINITION, _HEADER))
            for builtin in self._store.fielddefs:
                types.pop(builtin, None)
            _Sizes({**self._store.fielddefs, **types}).check()
            self._store.register(types)
            text, _ = self._store.generate_msgdef(name, ros_version=2)
            self._store.get_msgdef(name)
        except _PARSE_ERRORS as error:
            raise UnknownTypeError(name) from error
        self.schema = Schema('ros2msg', text)

    def to_cdr(self, data: bytes | memoryview) -> bytes:
        """Convert a message.

        Raises:
            SerdeError: the message is not of this type.
        """
        try:
            return bytes(self._store.ros1_to_cdr(data, self._name))
        except (IndexError, AssertionError, OverflowError, MemoryError, ValueError) as error:
            raise SerdeError(str(error)) from error


@lru_cache(maxsize=_TYPES_KEPT)
def ros1_type(name: str, definition: str) -> Ros1Type:
    """The type, made once however many publishers a topic has.

    Raises:
        UnknownTypeError: the definition cannot be understood.
    """
    return Ros1Type(name, definition)


class _Sizes:
    """The number of values that a message of each type holds at least.

    A type that holds itself, or thousands of others, or a sequence of nothing would keep the
    generated converters busy for ever.
    """

    def __init__(self, types: dict[str, Any]) -> None:
        self._types = types
        self._least: dict[str, int | None] = {}
        self._depth = 0

    def check(self) -> None:
        """Raise ValueError where a type is none of a message that somebody would record."""
        for name in self._types:
            if self._of_type(name) > _MOST_NUMBERS:
                raise ValueError(f'{name} is too complex')

    def _of_type(self, name: str) -> int:
        if name not in self._least:
            self._least[name] = None
            self._depth += 1
            if self._depth > _DEEPEST:
                raise ValueError(f'{name} is nested too deeply')
            self._least[name] = sum(self._of_field(kind) for _, kind in self._types[name][1])
            self._depth -= 1
        least = self._least[name]
        if least is None:
            raise ValueError(f'{name} contains itself')
        return least

    def _of_field(self, field: Any) -> int:
        kind, content = field
        if kind == Nodetype.BASE:
            return 1
        if kind == Nodetype.NAME:
            return self._of_type(content)
        item, count = content
        if item[0] == Nodetype.BASE and item[1][0] != _STRING:
            return 1
        least = self._of_field(item)
        if least == 0:
            raise ValueError('a sequence of empty elements')
        return least * count if kind == Nodetype.ARRAY else 1
