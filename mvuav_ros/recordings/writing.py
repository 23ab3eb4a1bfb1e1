"""Writing a recording as an mcap file that is readable however the writing ends."""

from __future__ import annotations

import os
import threading
import time
from collections import deque
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from types import MappingProxyType, TracebackType

from mcap.records import Attachment, Channel, Header, Metadata
from mcap.records import Schema as SchemaRecord

from mvuav_ros.recordings.errors import RecordingError
from mvuav_ros.recordings.mcap_chunks import Chunk, Summary, record_bytes
from mvuav_ros.recordings.mcap_records import MAGIC
from mvuav_ros.recordings.output_file import OutputFile
from mvuav_ros.recordings.recording import RecordedMessage, Schema, normalised_type
from mvuav_ros.recordings.schemas import schema_of, type_hash

LIBRARY = 'mvuav_ros'
"""What the files' headers name as their maker."""

_CHUNK_BYTES = 1 << 20
# Chunks end by the messages' own time, so that the same messages give the same file; only where
# the processing is slower than half of real time does the clock on the wall have to end them.
_CHUNK_NS = 500_000_000
_CHUNK_WALL_S = 0.8
_MOST_WAITING = 4

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


class RecordingWriter:
    """Writes messages to a .mcap file with zstd chunks and embedded schemas.

    A context manager: the file is completed at the end, also when the user interrupts
    (KeyboardInterrupt, SystemExit). After any other exception everything so far is in the file,
    but the end mark is left out, so that it does not look complete; a file without a message is
    removed. A process that is killed
    leaves what is older than a second. Messages are compressed and written by a thread of its
    own.

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
        """Create the file.

        Args:
            path: where to; ends in '.mcap'.
            overwrite: whether a file that exists may be replaced.
            metadata: records by name, written at once at the file's beginning.

        Raises:
            RecordingError: the file exists or cannot be created.
        """
        self.path = Path(path)
        self.moved = 0
        self.extras: Iterable[Attachment | Metadata] = ()
        self._file = OutputFile(self.path, overwrite)
        self._summary = Summary()
        self._schemas: dict[tuple[str, Schema | None], int] = {}
        self._channels: dict[tuple[str, str, Schema | None], _Channel] = {}
        # The last one is being filled; appending an empty one hands it over in a single step,
        # so that Ctrl-C at any moment loses and doubles nothing.
        self._chunks = deque([Chunk()])
        self._since = 0.0
        self._changed = threading.Condition()
        self._closed = False
        self._error: Exception | None = None
        start = MAGIC + record_bytes(Header('ros2', LIBRARY))
        for name, values in metadata.items():
            start += self._summary.add_extra(Metadata(name, dict(values)), len(start))
        try:
            self._file.append(start)
        except OSError as error:
            self._file.close()
            raise self._file.failure(error) from None
        self._thread = threading.Thread(target=self._run, name='recording', daemon=True)
        self._thread.start()

    def __enter__(self) -> RecordingWriter:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        if kind is not None and issubclass(kind, Exception):
            is_ours = not self._closed and self._file.is_there
            with suppress(RecordingError):
                self._finish(complete=False)
            # Nothing to be kept, and in the way of the next attempt.
            if is_ours and not self._channels:
                with suppress(OSError):
                    self.path.unlink()
            return
        self.close()

    @property
    def size(self) -> int:
        """Bytes in the file by now."""
        return self._file.size

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
        """Write one message.

        Args:
            topic: the topic's full name.
            type: 'pkg/msg/Type'.
            stamp_ns: the log time in ns since the epoch.
            cdr: the message with its four-byte CDR header.
            schema: the type's definition; Jazzy's if None.
            qos: the publisher's profiles as rosbag2 writes them.
            publish_ns: the publishing time; the log time if None.
            sequence: the publisher's number of the message; counted here if None.

        Raises:
            RecordingError: the file cannot be written, such as when the disk is full.
        """
        with self._changed:
            self._raise_error()
            if self._closed:
                raise RecordingError(f'{self.path} is already closed')
            channel = self._channels.get((topic, type, schema))
            if channel is None:
                channel = self._new_channel(topic, type, schema, qos)
            # ROS clocks start at zero; an mcap file holds no earlier time.
            self.moved += stamp_ns < 0
            stamp_ns = max(stamp_ns, 0)
            publish_ns = stamp_ns if publish_ns is None else publish_ns
            if not self._chunks[-1].takes(stamp_ns, _CHUNK_NS):
                self._hand_over()
            chunk = self._chunks[-1]
            if chunk.message_count == 0:
                self._since = time.monotonic()
                self._changed.notify_all()
            channel.sequence += 1
            number = channel.sequence if sequence is None else sequence
            chunk.add(channel.id, number, (stamp_ns, publish_ns), cdr)
            if chunk.size >= _CHUNK_BYTES:
                self._hand_over()

    def copy(self, message: RecordedMessage) -> None:
        """Write a message of another recording with its own definition and QoS.

        Raises:
            RecordingError: the file cannot be written, such as when the disk is full.
        """
        self.write(*message)

    def close(self) -> None:
        """Write what is left, and the end that makes the file complete.

        Raises:
            RecordingError: the file cannot be written; it then ends after the last whole chunk.
        """
        if not self._closed:
            self._finish(complete=True)

    def _finish(self, complete: bool) -> None:
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
        try:
            self._file.close()
        except OSError as error:
            self._error = self._error or error
        self._raise_error()

    def _new_channel(self, topic: str, type: str, schema: Schema | None, qos: str) -> _Channel:
        kind = normalised_type(type)
        text = schema or schema_of(kind)
        schema_id = self._schemas.get((kind, text))
        if schema_id is None:
            schema_id = self._schemas[kind, text] = len(self._schemas) + 1
            record = SchemaRecord(
                id=schema_id,
                data=text.text.encode() if text else b'',
                encoding=text.encoding if text else '',
                name=kind,
            )
            self._chunks[-1].define(record)
            self._summary.define(record)
        metadata = {'offered_qos_profiles': qos}
        if text == schema_of(kind) and type_hash(kind):
            metadata['topic_type_hash'] = type_hash(kind)
        channel = Channel(
            id=len(self._channels) + 1,
            topic=topic,
            message_encoding='cdr',
            metadata=metadata,
            schema_id=schema_id,
        )
        self._chunks[-1].define(channel)
        self._summary.define(channel)
        self._channels[topic, type, schema] = _Channel(channel.id)
        return self._channels[topic, type, schema]

    def _hand_over(self) -> None:
        """Begin a new chunk, once the thread keeps up; the lock is held."""
        while len(self._chunks) > _MOST_WAITING and self._error is None:
            self._changed.wait()
        self._raise_error()
        if self._chunks[-1].message_count:
            self._chunks.append(Chunk())
            self._changed.notify_all()

    def _run(self) -> None:
        """Write the chunks that are handed over, and the last one when it gets old."""
        while (chunk := self._next_chunk()) is not None:
            try:
                encoded = chunk.encode(self._file.size)
                self._file.append(encoded.data)
                self._summary.add(chunk, encoded.index_record)
            except Exception as error:
                with self._changed:
                    self._error = error
                    self._changed.notify_all()
                return

    def _next_chunk(self) -> Chunk | None:
        """Wait for a chunk to write; None at the end."""
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
            raise self._file.failure(self._error)


class _Channel:
    """A channel's number, and that of its last message."""

    __slots__ = ('id', 'sequence')

    def __init__(self, channel_id: int) -> None:
        self.id = channel_id
        self.sequence = 0
