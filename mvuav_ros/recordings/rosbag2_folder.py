"""Writing a recording as the folder that rosbag2 makes: parts by size, and metadata.yaml."""

from __future__ import annotations

import glob
from collections.abc import Iterable, Mapping
from pathlib import Path
from types import MappingProxyType, TracebackType
from typing import Any

import yaml
from mcap.records import Attachment, Metadata

from mvuav_ros.messages.definitions import Schema
from mvuav_ros.recordings.account import RecordingError
from mvuav_ros.recordings.layout import METADATA
from mvuav_ros.recordings.writing import RELIABLE_QOS, RecordingWriter

_VERSION = 5
"""Of metadata.yaml: the newest that every release since Humble reads."""


class Rosbag2Writer:
    """Writes parts NAME_0.mcap, NAME_1.mcap … into a new folder NAME; a context manager.

    Ended by an exception it leaves no metadata.yaml, so that it does not look complete.
    """

    def __init__(
        self,
        folder: Path,
        split_bytes: int = 0,
        metadata: Mapping[str, Mapping[str, str]] = MappingProxyType({}),
    ) -> None:
        """Create the folder.

        Args:
            folder: must not exist, or be empty.
            split_bytes: a part that has reached this size is the last of its kind; 0: no limit.
            metadata: records by name, written at the beginning of each part.

        Raises:
            RecordingError: there is something already, or it cannot be created.
        """
        self._folder = folder
        self._split_bytes = split_bytes
        self._records = metadata
        self._parts: list[_Part] = []
        self._topics: dict[tuple[str, str], _Topic] = {}
        try:
            folder.mkdir(parents=True, exist_ok=True)
            if any(folder.iterdir()):
                raise RecordingError(f'{folder} is not empty; give another folder')
        except OSError as error:
            raise RecordingError(f'{folder} cannot be made: {error.strerror or error}') from None
        self._begin_part()

    def __enter__(self) -> Rosbag2Writer:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._parts[-1].writer.__exit__(kind, error, traceback)
        if kind is None or not issubclass(kind, Exception):
            content = yaml.safe_dump(self._metadata(), sort_keys=False)
            (self._folder / METADATA).write_text(content, encoding='utf-8')
        elif not any(self._folder.iterdir()):
            self._folder.rmdir()

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
        """Write one message; see `RecordingWriter.write`.

        Raises:
            RecordingError: the file cannot be written, such as when the disk is full.
        """
        if 0 < self._split_bytes <= self._parts[-1].writer.size:
            self._parts[-1].writer.close()
            self._begin_part()
        self._parts[-1].writer.write(topic, type, stamp_ns, cdr, schema, qos, publish_ns, sequence)
        self._parts[-1].count(stamp_ns)
        self._topics.setdefault((topic, type), _Topic(qos)).messages += 1

    @property
    def extras(self) -> Iterable[Attachment | Metadata]:
        """Attachments and metadata that are written at the end of the last part."""
        return self._parts[-1].writer.extras

    @extras.setter
    def extras(self, records: Iterable[Attachment | Metadata]) -> None:
        self._parts[-1].writer.extras = records

    @property
    def moved(self) -> int:
        """Messages from before 1970, which were given the time 0."""
        return sum(part.writer.moved for part in self._parts)

    def _begin_part(self) -> None:
        name = f'{self._folder.resolve().name}_{len(self._parts)}.mcap'
        path = self._folder / name
        self._parts.append(_Part(RecordingWriter(path, metadata=self._records)))

    def _metadata(self) -> dict[str, Any]:
        filled = [part for part in self._parts if part.messages]
        first = min((part.first_ns for part in filled), default=0)
        last = max((part.last_ns for part in filled), default=0)
        content = {
            'version': _VERSION,
            'storage_identifier': 'mcap',
            **_span(first, last, sum(part.messages for part in filled)),
            'topics_with_message_count': [
                {
                    'topic_metadata': {
                        'name': name,
                        'type': kind,
                        'serialization_format': 'cdr',
                        'offered_qos_profiles': topic.qos,
                    },
                    'message_count': topic.messages,
                }
                for (name, kind), topic in self._topics.items()
            ],
            'compression_format': '',
            'compression_mode': '',
            'relative_file_paths': [part.name for part in self._parts],
            'files': [
                {'path': part.name, **_span(part.first_ns, part.last_ns, part.messages)}
                for part in self._parts
            ],
        }
        return {'rosbag2_bagfile_information': content}


def open_writer(
    path: Path,
    split_bytes: int | None,
    overwrite: bool = False,
    metadata: Mapping[str, Mapping[str, str]] = MappingProxyType({}),
) -> RecordingWriter | Rosbag2Writer:
    """A writer of one mcap file or, with a number of bytes, of a folder as rosbag2 makes it.

    Args:
        path: the file, or the folder.
        split_bytes: None for a file; see `Rosbag2Writer`.
        overwrite: whether a file, or the parts of a folder that rosbag2 made, may be replaced.
        metadata: records by name.

    Raises:
        RecordingError: there is something already, or it cannot be created.
    """
    if split_bytes is None:
        return RecordingWriter(path, overwrite, metadata)
    if overwrite and path.is_dir():
        for file in [*path.glob(f'{glob.escape(path.resolve().name)}_*.mcap'), path / METADATA]:
            file.unlink(missing_ok=True)
    return Rosbag2Writer(path, split_bytes, metadata)


class _Topic:
    def __init__(self, qos: str) -> None:
        self.qos = qos
        self.messages = 0


class _Part:
    def __init__(self, writer: RecordingWriter) -> None:
        self.writer = writer
        self.name = writer.path.name
        self.messages = self.first_ns = self.last_ns = 0

    def count(self, stamp_ns: int) -> None:
        self.first_ns = min(self.first_ns, stamp_ns) if self.messages else stamp_ns
        self.last_ns = max(self.last_ns, stamp_ns)
        self.messages += 1


def _span(first_ns: int, last_ns: int, messages: int) -> dict[str, Any]:
    return {
        'duration': {'nanoseconds': last_ns - first_ns},
        'starting_time': {'nanoseconds_since_epoch': first_ns},
        'message_count': messages,
    }
