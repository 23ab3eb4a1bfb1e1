"""Writing a recording as the folder that rosbag2 makes: parts by size, and metadata.yaml."""

from __future__ import annotations

import glob
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import yaml

from mvuav_ros.recordings.account import RecordingError
from mvuav_ros.recordings.layout import METADATA
from mvuav_ros.recordings.remote import write_whole
from mvuav_ros.recordings.writing import RecordingWriter

_VERSION = 5
"""Of metadata.yaml: the newest that every release since Humble reads."""


class Rosbag2Writer(RecordingWriter):
    """Writes parts NAME_0.mcap, NAME_1.mcap … into a new folder NAME; a context manager.

    Ended by an exception it leaves no metadata.yaml, so that it does not look complete. The extras
    are in the last part, the records of the metadata in each.
    """

    def __init__(
        self, folder: Path, split_bytes: int, metadata: Mapping[str, Mapping[str, str]]
    ) -> None:
        """Create the folder, unless it is there and empty; see `RecordingWriter`.

        Raises:
            RecordingError: there is something already, or it cannot be created.
        """
        try:
            folder.mkdir(parents=True, exist_ok=True)
            if any(folder.iterdir()):
                raise RecordingError(f'{folder} is not empty; give another folder')
        except OSError as error:
            raise RecordingError(f'{folder} cannot be made: {error.strerror or error}') from None
        super().__init__(folder, False, metadata, split_bytes)

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        super().__exit__(kind)
        if kind is None or not issubclass(kind, Exception):
            content = yaml.safe_dump(self._metadata(), sort_keys=False)
            write_whole(self.path / METADATA, content)
        elif not any(self.path.iterdir()):
            self.path.rmdir()

    def _part_path(self, number: int) -> Path:
        return self.path / f'{self.path.resolve().name}_{number}.mcap'

    def _metadata(self) -> dict[str, Any]:
        counts: Counter[tuple[str, str]] = Counter()
        offered: dict[tuple[str, str], str] = {}
        for part in self.parts:
            for (name, kind, _), (number, qos) in part.channels.items():
                counts[name, kind] += part.counts[number]
                offered.setdefault((name, kind), qos)
        first = min((part.start_ns for part in self.parts if part.messages), default=0)
        last = max(part.end_ns for part in self.parts)
        content = {
            'version': _VERSION,
            'storage_identifier': 'mcap',
            **_span(first, last, counts.total()),
            'topics_with_message_count': [
                {
                    'topic_metadata': {
                        'name': name,
                        'type': kind,
                        'serialization_format': 'cdr',
                        'offered_qos_profiles': qos,
                    },
                    'message_count': counts[name, kind],
                }
                for (name, kind), qos in offered.items()
            ],
            'compression_format': '',
            'compression_mode': '',
            'relative_file_paths': [part.file.path.name for part in self.parts],
            'files': [
                {
                    'path': part.file.path.name,
                    **_span(part.start_ns, part.end_ns, part.messages),
                }
                for part in self.parts
            ],
        }
        return {'rosbag2_bagfile_information': content}


def open_writer(
    path: Path,
    split_bytes: int | None,
    overwrite: bool = False,
    metadata: Mapping[str, Mapping[str, str]] = MappingProxyType({}),
) -> RecordingWriter:
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
