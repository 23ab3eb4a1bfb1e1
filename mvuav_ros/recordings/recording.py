"""What a recording consists of, whatever its storage."""

from __future__ import annotations

from collections.abc import Container, Hashable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol


class Schema(NamedTuple):
    """A message definition as text; ``encoding`` is 'ros2msg' or 'ros2idl'."""

    encoding: str
    text: str


@dataclass(frozen=True)
class TopicInfo:
    """One topic of a recording.

    ``type`` is written 'pkg/msg/Type'; ``message_count`` is what the recording's index claims,
    None where there is no index; ``serialization_format`` is 'cdr', or 'ros1' for messages that
    are converted to CDR while they are read; ``qos`` is the publisher's profiles as rosbag2
    wrote them (YAML), empty if unknown.
    """

    name: str
    type: str
    message_count: int | None
    serialization_format: str
    schema: Schema | None = None
    qos: str = ''


class SkippedChannel(NamedTuple):
    """A channel that is not read because its messages are not CDR."""

    name: str
    encoding: str


class RecordedMessage(NamedTuple):
    """One message; ``stamp_ns`` is when it was logged, ``data`` is CDR with its header.

    A very large message is a view of the chunk that it lies in.
    """

    topic: str
    type: str
    stamp_ns: int
    data: bytes | memoryview
    schema: Schema | None = None
    qos: str = ''


class Problems:
    """What is wrong with a recording; the same again (in a second pass) changes nothing.

    Of very many errors the first are told.
    """

    def __init__(self) -> None:
        self._errors: dict[Hashable, str] = {}
        self._warnings: dict[Hashable, str] = {}
        self._further = False

    def error(self, key: Hashable, text: str) -> None:
        """Say what could not be read, replacing what was said under the same key."""
        if key in self._errors or len(self._errors) < _MOST_TEXTS:
            self._errors[key] = text
        else:
            self._further = True

    def warning(self, key: Hashable, text: str) -> None:
        """Say what is unusual, though nothing is lost by it."""
        if len(self._warnings) < _MOST_TEXTS:
            self._warnings[key] = text

    @property
    def errors(self) -> list[str]:
        """The errors in order of discovery."""
        errors = list(self._errors.values())
        return [*errors, 'and more of that kind'] if self._further else errors

    @property
    def warnings(self) -> list[str]:
        """The warnings in order of discovery."""
        return list(self._warnings.values())


class RecordingFile(Protocol):
    """One file of a recording."""

    def channels(self) -> Sequence[TopicInfo]:
        """Every channel, those that are not CDR included; found once, when first asked for."""

    def messages(
        self, topics: Container[str] | None, start_ns: int | None, end_ns: int | None
    ) -> Iterator[RecordedMessage]:
        """The messages in stored order, ``start_ns`` <= log time < ``end_ns``."""


_MOST_TEXTS = 200
READABLE_FORMATS = ('cdr', 'ros1')


def normalised_type(name: str) -> str:
    """'pkg/Type' as 'pkg/msg/Type'; other names unchanged."""
    parts = name.split('/')
    return f'{parts[0]}/msg/{parts[1]}' if len(parts) == 2 else name


def counted(count: int, noun: str) -> str:
    """'1 message', '2 messages'."""
    return f'{count} {noun}' if count == 1 else f'{count} {noun}s'
