"""The channels of an mcap file: what its schema, channel and statistics records define."""

from __future__ import annotations

import struct
from collections import Counter
from dataclasses import replace
from io import BytesIO
from typing import BinaryIO

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Statistics
from mcap.records import Schema as SchemaRecord

from mvuav_ros.messages.definitions import (
    Ros1Type,
    Schema,
    UnknownTypeError,
    normalised_type,
    ros1_type,
)
from mvuav_ros.messages.untrusted import words
from mvuav_ros.recordings.mcap_records import HEADER, MAGIC, is_intact, summary_start
from mvuav_ros.recordings.recording import TopicInfo

PARSE_ERRORS = (McapError, struct.error, UnicodeDecodeError, ValueError)
_DEFINING = (Opcode.SCHEMA, Opcode.CHANNEL)
_IN_SUMMARY = (
    *_DEFINING,
    *(Opcode.STATISTICS, Opcode.CHUNK_INDEX, Opcode.ATTACHMENT_INDEX, Opcode.METADATA_INDEX),
    *(Opcode.SUMMARY_OFFSET, Opcode.FOOTER, *range(0x80, 0x100)),
)
_Key = tuple[int, str, str, str]
MOST_SCHEMA_BYTES = 1 << 26
"""Of all schemas together; those of Autoware's hundreds of types are two million."""


class DefinitionError(ValueError):
    """A schema, channel or index that cannot be used, with the reason in words."""


class Channels:
    """Channels by their number, as they are defined on the way through the file.

    Attributes:
        topics: each channel's topic by now.
        ros1: what converts the messages of a channel that holds ROS 1's.
        counts: messages of each definition; None if nobody has said or counted them.
    """

    def __init__(self) -> None:
        self.topics: dict[int, TopicInfo] = {}
        self.ros1: dict[int, Ros1Type] = {}
        self.counts: Counter[_Key] | None = None
        self._found: dict[_Key, TopicInfo] = {}
        self._first: dict[int, TopicInfo] = {}
        self._schemas: dict[int, tuple[str, Schema | None]] = {}
        self._schema_bytes = 0

    def begin(self) -> None:
        """Begin at the file's start: until it defines a channel, the first that is known counts."""
        self.topics = dict(self._first)

    def forget(self) -> None:
        """Begin another file, joined to the one before: its numbers mean something else."""
        self.topics = {}
        self._schemas = {}
        self._schema_bytes = 0

    def listed(self) -> tuple[TopicInfo, ...]:
        """Every definition with its number of messages."""
        if self.counts is None:
            return tuple(self._found.values())
        counts = self.counts
        return tuple(replace(info, message_count=counts[key]) for key, info in self._found.items())

    def count(self, channel: int) -> None:
        """Count a message, if its channel is known."""
        if self.counts is not None and channel in self.topics:
            self.counts[_key(channel, self.topics[channel])] += 1

    def define(self, opcode: int, body: bytes | memoryview, *, in_summary: bool = False) -> str:
        """Take in a schema or channel record; one of a summary counts where the data have none.

        Returns:
            In words, how it contradicts what was said of the channel before; '' if it does not.

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
                if not (in_summary and record.id in self._schemas):
                    self._schemas[record.id] = normalised_type(record.name), schema
                return ''
            channel = Channel.read(stream)
        except PARSE_ERRORS:
            raise DefinitionError('a channel or schema record is damaged') from None
        if in_summary and channel.id in self.topics:
            return ''
        return self._take_channel(channel)

    def read_summary(self, stream: BinaryIO) -> bool:
        """Take the channels and counts from the file's end; whether it has them.

        Raises:
            DefinitionError: not all of it is sound.
        """
        size = stream.seek(0, 2)
        start, end = summary_start(stream, size), size - len(MAGIC)
        if start is None:
            raise DefinitionError('its index is missing (was the recording cut off?)')
        if not is_intact(stream, start, end):
            raise DefinitionError('its index is damaged')
        statistics = None
        while start + HEADER.size <= end:
            stream.seek(start)
            opcode, length = HEADER.unpack(stream.read(HEADER.size))
            start += HEADER.size + length
            if opcode not in _IN_SUMMARY or start > end:
                raise DefinitionError('its index is damaged')
            if opcode in _DEFINING and length <= MOST_SCHEMA_BYTES:
                self.define(opcode, stream.read(length))
            elif opcode == Opcode.STATISTICS:
                statistics = statistics_of(stream.read(length))
        if statistics is not None:
            counts = statistics.channel_message_counts
            self.counts = Counter({key: counts.get(key[0], 0) for key in self._found})
        return bool(self._found) or (statistics is not None and statistics.message_count == 0)

    def _take_channel(self, channel: Channel) -> str:
        topic = self._topic(channel)
        before = self.topics.get(channel.id)
        self.topics[channel.id] = topic
        self._first.setdefault(channel.id, topic)
        self._found.setdefault(_key(channel.id, topic), topic)
        if before is None or _key(0, before) == _key(0, topic):
            return ''
        return (
            f'channel {channel.id} was said to be {words(before.name)} ({words(before.type)}), '
            f'and is {words(topic.name)} ({words(topic.type)}) in the data'
        )

    def _topic(self, channel: Channel) -> TopicInfo:
        kind, schema = self._schemas.get(channel.schema_id, ('', None))
        encoding = channel.message_encoding
        self.ros1.pop(channel.id, None)
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


def statistics_of(body: bytes) -> Statistics | None:
    """The statistics record; None if it is damaged."""
    try:
        statistics: Statistics = Statistics.read(ReadDataStream(BytesIO(body)))
    except PARSE_ERRORS:
        return None
    return statistics


def _key(channel: int, topic: TopicInfo) -> _Key:
    return channel, topic.name, topic.type, topic.serialization_format
