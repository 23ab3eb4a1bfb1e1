"""ROS 1 message types as their bag defines them, and their conversion to CDR."""

from __future__ import annotations

from rosbags.serde import SerdeError
from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore

from mvuav_ros.recordings.recording import Schema

_HEADER = 'std_msgs/msg/Header'
_HEADER_DEFINITION = 'builtin_interfaces/Time stamp\nstring frame_id\n'


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
            types = get_types_from_msg(definition, name)
            if _HEADER in types:
                types.update(get_types_from_msg(_HEADER_DEFINITION, _HEADER))
            for builtin in self._store.fielddefs:
                types.pop(builtin, None)
            self._store.register(types)
            text, _ = self._store.generate_msgdef(name, ros_version=2)
            self._store.get_msgdef(name)
        except (TypesysError, KeyError, ValueError, SyntaxError, AssertionError) as error:
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
