"""What a recording consists of, whatever its storage."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:  # rosbags takes a tenth of a second
    from mvuav_ros.messages.definitions import Schema


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


@dataclass(frozen=True)
class SkippedChannel:
    """A channel that is not read because its messages are not CDR."""

    name: str
    encoding: str


class RecordedMessage(NamedTuple):
    """One message; ``stamp_ns`` is when it was logged, ``data`` is CDR with its header.

    A very large message is a view of the chunk that it lies in. ``publish_ns`` and ``sequence``
    are the publisher's, where the recording has them.
    """

    topic: str
    type: str
    stamp_ns: int
    data: bytes | memoryview
    schema: Schema | None = None
    qos: str = ''
    publish_ns: int | None = None
    sequence: int | None = None


def counted(count: int, noun: str) -> str:
    """'1 message', '2 messages'."""
    return f'{count} {noun}' if count == 1 else f'{count} {noun}s'
