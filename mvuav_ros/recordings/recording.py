"""What a recording consists of, whatever its storage."""

from __future__ import annotations

from collections.abc import Container, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

from mvuav_ros.messages.definitions import Schema
from mvuav_ros.messages.untrusted import MAX_LINE, words
from mvuav_ros.recordings.account import Account


class RecordingError(Exception):
    """A recording that cannot be read or written; one visible line that says what to do."""

    def __init__(self, text: object) -> None:
        super().__init__(words(text, MAX_LINE))


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


@dataclass
class ChunkTally:
    """A chunk on the way: the messages that came out of it, and those that its indexes list.

    Attributes:
        file: that it lies in.
        offset: where it begins, bytes; -1 is none.
        reason: why it is not read, or not all of it.
        got: messages that came out.
        indexed: messages that the indexes behind it list; None if there are none.
    """

    file: str
    offset: int = -1
    reason: str = ''
    got: int = 0
    indexed: int | None = None

    def end(self, account: Account) -> None:
        """Say what is missing; nothing is of a chunk that was left out as nobody wanted it."""
        missing = None if self.indexed is None else max(self.indexed - self.got, 0)
        if self.offset < 0 or not (self.reason or (missing and self.got)):
            return
        if missing == 0 and self.got:  # what is no record held none
            return
        how = f'skipped, as {self.reason}' if self.reason else 'is not all there'
        messages = 'its messages are' if missing is None else counted(missing, 'message')
        said = f'{self.file}: chunk at byte {self.offset} {how}: {messages} lost'
        account.lose(self.file, self.offset, said, missing)


class RecordingFile(Protocol):
    """One file of a recording.

    Attributes:
        written: messages that its index speaks of, once a pass has ended; None without an index.
        sound: messages that the newest pass found whole, wanted or not.
        skipped: those among them that are not ROS's.
    """

    written: int | None
    sound: int
    skipped: int

    def channels(self) -> Sequence[TopicInfo]:
        """Every channel, those that are not CDR included; found once, when first asked for."""

    def messages(
        self, topics: Container[str] | None, start_ns: int | None, end_ns: int | None
    ) -> Iterator[RecordedMessage]:
        """The messages in stored order, ``start_ns`` <= log time < ``end_ns``."""


READABLE_FORMATS = ('cdr', 'ros1')


def counted(count: int, noun: str) -> str:
    """'1 message', '2 messages'."""
    return f'{count} {noun}' if count == 1 else f'{count} {noun}s'
