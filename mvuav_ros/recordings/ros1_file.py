"""Reading one ROS 1 bag (format 2.0) in stored order, whole, cut off or never indexed.

rosbags reads indexed bags only, and keeps the whole index in memory. Here the records are walked
one by one; rosbags parses their headers and converts the messages to CDR.
"""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Container, Iterator
from io import BytesIO, RawIOBase
from pathlib import Path
from typing import BinaryIO, NamedTuple, cast

from rosbags.rosbag1.reader import Header, ReaderError, RecordType

from mvuav_ros.messages.definitions import Schema
from mvuav_ros.messages.sensors import normalised_type
from mvuav_ros.recordings.account import Account, RecordingError
from mvuav_ros.recordings.compression import SIZE_LIMIT, Limit, Unpacked, unpack
from mvuav_ros.recordings.layout import ROS1_START as MAGIC
from mvuav_ros.recordings.stored_file import (
    END_OF_TIME,
    START_OF_TIME,
    UNKNOWN_ROS1,
    Channels,
    ChunkTally,
    RecordingFile,
    StoredMessage,
    TopicInfo,
)

VERSION_LINE = MAGIC + b'2.0\n'
PARSE_ERRORS = (ReaderError, struct.error, UnicodeDecodeError, ValueError)
_MAX_HEADER = 1 << 20
_SEARCH_BLOCK = 1 << 20
_KINDS = frozenset(int(kind) for kind in RecordType)


class Record(NamedTuple):
    """A record's header and kind, and where its data are (bytes)."""

    header: Header
    kind: int
    data: int
    size: int


def record_at(stream: BinaryIO, position: int) -> Record | None:
    """The record there, None where none is; the stream is left at its data."""
    stream.seek(position)
    length = stream.read(4)
    if len(length) < 4 or not 0 < int.from_bytes(length, 'little') < _MAX_HEADER:
        return None
    stream.seek(position)
    try:
        header = Header.read(stream)
        kind = header.get_uint8('op')
    except PARSE_ERRORS:
        return None
    length = stream.read(4)
    if len(length) < 4 or kind not in _KINDS:
        return None
    return Record(header, kind, stream.tell(), int.from_bytes(length, 'little'))


def next_chunk(stream: BinaryIO, start: int, size: int) -> int | None:
    """Where the next chunk's record begins; its header holds three fields in any order."""
    first = start
    while start < size:
        stream.seek(start)
        block = stream.read(_SEARCH_BLOCK + 64)
        place = block.find(b'op=\x05')
        while 0 <= place < _SEARCH_BLOCK + 32:
            for back in range(8, 64):
                record = None
                if start + place - back >= first:
                    record = record_at(stream, start + place - back)
                if (
                    record is not None
                    and record.kind == RecordType.CHUNK
                    and {'compression', 'size'} <= record.header.keys()
                ):
                    return start + place - back
            place = block.find(b'op=\x05', place + 1)
        start += _SEARCH_BLOCK
    return None


class _View(RawIOBase):
    """A chunk as a stream, without copying it as BytesIO does."""

    def __init__(self, raw: memoryview) -> None:
        self._raw = raw
        self._position = 0

    def seek(self, offset: int, whence: int = 0) -> int:
        assert whence == 0
        self._position = offset
        return offset

    def tell(self) -> int:
        return self._position

    def read(self, size: int = -1) -> bytes:
        data = bytes(self._raw[self._position : self._position + size])
        self._position += len(data)
        return data


_MAX_CONNECTION = 1 << 24
_INDEX_ENTRY_SIZE = 12
_MAX_CONNECTIONS = 1 << 16
# Each costs some milliseconds; Autoware has hundreds.
_MAX_DEFINITIONS = 2000
_SINGLE = frozenset({RecordType.CONNECTION, RecordType.MSGDATA})


class Ros1File(RecordingFile):
    """One ROS 1 bag."""

    def __init__(self, path: Path, account: Account, limit: Limit) -> None:
        super().__init__(path, account, limit)
        self._raw: dict[int, tuple[str, bytes]] = {}
        self._definitions: set[tuple[str, str]] = set()

    def _scan(self, stream: BinaryIO) -> None:
        """Take in every connection, from the bag's index or else from a pass through it.

        Raises:
            RecordingError: the bag has another version, or is encrypted.
        """
        is_indexed = self._read_index(stream)
        if is_indexed:
            next(self._stored(stream, None, START_OF_TIME, END_OF_TIME), None)
        else:
            self._lose('index', 'not indexed (was the recording cut off?)', 0)
        if not is_indexed or self._channels.is_contradicted:
            self.written = None
            self._channels = Channels()
            stored = self._stored(stream, None, START_OF_TIME, END_OF_TIME)
            self._channels.count(number for number, *_ in stored)

    def _stored(
        self, stream: BinaryIO, _topics: Container[str] | None, _first_ns: int, _end_ns: int
    ) -> Iterator[StoredMessage]:
        """The message records; connections met on the way are taken in."""
        size = stream.seek(0, 2)
        self._limit.begin()
        self._raw.clear()
        chunk = ChunkTally(self._path.name)
        position = len(VERSION_LINE)
        while position < size:
            record = record_at(stream, position)
            if record is None or record.size > SIZE_LIMIT:
                found = next_chunk(stream, position + 1, size)
                if found is None:
                    chunk.end(self._account)
                    self._note_end(size - position)
                    return
                self._lose(
                    position, f'damaged at byte {position}, reading continues at byte {found}'
                )
                position = found
                continue
            available = min(record.size, size - record.data)
            if record.kind == RecordType.IDXDATA:
                chunk.indexed = (chunk.indexed or 0) + record.size // _INDEX_ENTRY_SIZE
            elif record.kind == RecordType.CHUNK:
                chunk.end(self._account)
                chunk = ChunkTally(self._path.name, position)
                stream.seek(record.data)
                if self._limit.left <= 0:
                    chunk.offset = -1
                    self._lose('limit', self._limit.reason)
                    position = record.data + record.size
                    continue
                raw, chunk.reason = self._chunk(record, stream, cut=available < record.size)
                for message in self._records(raw, chunk):
                    chunk.got += 1
                    yield message
            elif record.kind in _SINGLE:
                stream.seek(record.data)
                yield from self._record(record, memoryview(stream.read(available)), in_index=True)
            if available < record.size:
                self._note_end(size - position)
                return
            position = record.data + record.size
        chunk.end(self._account)

    def _chunk(self, record: Record, stream: BinaryIO, *, cut: bool) -> Unpacked:
        """What a chunk holds; of one that is cut, what there is of it, of a damaged one nothing."""
        try:
            compression = record.header.get_string('compression')
            size = record.header.get_uint32('size')
        except ReaderError:
            return Unpacked(memoryview(b''), 'its header is damaged')
        if size > SIZE_LIMIT:
            return Unpacked(memoryview(b''), f'it is larger than 1 GB ({size} bytes)')
        raw, problem = unpack(stream, record.size, compression, size, size)
        self._limit.spend(len(raw))
        if not problem and len(raw) != size:
            problem = 'its size is wrong'
        if cut:
            problem = ''
        return Unpacked(raw[: 0 if problem else None], problem)

    def _records(self, raw: memoryview, chunk: ChunkTally) -> Iterator[StoredMessage]:
        stream = cast(BinaryIO, _View(raw))
        position = 0
        while position < len(raw):
            record = record_at(stream, position)
            if record is None or record.data + record.size > len(raw):
                chunk.reason = 'it holds what is no record'
                return
            yield from self._record(record, raw[record.data : record.data + record.size])
            position = record.data + record.size

    def _record(
        self, record: Record, data: memoryview, *, in_index: bool = False
    ) -> Iterator[StoredMessage]:
        if record.kind == RecordType.CONNECTION:
            self._connect(record.header, data, in_index)
        elif record.kind == RecordType.MSGDATA and len(data) == record.size:
            try:
                number, stamp_ns = record.header.get_uint32('conn'), record.header.get_time('time')
                yield number, None, stamp_ns, None, data
            except PARSE_ERRORS:
                self._lose(record.data, 'a message record is damaged', 1)

    def _connect(self, header: Header, data: memoryview, in_index: bool) -> None:
        """Take in a connection record; one of the index counts where the data have none."""
        try:
            key, name = header.get_uint32('conn'), header.get_string('topic')
            raw = name, bytes(data)
            if key in self._channels.known and (in_index or self._raw.get(key) == raw):
                return
            full = key not in self._channels.known and len(self._channels) >= _MAX_CONNECTIONS
            if len(data) > _MAX_CONNECTION or full:
                raise ValueError('implausibly large')
            fields = Header.read(BytesIO(struct.pack('<I', len(data)) + data))
            kind = normalised_type(fields.get_string('type'))
            definition = fields.get_string('message_definition')
        except PARSE_ERRORS:
            self._lose('connections', 'a connection record is damaged', 0)
            return
        self._raw[key] = raw
        self._definitions.add((kind, definition))
        encoding = 'ros1' if len(self._definitions) <= _MAX_DEFINITIONS else UNKNOWN_ROS1
        schema = Schema('ros1msg', definition)
        self._define(key, TopicInfo(name, kind, None, encoding, schema))

    def _read_index(self, stream: BinaryIO) -> bool:
        """Take the connections and counts from the bag's end, if all of it is there."""
        line = stream.readline(64)
        if line.startswith(MAGIC) and line != VERSION_LINE:
            version = line[len(MAGIC) :].strip().decode('ascii', 'replace')
            raise RecordingError(
                f'{self._path} is a ROS 1 bag of version {version}; convert it to version 2.0 '
                'with "rosbag fix"'
            )
        record = record_at(stream, len(VERSION_LINE))
        if record is None or record.kind != RecordType.BAGHEADER:
            return False
        header = record.header
        if header.get('encryptor'):
            raise RecordingError(f'{self._path} is encrypted; decrypt it with "rosbag decrypt"')
        try:
            position = header.get_uint64('index_pos')
            left = header.get_uint32('conn_count') + header.get_uint32('chunk_count')
        except ReaderError:
            return False
        if position > stream.seek(0, 2):
            return False
        counts: Counter[int] = Counter()
        for _ in range(left):
            record = record_at(stream, position)
            if record is None or record.size > _MAX_CONNECTION:
                return False
            data = memoryview(stream.read(record.size))
            if len(data) < record.size:
                return False
            if record.kind == RecordType.CONNECTION:
                self._connect(record.header, data, True)
            elif record.kind == RecordType.CHUNK_INFO and record.size % 8 == 0:
                for key, count in struct.iter_unpack('<II', data):
                    counts[key] += count
            else:
                return False
            position = record.data + record.size
        self._channels.take_counts(counts)
        self.written = counts.total()
        return position > len(VERSION_LINE)
