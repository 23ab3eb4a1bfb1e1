"""The recordings that a user names, each a flight with a name of its own."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from pathlib import Path

from mvuav_ros.recordings.content import is_bag_file, plain_name
from mvuav_ros.recordings.errors import RecordingError
from mvuav_ros.recordings.layout import METADATA
from mvuav_ros.recordings.remote import is_url
from mvuav_ros.recordings.sources.image_folder import IMAGE_SUFFIXES

VIDEO_SUFFIXES = frozenset(
    {'.mp4', '.avi', '.mov', '.mkv', '.webm', '.m4v', '.mpg', '.mpeg', '.ts', '.wmv', '.flv'}
)
_SUFFIXES = ('.zstd', '.zst', '.mcap', '.db3', '.bag')
_PART = re.compile(r'(.*)_(\d+)\.[^.]+')
_DATE = re.compile(r'\d{4}[-_]\d\d[-_]\d\d[-_\d]*')


def recordings_in(source: str) -> list[str]:
    """What a path names: itself, or the recordings in a folder of them.

    A folder of images is one recording, and so is one with a rosbag2 ``metadata.yaml``. Without
    it files are the parts of one if all are named as rosbag2 and rosbag name parts: by the
    folder or by a date, and a number.
    """
    path = Path(source).expanduser()
    if is_url(source) or not path.is_dir() or _is_one(path):
        return [source]
    found = [entry for entry in _entries(path) if _is_recording(entry)]
    return [str(Path(source) / entry.name) for entry in found] or [source]


def flight_name(source: str) -> str:
    """What a recording's results are called: its name without what says how it is stored."""
    path = Path(source.split('?')[0] if is_url(source) else source).expanduser()
    if path.name == METADATA:
        path = path.parent
    name = path.absolute().name
    if any(sign in name for sign in '*?['):
        name = path.absolute().parent.name
    if path.is_dir():
        return name
    for suffix in _SUFFIXES:
        name = name.removesuffix(suffix)
    return name if path.suffix in _SUFFIXES else name.removesuffix(path.suffix)


def by_flight(sources: Sequence[str]) -> dict[str, str]:
    """Recordings by the names of their flights.

    Raises:
        RecordingError: two have the same name.
    """
    flights: dict[str, str] = {}
    for source in sources:
        name = flight_name(source)
        if name in flights:
            raise RecordingError(
                f'{flights[name]} and {source} would both become {name}; '
                'take them one after the other, into folders of their own'
            )
        flights[name] = source
    return flights


def _entries(folder: Path) -> list[Path]:
    """In their natural order; of a file that is also there compressed only one."""
    entries = [entry for entry in folder.iterdir() if not entry.name.startswith('.')]
    names = {entry.name for entry in entries}
    return sorted(
        (
            entry
            for entry in entries
            if entry.name.removesuffix('.zstd') not in names - {entry.name}
        ),
        key=lambda entry: [
            part.zfill(20) if part.isdigit() else part for part in re.split(r'(\d+)', entry.name)
        ],
    )


def _is_recording(entry: Path) -> bool:
    if entry.is_dir():
        return _is_one(entry)
    return is_bag_file(entry) or entry.suffix.lower() in VIDEO_SUFFIXES


def _is_one(folder: Path) -> bool:
    """Whether a folder is one recording."""
    try:
        entries = _entries(folder)
    except OSError:
        return False
    if any(entry.name == METADATA for entry in entries):
        return True
    files = [entry for entry in entries if entry.is_file()]
    if not any(map(_is_recording, files)):
        return any(entry.suffix.lower() in IMAGE_SUFFIXES for entry in files)
    return _are_parts(folder.absolute().name, [file.name for file in files if is_bag_file(file)])


def _are_parts(folder: str, names: Iterable[str]) -> bool:
    found = [_PART.fullmatch(plain_name(name)) for name in names]
    if len(found) == 1:
        return True
    # ROS 1 gives each part the date at which it begins.
    stems = {_DATE.sub('DATE', match[1]) if match else '' for match in found}
    return stems == {_DATE.sub('DATE', folder.lower())} or (
        len(stems) == 1 and 'DATE' in min(stems)
    )
