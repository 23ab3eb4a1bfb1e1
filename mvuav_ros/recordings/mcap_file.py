"""Reading one mcap file in stored order, whole or damaged."""

from __future__ import annotations

import struct
import zlib
from collections import Counter
from collections.abc import Container, Generator, Iterator, Sequence
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Footer, Statistics
from mcap.records import Schema as SchemaRecord

from mvuav_ros.recordings.compression import CompressionError, decompress, decompress_start
from mvuav_ros.recordings.mcap_records import HEADER, MAGIC, MESSAGE_HEADER, Frame, RecordWalk
from mvuav_ros.recordings.recording import (
    Losses,
    RecordedMessage,
    Schema,
    TopicInfo,
    counted,
    normalised_type,
)

_FOOTER_SIZE = HEADER.size + 20 + len(MAGIC)
_PARSE_ERRORS = (McapError, struct.error, UnicodeDecodeError, ValueError)
_INDEX_ENTRY_SIZE = 16


class McapFile:
    """One mcap file; it is opened anew for every pass."""

    def __init__(self, path: Path, losses: Losses) -> None:
        self._path = path
        self._name = path.name
        self._losses = losses
        self._schemas: dict[int, SchemaRecord] = {}
        self._topics: dict[int, TopicInfo] = {}
        self._promised: int | None = None
        self._indexed = False
        self._scanned = False

    def channels(self) -> Sequence[TopicInfo]:
        """Every channel, from the summary at the file's end or else from a pass through it."""
        if not self._scanned:
            with self._path.open('rb') as stream:
                self._indexed = self._read_summary(stream)
                if not self._indexed:
                    self._schemas.clear()
                    self._topics.clear()
                    self._set_counts(self._count(stream))
            self._scanned = True
        return tuple(self._topics.values())

    def messages(
        self, topics: Container[str] | None, start_ns: int | None, end_ns: int | None
    ) -> Iterator[RecordedMessage]:
        """The messages in stored order, ``start_ns`` <= log time < ``end_ns``."""
        self.channels()
        first = -1 if start_ns is None else start_ns
        last = 1 << 64 if end_ns is None else end_ns
        everything = start_ns is None and end_ns is None
        seen = orphans = 0
        with self._path.open('rb') as stream:
            for opcode, body in self._contents(stream, first, last):
                if opcode != Opcode.MESSAGE:
                    self._define(opcode, body)
                    continue
                seen += 1
                channel, _, stamp_ns, _ = MESSAGE_HEADER.unpack_from(body)
                topic = self._topics.get(channel)
                if topic is None:
                    orphans += 1
                    continue
                if topic.serialization_format != 'cdr' or not first <= stamp_ns < last:
                    continue
                if topics is None or topic.name in topics:
                    yield RecordedMessage(
                        topic.name,
                        topic.type,
                        stamp_ns,
                        bytes(body[MESSAGE_HEADER.size :]),
                        topic.schema,
                        topic.qos,
                    )
        if orphans:
            self._note('orphans', f'{counted(orphans, "message")} of unknown channels skipped')
        if everything and self._promised is not None and seen < self._promised:
            self._note('count', f'{self._promised - seen} of {self._promised} messages lost')

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
        walk = RecordWalk(stream, self._name, self._losses)
        lost_chunk: tuple[int, str] | None = None
        lost = 0
        for frame in walk.frames():
            if frame.opcode == Opcode.MESSAGE_INDEX:
                if lost_chunk is not None:
                    lost += (frame.length - 6) // _INDEX_ENTRY_SIZE
                    self._note_chunk(lost_chunk, lost)
                continue
            lost_chunk = None
            if frame.opcode == Opcode.CHUNK:
                reason = yield from self._chunk(walk, frame, first, last)
                if reason:
                    lost_chunk, lost = (frame.body - HEADER.size, reason), 0
                    self._note_chunk(lost_chunk, None)
            elif frame.opcode in _CONTENT and frame.available == frame.length:
                yield frame.opcode, memoryview(walk.read(frame.body, frame.length))

    def _chunk(
        self, walk: RecordWalk, frame: Frame, first: int, last: int
    ) -> Generator[tuple[int, memoryview], None, str]:
        """Yield the records of a chunk; return why it cannot be read, '' if it can."""
        header = walk.chunk_header(frame)
        assert header is not None
        # Without an index, a chunk out of the range may still define a channel within it.
        known_times = self._indexed and header.end_ns > 0
        if known_times and (header.end_ns < first or header.start_ns >= last):
            return ''
        data = walk.read(header.data_offset, header.data_size)
        if len(data) < header.data_size:
            yield from self._records(decompress_start(data, header.compression))
            return ''
        reason = ''
        try:
            raw = decompress(data, header.compression, header.uncompressed_size)
        except CompressionError as error:
            raw, reason = decompress_start(data, header.compression), str(error)
        if not reason and header.crc and zlib.crc32(raw) != header.crc:
            reason = 'its checksum is wrong'
        for opcode, body in self._records(raw):
            # The first chunk often defines the channels of all others, at its very start.
            if not reason or opcode != Opcode.MESSAGE:
                yield opcode, body
        return reason

    def _records(self, raw: bytes) -> Iterator[tuple[int, memoryview]]:
        view = memoryview(raw)
        position = 0
        while position + HEADER.size <= len(raw):
            opcode, length = HEADER.unpack_from(raw, position)
            position += HEADER.size
            if position + length > len(raw):
                return
            if opcode in _CONTENT and length >= _CONTENT[opcode]:
                yield opcode, view[position : position + length]
            position += length

    def _define(self, opcode: int, body: bytes | memoryview) -> None:
        """Take in a schema or channel record; the first of an id counts."""
        stream = ReadDataStream(BytesIO(body))
        try:
            if opcode == Opcode.SCHEMA:
                schema = SchemaRecord.read(stream)
                self._schemas.setdefault(schema.id, schema)
            elif opcode == Opcode.CHANNEL:
                channel = Channel.read(stream)
                if channel.id not in self._topics:
                    self._topics[channel.id] = self._topic(channel)
        except _PARSE_ERRORS:
            self._note('definitions', 'a channel or schema record is damaged')

    def _topic(self, channel: Channel) -> TopicInfo:
        record = self._schemas.get(channel.schema_id)
        schema = None
        if record is not None and record.data:
            schema = Schema(record.encoding, record.data.decode('utf-8', 'replace'))
        return TopicInfo(
            channel.topic,
            normalised_type(record.name) if record is not None else '',
            None,
            channel.message_encoding,
            schema,
            channel.metadata.get('offered_qos_profiles', ''),
        )

    def _read_summary(self, stream: BinaryIO) -> bool:
        """Take the channels and counts from the file's end, if all of it is sound."""
        size = stream.seek(0, 2)
        start = self._summary_start(stream, size)
        if start is None:
            self._note('index', 'its index is missing (was the recording cut off?)')
            return False
        stream.seek(start)
        summary = stream.read(size - len(MAGIC) - start)
        (crc,) = struct.unpack('<I', summary[-4:])
        if crc and zlib.crc32(summary[:-4]) != crc:
            self._note('index', 'its index is damaged')
            return False
        position = 0
        while position + HEADER.size <= len(summary):
            opcode, length = HEADER.unpack_from(summary, position)
            position += HEADER.size
            body = summary[position : position + length]
            if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                self._define(opcode, body)
            elif opcode == Opcode.STATISTICS:
                statistics = _parsed_statistics(body)
                if statistics is not None:
                    self._promised = statistics.message_count
                    self._set_counts(Counter(statistics.channel_message_counts))
            position += length
        return bool(self._topics)

    def _summary_start(self, stream: BinaryIO, size: int) -> int | None:
        """Where the summary begins (the footer, if there is none); None without a footer."""
        footer_offset = size - _FOOTER_SIZE
        if footer_offset < len(MAGIC):
            return None
        stream.seek(footer_offset)
        end = stream.read(_FOOTER_SIZE)
        if end[-len(MAGIC) :] != MAGIC or HEADER.unpack_from(end) != (Opcode.FOOTER, 20):
            return None
        footer = Footer.read(ReadDataStream(BytesIO(end[HEADER.size :])))
        if footer.summary_start == 0:
            return footer_offset
        return footer.summary_start if footer.summary_start <= footer_offset else None

    def _set_counts(self, counts: Counter[int]) -> None:
        for key, topic in self._topics.items():
            self._topics[key] = replace(topic, message_count=counts[key])

    def _note_chunk(self, chunk: tuple[int, str], lost: int | None) -> None:
        offset, reason = chunk
        messages = 'its messages are' if lost is None else f'{counted(lost, "message")}'
        self._note(offset, f'chunk at byte {offset} skipped, as {reason}: {messages} lost')

    def _note(self, key: object, text: str) -> None:
        self._losses.note((self._path, key), f'{self._name}: {text}')


def _parsed_statistics(body: bytes) -> Statistics | None:
    try:
        statistics: Statistics = Statistics.read(ReadDataStream(BytesIO(body)))
    except _PARSE_ERRORS:
        return None
    return statistics


_CONTENT = {Opcode.SCHEMA: 8, Opcode.CHANNEL: 12, Opcode.MESSAGE: MESSAGE_HEADER.size}
