"""Reading one ROS 1 bag (format 2.0) in stored order, whole, cut off or never indexed.

rosbags reads indexed bags only, and keeps the whole index in memory. Here the records are walked
one by one; rosbags parses their headers and converts the messages to CDR.
"""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Container, Iterator, Sequence
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, NamedTuple

from rosbags.rosbag1.reader import Header, ReaderError, RecordType
from rosbags.serde import SerdeError

from mvuav_ros.recordings.compression import SIZE_LIMIT, CompressionError, unpack
from mvuav_ros.recordings.errors import RecordingError
from mvuav_ros.recordings.recording import (
    Problems,
    RecordedMessage,
    TopicInfo,
    counted,
    normalised_type,
)
from mvuav_ros.recordings.ros1_records import (
    MAGIC,
    PARSE_ERRORS,
    VERSION_LINE,
    Record,
    next_chunk,
    record_at,
    stream_of,
)
from mvuav_ros.recordings.ros1_types import Ros1Type, UnknownTypeError, ros1_type

_LARGEST_CONNECTION = 1 << 24
_MOST_CONNECTIONS = 1 << 16
_SINGLE = frozenset({RecordType.CONNECTION, RecordType.MSGDATA})


class _Message(NamedTuple):
    key: int
    stamp_ns: int
    data: memoryview


class Ros1File:
    """One ROS 1 bag; it is opened anew for every pass."""

    def __init__(self, path: Path, problems: Problems) -> None:
        self._path = path
        self._problems = problems
        self._topics: dict[int, TopicInfo] = {}
        self._types: dict[int, Ros1Type] = {}
        self._scanned = False

    def channels(self) -> Sequence[TopicInfo]:
        """Every connection, from the bag's index or else from a pass through it.

        Raises:
            RecordingError: the bag has another version, or is encrypted.
        """
        if not self._scanned:
            with self._path.open('rb') as stream:
                if not self._read_index(stream):
                    self._note('index', 'not indexed (was the recording cut off?)')
                    self._set_counts(Counter(message.key for message in self._contents(stream)))
            self._scanned = True
        return tuple(self._topics.values())

    def messages(
        self, topics: Container[str] | None, start_ns: int | None, end_ns: int | None
    ) -> Iterator[RecordedMessage]:
        """The messages in stored order, ``start_ns`` <= log time < ``end_ns``, as CDR."""
        self.channels()
        unreadable: Counter[str] = Counter()
        with self._path.open('rb') as stream:
            for key, stamp_ns, data in self._contents(stream):
                topic = self._topics.get(key)
                if topic is None:
                    unreadable['unknown topics'] += 1
                    continue
                early = start_ns is not None and stamp_ns < start_ns
                late = end_ns is not None and stamp_ns >= end_ns
                if early or late or (topics is not None and topic.name not in topics):
                    continue
                if key not in self._types:
                    continue
                try:
                    cdr = self._types[key].to_cdr(data)
                except SerdeError:
                    unreadable[topic.name] += 1
                    continue
                yield RecordedMessage(topic.name, topic.type, stamp_ns, cdr, topic.schema)
        for name, count in unreadable.items():
            self._note(name, f'{counted(count, "malformed message")} of {name} skipped')

    def _contents(self, stream: BinaryIO) -> Iterator[_Message]:
        """The message records; connections met on the way are taken in."""
        size = stream.seek(0, 2)
        lost_chunk: tuple[int, str] | None = None
        lost = 0
        position = len(VERSION_LINE)
        while position < size:
            record = record_at(stream, position)
            if record is None or record.size > SIZE_LIMIT:
                found = next_chunk(stream, position + 1, size)
                if found is None:
                    self._note_end(size - position)
                    return
                self._note(
                    position, f'damaged at byte {position}, reading continues at byte {found}'
                )
                position = found
                continue
            available = min(record.size, size - record.data)
            if record.kind == RecordType.IDXDATA and lost_chunk is not None:
                lost += record.size // 12
                self._note_chunk(*lost_chunk, lost)
            elif record.kind == RecordType.CHUNK:
                lost_chunk, lost = None, 0
                stream.seek(record.data)
                try:
                    raw = self._chunk(record, stream, cut=available < record.size)
                except CompressionError as error:
                    lost_chunk = (position, str(error))
                    self._note_chunk(*lost_chunk, None)
                else:
                    yield from self._records(raw)
            elif record.kind in _SINGLE:
                stream.seek(record.data)
                yield from self._record(record, memoryview(stream.read(available)))
            if available < record.size:
                self._note_end(size - position)
                return
            position = record.data + record.size

    def _chunk(self, record: Record, stream: BinaryIO, *, cut: bool) -> memoryview:
        """What a chunk holds; of one that is cut, what there is of it."""
        try:
            compression = record.header.get_string('compression')
            size = record.header.get_uint32('size')
        except ReaderError:
            raise CompressionError('its header is damaged') from None
        if size > SIZE_LIMIT:
            raise CompressionError(f'it is larger than 1 GB ({size} bytes)')
        raw, problem = unpack(stream, record.size, compression, size, size)
        if not problem and len(raw) != size:
            problem = 'its size is wrong'
        if problem and not cut:
            raise CompressionError(problem)
        return raw

    def _records(self, raw: memoryview) -> Iterator[_Message]:
        stream = stream_of(raw)
        position = 0
        while position < len(raw):
            record = record_at(stream, position)
            if record is None or record.data + record.size > len(raw):
                return
            yield from self._record(record, raw[record.data : record.data + record.size])
            position = record.data + record.size

    def _record(self, record: Record, data: memoryview) -> Iterator[_Message]:
        if record.kind == RecordType.CONNECTION:
            self._connect(record.header, data)
        elif record.kind == RecordType.MSGDATA and len(data) == record.size:
            try:
                yield _Message(
                    record.header.get_uint32('conn'), record.header.get_time('time'), data
                )
            except PARSE_ERRORS:
                self._note(record.data, 'a message record is damaged')

    def _connect(self, header: Header, data: memoryview) -> None:
        """Take in a connection record; the first of an id counts."""
        try:
            key, name = header.get_uint32('conn'), header.get_string('topic')
            if key in self._topics:
                return
            if len(data) > _LARGEST_CONNECTION or len(self._topics) >= _MOST_CONNECTIONS:
                raise ValueError('implausibly large')
            fields = Header.read(BytesIO(struct.pack('<I', len(data)) + data))
            kind = normalised_type(fields.get_string('type'))
            definition = fields.get_string('message_definition')
        except PARSE_ERRORS:
            self._note('connections', 'a connection record is damaged')
            return
        try:
            converter = ros1_type(kind, definition)
        except UnknownTypeError:
            self._topics[key] = TopicInfo(name, kind, None, 'ros1 without a valid definition')
            return
        self._types[key] = converter
        self._topics[key] = TopicInfo(name, kind, None, 'ros1', converter.schema)

    def _bag_header(self, stream: BinaryIO) -> Header | None:
        """The bag's header, None if it is damaged."""
        line = stream.readline(64)
        if line.startswith(MAGIC) and line != VERSION_LINE:
            version = line[len(MAGIC) :].strip().decode('ascii', 'replace')
            raise RecordingError(
                f'{self._path} is a ROS 1 bag of version {version}; convert it to version 2.0 '
                'with "rosbag fix"'
            )
        record = record_at(stream, len(VERSION_LINE))
        if record is None or record.kind != RecordType.BAGHEADER:
            return None
        if record.header.get('encryptor'):
            raise RecordingError(f'{self._path} is encrypted; decrypt it with "rosbag decrypt"')
        return record.header

    def _read_index(self, stream: BinaryIO) -> bool:
        """Take the connections and counts from the bag's end, if all of it is there."""
        header = self._bag_header(stream)
        if header is None:
            return False
        try:
            position = header.get_uint64('index_pos')
            left = header.get_uint32('conn_count') + header.get_uint32('chunk_count')
        except ReaderError:
            return False
        counts: Counter[int] = Counter()
        for _ in range(left):
            record = record_at(stream, position)
            if record is None or record.size > _LARGEST_CONNECTION:
                return False
            data = memoryview(stream.read(record.size))
            if len(data) < record.size:
                return False
            if record.kind == RecordType.CONNECTION:
                self._connect(record.header, data)
            elif record.kind == RecordType.CHUNK_INFO and record.size % 8 == 0:
                for key, count in struct.iter_unpack('<II', data):
                    counts[key] += count
            else:
                return False
            position = record.data + record.size
        self._set_counts(counts)
        return position > len(VERSION_LINE)

    def _set_counts(self, counts: Counter[int]) -> None:
        for key, topic in self._topics.items():
            self._topics[key] = replace(topic, message_count=counts[key])

    def _note_chunk(self, offset: int, reason: str, lost: int | None) -> None:
        messages = 'its messages are' if lost is None else counted(lost, 'message')
        self._note(offset, f'chunk at byte {offset} skipped, as {reason}: {messages} lost')

    def _note_end(self, size: int) -> None:
        self._note('end', f'cut off or damaged; its last {size} bytes cannot be read in full')

    def _note(self, key: object, text: str) -> None:
        self._problems.error((self._path, key), f'{self._path.name}: {text}')
