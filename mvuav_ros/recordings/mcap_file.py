"""Reading one mcap file in stored order, whole or damaged."""

from __future__ import annotations

import zlib
from collections import Counter
from collections.abc import Container, Generator, Iterator, Sequence
from pathlib import Path
from typing import BinaryIO

from mcap.opcode import Opcode
from rosbags.serde import SerdeError

from mvuav_ros.recordings.compression import SIZE_LIMIT, unpack
from mvuav_ros.recordings.mcap_channels import MOST_SCHEMA_BYTES, Channels, DefinitionError
from mvuav_ros.recordings.mcap_records import (
    HEADER,
    MESSAGE_HEADER,
    ChunkHeader,
    RecordSpan,
    RecordWalk,
)
from mvuav_ros.recordings.recording import (
    READABLE_FORMATS,
    Problems,
    RecordedMessage,
    TopicInfo,
    counted,
)

_INDEX_ENTRY_SIZE = 16
# A chunk whose size is wrong is still good where its checksum holds, up to this size in bytes.
_CREDIBLE_SIZE = 1 << 26
# From here on a message is given as a view of its chunk, as two copies would take twice the memory.
_LARGE = 1 << 24


class McapFile:
    """One mcap file; it is opened anew for every pass."""

    def __init__(self, path: Path, problems: Problems) -> None:
        self._path = path
        self._name = path.name
        self._problems = problems
        self._channels = Channels()
        self._indexed = False
        self._scanned = False

    def channels(self) -> Sequence[TopicInfo]:
        """Every channel, from the summary at the file's end or else from a pass through it."""
        if not self._scanned:
            with self._path.open('rb') as stream:
                self._indexed = self._read_summary(stream)
                if not self._indexed:
                    promised = self._channels.promised
                    self._channels = Channels()
                    self._channels.promised = promised
                    self._channels.set_counts(self._count(stream))
            self._scanned = True
        return tuple(self._channels.topics.values())

    def messages(
        self, topics: Container[str] | None, start_ns: int | None, end_ns: int | None
    ) -> Iterator[RecordedMessage]:
        """The messages in stored order, ``start_ns`` <= log time < ``end_ns``."""
        self.channels()
        first = -1 if start_ns is None else start_ns
        last = 1 << 64 if end_ns is None else end_ns
        everything = start_ns is None and end_ns is None
        malformed: Counter[str] = Counter()
        seen = orphans = 0
        promised = self._channels.promised
        with self._path.open('rb') as stream:
            for opcode, body in self._contents(stream, first, last):
                if opcode != Opcode.MESSAGE:
                    self._define(opcode, body)
                    continue
                seen += 1
                channel, _, stamp_ns, _ = MESSAGE_HEADER.unpack_from(body)
                topic = self._channels.topics.get(channel)
                if topic is None:
                    orphans += 1
                    continue
                if topic.serialization_format not in READABLE_FORMATS:
                    continue
                if first <= stamp_ns < last and (topics is None or topic.name in topics):
                    try:
                        data = self._as_cdr(channel, body[MESSAGE_HEADER.size :])
                    except SerdeError:
                        malformed[topic.name] += 1
                        continue
                    yield RecordedMessage(
                        topic.name, topic.type, stamp_ns, data, topic.schema, topic.qos
                    )
        if orphans:
            self._note('orphans', f'{counted(orphans, "message")} of unknown channels skipped')
        for name, count in malformed.items():
            self._note(name, f'{counted(count, "malformed message")} of {name} skipped')
        if everything and promised is not None and seen < promised:
            self._note('count', f'{promised - seen} of {promised} messages lost')

    def _as_cdr(self, channel: int, data: memoryview) -> bytes | memoryview:
        if channel in self._channels.ros1:
            return self._channels.ros1[channel].to_cdr(data)
        return bytes(data) if len(data) < _LARGE else data

    def _count(self, stream: BinaryIO) -> Counter[int]:
        counts: Counter[int] = Counter()
        for opcode, body in self._contents(stream, -1, 1 << 64):
            if opcode == Opcode.MESSAGE:
                counts[MESSAGE_HEADER.unpack_from(body)[0]] += 1
            else:
                self._define(opcode, body)
        return counts

    def _contents(
        self, stream: BinaryIO, first: int, last: int
    ) -> Iterator[tuple[int, memoryview]]:
        """Schema, channel and message records, those inside chunks included."""
        walk = RecordWalk(stream, self._name, self._problems)
        lost_chunk: tuple[int, str] | None = None
        lost = 0
        for span in walk.spans():
            if span.opcode == Opcode.MESSAGE_INDEX:
                if lost_chunk is not None:
                    lost += (span.length - 6) // _INDEX_ENTRY_SIZE
                    self._note_chunk(lost_chunk, lost)
                continue
            lost_chunk = None
            if span.opcode == Opcode.CHUNK:
                reason = yield from self._chunk(walk, span, first, last)
                if reason:
                    lost_chunk, lost = (span.body - HEADER.size, reason), 0
                    self._note_chunk(lost_chunk, None)
            elif span.length > SIZE_LIMIT:
                self._note(span.body, f'record at byte {span.body} skipped: larger than 1 GB')
            elif span.length > MOST_SCHEMA_BYTES and span.opcode in _DEFINITIONS:
                self._note(span.body, f'definition at byte {span.body} skipped: larger than 64 MB')
            elif span.opcode in _CONTENT and span.available == span.length:
                yield span.opcode, memoryview(walk.read(span.body, span.length))

    def _chunk(
        self, walk: RecordWalk, span: RecordSpan, first: int, last: int
    ) -> Generator[tuple[int, memoryview], None, str]:
        """Yield the records of a chunk; return why it cannot be read, '' if it can."""
        header = walk.chunk_header(span)
        assert header is not None
        # Without an index, a chunk out of the range may still define a channel within it.
        known_times = self._indexed and header.end_ns > 0
        if known_times and (header.end_ns < first or header.start_ns >= last):
            return ''
        size = header.uncompressed_size
        raw, problem = unpack(
            walk.stream_at(header.data_offset),
            header.data_size,
            header.compression,
            size,
            max(size if size <= SIZE_LIMIT else 0, _CREDIBLE_SIZE),
        )
        if span.available < span.length:
            yield from self._records(raw)
            return ''
        if header.crc and header.crc == zlib.crc32(raw):
            problem = ''
        elif not problem:
            problem = _contradiction(header, raw)
        elif size > SIZE_LIMIT:
            problem = f'it is larger than 1 GB ({size} bytes)'
        for opcode, body in self._records(raw):
            # The first chunk often defines the channels of all others, at its very start.
            if not problem or opcode != Opcode.MESSAGE:
                yield opcode, body
        return problem

    def _records(self, view: memoryview) -> Iterator[tuple[int, memoryview]]:
        position = 0
        while position + HEADER.size <= len(view):
            opcode, length = HEADER.unpack_from(view, position)
            position += HEADER.size
            if opcode == 0 or position + length > len(view):  # zeros are no records
                return
            credible = length <= MOST_SCHEMA_BYTES or opcode == Opcode.MESSAGE
            if credible and opcode in _CONTENT and length >= _CONTENT[opcode]:
                yield opcode, view[position : position + length]
            position += length

    def _define(self, opcode: int, body: bytes | memoryview) -> None:
        try:
            self._channels.define(opcode, body)
        except DefinitionError as error:
            self._note('definitions', str(error))

    def _read_summary(self, stream: BinaryIO) -> bool:
        """Whether the channels could be taken from the file's end."""
        try:
            self._channels.read_summary(stream)
        except DefinitionError as error:
            self._note('index', str(error))
            return False
        return bool(self._channels.topics) or self._channels.promised == 0

    def _note_chunk(self, chunk: tuple[int, str], lost: int | None) -> None:
        offset, reason = chunk
        messages = 'its messages are' if lost is None else f'{counted(lost, "message")}'
        self._note(offset, f'chunk at byte {offset} skipped, as {reason}: {messages} lost')

    def _note(self, key: object, text: str) -> None:
        self._problems.error((self._path, key), f'{self._name}: {text}')


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
_CONTENT = {Opcode.SCHEMA: 8, Opcode.CHANNEL: 12, Opcode.MESSAGE: MESSAGE_HEADER.size}
