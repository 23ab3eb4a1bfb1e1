"""Reading one ROS 1 bag (format 2.0) in stored order, whole, cut off or never indexed.

rosbags reads indexed bags only, and keeps the whole index in memory. Here the records are walked
one by one; rosbags parses their headers and converts the messages to CDR.
"""

from __future__ import annotations

import re
import struct
from collections import Counter
from collections.abc import Callable, Container, Iterator
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, NamedTuple

from rosbags.rosbag1.reader import Header, ReaderError, RecordType

from mvuav_ros.messages.definitions import Schema
from mvuav_ros.messages.sensors import normalised_type
from mvuav_ros.recordings.account import Account, RecordingError
from mvuav_ros.recordings.compression import SIZE_LIMIT, Limit, unpack
from mvuav_ros.recordings.layout import ROS1_START as MAGIC
from mvuav_ros.recordings.stored_file import (
    UNKNOWN_ROS1,
    ChunkTally,
    RecordingFile,
    StoredMessage,
    TopicInfo,
)

_VERSION_LINE = MAGIC + b'2.0\n'
_PARSE_ERRORS = (ReaderError, struct.error, UnicodeDecodeError, ValueError)
_MAX_HEADER = 1 << 20
_SEARCH_BLOCK = 1 << 20
_KINDS = frozenset(int(kind) for kind in RecordType)
_IN_CHUNK = (RecordType.CONNECTION, RecordType.MSGDATA)
_CHUNK_MARK = re.compile(rb'op=\x05')
_MAX_CONNECTION = 1 << 24
_INDEX_ENTRY_SIZE = 12
_CHUNK_FIELDS = frozenset(('compression', 'size'))
_MAX_CONNECTIONS = 1 << 16
# Each costs some milliseconds; Autoware has hundreds.
_MAX_DEFINITIONS = 2000

_Read = Callable[[int, int], bytes]
"""Gives so many bytes from an offset on, fewer at the end."""


class _Record(NamedTuple):
    """A record's header and kind, and where its data are (bytes)."""

    header: Header
    kind: int
    data: int
    size: int


def _reader_of(stream: BinaryIO) -> _Read:
    def read(offset: int, size: int) -> bytes:
        stream.seek(offset)
        return stream.read(size)

    return read


def _record_at(read: _Read, position: int) -> _Record | None:
    """The record there, None where none is."""
    length = int.from_bytes(read(position, 4), 'little')
    if not 0 < length < _MAX_HEADER:
        return None
    try:
        header = Header.read(BytesIO(read(position, 4 + length)))
        kind = header.get_uint8('op')
    except _PARSE_ERRORS:
        return None
    data = position + 4 + length + 4
    size = read(data - 4, 4)
    if len(size) < 4 or kind not in _KINDS:
        return None
    if kind == RecordType.CHUNK and not header.keys() >= _CHUNK_FIELDS:
        return None
    return _Record(header, kind, data, int.from_bytes(size, 'little'))


def _next_chunk(read: _Read, start: int, size: int) -> int:
    """Where the next chunk's record begins, or the file ends.

    Its header holds three fields in any order.
    """
    for offset in range(start, size, _SEARCH_BLOCK):
        for match in _CHUNK_MARK.finditer(read(offset, _SEARCH_BLOCK + 64)):
            mark = offset + match.start()
            for position in range(mark - 8, max(mark - 64, start - 1), -1):
                record = _record_at(read, position)
                if record is not None and record.kind == RecordType.CHUNK:
                    return position
    return size


class Ros1File(RecordingFile):
    """One ROS 1 bag."""

    def __init__(self, path: Path, account: Account, limit: Limit) -> None:
        super().__init__(path, account, limit)
        self._raw: dict[int, tuple[str, bytes]] = {}
        self._definitions: set[tuple[str, str]] = set()
        # By the index at the bag's end: messages of each chunk by its place, and all its chunks.
        self._listed: dict[int, int] = {}
        self._chunk_count = 0

    def _stored(
        self, stream: BinaryIO, _topics: Container[str] | None, _first_ns: int, _end_ns: int
    ) -> Iterator[StoredMessage]:
        """The message records; connections met on the way are taken in."""
        size = stream.seek(0, 2)
        read = _reader_of(stream)
        self._raw.clear()
        listed = self._listed if self._is_indexed else {}
        met: set[int] = set()
        hidden: dict[int, int] = {}
        written: list[int | None] = []
        chunk, is_gapped = ChunkTally(), False
        position = len(_VERSION_LINE)
        while position < size:
            record = _record_at(read, position)
            if record is not None and record.size > SIZE_LIMIT:
                record = None
            end = size + 1 if record is None else record.data + record.size
            if is_cut := end > size:
                # A damaged length may reach over the chunks that follow.
                end = _next_chunk(read, position + 1, size)
                is_gapped, chunk.is_index_whole = True, False
            if record is None:
                pass
            elif record.kind == RecordType.IDXDATA:
                entries = record.size // _INDEX_ENTRY_SIZE
                chunk.indexed = (chunk.indexed or 0) + entries
                chunk.is_index_whole &= record.header.get('count') == struct.pack('<I', entries)
            elif record.kind == RecordType.CHUNK:
                written.append(self._end(chunk))
                chunk = ChunkTally(position, listed=listed.get(position))
                met.add(position)
                yield from self._read_chunk(record, stream, end, chunk, is_cut)
            elif record.kind in _IN_CHUNK:
                data = memoryview(read(record.data, end - record.data))
                yield from self._record(record, data, in_index=True)
            if is_cut:
                behind = {at: listed[at] for at in listed.keys() - met if position <= at < end}
                hidden |= behind
                lost = sum(behind.values()) if self._is_indexed else None
                self._lose_stretch(position, end, size, lost)
            position = end
        written += [self._end(chunk), *hidden.values()]
        # Where chunks may be hidden, all have to be known by their places.
        is_listed = hidden.keys() | met == listed.keys() and len(listed) == self._chunk_count
        if is_gapped and self._is_indexed and not is_listed:
            self.lose('chunks', 'its index speaks of other chunks than are there')
            written.append(None)
        # Without the index, no chunk is missing if there are as many as the header's number, which
        # is written at the end.
        is_complete = self._is_indexed or 0 < len(met) == self._chunk_count
        is_known = is_complete and None not in written
        self._written = sum(filter(None, written)) if is_known else None

    def _lose_stretch(self, position: int, end: int, size: int, lost: int | None) -> None:
        if end == size:
            self.lose_end(size - position, lost)
        else:
            said = f'damaged at byte {position}, reading continues at byte {end}'
            self.lose(position, said, lost)

    def _read_chunk(
        self, record: _Record, stream: BinaryIO, end: int, chunk: ChunkTally, is_cut: bool
    ) -> Iterator[StoredMessage]:
        """The messages of a chunk: those that are there if it is cut, none if it is damaged."""
        if self._limit.left <= 0:
            chunk.offset, chunk.reason = -1, self._limit.reason
            self.lose('limit', chunk.reason)
            return
        try:
            compression = record.header.get_string('compression')
            size = record.header.get_uint32('size')
        except ReaderError:
            chunk.reason = 'its header is damaged'
            return
        if size > SIZE_LIMIT:
            chunk.reason = f'it is larger than 1 GB ({size} bytes)'
            return
        stream.seek(record.data)
        raw, chunk.reason = unpack(stream, end - record.data, compression, size, size)
        self._limit.left -= len(raw)
        if not chunk.reason and len(raw) != size:
            chunk.reason = 'its size is wrong'
        if is_cut:
            chunk.reason = 'it is cut off'
        elif chunk.reason:
            return
        position = 0
        while position < len(raw):
            inner = _record_at(lambda at, size: bytes(raw[at : at + size]), position)
            is_whole = inner is not None and inner.data + inner.size <= len(raw)
            if inner is None or not is_whole or inner.kind not in _IN_CHUNK:
                chunk.reason = chunk.reason or 'it holds what is no record'
                return
            chunk.got += inner.kind == RecordType.MSGDATA
            yield from self._record(inner, raw[inner.data : inner.data + inner.size])
            position = inner.data + inner.size

    def _record(
        self, record: _Record, data: memoryview, *, in_index: bool = False
    ) -> Iterator[StoredMessage]:
        if record.kind == RecordType.CONNECTION:
            self._connect(record.header, data, in_index)
        elif record.kind == RecordType.MSGDATA and len(data) == record.size:
            try:
                number, stamp_ns = record.header.get_uint32('conn'), record.header.get_time('time')
                yield number, None, stamp_ns, None, data
            except _PARSE_ERRORS:
                count = None if in_index else 1
                self.lose(record.data, 'a message record is damaged', count)

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
        except _PARSE_ERRORS:
            self.lose('connections', 'a connection record is damaged', 0)
            return
        self._raw[key] = raw
        self._definitions.add((kind, definition))
        encoding = 'ros1' if len(self._definitions) <= _MAX_DEFINITIONS else UNKNOWN_ROS1
        schema = Schema('ros1msg', definition)
        self._define(key, TopicInfo(name, kind, None, encoding, schema))

    def _read_index(self, stream: BinaryIO) -> bool:
        """Take the connections and counts from the bag's end, if all of it is there.

        Raises:
            RecordingError: the bag has another version, or is encrypted.
        """
        line = stream.readline(64)
        if line.startswith(MAGIC) and line != _VERSION_LINE:
            version = line[len(MAGIC) :].strip().decode('ascii', 'replace')
            raise RecordingError(
                f'{self._path} is a ROS 1 bag of version {version}; convert it to version 2.0 '
                'with "rosbag fix"'
            )
        size = stream.seek(0, 2)
        read = _reader_of(stream)
        start, count = self._index_place(read)
        is_inside = len(_VERSION_LINE) < start <= size
        is_read = is_inside and self._read_entries(read, start, count) == size
        if not is_read:
            self.lose('index', 'not indexed (was the recording cut off?)')
        return is_read

    def _index_place(self, read: _Read) -> tuple[int, int]:
        """Where the bag's header says that the index begins, and how many records it has; or 0."""
        record = _record_at(read, len(_VERSION_LINE))
        if record is None or record.kind != RecordType.BAGHEADER:
            return 0, 0
        header = record.header
        if header.get('encryptor'):
            raise RecordingError(f'{self._path} is encrypted; decrypt it with "rosbag decrypt"')
        try:
            self._chunk_count = header.get_uint32('chunk_count')
            count = header.get_uint32('conn_count') + self._chunk_count
            return header.get_uint64('index_pos'), count
        except ReaderError:
            return 0, 0

    def _read_entries(self, read: _Read, position: int, left: int) -> int:
        """Take the index's records; where they end, or 0 if one is damaged."""
        counts: Counter[int] = Counter()
        listed, last = dict[int, int](), position
        for _ in range(left):
            record = _record_at(read, position)
            if record is None:
                return 0
            data = memoryview(read(record.data, min(record.size, _MAX_CONNECTION)))
            if len(data) < record.size:
                return 0
            if record.kind == RecordType.CONNECTION:
                self._connect(record.header, data, True)
            elif record.kind == RecordType.CHUNK_INFO and record.size % 8 == 0:
                of = Counter(dict(struct.iter_unpack('<II', data)))
                counts += of
                listed[int.from_bytes(record.header.get('chunk_pos', b''), 'little')] = of.total()
            else:
                return 0
            position = record.data + record.size
        self._channels.take_counts(counts)
        # Behind a chunk is an entry for each of its messages: a larger number is damaged.
        ends = [*sorted(listed)[1:], last]
        room = zip(sorted(listed), ends, strict=False)
        self._listed = {
            at: listed[at] for at, end in room if listed[at] <= (end - at) // _INDEX_ENTRY_SIZE
        }
        return position
