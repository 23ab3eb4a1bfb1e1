"""Reading one mcap file in stored order, whole or damaged."""

from __future__ import annotations

import zlib
from collections import Counter
from collections.abc import Container, Hashable, Iterator, Sequence
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment, Metadata
from rosbags.serde import SerdeError

from mvuav_ros.recordings.account import Account
from mvuav_ros.recordings.compression import unpack
from mvuav_ros.recordings.limits import SIZE_LIMIT, Limit
from mvuav_ros.recordings.mcap_channels import (
    MOST_SCHEMA_BYTES,
    PARSE_ERRORS,
    Channels,
    DefinitionError,
    statistics_of,
)
from mvuav_ros.recordings.mcap_records import (
    HEADER,
    MAGIC,
    MESSAGE_HEADER,
    ChunkHeader,
    RecordSpan,
    RecordWalk,
)
from mvuav_ros.recordings.recording import (
    READABLE_FORMATS,
    ChunkTally,
    RecordedMessage,
    TopicInfo,
    counted,
)

_INDEX_ENTRY_SIZE = 16
_FIRST_BODY = len(MAGIC) + HEADER.size
_BLOCK = 1 << 20
_LARGEST_EXTRA = 1 << 28
# Of a chunk that is out of the range: enough to see its first message's time.
_PEEK = 1 << 16
# A chunk whose size is wrong is still good where its checksum holds, up to this size in bytes.
_CREDIBLE_SIZE = 1 << 26
# From here on a message is given as a view of its chunk, as two copies would take twice the memory.
_LARGE = 1 << 24


class McapFile:
    """One mcap file, or several that were joined; it is opened anew for every pass."""

    written: int | None = None
    sound = 0
    skipped = 0
    _is_contradicted = False

    def __init__(self, path: Path, account: Account, limit: Limit) -> None:
        self._path = path
        self._limit = limit
        self._name = path.name
        self._account = account
        self._channels = Channels()
        self._indexed = False
        self._scanned = False

    def channels(self) -> Sequence[TopicInfo]:
        """Every channel, from the summary at the file's end or else from a pass through it."""
        if not self._scanned:
            with self._path.open('rb') as stream:
                self._indexed = self._read_summary(stream)
                if not self._indexed:
                    self._channels = Channels()
                    self._channels.counts = Counter()
                    for channel, _ in self._messages(stream, -1, 1 << 64):
                        self._channels.count(channel)
            self._scanned = True
        return self._channels.listed()

    def messages(
        self, topics: Container[str] | None, start_ns: int | None, end_ns: int | None
    ) -> Iterator[RecordedMessage]:
        """The messages in stored order, ``start_ns`` <= log time < ``end_ns``."""
        self.channels()
        self._channels.begin()
        first = -1 if start_ns is None else start_ns
        last = 1 << 64 if end_ns is None else end_ns
        unreadable: Counter[str] = Counter()
        self.sound = self.skipped = 0
        with self._path.open('rb') as stream:
            for channel, body in self._messages(stream, first, last):
                topic = self._channels.topics.get(channel)
                if topic is None:
                    unreadable[''] += 1
                    continue
                self.sound += 1
                if topic.serialization_format not in READABLE_FORMATS:
                    self.skipped += 1
                    continue
                _, sequence, stamp_ns, publish_ns = MESSAGE_HEADER.unpack_from(body)
                if first <= stamp_ns < last and (topics is None or topic.name in topics):
                    try:
                        data = self._as_cdr(channel, body[MESSAGE_HEADER.size :])
                    except SerdeError:
                        self.sound -= 1
                        unreadable[topic.name] += 1
                        continue
                    yield RecordedMessage(
                        *(topic.name, topic.type, stamp_ns, data, topic.schema, topic.qos),
                        *(publish_ns, sequence),
                    )
        for name, count in unreadable.items():
            what = f'{counted(count, "malformed message")} of {name}'
            what = what if name else f'{counted(count, "message")} of unknown channels'
            self._lose(('messages', name), f'{what} skipped', count)

    def extras(self) -> Iterator[Attachment | Metadata]:
        """The attachments and metadata."""
        with self._path.open('rb') as stream:
            walk = RecordWalk(stream, self._name, self._account)
            for span in walk.spans():
                if span.opcode not in _EXTRAS:
                    continue
                kind = _EXTRAS[span.opcode]
                try:
                    if span.length > _LARGEST_EXTRA:
                        raise ValueError('too large')
                    body = walk.read(span.body, span.length)
                    yield kind.read(ReadDataStream(BytesIO(body)))
                except (*PARSE_ERRORS, MemoryError) as error:
                    said = f'{kind.__name__.lower()} at byte {span.body} not read: {error}'
                    self._lose(('extra', span.body), said, 0)

    def _as_cdr(self, channel: int, data: memoryview) -> bytes | memoryview:
        if channel in self._channels.ros1:
            return self._channels.ros1[channel].to_cdr(data)
        return bytes(data) if len(data) < _LARGE else data

    def _messages(
        self, stream: BinaryIO, first: int, last: int
    ) -> Iterator[tuple[int, memoryview]]:
        """Message records with their channels, whose definitions are taken in on the way."""
        walk = RecordWalk(stream, self._name, self._account)
        self._limit.begin()
        chunk = ChunkTally(self._name)
        promised: int | None = None
        totals: list[int | None] = []
        is_closed = in_summary = False
        for span in walk.spans():
            if span.opcode == Opcode.MESSAGE_INDEX:
                entries = (span.length - 6) // _INDEX_ENTRY_SIZE
                chunk.indexed = entries + (chunk.indexed or 0)
                continue
            chunk.end(self._account)
            chunk = ChunkTally(self._name)
            if span.opcode == Opcode.CHUNK:
                chunk = ChunkTally(self._name, span.body - HEADER.size)
                for opcode, body in self._chunk(walk, span, first, last, chunk):
                    if opcode == Opcode.MESSAGE:
                        chunk.got += 1
                        yield MESSAGE_HEADER.unpack_from(body)[0], body
                    else:
                        self._define(opcode, body)
            elif span.opcode == Opcode.HEADER and span.body > _FIRST_BODY:
                self._account.note((self._name, 'joined'), f'{self._name}: several, joined in one')
                self._channels.forget()
                totals += [] if is_closed else [None]
                is_closed = in_summary = False
            elif span.opcode == Opcode.DATA_END:
                in_summary = True
            elif span.opcode == Opcode.FOOTER:
                totals.append(promised if walk.is_summary_intact(span) else None)
                promised, is_closed = None, True
            elif span.opcode == Opcode.STATISTICS and span.available == span.length < _BLOCK:
                statistics = statistics_of(walk.read(span.body, span.length))
                promised = None if statistics is None else statistics.message_count
            elif span.length > SIZE_LIMIT:
                self._lose(span.body, f'record at byte {span.body} skipped: larger than 1 GB', 1)
            elif span.length > MOST_SCHEMA_BYTES and span.opcode in _DEFINITIONS:
                said = f'definition at byte {span.body} skipped: larger than 64 MB'
                self._lose(span.body, said, 0)
            elif span.opcode in _CONTENT and span.available == span.length:
                body = memoryview(walk.read(span.body, span.length))
                if span.opcode == Opcode.MESSAGE:
                    yield MESSAGE_HEADER.unpack_from(body)[0], body
                else:
                    self._define(span.opcode, body, in_summary=in_summary)
        chunk.end(self._account)
        totals += [] if is_closed else [None]
        counts = [total for total in totals if total is not None]
        self.written = sum(counts) if len(counts) == len(totals) else None

    def _chunk(
        self, walk: RecordWalk, span: RecordSpan, first: int, last: int, chunk: ChunkTally
    ) -> Iterator[tuple[int, memoryview]]:
        """The records of a chunk; why it cannot be read, or not all of it, goes to its reason."""
        header = walk.chunk_header(span)
        assert header is not None
        # Without an index, a chunk out of the range may still define a channel within it.
        if self._indexed and not (header.start_ns < last and first <= header.end_ns):
            if self._are_true(walk, header):
                return
            said = f'{self._name}: times of chunks are wrong; all are read'
            self._account.note((self._name, 'times'), said)
        if self._limit.left <= 0:
            chunk.offset = -1
            self._lose('limit', self._limit.reason)
            return
        size = header.uncompressed_size
        raw, problem = unpack(
            walk.stream_at(header.data_offset),
            header.data_size,
            header.compression,
            size,
            max(size if size <= SIZE_LIMIT else 0, _CREDIBLE_SIZE),
        )
        self._limit.spend(len(raw))
        if span.available < span.length:
            yield from self._records(raw)
            return
        if header.crc and header.crc == zlib.crc32(raw):
            problem = ''
        elif not problem:
            problem = _contradiction(header, raw)
        elif size > SIZE_LIMIT:
            problem = f'it is larger than 1 GB ({size} bytes)'
        is_whole = True
        records = self._records(raw)
        while (record := next(records, None)) is not None:
            is_whole = record[0] != 0
            # The first chunk often defines the channels of all others, at its very start.
            if is_whole and not (problem and record[0] == Opcode.MESSAGE):
                yield record
        chunk.reason = problem or ('' if is_whole else 'it holds what is no record')

    def _are_true(self, walk: RecordWalk, header: ChunkHeader) -> bool:
        """Whether the first message of a chunk lies between the times that its header says."""
        length = min(header.data_size, _PEEK)
        stream = walk.stream_at(header.data_offset)
        raw, _ = unpack(stream, length, header.compression, -1, _CREDIBLE_SIZE)
        for opcode, body in self._records(raw, whole=False):
            if opcode == Opcode.MESSAGE:
                stamp_ns = MESSAGE_HEADER.unpack_from(body)[2]
                return bool(header.start_ns <= stamp_ns <= header.end_ns)
        return header.end_ns > 0

    def _records(self, view: memoryview, *, whole: bool = True) -> Iterator[tuple[int, memoryview]]:
        """The records of a chunk, the last one of kind 0 if it ends in what is none."""
        position = 0
        while position + HEADER.size <= len(view):
            opcode, length = HEADER.unpack_from(view, position)
            position += HEADER.size
            if opcode == 0 or (whole and position + length > len(view)):  # zeros are no records
                break
            credible = length <= MOST_SCHEMA_BYTES or opcode == Opcode.MESSAGE
            end = min(position + length, len(view))
            if credible and opcode in _CONTENT and end - position >= _CONTENT[opcode]:
                yield opcode, view[position:end]
            position += length
        if whole and position != len(view):
            yield 0, view[:0]

    def _define(self, opcode: int, body: bytes | memoryview, *, in_summary: bool = False) -> None:
        try:
            contradiction = self._channels.define(opcode, body, in_summary=in_summary)
        except DefinitionError as error:
            self._lose('definitions', str(error), 0)
            return
        if contradiction:
            self._is_contradicted = True
            self._account.note((self._name, contradiction), f'{self._name}: {contradiction}')

    def _read_summary(self, stream: BinaryIO) -> bool:
        """Whether the channels could be taken from the file's end, and the data begin likewise."""
        try:
            if not self._channels.read_summary(stream):
                return False
        except DefinitionError as error:
            self._lose('index', str(error), 0)
            return False
        self._channels.begin()
        next(self._messages(stream, -1, 1 << 64), None)
        return not self._is_contradicted

    def _lose(self, key: Hashable, text: str, count: int | None = None) -> None:
        self._account.lose(self._name, key, f'{self._name}: {text}', count)


def _contradiction(header: ChunkHeader, raw: memoryview) -> str:
    """Why a chunk that was unpacked is not what its header says; '' if it may be."""
    if header.crc:
        if len(raw) == header.uncompressed_size:
            return 'its checksum is wrong'
    elif header.compression in ('', 'none'):
        # Its length stands twice in the record.
        return ''
    return '' if len(raw) == header.uncompressed_size else 'its size is wrong'


_DEFINITIONS = (Opcode.SCHEMA, Opcode.CHANNEL)
_EXTRAS: dict[int, Any] = {Opcode.ATTACHMENT: Attachment, Opcode.METADATA: Metadata}
_CONTENT = {Opcode.SCHEMA: 8, Opcode.CHANNEL: 12, Opcode.MESSAGE: MESSAGE_HEADER.size}
