"""Opening a recording, whatever its storage and condition."""

from __future__ import annotations

import os
from collections.abc import Container, Iterator
from contextlib import AbstractContextManager
from dataclasses import replace
from itertools import chain
from pathlib import Path
from tempfile import TemporaryDirectory

from mcap.records import Attachment, Metadata

from mvuav_ros.recordings.account import Account, RecordingError
from mvuav_ros.recordings.compression import Limit, decompress_file
from mvuav_ros.recordings.layout import (
    MCAP_START,
    ROS1_START,
    SQLITE_START,
    ZSTD_START,
    plain_name,
    recording_files,
    start_of,
)
from mvuav_ros.recordings.mcap_file import McapFile
from mvuav_ros.recordings.ros1_file import Ros1File
from mvuav_ros.recordings.sqlite_file import SqliteFile
from mvuav_ros.recordings.stored_file import (
    READABLE_FORMATS,
    RecordedMessage,
    RecordingFile,
    SkippedChannel,
    TopicInfo,
)

_FORMATS: tuple[tuple[bytes, str, type[RecordingFile]], ...] = (
    (MCAP_START, '.mcap', McapFile),
    (SQLITE_START, '.db3', SqliteFile),
    (ROS1_START, '.bag', Ros1File),
)


def open_recording(path: str | os.PathLike[str]) -> Recording:
    """Open a rosbag2 folder, a bare .mcap or .db3, or a ROS 1 .bag file, damaged or not.

    Raises:
        RecordingError: nothing can be read from there.
    """
    return Recording(Path(path))


class Recording(AbstractContextManager['Recording']):
    """An open recording; made by `open_recording`, and a context manager.

    Attributes:
        path: where it lies.
        topics: what can be read, in order of first definition.
        skipped: the channels that cannot, as their messages are not CDR.
        account: what was kept and lost; more may come while messages are read.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.topics: tuple[TopicInfo, ...] = ()
        self.skipped: tuple[SkippedChannel, ...] = ()
        self.account = Account(path)
        self._folder: TemporaryDirectory[str] | None = None
        self._unpacked = path
        self._opened: dict[Path, RecordingFile] = {}
        self._files: list[Path] = []
        try:
            self._files = self._readable_files(recording_files(path, self.account))
        except BaseException:
            self.account.is_reported = True  # by the error
            self.close()
            raise

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def message_count(self) -> int | None:
        """The number of messages of all topics; None where the recording does not say."""
        counts = [topic.message_count for topic in self.topics]
        return None if None in counts else sum(count or 0 for count in counts)

    def messages(
        self,
        topics: Container[str] | None = None,
        start_ns: int | None = None,
        end_ns: int | None = None,
    ) -> Iterator[RecordedMessage]:
        """The messages in the order in which they were recorded; may be called repeatedly.

        Those of some topics (all if None) with ``start_ns`` <= log time < ``end_ns``.

        Raises:
            RecordingError: a compressed file cannot be unpacked (no space).
        """
        # Without a loop of its own, as every message would pass through it.
        return chain.from_iterable(self._passes(topics, start_ns, end_ns))

    def _passes(
        self, topics: Container[str] | None, start_ns: int | None, end_ns: int | None
    ) -> Iterator[Iterator[RecordedMessage]]:
        account = self.account
        account.kept = account.skipped = 0
        for path in self._files:
            try:
                yield self._file(path).messages(topics, start_ns, end_ns)
            except OSError as error:
                said = f'{path.name}: reading ended early: {error.strerror or error}'
                account.lose(path.name.removesuffix('.zstd'), 'io', said)

    def extras(self) -> Iterator[Attachment | Metadata]:
        """The attachments and metadata of mcap files."""
        for path in self._files:
            file = self._file(path)
            if isinstance(file, McapFile):
                yield from file.extras()

    def close(self) -> None:
        """Remove what was unpacked; who reads on unpacks it again."""
        self._opened.clear()
        if self._folder is not None:
            self._folder.cleanup()
            self._folder = None

    def _readable_files(self, paths: list[Path]) -> list[Path]:
        topics: dict[tuple[str, str], TopicInfo] = {}
        skipped: dict[SkippedChannel, None] = {}
        readable: list[Path] = []
        refusals: list[RecordingError] = []
        for path in paths:
            try:
                channels = self._file(path).channels()
            except (OSError, RecordingError) as error:
                if isinstance(error, OSError):
                    error = RecordingError(f'{path} cannot be read: {error.strerror or error}')
                refusals.append(error)
                continue
            readable.append(path)
            for channel in channels:
                if channel.serialization_format in READABLE_FORMATS:
                    key = (channel.name, channel.type)
                    topics[key] = _merged(topics.get(key), channel)
                else:
                    skipped[SkippedChannel(channel.name, channel.serialization_format)] = None
        if not readable:
            raise refusals[0]
        if not topics and not skipped and self.account.errors:
            reasons = '; '.join(self.account.errors)
            raise RecordingError(f'{self.path} holds no readable topic: {reasons}')
        for refusal in refusals:
            self.account.lose(str(refusal), 'refused', str(refusal))
        self.topics = tuple(topics.values())
        self.skipped = tuple(skipped)
        return readable

    def _file(self, path: Path) -> RecordingFile:
        """The file at ``path``, unpacked if it is compressed as a whole."""
        if path not in self._opened:
            limit = Limit(path.stat().st_size)
            target = path
            if start_of(path).startswith(ZSTD_START):
                # One unpacked file at a time, as all of a long recording might fill the disk.
                if self._folder is not None:
                    self._folder.cleanup()
                    self._opened.pop(self._unpacked, None)
                self._folder, self._unpacked = TemporaryDirectory(prefix='mvuav_'), path
                target = Path(self._folder.name) / path.name.removesuffix('.zstd')
                decompress_file(path, target, self.account, limit)
            self._opened[path] = _opened(target, path, self.account, limit)
        return self._opened[path]


def _opened(path: Path, named: Path, account: Account, limit: Limit) -> RecordingFile:
    """The file at a path, which the user has named so: it may be an unpacked one."""
    start = start_of(path)
    if not path.is_file():
        raise RecordingError(f'{named} is neither a file nor a folder')
    if not start and named == path:
        raise RecordingError(f'{path} is empty')
    for magic, _, kind in _FORMATS:
        if start.startswith(magic):
            return kind(path, account, limit)
    for magic, suffix, kind in _FORMATS:
        if plain_name(path.name).endswith(suffix) and len(start) == 16 and kind is not SqliteFile:
            said = f'{path.name}: its first {len(magic)} bytes are damaged'
            account.lose(path.name, 'start', said, 0)
            return kind(path, account, limit)
    if any(magic.startswith(start) for magic, _, _ in _FORMATS):
        raise RecordingError(
            f'{named} was cut off within its first bytes; nothing can be recovered'
        )
    raise RecordingError(
        f'{named} is not a recording; give a rosbag2 folder, a .mcap, a .db3 or a ROS 1 .bag file'
    )


def _merged(known: TopicInfo | None, channel: TopicInfo) -> TopicInfo:
    """One topic's channels (publishers, split files) as one."""
    if known is None:
        return channel
    counts = (known.message_count, channel.message_count)
    total = None if None in counts else sum(count for count in counts if count is not None)
    schema, qos = known.schema or channel.schema, known.qos or channel.qos
    return replace(known, message_count=total, schema=schema, qos=qos)
