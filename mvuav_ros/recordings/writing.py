"""Writing a recording as an mcap file that is readable however the writing ends."""

from __future__ import annotations

import errno
import os
import struct
import threading
import time
import zlib
from collections import Counter, deque
from collections.abc import Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, suppress
from itertools import count
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

    @property
    def is_there(self) -> bool:
        """Whether the file is still the one of that name."""
        try:
            return os.path.samestat(os.fstat(self._file), self.path.lstat())
        except OSError:
            return False

    def close(self) -> None:
        """Let go of the file.

        Raises:
            OSError: the operating system says only now that it could not write, or the file is not
                there any more: another program has put its own in its place.
        """
        try:
            if not self.is_there:
                raise OSError(errno.ESTALE, 'another program has replaced it meanwhile')
        finally:
            os.close(self._file)

    def failure(self, error: Exception, messages: int) -> RecordingError:
        """The error in words for the user; so many messages are in the file."""
        reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        kept = '; what it holds so far can be read' if messages else ''
        return RecordingError(f'{reason}: {self.path} cannot be written{kept}')


_LEVEL = 1
_INDEX_ENTRY = struct.Struct('<QQ')
_INDEX_HEADER = struct.Struct('<HI')
_SUMMARY = (
    *(Opcode.SCHEMA, Opcode.CHANNEL, Opcode.STATISTICS),
    *(Opcode.CHUNK_INDEX, Opcode.ATTACHMENT_INDEX, Opcode.METADATA_INDEX),
)


class Chunk:
    """Records on their way into the file; times in ns, sizes in bytes."""

    def __init__(self) -> None:
        self._records = bytearray()
        self.entries: dict[int, bytearray] = {}
        self.message_count = 0
        self.start_ns = (1 << 64) - 1
        self.end_ns = 0

    @property
    def size(self) -> int:
        """Bytes before compression."""
        return len(self._records)

    def define(self, record: McapRecord) -> None:
        """Add a schema or channel."""
        self._records += record_bytes(record)

    def add(
        self, channel: int, number: int, stamp_ns: int, publish_ns: int, data: bytes | memoryview
    ) -> int:
        """Add a message, logged and published at these times; returns the size by now."""
        offset = len(self._records)
        entries = self.entries.setdefault(channel, bytearray())
        indexed = len(entries)
        try:
            self._records += HEADER.pack(Opcode.MESSAGE, MESSAGE_HEADER.size + len(data))
            self._records += MESSAGE_HEADER.pack(channel, number, stamp_ns, publish_ns)
            self._records += data
            entries += _INDEX_ENTRY.pack(stamp_ns, offset)
            self.message_count += 1
        except BaseException:  # Ctrl-C too must leave only whole messages
            del self._records[offset:]
            del entries[indexed:]
            raise
        self.start_ns, self.end_ns = min(self.start_ns, stamp_ns), max(self.end_ns, stamp_ns)
        return len(self._records)

    def takes(self, stamp_ns: int) -> bool:
        """Whether a message of that time keeps the chunk within its span of time."""
        if self.message_count == 0:
            return True
        return self.end_ns - _CHUNK_NS < stamp_ns < self.start_ns + _CHUNK_NS

    def encode(self, offset: int) -> tuple[bytes, records.ChunkIndex]:
        """What is to be written at ``offset`` of the file, and the index record for its end."""
        start_ns = self.start_ns if self.entries else 0
        data = zstandard.ZstdCompressor(level=_LEVEL).compress(self._records)
        checksum = zlib.crc32(self._records)
        chunk = records.Chunk('zstd', data, self.end_ns, start_ns, checksum, self.size)
        pieces = [record_bytes(chunk)]
        chunk_length = length = len(pieces[0])
        offsets: dict[int, int] = {}
        for key, entries in self.entries.items():
            offsets[key] = offset + length
            body = _INDEX_HEADER.pack(key, len(entries)) + entries
            pieces += [HEADER.pack(Opcode.MESSAGE_INDEX, len(body)), body]
            length += HEADER.size + len(body)
        index = records.ChunkIndex(
            chunk_length=chunk_length,
            chunk_start_offset=offset,
            compression=chunk.compression,
            compressed_size=len(data),
            message_end_time=self.end_ns,
            message_index_length=length - chunk_length,
            message_index_offsets=offsets,
            message_start_time=start_ns,
            uncompressed_size=self.size,
        )
        return b''.join(pieces), index


class _Summary:
    """What stands at a file's end; kept as bytes, as there is a chunk for every half second.

    ``statistics`` has the messages that were added by now.
    """

    def __init__(self) -> None:
        self._groups = {opcode: bytearray() for opcode in _SUMMARY}
        self._counts: Counter[Opcode] = Counter()
        self.statistics = records.Statistics(0, 0, {}, 0, 0, 0, 0, 0, 0)

    def add(self, opcode: Opcode, record: McapRecord) -> None:
        self._groups[opcode] += record_bytes(record)
        self._counts[opcode] += 1

    def add_chunk(self, chunk: Chunk, index: records.ChunkIndex) -> None:
        self.add(Opcode.CHUNK_INDEX, index)
        if not chunk.entries:
            return
        statistics = self.statistics
        if statistics.message_count == 0 or chunk.start_ns < statistics.message_start_time:
            statistics.message_start_time = chunk.start_ns
        statistics.message_end_time = max(statistics.message_end_time, chunk.end_ns)
        counts = statistics.channel_message_counts
        for key, entries in chunk.entries.items():
            added = len(entries) // _INDEX_ENTRY.size
            statistics.message_count += added
            counts[key] = counts.get(key, 0) + added

    def add_extra(self, record: Attachment | Metadata, offset: int) -> bytes:
        """An attachment or metadata as it is to be written at ``offset``."""
        data = record_bytes(record)
        if isinstance(record, Metadata):
            self.add(Opcode.METADATA_INDEX, records.MetadataIndex(offset, len(data), record.name))
            return data
        about = record.log_time, record.create_time, len(record.data), record.name
        attached = records.AttachmentIndex(offset, len(data), *about, record.media_type)
        self.add(Opcode.ATTACHMENT_INDEX, attached)
        return data

    def encode(self, offset: int) -> bytes:
        """Everything from the data's end to the file's end, to be written at ``offset``."""
        counts = self._counts
        self.statistics.schema_count = counts[Opcode.SCHEMA]
        self.statistics.channel_count = counts[Opcode.CHANNEL]
        self.statistics.chunk_count = counts[Opcode.CHUNK_INDEX]
        self.statistics.attachment_count = counts[Opcode.ATTACHMENT_INDEX]
        self.statistics.metadata_count = counts[Opcode.METADATA_INDEX]
        self.add(Opcode.STATISTICS, self.statistics)
        data_end = record_bytes(records.DataEnd(0))
        start = offset + len(data_end)
        summary = offsets = b''
        for opcode, group in self._groups.items():
            if group:
                group_start = start + len(summary)
                offsets += record_bytes(records.SummaryOffset(opcode, group_start, len(group)))
                summary += group
        footer = record_bytes(records.Footer(start, start + len(summary), 0))[:-4]
        summary += offsets
        crc = struct.pack('<I', zlib.crc32(footer, zlib.crc32(summary)))
        return data_end + summary + footer + crc + MAGIC


def record_bytes(record: McapRecord) -> bytes:
    """One record as it stands in the file."""
    builder: Any = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())


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


class RecordingWriter(AbstractContextManager['RecordingWriter']):
    """Writes messages to a .mcap file with zstd chunks and embedded schemas.

    A context manager: the file is completed at the end, also when the user interrupts
    (KeyboardInterrupt, SystemExit). After any other exception everything so far is in the file,
    but the end mark is left out, so that it does not look complete; a file without a message is
    removed. A process that is killed leaves what is older than a second.

    Attributes:
        path: of the file.
        moved: messages from before 1970, which were given the time 0.
        extras: attachments and metadata that are written at the end.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        overwrite: bool = False,
        metadata: Mapping[str, Mapping[str, str]] = MappingProxyType({}),
    ) -> None:
        """Create the file, whose name ends in '.mcap', with the records of ``metadata`` by name.

        Raises:
            RecordingError: the file exists or cannot be created.
        """
        self.path = Path(path)
        self.moved = 0
        self.extras: Iterable[Attachment | Metadata] = ()
        self._file = OutputFile(self.path, overwrite)
        self._summary = _Summary()
        self._schemas: dict[tuple[str, Schema | None], int] = {}
        # A channel's number, and those of its messages.
        self._channels: dict[tuple[str, str, Schema | None], tuple[int, Iterator[int]]] = {}
        # The last one is being filled; appending an empty one hands it over in a single step,
        # so that Ctrl-C at any moment loses and doubles nothing.
        self._chunks = deque([Chunk()])
        self._since = 0.0
        self._changed = threading.Condition()
        self._closed = False
        self._error: Exception | None = None
        start = MAGIC + record_bytes(records.Header('ros2', 'mvuav_ros'))
        for name, values in metadata.items():
            start += self._summary.add_extra(Metadata(name, dict(values)), len(start))
        try:
            self._file.append(start)
        except OSError as error:
            self._let_go(complete=False)
            raise self._file.failure(error, 0) from None
        self._thread = threading.Thread(target=self._run, name='recording', daemon=True)
        self._thread.start()

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is not None and issubclass(kind, Exception):
            with suppress(RecordingError):
                self.close(complete=False)
            return
        self.close()

    @property
    def size(self) -> int:
        """Bytes in the file by now."""
        return self._file.size

    @property
    def statistics(self) -> records.Statistics:
        """Numbers and times of the messages in the file by now; of all once it is closed."""
        return self._summary.statistics

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
            channel = self._channels.get((topic, type, schema))
            if channel is None:
                channel = self._new_channel(topic, type, schema, qos)
            # ROS clocks start at zero; an mcap file holds no earlier time.
            self.moved += stamp_ns < 0
            stamp_ns = max(stamp_ns, 0)
            publish_ns = stamp_ns if publish_ns is None else publish_ns
            chunk = self._chunks[-1]
            # Of one stamp are all results of a frame.
            if not (chunk.start_ns == stamp_ns == chunk.end_ns or chunk.takes(stamp_ns)):
                self._hand_over()
                chunk = self._chunks[-1]
            if chunk.message_count == 0:
                self._since = time.monotonic()
                self._changed.notify_all()
            channel_id, numbers = channel
            number = next(numbers)
            number = number if sequence is None else sequence
            if chunk.add(channel_id, number, stamp_ns, publish_ns, cdr) >= _CHUNK_BYTES:
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
        try:
            if complete and self._error is None:
                for record in self.extras:
                    self._file.append(self._summary.add_extra(record, self._file.size))
                self._file.append(self._summary.encode(self._file.size))
        except OSError as error:
            self._error = error
        self._let_go(complete)
        self._raise_error()

    def _let_go(self, complete: bool) -> None:
        is_ours = self._file.is_there
        try:
            self._file.close()
        except OSError as error:
            self._error = self._error or error
        if is_ours and not self.statistics.message_count and (self._error or not complete):
            # Nothing to be kept, and in the way of the next attempt.
            with suppress(OSError):
                self.path.unlink()

    def _new_channel(
        self, topic: str, type: str, schema: Schema | None, qos: str
    ) -> tuple[int, Iterator[int]]:
        kind = normalised_type(type)
        text = schema or schema_of(kind)
        schema_id = self._schemas.get((kind, text))
        if schema_id is None:
            schema_id = self._schemas[kind, text] = len(self._schemas) + 1
            encoding, definition = text or ('', '')
            record = records.Schema(schema_id, definition.encode(), encoding, kind)
            self._chunks[-1].define(record)
            self._summary.add(Opcode.SCHEMA, record)
        metadata = {'offered_qos_profiles': qos}
        if text == schema_of(kind) and type_hash(kind):
            metadata['topic_type_hash'] = type_hash(kind)
        number = len(self._channels) + 1
        channel = records.Channel(number, topic, 'cdr', metadata, schema_id)
        self._chunks[-1].define(channel)
        self._summary.add(Opcode.CHANNEL, channel)
        return self._channels.setdefault((topic, type, schema), (channel.id, count(1)))

    def _hand_over(self) -> None:
        """Begin a new chunk, once the thread keeps up; the lock is held."""
        while len(self._chunks) > _MAX_WAITING and self._error is None:
            self._changed.wait()
        self._raise_error()
        if self._chunks[-1].message_count:
            self._chunks.append(Chunk())
            self._changed.notify_all()

    def _run(self) -> None:
        while (chunk := self._next_chunk()) is not None:
            try:
                data, index = chunk.encode(self._file.size)
                self._file.append(data)
                self._summary.add_chunk(chunk, index)
            except Exception as error:
                with self._changed:
                    self._error = error
                    self._changed.notify_all()
                return

    def _next_chunk(self) -> Chunk | None:
        with self._changed:
            while len(self._chunks) == 1 and not self._closed:
                if self._chunks[0].message_count == 0:
                    self._changed.wait()
                    continue
                left = self._since + _CHUNK_WALL_S - time.monotonic()
                if left > 0:
                    self._changed.wait(left)
                else:
                    self._chunks.append(Chunk())
            chunk = self._chunks.popleft() if self._chunks else None
            self._changed.notify_all()
            return chunk if chunk is not None and chunk.size else None

    def _raise_error(self) -> None:
        if self._error is not None:
            raise self._file.failure(self._error, self.statistics.message_count)
