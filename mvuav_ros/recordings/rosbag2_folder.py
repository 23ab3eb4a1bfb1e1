"""Writing a recording as the folder that rosbag2 makes: parts by size, and metadata.yaml."""

from __future__ import annotations

import glob
from collections import Counter
from collections.abc import Iterable, Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from types import MappingProxyType
from typing import Any

import yaml
from mcap.records import Attachment, Metadata

from mvuav_ros.messages.definitions import Schema
from mvuav_ros.recordings.account import RecordingError
from mvuav_ros.recordings.layout import METADATA
from mvuav_ros.recordings.writing import RELIABLE_QOS, RecordingWriter

_VERSION = 5
"""Of metadata.yaml: the newest that every release since Humble reads."""


class Rosbag2Writer(AbstractContextManager['Rosbag2Writer']):
    """Writes parts NAME_0.mcap, NAME_1.mcap … into a new folder NAME; a context manager.

    Ended by an exception it leaves no metadata.yaml, so that it does not look complete. ``extras``
    are attachments and metadata that are written at the end of the last part.
    """

    def __init__(
        self, folder: Path, split_bytes: int, metadata: Mapping[str, Mapping[str, str]]
    ) -> None:
        """Create the folder, unless it is there and empty.

        The next part begins when one has reached ``split_bytes``; 0: never. Each begins with the
        records of ``metadata``, by name.

        Raises:
            RecordingError: there is something already, or it cannot be created.
        """
        self._folder = folder
        self._split_bytes = split_bytes
        self._records = metadata
        self.extras: Iterable[Attachment | Metadata] = ()
        self._parts: list[RecordingWriter] = []
        self._topics: dict[tuple[str, str], str] = {}
        self._counts: Counter[tuple[str, str]] = Counter()
        try:
            folder.mkdir(parents=True, exist_ok=True)
            if any(folder.iterdir()):
                raise RecordingError(f'{folder} is not empty; give another folder')
        except OSError as error:
            raise RecordingError(f'{folder} cannot be made: {error.strerror or error}') from None
        self._begin_part()

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self._parts[-1].extras = self.extras
        self._parts[-1].__exit__(kind)
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
        """Write one message; see `RecordingWriter.write`."""
        if 0 < self._split_bytes <= self._parts[-1].size:
            self._parts[-1].close()
            self._begin_part()
        self._parts[-1].write(topic, type, stamp_ns, cdr, schema, qos, publish_ns, sequence)
        self._topics.setdefault((topic, type), qos)
        self._counts[topic, type] += 1

    @property
    def moved(self) -> int:
        """Messages from before 1970, which were given the time 0."""
        return sum(part.moved for part in self._parts)

    def _begin_part(self) -> None:
        name = f'{self._folder.resolve().name}_{len(self._parts)}.mcap'
        self._parts.append(RecordingWriter(self._folder / name, metadata=self._records))

    def _metadata(self) -> dict[str, Any]:
        counts = [part.statistics for part in self._parts]
        first = min((each.message_start_time for each in counts if each.message_count), default=0)
        last = max(each.message_end_time for each in counts)
        content = {
            'version': _VERSION,
            'storage_identifier': 'mcap',
            **_span(first, last, self._counts.total()),
            'topics_with_message_count': [
                {
                    'topic_metadata': {
                        'name': name,
                        'type': kind,
                        'serialization_format': 'cdr',
                        'offered_qos_profiles': qos,
                    },
                    'message_count': self._counts[name, kind],
                }
                for (name, kind), qos in self._topics.items()
            ],
            'compression_format': '',
            'compression_mode': '',
            'relative_file_paths': [part.path.name for part in self._parts],
            'files': [
                {
                    'path': part.path.name,
                    **_span(each.message_start_time, each.message_end_time, each.message_count),
                }
                for part, each in zip(self._parts, counts, strict=True)
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

    To overwrite replaces a file, or the parts of a folder that rosbag2 made.

    Raises:
        RecordingError: there is something already, or it cannot be created.
    """
    if split_bytes is None:
        return RecordingWriter(path, overwrite, metadata)
    if overwrite and path.is_dir():
        ours = {*path.glob(f'{glob.escape(path.resolve().name)}_*.mcap'), path / METADATA}
        # Otherwise nothing is removed: the writer refuses such a folder.
        if ours.issuperset(path.iterdir()):
            for file in ours:
                file.unlink(missing_ok=True)
    return Rosbag2Writer(path, split_bytes, metadata)


def _span(first_ns: int, last_ns: int, messages: int) -> dict[str, Any]:
    return {
        'duration': {'nanoseconds': last_ns - first_ns},
        'starting_time': {'nanoseconds_since_epoch': first_ns},
        'message_count': messages,
    }
