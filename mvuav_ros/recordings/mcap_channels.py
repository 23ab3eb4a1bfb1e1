"""The channels of an mcap file: what its schema, channel and statistics records define."""

from __future__ import annotations

import struct
import zlib
from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from io import BytesIO
from typing import BinaryIO

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Footer, Statistics
from mcap.records import Schema as SchemaRecord

from mvuav_ros.recordings.mcap_records import HEADER, MAGIC
from mvuav_ros.recordings.recording import Schema, TopicInfo, normalised_type
from mvuav_ros.recordings.ros1_types import Ros1Type, UnknownTypeError, ros1_type

_FOOTER_SIZE = HEADER.size + 20 + len(MAGIC)
_PARSE_ERRORS = (McapError, struct.error, UnicodeDecodeError, ValueError)
_DEFINING = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.STATISTICS)
MOST_SCHEMA_BYTES = 1 << 26
"""Of all schemas together; those of Autoware's hundreds of types are two million."""

_BLOCK = 1 << 20


class DefinitionError(ValueError):
    """A schema, channel or index that cannot be used, with the reason in words."""


class Channels:
    """Channels by their number; the first definition of a number counts.

    Attributes:
        topics: each channel's topic.
        ros1: what converts the messages of a channel that holds ROS 1's.
        promised: number of messages that the file's statistics promise; None without any.
    """

    def __init__(self) -> None:
        self.topics: dict[int, TopicInfo] = {}
        self.ros1: dict[int, Ros1Type] = {}
        self.promised: int | None = None
        self._schemas: dict[int, tuple[str, Schema | None]] = {}
        self._schema_bytes = 0

    def define(self, opcode: int, body: bytes | memoryview) -> None:
        """Take in a schema or channel record.

        Raises:
            DefinitionError: it is damaged.
        """
        if opcode == Opcode.SCHEMA:
            self._schema_bytes += len(body)
            if self._schema_bytes > MOST_SCHEMA_BYTES:
                raise DefinitionError('its schemas are implausibly large')
        stream = ReadDataStream(BytesIO(body))
        try:
            if opcode == Opcode.SCHEMA:
                record = SchemaRecord.read(stream)
                text = record.data.decode('utf-8', 'replace')
                schema = Schema(record.encoding, text) if text else None
                self._schemas.setdefault(record.id, (normalised_type(record.name), schema))
            elif opcode == Opcode.CHANNEL:
                channel = Channel.read(stream)
                if channel.id not in self.topics:
                    self.topics[channel.id] = self._topic(channel)
        except _PARSE_ERRORS:
            raise DefinitionError('a channel or schema record is damaged') from None

    def set_counts(self, counts: Mapping[int, int]) -> None:
        """Set every channel's number of messages."""
        for key, topic in self.topics.items():
            self.topics[key] = replace(topic, message_count=counts.get(key, 0))

    def read_summary(self, stream: BinaryIO) -> None:
        """Take the channels and counts from the file's end.

        Raises:
            DefinitionError: not all of it is sound.
        """
        size = stream.seek(0, 2)
        start, end = _summary_start(stream, size), size - len(MAGIC)
        if start is None:
            raise DefinitionError('its index is missing (was the recording cut off?)')
        if not _is_intact(stream, start, end):
            raise DefinitionError('its index is damaged')
        while start + HEADER.size <= end:
            stream.seek(start)
            opcode, length = HEADER.unpack(stream.read(HEADER.size))
            start += HEADER.size + length
            if opcode in _DEFINING and start <= end and length <= MOST_SCHEMA_BYTES:
                self._take(opcode, stream.read(length))

    def _take(self, opcode: int, body: bytes) -> None:
        if opcode != Opcode.STATISTICS:
            self.define(opcode, body)
            return
        try:
            statistics = Statistics.read(ReadDataStream(BytesIO(body)))
        except _PARSE_ERRORS:
            return
        self.promised = statistics.message_count
        self.set_counts(Counter(statistics.channel_message_counts))

    def _topic(self, channel: Channel) -> TopicInfo:
        kind, schema = self._schemas.get(channel.schema_id, ('', None))
        encoding = channel.message_encoding
        if encoding == 'ros1':
            try:
                self.ros1[channel.id] = ros1_type(kind, schema.text if schema else '')
                schema = self.ros1[channel.id].schema
            except UnknownTypeError:
                encoding = 'ros1 without a valid definition'
        return TopicInfo(
            channel.topic,
            kind,
            None,
            encoding,
            schema,
            channel.metadata.get('offered_qos_profiles', ''),
        )


def _summary_start(stream: BinaryIO, size: int) -> int | None:
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


def _is_intact(stream: BinaryIO, start: int, end: int) -> bool:
    """Whether the checksum at the summary's end holds; without one it is believed."""
    stream.seek(end - 4)
    (expected,) = struct.unpack('<I', stream.read(4))
    if expected == 0:
        return True
    stream.seek(start)
    checksum, left = 0, end - 4 - start
    while left > 0:
        block = stream.read(min(left, _BLOCK))
        checksum = zlib.crc32(block, checksum)
        left -= len(block)
    return bool(checksum == expected)
