"""One mcap file, or several that were joined, read in stored order, whole or damaged.

The mcap library parses what records hold. Its readers end at the first damaged byte, and allocate
what a chunk claims: so where records begin and end, and what becomes of a chunk, is found here.
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Container, Iterator
from contextlib import suppress
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Footer, Metadata, Statistics
from mcap.records import Schema as SchemaRecord

from mvuav_ros.messages.definitions import Schema
from mvuav_ros.messages.sensors import normalised_type
from mvuav_ros.recordings.account import Account
from mvuav_ros.recordings.compression import PLAIN, SIZE_LIMIT, Limit, unpack
from mvuav_ros.recordings.layout import MCAP_START as MAGIC
from mvuav_ros.recordings.stored_file import (
    ChunkTally,
    RecordingFile,
    StoredMessage,
    TopicInfo,
)

HEADER = struct.Struct('<BQ')
CHUNK_HEADER = struct.Struct('<QQQII')
MESSAGE_HEADER = struct.Struct('<HIQQ')

_MIN_LENGTHS = {
    Opcode.HEADER: 8,
    Opcode.FOOTER: 20,
    Opcode.SCHEMA: 14,
    Opcode.CHANNEL: 16,
    Opcode.MESSAGE: 22,
    Opcode.CHUNK: 40,
    Opcode.MESSAGE_INDEX: 6,
    Opcode.CHUNK_INDEX: 64,
    Opcode.ATTACHMENT: 36,
    Opcode.ATTACHMENT_INDEX: 48,
    Opcode.STATISTICS: 46,
    Opcode.METADATA: 8,
    Opcode.METADATA_INDEX: 20,
    Opcode.SUMMARY_OFFSET: 17,
    Opcode.DATA_END: 4,
}
_PRIVATE_OPCODES = 0x80
_DEFINITIONS = (Opcode.SCHEMA, Opcode.CHANNEL)
_EXTRAS = (Opcode.ATTACHMENT, Opcode.METADATA)
_PARSERS: dict[int, Any] = {
    Opcode.SCHEMA: SchemaRecord,
    Opcode.CHANNEL: Channel,
    Opcode.STATISTICS: Statistics,
    Opcode.ATTACHMENT: Attachment,
    Opcode.METADATA: Metadata,
    Opcode.FOOTER: Footer,
}
_IN_CHUNK = {Opcode.SCHEMA: 8, Opcode.CHANNEL: 12, Opcode.MESSAGE: MESSAGE_HEADER.size}
"""The records of a chunk that count, and how long they are at least."""
_PARSE_ERRORS = (McapError, struct.error, UnicodeDecodeError, ValueError)
_CANDIDATE = re.compile(rb'[\x01-\x0f](?=.{4}\0{4})', re.DOTALL)
_BLOCK = 1 << 20
_FOOTER_HEAD = HEADER.pack(Opcode.FOOTER, 20)
_FOOTER_SIZE = len(_FOOTER_HEAD) + 20 + len(MAGIC)
_FIRST_BODY = len(MAGIC) + HEADER.size
_INDEX_ENTRY_SIZE = 16
_MAX_COMPRESSION_NAME = 16
_MAX_EXTRA = 1 << 28
_MAX_SCHEMAS = 1 << 26
"""Bytes of all schemas together; those of Autoware's hundreds of types are two million."""
# Of a chunk that is out of the range: enough to see its first message's time.
_PEEK = 1 << 16
# A chunk whose size is wrong is still good where its checksum holds, up to this size in bytes.
_CREDIBLE_SIZE = 1 << 26


class McapFile(RecordingFile):
    """One mcap file, or several that were joined."""

    def __init__(self, path: Path, account: Account, limit: Limit) -> None:
        super().__init__(path, account, limit)
        self._schema_bytes = 0
        self._in_summary: dict[_Key, Any] | None = None
        self._is_summary_intact = True
        self._contradicted: set[_Key] = set()

    def extras(self) -> Iterator[Attachment | Metadata]:
        """The attachments and metadata."""
        with self._path.open('rb') as stream:
            walk = _Records(stream, self)
            for span in walk.spans():
                if span.opcode not in _EXTRAS:
                    continue
                try:
                    if span.length > _MAX_EXTRA:
                        raise ValueError('too large')
                    yield _parsed(span.opcode, walk.read(span.body, span.length))
                except (*_PARSE_ERRORS, MemoryError) as error:
                    kind = Opcode(span.opcode).name.lower()
                    said = f'{kind} at byte {span.body} not read: {error}'
                    self.lose(('extra', span.body), said, 0)

    def _read_index(self, stream: BinaryIO) -> bool:
        """Whether the channels could be taken from the file's end."""
        walk = _Records(stream, self)
        found = walk.summary()
        if found is None:
            self.lose('index', 'its index is missing (was the recording cut off?)')
            return False
        (place, is_intact), statistics = found, None
        while is_intact and place < walk.size - len(MAGIC):
            span = walk.span_at(place)
            if span is None or span.length > _MAX_SCHEMAS:
                is_intact = False
                break
            if span.opcode in _DEFINITIONS:
                is_intact = self._take(span.opcode, walk.read(span.body, span.length))
            elif span.opcode == Opcode.STATISTICS:
                statistics = _sound(span.opcode, walk.read(span.body, span.length))
            place = span.body + span.length
        if not is_intact:
            self.lose('index', 'its index is damaged', 0)
            return False
        if statistics is not None:
            self._channels.take_counts(statistics.channel_message_counts)
            self._written = statistics.message_count
        return len(self._channels) > 0 or self._written == 0

    def _stored(
        self, stream: BinaryIO, _topics: Container[str] | None, first_ns: int, end_ns: int
    ) -> Iterator[StoredMessage]:
        walk = _Records(stream, self)
        self._schema_bytes = 0
        chunk, in_summary = ChunkTally(), False
        for span in walk.spans():
            if span.opcode == Opcode.MESSAGE_INDEX:
                entries = (span.length - 6) // _INDEX_ENTRY_SIZE
                chunk.indexed = entries + (chunk.indexed or 0)
                continue
            if span.opcode >= _PRIVATE_OPCODES:
                chunk.is_index_whole = False
                continue
            self._end(chunk)
            chunk = ChunkTally()
            if span.chunk is not None:
                chunk.offset = span.body - HEADER.size
                records = self._chunk(walk, span, span.chunk, (first_ns, end_ns), chunk)
            elif span.opcode in _IN_CHUNK:
                records = self._alone(walk, span)
            else:
                in_summary = span.opcode == Opcode.DATA_END or in_summary
                if span.opcode == Opcode.HEADER and span.body > _FIRST_BODY:
                    self.note('joined', 'several, joined in one')
                    # The numbers of the next file mean something else.
                    self._channels.known, self._channels.schemas, self._schema_bytes = {}, {}, 0
                    in_summary = False
                continue
            for opcode, body in records:
                if opcode == Opcode.MESSAGE:
                    chunk.got += 1
                    yield *MESSAGE_HEADER.unpack_from(body), body[MESSAGE_HEADER.size :]
                else:
                    self._take(opcode, body, in_summary=in_summary)
        self._end(chunk)

    def _alone(self, walk: _Records, span: _Span) -> Iterator[tuple[int, memoryview]]:
        """A record that stands in no chunk, unless it is larger than anybody would write."""
        if span.length > SIZE_LIMIT:
            self.lose(span.body, f'record at byte {span.body} skipped: larger than 1 GB', 1)
        elif span.length > _MAX_SCHEMAS and span.opcode in _DEFINITIONS:
            said = f'definition at byte {span.body} skipped: larger than 64 MB'
            self.lose(span.body, said, 0)
        else:
            yield span.opcode, memoryview(walk.read(span.body, span.length))

    def _chunk(
        self,
        walk: _Records,
        span: _Span,
        header: _ChunkHeader,
        wanted: tuple[int, int],
        chunk: ChunkTally,
    ) -> Iterator[tuple[int, memoryview]]:
        """The records of a chunk; why it cannot be read, or not all of it, goes to its reason."""
        # Without an index, a chunk out of the range may still define a channel within it.
        if self._is_indexed and not (header.start_ns < wanted[1] and wanted[0] <= header.end_ns):
            if self._are_true(walk, header):
                return
            self.note('times', 'times of chunks are wrong; all are read')
        if self._limit.left <= 0:
            chunk.offset = -1
            self.lose('limit', self._limit.reason)
            return
        size = header.uncompressed_size
        raw, problem = unpack(
            walk.stream_at(header.data_offset),
            header.data_size,
            header.compression,
            size,
            max(size if size <= SIZE_LIMIT else 0, _CREDIBLE_SIZE),
        )
        self._limit.left -= len(raw)
        is_cut = span.available < span.length
        if is_cut or (header.crc and header.crc == zlib.crc32(raw)):
            problem = ''
        # The length of a plain one stands twice in the record.
        elif not problem and len(raw) != size and (header.crc or header.compression not in PLAIN):
            problem = 'its size is wrong'
        elif not problem and header.crc:
            problem = 'its checksum is wrong'
        elif problem and size > SIZE_LIMIT:
            problem = f'it is larger than 1 GB ({size} bytes)'
        is_whole = True
        for record in _records_in(raw):
            is_whole = record[0] != 0
            # The first chunk often defines the channels of all others, at its very start.
            if is_whole and not (problem and self._is_doubtful(walk, *record)):
                yield record
        chunk.reason = problem or ('' if is_whole or is_cut else 'it holds what is no record')

    def _is_doubtful(self, walk: _Records, opcode: int, body: memoryview) -> bool:
        """Whether a damaged chunk's record is not to be believed.

        Messages are not; a definition is unless the summary contradicts it. Where the summary is
        damaged as well, nobody knows which of the two is right, and neither is believed.
        """
        if opcode == Opcode.MESSAGE:
            return True
        if self._in_summary is None:
            self._in_summary = {}
            if (found := walk.summary()) is not None:
                start, self._is_summary_intact = found
                content = memoryview(walk.read(start, _MAX_SCHEMAS))
                for each in _records_in(content, whole=False):
                    self._in_summary[_key(*each)] = _meaning(*each)
        key = _key(opcode, body)
        if self._in_summary.get(key) in (None, _meaning(opcode, body)):
            return False
        if not self._is_summary_intact:
            self._contradicted.add(key)
        return True

    @staticmethod
    def _are_true(walk: _Records, header: _ChunkHeader) -> bool:
        """Whether the first message of a chunk lies between the times that its header says."""
        length = min(header.data_size, _PEEK)
        stream = walk.stream_at(header.data_offset)
        raw, _ = unpack(stream, length, header.compression, -1, _CREDIBLE_SIZE)
        for opcode, body in _records_in(raw, whole=False):
            if opcode == Opcode.MESSAGE:
                stamp_ns = MESSAGE_HEADER.unpack_from(body)[2]
                return bool(header.start_ns <= stamp_ns <= header.end_ns)
        return header.end_ns > 0

    def _take(self, opcode: int, body: bytes | memoryview, *, in_summary: bool = False) -> bool:
        """Take in a schema or channel, of the summary what the data lack; whether it is sound."""
        if in_summary and _key(opcode, body) in self._contradicted:
            return False
        self._schema_bytes += len(body) if opcode == Opcode.SCHEMA else 0
        if self._schema_bytes > _MAX_SCHEMAS:
            self.lose('definitions', 'its schemas are implausibly large', 0)
            return False
        record = _sound(opcode, body)
        if record is None:
            self.lose('definitions', 'a channel or schema record is damaged', 0)
            return False
        if opcode == Opcode.SCHEMA:
            text = record.data.decode('utf-8', 'replace')
            if not (in_summary and record.id in self._channels.schemas):
                schema = Schema(record.encoding, text) if text else None
                self._channels.schemas[record.id] = normalised_type(record.name), schema
        elif not (in_summary and record.id in self._channels.known):
            kind, schema = self._channels.schemas.get(record.schema_id, ('', None))
            qos = record.metadata.get('offered_qos_profiles', '')
            topic = TopicInfo(record.topic, kind, None, record.message_encoding, schema, qos)
            self._define(record.id, topic)
        return True


class _ChunkHeader(NamedTuple):
    """What stands before a chunk's data; times in ns, sizes in bytes."""

    start_ns: int
    end_ns: int
    uncompressed_size: int
    crc: int
    compression: str
    data_offset: int
    data_size: int


class _Span(NamedTuple):
    """Where a record lies; of a chunk that is cut fewer bytes are ``available``."""

    opcode: int
    body: int
    length: int
    available: int
    chunk: _ChunkHeader | None


class _Records:
    def __init__(self, stream: BinaryIO, file: RecordingFile) -> None:
        self._stream, self._file = stream, file
        self.size = stream.seek(0, 2)

    def spans(self) -> Iterator[_Span]:
        """Every record, those of files that were joined included; damage is stepped over."""
        offset = search_from = len(MAGIC)
        is_closed = False
        while offset < self.size:
            span = self.span_at(offset)
            if span is None:
                found = self._next_record(search_from)
                if found is None:
                    left = self.size - offset
                    if is_closed:
                        self._file.note('end', f'the {left} bytes behind its end are no records')
                    else:
                        self._file.lose_end(left)
                    return
                said = f'damaged at byte {offset}, reading continues at byte {found}'
                self._file.lose(offset, said)
                offset, search_from = found, found + 1
                continue
            if span.opcode >= _PRIVATE_OPCODES:
                said = f'record of unknown kind {span.opcode} skipped at byte {offset}'
                self._file.lose(offset, said, 0)
            yield span
            if span.available < span.length:
                self._file.lose_end(self.size - offset)
                return
            offset = span.body + span.length
            is_closed = span.opcode == Opcode.FOOTER
            while is_closed and self.read(offset, len(MAGIC)) == MAGIC:
                offset += len(MAGIC)
            # A message's length cannot be checked: if what follows makes no sense, it was wrong.
            search_from = span.body if span.opcode == Opcode.MESSAGE else offset + 1

    def read(self, offset: int, size: int) -> bytes:
        """The bytes there, fewer at the file's end."""
        return self.stream_at(offset).read(size)

    def stream_at(self, offset: int) -> BinaryIO:
        """The file, to be read from there."""
        self._stream.seek(offset)
        return self._stream

    def summary(self) -> tuple[int, bool] | None:
        """Where the summary begins (the footer, if there is none), and whether its checksum holds.

        None without a footer; without a checksum the summary is believed.
        """
        footer_offset = self.size - _FOOTER_SIZE
        if footer_offset < len(MAGIC):
            return None
        tail = self.read(footer_offset, _FOOTER_SIZE)
        if tail[-len(MAGIC) :] != MAGIC or tail[: HEADER.size] != _FOOTER_HEAD:
            return None
        said = _parsed(Opcode.FOOTER, tail[HEADER.size :])
        start: int = said.summary_start or footer_offset
        if start > footer_offset:
            return None
        stream, checksum, left = self.stream_at(start), 0, self.size - len(MAGIC) - 4 - start
        while said.summary_crc and left > 0:
            block = stream.read(min(left, _BLOCK))
            checksum = zlib.crc32(block, checksum)
            left -= len(block)
        return start, bool(checksum == said.summary_crc)

    def span_at(self, offset: int) -> _Span | None:
        """The record there, if its length may be true: a chunk repeats it, others must fit."""
        head = self.read(offset, HEADER.size)
        if len(head) < HEADER.size:
            return None
        opcode, length = HEADER.unpack(head)
        minimum = 0 if opcode >= _PRIVATE_OPCODES else _MIN_LENGTHS.get(opcode)
        if minimum is None or length < minimum:
            return None
        body = offset + HEADER.size
        available = min(length, self.size - body)
        chunk = self._chunk_header(body, length) if opcode == Opcode.CHUNK else None
        if chunk is None and (opcode == Opcode.CHUNK or available < length):
            return None
        return _Span(opcode, body, length, available, chunk)

    def _chunk_header(self, body: int, length: int) -> _ChunkHeader | None:
        """The header of a chunk; None if it contradicts the record's length."""
        fixed = CHUNK_HEADER.size
        head = self.read(body, min(fixed + _MAX_COMPRESSION_NAME + 8, length))
        if len(head) < fixed:
            return None
        start_ns, end_ns, size, crc, name_length = CHUNK_HEADER.unpack_from(head)
        end = fixed + name_length + 8
        if name_length > _MAX_COMPRESSION_NAME or len(head) < end:
            return None
        (data_size,) = struct.unpack_from('<Q', head, end - 8)
        compression = head[fixed : end - 8].decode('ascii', 'replace')
        # The records of one that is too large, and plain, can be found one by one.
        if end + data_size != length or (size > SIZE_LIMIT and compression in PLAIN):
            return None
        return _ChunkHeader(start_ns, end_ns, size, crc, compression, body + end, data_size)

    def _next_record(self, start: int) -> int | None:
        for block in range(start, self.size, _BLOCK):
            # 8 bytes more, so that no candidate is split between two blocks.
            for match in _CANDIDATE.finditer(self.read(block, _BLOCK + 8)):
                if self._convinces(block + match.start()):
                    return block + match.start()
        return None

    def _convinces(self, offset: int) -> bool:
        """Whether a chunk, the footer, or three records in a row begin there."""
        for _ in range(3):
            span = self.span_at(offset)
            if span is None or span.chunk is not None:
                return span is not None
            offset = span.body + span.length
            if span.opcode == Opcode.FOOTER:
                return self.read(offset, len(MAGIC)) == MAGIC
            if offset == self.size:
                break
        return True


def _parsed(opcode: int, body: bytes | memoryview) -> Any:
    """A record's content as the mcap library has it; see `_PARSE_ERRORS`."""
    return _PARSERS[opcode].read(ReadDataStream(BytesIO(body)))


def _sound(opcode: int, body: bytes | memoryview) -> Any:
    """A record's content; None if it is damaged."""
    with suppress(*_PARSE_ERRORS):
        return _parsed(opcode, body)
    return None


_Key = tuple[int, bytes]
"""Of a schema or channel: its opcode, and its number in its first two bytes."""


def _key(opcode: int, body: bytes | memoryview) -> _Key:
    return opcode, bytes(body[:2])


def _meaning(opcode: int, body: bytes | memoryview) -> Any:
    """What a schema or channel is called; None if it is damaged."""
    record = _sound(opcode, body)
    if record is None or opcode == Opcode.SCHEMA:
        return record and record.name
    return record.topic, record.schema_id, record.message_encoding


def _records_in(view: memoryview, *, whole: bool = True) -> Iterator[tuple[int, memoryview]]:
    """The records of a chunk, the last one of kind 0 if it ends in what is none."""
    position = 0
    while position + HEADER.size <= len(view):
        opcode, length = HEADER.unpack_from(view, position)
        position += HEADER.size
        if opcode == 0 or (whole and position + length > len(view)):  # zeros are no records
            break
        credible = length <= _MAX_SCHEMAS or opcode == Opcode.MESSAGE
        end = min(position + length, len(view))
        if credible and opcode in _IN_CHUNK and end - position >= _IN_CHUNK[opcode]:
            yield opcode, view[position:end]
        position += length
    if whole and position != len(view):
        yield 0, view[:0]
