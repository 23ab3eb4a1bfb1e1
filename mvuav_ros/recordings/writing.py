"""Writing a recording as an mcap file that is readable however the writing ends."""

from __future__ import annotations

import errno
import os
import struct
import threading
import time
import zlib
from collections import Counter, deque
from collections.abc import Iterable, Mapping
from contextlib import AbstractContextManager, suppress
from pathlib import Path
from types import MappingProxyType
from typing import Any

import zstandard
from mcap import records
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Attachment, McapRecord, Metadata

from mvuav_ros.messages.definitions import Schema, schema_of, type_hash
from mvuav_ros.messages.sensors import normalised_type
from mvuav_ros.recordings.account import RecordingError
from mvuav_ros.recordings.layout import MCAP_START as MAGIC
from mvuav_ros.recordings.mcap_file import HEADER, MESSAGE_HEADER
from mvuav_ros.recordings.stored_file import RecordedMessage


class OutputFile:
    """A file that is appended to; ``size`` is what it holds by now, in bytes."""

    def __init__(self, path: Path, overwrite: bool) -> None:
        """Create the file, and its folder.

        Raises:
            RecordingError: it exists or cannot be created.
        """
        self.path = path
        self.size = 0
        if path.suffix != '.mcap':
            raise RecordingError(f'{path}: the name of a recording must end in .mcap')
        if path.is_dir():
            raise RecordingError(f'{path} is a folder; give the name of a file')
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            said = f'{path.parent} cannot be made: {error.strerror or error}'
            raise RecordingError(said) from None
        try:
            if overwrite:
                # Not truncated in place: someone may be reading the old file.
                path.unlink(missing_ok=True)
            flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC
            self._file = os.open(path, flags, 0o666)
        except FileExistsError:
            said = f'{path} exists; choose another name, or overwrite it (--force)'
            raise RecordingError(said) from None
        except OSError as error:
            raise RecordingError(f'{path} cannot be written: {error.strerror or error}') from None

    def append(self, data: bytes) -> None:
        """Write all of ``data``, or nothing if that fails.

        Raises:
            OSError: it failed.
        """
        view = memoryview(data)
        try:
            while view:
                view = view[os.write(self._file, view) :]
        except OSError:
            with suppress(OSError):
                os.ftruncate(self._file, self.size)
            raise
        self.size += len(data)

    def close(self, *, keep: bool = True) -> None:
        """Let go of the file, or remove it: it would be in the way of the next attempt.

        Raises:
            OSError: the operating system says only now that it could not write, or the file is not
                there any more: another program has put its own in its place.
        """
        try:
            if not self._is_there:
                raise OSError(errno.ESTALE, 'another program has replaced it meanwhile')
            if not keep:
                self.path.unlink(missing_ok=True)
        finally:
            os.close(self._file)

    @property
    def _is_there(self) -> bool:
        """Whether the file is still the one of that name."""
        try:
            return os.path.samestat(os.fstat(self._file), self.path.lstat())
        except OSError:
            return False


_CHUNK_BYTES = 1 << 20
# Chunks end by the messages' own time, so that the same messages give the same file; only where
# the processing is slower than half of real time does the clock on the wall have to end them.
_CHUNK_NS = 500_000_000
_CHUNK_WALL_S = 0.8
_MAX_WAITING = 4

# Reliable, volatile, the last ten: as numbers, which every ROS 2 release's rosbag2 reads.
RELIABLE_QOS = """\
- history: 1
  depth: 10
  reliability: 1
  durability: 2
  deadline: {sec: 9223372036, nsec: 854775807}
  lifespan: {sec: 9223372036, nsec: 854775807}
  liveliness: 1
  liveliness_lease_duration: {sec: 9223372036, nsec: 854775807}
  avoid_ros_namespace_conventions: false
"""


class _Chunk:
    """Messages on their way into the file; ``size`` in bytes."""

    def __init__(self) -> None:
        self.messages: list[RecordedMessage] = []
        self.size = 0
        self.start_ns = self.end_ns = 0

    def add(self, message: RecordedMessage) -> None:
        """Take one more; appending it is a single step, so that Ctrl-C leaves only whole ones."""
        stamp_ns = message.stamp_ns
        if not self.messages:
            self.start_ns = self.end_ns = stamp_ns
        self.start_ns, self.end_ns = min(self.start_ns, stamp_ns), max(self.end_ns, stamp_ns)
        self.size += MESSAGE_HEADER.size + len(message.data)
        self.messages.append(message)

    def takes(self, stamp_ns: int) -> bool:
        """Whether a message of that time keeps the chunk within its span of time."""
        is_near = self.end_ns - _CHUNK_NS < stamp_ns < self.start_ns + _CHUNK_NS
        return is_near or not self.messages


_Channel = tuple[str, str, Schema | None]
"""Topic, type, and definition, None where it is Jazzy's."""


_LEVEL = 1
_SUMMARY = (
    *(Opcode.SCHEMA, Opcode.CHANNEL, Opcode.STATISTICS),
    *(Opcode.CHUNK_INDEX, Opcode.ATTACHMENT_INDEX, Opcode.METADATA_INDEX),
)
_builder: Any = RecordBuilder
"""The library's, which has no types."""


def record_bytes(record: McapRecord) -> bytes:
    """One record as it stands in the file."""
    content = _builder()
    record.write(content)
    return bytes(content.end())


class McapPart:
    """One mcap file; the ``messages`` in it by now are from ``start_ns`` to ``end_ns``.

    ``channels`` has the number and QoS of each, ``counts`` its messages by the number.
    """

    def __init__(
        self, path: Path, overwrite: bool, metadata: Mapping[str, Mapping[str, str]]
    ) -> None:
        """Create the file with the records of ``metadata`` by name; errors as of `OutputFile`."""
        self.file = OutputFile(path, overwrite)
        self.messages = self.start_ns = self.end_ns = 0
        self.channels: dict[_Channel, tuple[int, str]] = {}
        self.counts: Counter[int] = Counter()
        self._schemas: dict[tuple[str, Schema | None], int] = {}
        # Kept as bytes, as there is a chunk for every half second.
        self._summary = {opcode: _builder() for opcode in _SUMMARY}
        self._listed: Counter[Opcode] = Counter()
        try:
            self.file.append(MAGIC + record_bytes(records.Header('ros2', 'mvuav_ros')))
            for name, values in metadata.items():
                self._append_extra(Metadata(name, dict(values)))
        except OSError as error:
            self.file.close(keep=False)
            raise self.failure(error) from None

    def write(self, chunk: _Chunk) -> None:
        """Write the messages of a chunk; OSError where it fails, and then none of them."""
        raw, indexes = self._content(chunk)
        data = zstandard.ZstdCompressor(level=_LEVEL).compress(raw)
        times, checksum = (chunk.end_ns, chunk.start_ns), zlib.crc32(raw)
        packed = _builder()
        records.Chunk('zstd', data, *times, checksum, len(raw)).write(packed)
        length, offset, offsets = packed.count, self.file.size, dict[int, int]()
        for channel, index in indexes.items():
            offsets[channel] = offset + packed.count
            index.write(packed)
        listed = records.ChunkIndex(
            chunk_length=length,
            chunk_start_offset=offset,
            compression='zstd',
            compressed_size=len(data),
            message_end_time=chunk.end_ns,
            message_index_length=packed.count - length,
            message_index_offsets=offsets,
            message_start_time=chunk.start_ns,
            uncompressed_size=len(raw),
        )
        self.file.append(packed.end())
        self._list(Opcode.CHUNK_INDEX, listed)
        self.start_ns = min(self.start_ns, chunk.start_ns) if self.messages else chunk.start_ns
        self.end_ns = max(self.end_ns, chunk.end_ns)
        self.messages += len(chunk.messages)

    def _content(self, chunk: _Chunk) -> tuple[bytes, dict[int, records.MessageIndex]]:
        """A chunk's records, and where in them each channel's messages are."""
        content, indexes = _builder(), dict[int, records.MessageIndex]()
        for topic, kind, logged_ns, data, schema, qos, published_ns, number in chunk.messages:
            key = topic, kind, schema
            if key not in self.channels:
                self.channels[key] = self._define(content, *key, qos), qos
            channel, _ = self.channels[key]
            self.counts[channel] += 1
            number = self.counts[channel] if number is None else number
            published_ns = logged_ns if published_ns is None else published_ns
            if channel not in indexes:
                indexes[channel] = records.MessageIndex(channel, [])
            indexes[channel].records.append((logged_ns, content.count))
            head = HEADER.pack(Opcode.MESSAGE, MESSAGE_HEADER.size + len(data))
            content.write(head + MESSAGE_HEADER.pack(channel, number, logged_ns, published_ns))
            content.write(data)
        return content.end(), indexes

    def _define(self, content: Any, topic: str, type: str, schema: Schema | None, qos: str) -> int:
        """Define a channel in a chunk; its number."""
        kind = normalised_type(type)
        text = schema or schema_of(kind)
        if (kind, text) not in self._schemas:
            number = self._schemas[kind, text] = len(self._schemas) + 1
            encoding, definition = text or ('', '')
            record = records.Schema(number, definition.encode(), encoding, kind)
            record.write(content)
            self._list(Opcode.SCHEMA, record)
        metadata = {'offered_qos_profiles': qos}
        if text == schema_of(kind) and type_hash(kind):
            metadata['topic_type_hash'] = type_hash(kind)
        number = len(self.channels) + 1
        channel = records.Channel(number, topic, 'cdr', metadata, self._schemas[kind, text])
        channel.write(content)
        self._list(Opcode.CHANNEL, channel)
        return number

    def _append_extra(self, record: Attachment | Metadata) -> None:
        offset, data = self.file.size, record_bytes(record)
        self.file.append(data)
        if isinstance(record, Metadata):
            index = records.MetadataIndex(offset, len(data), record.name)
            self._list(Opcode.METADATA_INDEX, index)
        else:
            about = record.log_time, record.create_time, len(record.data), record.name
            attached = records.AttachmentIndex(offset, len(data), *about, record.media_type)
            self._list(Opcode.ATTACHMENT_INDEX, attached)

    def _list(self, opcode: Opcode, record: McapRecord) -> None:
        """Keep a record for the file's end."""
        record.write(self._summary[opcode])
        self._listed[opcode] += 1

    def complete(self, extras: Iterable[Attachment | Metadata]) -> None:
        """Write the last records, and the end; OSError where it fails."""
        for record in extras:
            self._append_extra(record)
        statistics = records.Statistics(
            attachment_count=self._listed[Opcode.ATTACHMENT_INDEX],
            channel_count=self._listed[Opcode.CHANNEL],
            channel_message_counts=dict(self.counts),
            chunk_count=self._listed[Opcode.CHUNK_INDEX],
            message_count=self.messages,
            message_end_time=self.end_ns,
            message_start_time=self.start_ns,
            metadata_count=self._listed[Opcode.METADATA_INDEX],
            schema_count=self._listed[Opcode.SCHEMA],
        )
        self._list(Opcode.STATISTICS, statistics)
        data_end = record_bytes(records.DataEnd(0))
        start, summary, offsets = self.file.size + len(data_end), b'', b''
        for opcode, group in self._summary.items():
            if group.count:
                place = start + len(summary), group.count
                offsets += record_bytes(records.SummaryOffset(opcode, *place))
                summary += group.end()
        footer = record_bytes(records.Footer(start, start + len(summary), 0))[:-4]
        checksum = zlib.crc32(footer, zlib.crc32(summary + offsets))
        end = footer + struct.pack('<I', checksum) + MAGIC
        self.file.append(data_end + summary + offsets + end)

    def failure(self, error: Exception) -> RecordingError:
        """The error in words for the user."""
        if isinstance(error, RecordingError):
            return error
        reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        kept = '; what it holds so far can be read' if self.messages else ''
        return RecordingError(f'{reason}: {self.file.path} cannot be written{kept}')


class RecordingWriter(AbstractContextManager['RecordingWriter']):
    """Writes messages to a .mcap file with zstd chunks and embedded schemas.

    A context manager: the file is completed at the end, also when the user interrupts
    (KeyboardInterrupt, SystemExit). After any other exception everything so far is in the file,
    but the end mark is left out, so that it does not look complete; a file without a message is
    removed. A process that is killed leaves what is older than a second.

    Attributes:
        path: of the file.
        parts: the file; of a folder as rosbag2 makes it each file by now.
        moved: messages from before 1970, which were given the time 0.
        extras: attachments and metadata that are written at the end.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        overwrite: bool = False,
        metadata: Mapping[str, Mapping[str, str]] = MappingProxyType({}),
        split_bytes: int = 0,
    ) -> None:
        """Create the file, whose name ends in '.mcap', with the records of ``metadata`` by name.

        The next part begins when one has reached ``split_bytes``; 0: never.

        Raises:
            RecordingError: the file exists or cannot be created.
        """
        self.path = Path(path)
        self.moved = 0
        self.extras: Iterable[Attachment | Metadata] = ()
        self._split_bytes = split_bytes
        self._given = overwrite, metadata
        self.parts = [McapPart(self._part_path(0), *self._given)]
        # The last one is being filled; appending an empty one hands it over in a single step,
        # so that Ctrl-C at any moment loses and doubles nothing.
        self._chunks = deque([_Chunk()])
        self._since = 0.0
        self._changed = threading.Condition()
        self._closed = False
        self._error: Exception | None = None
        self._thread = threading.Thread(target=self._run, name='recording', daemon=True)
        self._thread.start()

    def _part_path(self, number: int) -> Path:
        """Where a part lies; there is only one."""
        return self.path

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is not None and issubclass(kind, Exception):
            with suppress(RecordingError):
                self.close(complete=False)
            return
        self.close()

    @property
    def size(self) -> int:
        """Bytes in the file, or files, by now."""
        return sum(part.file.size for part in self.parts)

    def write(
        self,
        topic: str,
        type: str,
        stamp_ns: int,
        cdr: bytes | memoryview,
        schema: Schema | None = None,
        qos: str = RELIABLE_QOS,
        publish_ns: int | None = None,
        sequence: int | None = None,
    ) -> None:
        """Write one message; that of another recording as ``write(*message)``.

        ``type`` is 'pkg/msg/Type', times are ns since the epoch, ``cdr`` has its four-byte header,
        and ``qos`` is as rosbag2 writes it. Left out, the definition is Jazzy's, the publishing
        time the log time, and the number counted here.

        Raises:
            RecordingError: the file cannot be written, such as when the disk is full.
        """
        with self._changed:
            if self._error is not None or self._closed:
                self._raise_error()
                raise RecordingError(f'{self.path} is already closed')
            # ROS clocks start at zero; an mcap file holds no earlier time.
            self.moved += stamp_ns < 0
            stamp_ns = max(stamp_ns, 0)
            if not self._chunks[-1].takes(stamp_ns):
                self._hand_over()
            chunk = self._chunks[-1]
            if not chunk.messages:
                self._since = time.monotonic()
                self._changed.notify_all()
            of = schema, qos, publish_ns, sequence
            # Its own: a caller's buffer may be used again before the thread writes it.
            chunk.add(RecordedMessage(topic, type, stamp_ns, bytes(cdr), *of))
            if chunk.size >= _CHUNK_BYTES:
                self._hand_over()

    def close(self, *, complete: bool = True) -> None:
        """Write what is left, and the end that makes the file ``complete``.

        Raises:
            RecordingError: the file cannot be written; it then ends after the last whole chunk.
        """
        with self._changed:
            if self._closed:
                return
            self._closed = True
            self._changed.notify_all()
        self._thread.join()
        part = self.parts[-1]
        try:
            if complete and self._error is None:
                part.complete(self.extras)
        except OSError as error:
            self._error = error
        try:
            part.file.close(keep=part.messages > 0 or (complete and self._error is None))
        except OSError as error:
            self._error = self._error or error
        self._raise_error()

    def _hand_over(self) -> None:
        """Begin a new chunk, once the thread keeps up; the lock is held."""
        while len(self._chunks) > _MAX_WAITING and self._error is None:
            self._changed.wait()
        self._raise_error()
        if self._chunks[-1].messages:
            self._chunks.append(_Chunk())
            self._changed.notify_all()

    def _run(self) -> None:
        while (chunk := self._next_chunk()) is not None:
            try:
                if 0 < self._split_bytes <= self.parts[-1].file.size:
                    self.parts[-1].complete(())
                    self.parts[-1].file.close()
                    self.parts.append(McapPart(self._part_path(len(self.parts)), *self._given))
                self.parts[-1].write(chunk)
            except Exception as error:
                with self._changed:
                    self._error = error
                    self._changed.notify_all()
                return

    def _next_chunk(self) -> _Chunk | None:
        with self._changed:
            while len(self._chunks) == 1 and not self._closed:
                if not self._chunks[0].messages:
                    self._changed.wait()
                    continue
                left = self._since + _CHUNK_WALL_S - time.monotonic()
                if left > 0:
                    self._changed.wait(left)
                else:
                    self._chunks.append(_Chunk())
            chunk = self._chunks.popleft() if self._chunks else None
            self._changed.notify_all()
            return chunk if chunk is not None and chunk.messages else None

    def _raise_error(self) -> None:
        if self._error is not None:
            raise self.parts[-1].failure(self._error)
