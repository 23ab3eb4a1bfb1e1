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


class Losses:
    """What could not be read; noting the same loss again (a second pass) changes nothing.

    Of very many losses the first are told.
    """

    def __init__(self) -> None:
        self._texts: dict[Hashable, str] = {}
        self._remarks: dict[Hashable, str] = {}
        self._further = False

    def note(self, key: Hashable, text: str) -> None:
        """Say a loss in words, replacing what was said under the same key."""
        if key in self._texts or len(self._texts) < _MOST_TEXTS:
            self._texts[key] = text
        else:
            self._further = True

    def remark(self, key: Hashable, text: str) -> None:
        """Say in words what is unusual, though nothing is lost by it."""
        if len(self._remarks) < _MOST_TEXTS:
            self._remarks[key] = text

    @property
    def remarks(self) -> list[str]:
        """The remarks in order of discovery."""
        return list(self._remarks.values())

    @property
    def texts(self) -> list[str]:
        """The losses in order of discovery."""
        texts = list(self._texts.values())
        return [*texts, 'and more of that kind'] if self._further else texts


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
