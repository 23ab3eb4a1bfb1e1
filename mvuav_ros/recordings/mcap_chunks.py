"""Building an mcap file's chunks and summary as bytes.

mcap's own writer ends a chunk by its size alone, has no say in the compression level, and keeps
an object per chunk; a recording that must survive being killed needs chunks to end by time.
"""

from __future__ import annotations

import struct
import zlib
from typing import Any, NamedTuple

import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from mvuav_ros.recordings.mcap_records import CHUNK_HEADER, HEADER, MAGIC, MESSAGE_HEADER

_COMPRESSION = b'zstd'
_LEVEL = 1
_INDEX_ENTRY = struct.Struct('<QQ')
_INDEX_HEADER = struct.Struct('<HI')


class Chunk:
    """Records on their way into the file; times in ns, sizes in bytes."""

    def __init__(self) -> None:
        self._records = bytearray()
        self._entries: dict[int, bytearray] = {}
        self.message_count = 0
        self.start_ns = (1 << 64) - 1
        self.end_ns = 0

    @property
    def size(self) -> int:
        """The size before compression."""
        return len(self._records)

    @property
    def counts(self) -> dict[int, int]:
        """The number of messages of each channel."""
        return {key: len(entries) // _INDEX_ENTRY.size for key, entries in self._entries.items()}

    def define(self, record: McapRecord) -> None:
        """Add a schema or channel."""
        self._records += record_bytes(record)

    def add(
        self, channel: int, sequence: int, times_ns: tuple[int, int], data: bytes | memoryview
    ) -> None:
        """Add a message; ``times_ns`` are when it was logged and published."""
        stamp_ns = times_ns[0]
        offset = len(self._records)
        entries = self._entries.get(channel)
        if entries is None:
            entries = self._entries[channel] = bytearray()
        indexed = len(entries)
        try:
            self._records += HEADER.pack(Opcode.MESSAGE, MESSAGE_HEADER.size + len(data))
            self._records += MESSAGE_HEADER.pack(channel, sequence, *times_ns)
            self._records += data
            entries += _INDEX_ENTRY.pack(stamp_ns, offset)
            self.message_count += 1
        except BaseException:  # Ctrl-C too must leave only whole messages
            del self._records[offset:]
            del entries[indexed:]
            raise
        self.start_ns = min(self.start_ns, stamp_ns)
        self.end_ns = max(self.end_ns, stamp_ns)

    def takes(self, stamp_ns: int, span_ns: int) -> bool:
        """Whether a message of that time keeps the chunk within the span of time."""
        if self.message_count == 0:
            return True
        return self.end_ns - span_ns < stamp_ns < self.start_ns + span_ns

    def encode(self, offset: int) -> EncodedChunk:
        """The chunk and message index records, to be written at ``offset`` of the file."""
        start_ns = self.start_ns if self._entries else 0
        data = zstandard.ZstdCompressor(level=_LEVEL).compress(self._records)
        head = CHUNK_HEADER.pack(
            start_ns, self.end_ns, self.size, zlib.crc32(self._records), len(_COMPRESSION)
        )
        head += _COMPRESSION + struct.pack('<Q', len(data))
        pieces: list[bytes | bytearray] = [
            HEADER.pack(Opcode.CHUNK, len(head) + len(data)),
            head,
            data,
        ]
        chunk_length = index_offset = sum(len(piece) for piece in pieces)
        offsets: dict[int, int] = {}
        for key, entries in self._entries.items():
            offsets[key] = offset + index_offset
            head = _INDEX_HEADER.pack(key, len(entries))
            pieces += [HEADER.pack(Opcode.MESSAGE_INDEX, len(head) + len(entries)), head, entries]
            index_offset += HEADER.size + len(head) + len(entries)
        index = ChunkIndex(
            chunk_length=chunk_length,
            chunk_start_offset=offset,
            compression=_COMPRESSION.decode(),
            compressed_size=len(data),
            message_end_time=self.end_ns,
            message_index_length=index_offset - chunk_length,
            message_index_offsets=offsets,
            message_start_time=start_ns,
            uncompressed_size=self.size,
        )
        return EncodedChunk(b''.join(pieces), record_bytes(index))


class EncodedChunk(NamedTuple):
    """What goes into the file now, and the index record that goes to its end."""

    data: bytes
    index_record: bytes


class Summary:
    """What stands at a file's end; kept as bytes, as there is a chunk for every half second."""

    def __init__(self) -> None:
        self._schemas = bytearray()
        self._channels = bytearray()
        self._chunks = bytearray()
        self._metadata = bytearray()
        self._attachments = bytearray()
        self._statistics = Statistics(
            attachment_count=0,
            channel_count=0,
            channel_message_counts={},
            chunk_count=0,
            message_count=0,
            metadata_count=0,
            message_start_time=0,
            message_end_time=0,
            schema_count=0,
        )

    def define(self, record: Schema | Channel) -> None:
        """Add a schema or channel."""
        if isinstance(record, Schema):
            self._schemas += record_bytes(record)
            self._statistics.schema_count += 1
        else:
            self._channels += record_bytes(record)
            self._statistics.channel_count += 1

    def add(self, chunk: Chunk, index: bytes) -> None:
        """Add a chunk that was written."""
        self._chunks += index
        statistics = self._statistics
        statistics.chunk_count += 1
        counts = statistics.channel_message_counts
        for key, count in chunk.counts.items():
            first = statistics.message_count == 0
            statistics.message_start_time = (
                chunk.start_ns if first else min(statistics.message_start_time, chunk.start_ns)
            )
            statistics.message_end_time = max(statistics.message_end_time, chunk.end_ns)
            statistics.message_count += count
            counts[key] = counts.get(key, 0) + count

    def add_extra(self, record: Attachment | Metadata, offset: int) -> bytes:
        """An attachment or metadata as it is to be written at ``offset``."""
        data = record_bytes(record)
        if isinstance(record, Metadata):
            index = MetadataIndex(offset=offset, length=len(data), name=record.name)
            self._metadata += record_bytes(index)
            self._statistics.metadata_count += 1
            return data
        about = record.log_time, record.create_time, len(record.data), record.name
        attached = AttachmentIndex(offset, len(data), *about, record.media_type)
        self._attachments += record_bytes(attached)
        self._statistics.attachment_count += 1
        return data

    def encode(self, offset: int) -> bytes:
        """Everything from the data's end to the file's end, to be written at ``offset``."""
        data_end = record_bytes(DataEnd(0))
        start = offset + len(data_end)
        groups = (
            (Opcode.SCHEMA, bytes(self._schemas)),
            (Opcode.CHANNEL, bytes(self._channels)),
            (Opcode.STATISTICS, record_bytes(self._statistics)),
            (Opcode.CHUNK_INDEX, bytes(self._chunks)),
            (Opcode.ATTACHMENT_INDEX, bytes(self._attachments)),
            (Opcode.METADATA_INDEX, bytes(self._metadata)),
        )
        summary = b''.join(group for _, group in groups)
        offsets_start = start + len(summary)
        group_start = start
        for opcode, group in groups:
            if group:
                summary += record_bytes(SummaryOffset(opcode, group_start, len(group)))
            group_start += len(group)
        footer = record_bytes(Footer(start, offsets_start, 0))[:-4]
        crc = struct.pack('<I', zlib.crc32(footer, zlib.crc32(summary)))
        return data_end + summary + footer + crc + MAGIC


def record_bytes(record: McapRecord) -> bytes:
    """One record as it stands in the file."""
    builder: Any = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())
