"""One file of a recording, whatever its storage: topics, messages, and the way to those wanted."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Container, Hashable, Iterable, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from pathlib import Path
from typing import BinaryIO, NamedTuple

from mvuav_ros.messages.definitions import Ros1Type, Schema, UnknownTypeError, ros1_type
from mvuav_ros.messages.untrusted import words
from mvuav_ros.recordings.account import Account, counted
from mvuav_ros.recordings.compression import Limit, decompress_message
from mvuav_ros.recordings.layout import ZSTD_START


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
    """A channel that is not read, as its messages are not CDR."""

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


READABLE_FORMATS = ('cdr', 'ros1')
UNKNOWN_ROS1 = 'ros1 without a valid definition'
START_OF_TIME, END_OF_TIME = -(1 << 63), 1 << 64
"""ns."""
# From here on a message is given as a view of its chunk, as two copies would take twice the memory.
_LARGE = 1 << 24

_UNKNOWN = 'message', 'of unknown channels skipped'
_MALFORMED = 'malformed message', 'of {} skipped'
_COMPRESSED = 'message', 'of {} cannot be decompressed'
"""Why messages are lost, in words around their topic; their number goes with the first."""

_Definition = tuple[int, str, str, str]
StoredMessage = tuple[int, int | None, int, int | None, bytes | memoryview]
"""Its channel's number, the publisher's number, log and publishing time (ns), and its data."""


@dataclass
class ChunkTally:
    """A chunk on the way: the messages that came out of it, and those that its indexes list."""

    offset: int = -1  # where it begins, bytes; -1 is none
    reason: str = ''  # why it is not read, or not all of it
    got: int = 0  # messages that came out
    indexed: int | None = None  # messages that the indexes behind it list; None without any
    is_index_whole: bool = True  # whether no record behind it may be a damaged index
    listed: int | None = None  # messages that the file's end says it has; None if it says nothing

    def written(self) -> int | None:
        """How many messages were written into it; None if nobody knows.

        What came out of a whole one, its indexes and the file's end are asked, and what two say
        counts. Of a whole one the end alone is not believed, whose numbers have no check.
        """
        indexed = self.indexed if self.is_index_whole else None
        got = None if self.reason else self.got
        said = Counter(n for n in (indexed, self.listed, got) if n is not None)
        number, votes = next(iter(said.most_common(1)), (None, 0))
        if votes < 2 and len(said) > 1:
            number = None if got is None else max(got, indexed or 0)
        return number if number is None else max(number, self.got)


class Channels:
    """Channels by their number, as they are defined on the way through a file.

    Attributes:
        known: each channel's topic by now, and what converts its messages if they are ROS 1's.
        schemas: each schema's type and definition by now, where they have numbers of their own.
        counts: messages of each definition; None if nobody has said or counted them.
        is_contradicted: whether the data define a channel otherwise than the index.
    """

    def __init__(self) -> None:
        self.known: dict[int, tuple[TopicInfo, Ros1Type | None]] = {}
        self.schemas: dict[int, tuple[str, Schema | None]] = {}
        self.counts: Counter[_Definition] | None = None
        self.is_contradicted = False
        self._found: dict[_Definition, TopicInfo] = {}
        self._first: dict[int, tuple[TopicInfo, Ros1Type | None]] = {}

    def __len__(self) -> int:
        return len(self._first)

    def begin(self) -> None:
        """Begin at the file's start: until it defines a channel, the first that is known counts."""
        self.known = dict(self._first)

    def listed(self) -> tuple[TopicInfo, ...]:
        """Every definition with its number of messages."""
        counts = self.counts
        return tuple(
            info if counts is None else replace(info, message_count=counts[key])
            for key, info in self._found.items()
        )

    def count(self, numbers: Iterable[int]) -> None:
        """Count messages by their channels' numbers, of those that are known."""
        self.counts = Counter()
        for number in numbers:
            if number in self.known:
                self.counts[_definition(number, self.known[number][0])] += 1

    def take_counts(self, counts: Mapping[int, int]) -> None:
        """Take the numbers of messages that an index has for each channel."""
        self.counts = Counter({key: counts.get(key[0], 0) for key in self._found})

    def define(self, number: int, topic: TopicInfo) -> str:
        """Take in a definition, and say how it contradicts the channel's last one; '' if not.

        A topic of encoding ``ros1`` has the schema that ROS 1 gives it.
        """
        converter = None
        if topic.serialization_format == 'ros1':
            try:
                converter = ros1_type(topic.type, topic.schema.text if topic.schema else '')
                topic = replace(topic, schema=converter.schema)
            except UnknownTypeError:
                topic = replace(topic, serialization_format=UNKNOWN_ROS1)
        before = self.known.get(number)
        self.known[number] = topic, converter
        self._first.setdefault(number, self.known[number])
        self._found.setdefault(_definition(number, topic), topic)
        if before is None or _meaning(before[0]) == _meaning(topic):
            return ''
        self.is_contradicted = True
        was, now = (f'{words(each.name)} ({words(each.type)})' for each in (before[0], topic))
        return f'channel {number} was said to be {was}, and is {now} in the data'


def _definition(number: int, topic: TopicInfo) -> _Definition:
    return number, topic.name, topic.type, topic.serialization_format


def _meaning(topic: TopicInfo) -> tuple[str, str, str]:
    """What may not change: ROS 1's stays ROS 1's where a definition of its type is damaged."""
    encoding = topic.serialization_format
    return topic.name, topic.type, 'ros1' if encoding == UNKNOWN_ROS1 else encoding


class RecordingFile(ABC):
    """One file of a recording; it is opened anew for every pass."""

    def __init__(self, path: Path, account: Account, limit: Limit) -> None:
        """Take a file; losses go to the account, and what is unpacked of it has a limit."""
        self._path, self._account, self._limit = path, account, limit
        self._message_limit = copy(limit)
        self._channels = Channels()
        self._scanned = self._is_indexed = False
        self._lost: Counter[tuple[tuple[str, str], str]] = Counter()
        # Messages that its index speaks of, once a pass has ended; None without an index.
        self._written: int | None = None

    def channels(self) -> Sequence[TopicInfo]:
        """Every channel, those that are not CDR included; found once, when first asked for."""
        if not self._scanned:
            with self._path.open('rb') as stream:
                self._scan(stream)
            self._scanned = True
        return self._channels.listed()

    def _scan(self, stream: BinaryIO) -> None:
        """Find the channels, by an index or else by a pass through the file."""
        self._is_indexed = self._read_index(stream)
        if self._is_indexed:  # the data must begin likewise
            next(self._pass(stream), None)
        if not self._is_indexed or self._channels.is_contradicted:
            self._is_indexed, self._channels = False, Channels()
            self._channels.count(number for number, *_ in self._pass(stream))

    def _read_index(self, stream: BinaryIO) -> bool:
        """Whether the channels could be taken from an index."""
        raise NotImplementedError

    def _pass(
        self,
        stream: BinaryIO,
        topics: Container[str] | None = None,
        first_ns: int = START_OF_TIME,
        end_ns: int = END_OF_TIME,
    ) -> Iterator[StoredMessage]:
        """The messages, as `_stored` has them, from the file's start."""
        self._channels.begin()
        self._limit.begin()
        return self._stored(stream, topics, first_ns, end_ns)

    @abstractmethod
    def _stored(
        self, stream: BinaryIO, topics: Container[str] | None, first_ns: int, end_ns: int
    ) -> Iterator[StoredMessage]:
        """Every message; of those that are not wanted the data need not be there.

        Chunks that hold no message of the time may be left out.
        """

    def messages(
        self, topics: Container[str] | None, start_ns: int | None, end_ns: int | None
    ) -> Iterator[RecordedMessage]:
        """The messages in stored order, ``start_ns`` <= log time < ``end_ns``, as CDR.

        A pass through all of it ends in a balance of what was written and what was there.
        """
        first = START_OF_TIME if start_ns is None else start_ns
        last = END_OF_TIME if end_ns is None else end_ns
        is_whole = start_ns is None and end_ns is None
        account = self._account
        sound = skipped = 0
        self._lost.clear()
        self._message_limit.begin()
        try:
            self.channels()
            with self._path.open('rb') as stream:
                stored = self._pass(stream, topics, first, last)
                for number, sequence, stamp_ns, publish_ns, raw in stored:
                    channel = self._channels.known.get(number)
                    if channel is None:
                        self._lost[_UNKNOWN, ''] += 1
                        continue
                    topic, converter = channel
                    sound += 1
                    if topic.serialization_format not in READABLE_FORMATS:
                        skipped += 1
                        continue
                    is_wanted = first <= stamp_ns < last
                    is_wanted = is_wanted and (topics is None or topic.name in topics)
                    # What nobody wants is examined as well where there is a balance.
                    data: bytes | memoryview | None = raw
                    is_packed = converter is not None or raw[:4] == ZSTD_START
                    if is_packed and (is_wanted or is_whole):
                        data = self._converted(raw, topic.name, converter, is_wanted)
                    elif is_wanted and len(raw) < _LARGE:
                        data = bytes(raw)
                    if data is None:
                        sound -= 1
                    elif is_wanted:
                        account.kept += 1
                        of = topic.schema, topic.qos, publish_ns, sequence
                        yield RecordedMessage(topic.name, topic.type, stamp_ns, data, *of)
            account.skipped += skipped
        except OSError as error:
            self.lose('io', f'reading ended early: {error.strerror or error}')
            is_whole = False
        self._lose_messages()
        if is_whole:
            account.settle(self._path.name, self._written, sound)

    def _lose_messages(self) -> None:
        for ((noun, why), name), count in self._lost.items():
            self.lose((noun, why, name), f'{counted(count, noun)} {why.format(name)}', count)

    def _converted(
        self, raw: bytes | memoryview, topic: str, converter: Ros1Type | None, is_wanted: bool
    ) -> bytes | memoryview | None:
        """A message of ROS 1, or one that is compressed by itself, as CDR; None if damaged."""
        data: bytes | memoryview | None = raw
        why = _MALFORMED
        if converter is not None and is_wanted:
            data = converter.to_cdr(raw)
        elif converter is not None:
            data = b'' if converter.fits(raw) else None
        if data is not None and data[:4] == ZSTD_START:
            why, data = _COMPRESSED, decompress_message(data, self._message_limit)
        if data is None:
            self._lost[why, topic] += 1
        return data

    def _define(self, number: int, topic: TopicInfo) -> None:
        """Take in a definition, and note a contradiction."""
        if contradiction := self._channels.define(number, topic):
            self.note(contradiction, contradiction)

    def _end(self, chunk: ChunkTally) -> int | None:
        """Say what a chunk lacks, of one that was left out, as nobody wanted it, nothing.

        Returns how many messages were written into it, None if nobody knows.
        """
        written = chunk.written()
        missing = None if written is None else written - chunk.got
        # What is no record held none.
        if chunk.offset >= 0 and not (missing == 0 and chunk.got) and (chunk.reason or chunk.got):
            how = f'skipped, as {chunk.reason}' if chunk.reason else 'is not all there'
            messages = 'its messages are' if missing is None else counted(missing, 'message')
            said = f'chunk at byte {chunk.offset} {how}: {messages} lost'
            self.lose(chunk.offset, said, missing)
        return written

    def lose(self, key: Hashable, text: str, count: int | None = None) -> None:
        """Say what cannot be read, and how many messages that are; see `Account.lose`."""
        self._account.lose(self._path.name, key, f'{self._path.name}: {text}', count)

    def note(self, key: Hashable, text: str) -> None:
        """Say what is unusual, though nothing is lost by it."""
        self._account.note((self._path.name, key), f'{self._path.name}: {text}')

    def lose_end(self, size: int, count: int | None = None) -> None:
        """Say that so many bytes at the end cannot be read, and how many messages they held."""
        said = f'cut off or damaged; its last {size} bytes cannot be read in full'
        self.lose('end', said, count)
