"""Which files make up a recording, and in what order."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from mvuav_ros.recordings.account import Account
from mvuav_ros.recordings.content import is_bag_file
from mvuav_ros.recordings.errors import RecordingError
from mvuav_ros.recordings.recording import counted

_NEVER_BAGS = frozenset({'.yaml', '.png', '.jpg', '.jpeg', '.txt', '.csv'})
_LARGEST_METADATA = 1 << 24
_ACCEPTED = 'a rosbag2 folder, a .mcap, a .db3 or a ROS 1 .bag file'
METADATA = 'metadata.yaml'


def recording_files(path: Path, account: Account) -> list[Path]:
    """The files of the recording at ``path`` in the order in which they were written.

    Raises:
        RecordingError: there is nothing, or nothing that looks like a recording.
    """
    try:
        if not path.exists():
            raise RecordingError(f'{path} does not exist; give {_ACCEPTED}')
        if path.name == METADATA:
            path = path.parent
        if not path.is_dir():
            return [path]
        present = [
            entry
            for entry in path.iterdir()
            if entry.suffix.lower() not in _NEVER_BAGS and is_bag_file(entry)
        ]
    except OSError as error:
        raise RecordingError(f'{path} cannot be read: {error.strerror or error}') from None
    if not present:
        raise RecordingError(f'{path} holds no recording (*.mcap, *.db3); give {_ACCEPTED}')
    present.sort(key=lambda entry: _natural_key(entry.name))
    if not (path / METADATA).exists():
        account.note((path, METADATA), f'{path.name}: {METADATA} is missing')
        return _only_series(path, present)
    listed = _listed_names(path / METADATA, account)
    if listed is None:
        return _only_series(path, present)
    return _chosen(present, listed, account)


def _listed_names(path: Path, account: Account) -> Sequence[str] | None:
    """The file names in metadata.yaml; None if it is damaged."""
    try:
        if not path.is_file() or path.stat().st_size > _LARGEST_METADATA:
            raise ValueError('no file, or implausibly large')
        content = YAML(typ='safe').load(path.read_text('utf-8'))
        told = content['rosbag2_bagfile_information']
        names = told['relative_file_paths']
        if names and all(isinstance(name, str) for name in names):
            _take_counts(told, [Path(name).name for name in names], account)
            return [Path(name).name for name in names]
    except (OSError, YAMLError, RecursionError, KeyError, TypeError, ValueError):
        pass
    account.note((path, METADATA), f'{path.parent.name}: {path.name} is damaged; not used')
    return None


def _take_counts(told: Mapping[str, Any], names: Sequence[str], account: Account) -> None:
    """What metadata.yaml says of each file's messages."""
    listed = told.get('files') or [{'path': names[0], 'message_count': told.get('message_count')}]
    if len(names) == 1 or told.get('files'):
        for file in listed:
            if isinstance(file.get('message_count'), int):
                account.promise(_plain(Path(file['path']).name), file['message_count'])


def _chosen(present: list[Path], listed: Sequence[str], account: Account) -> list[Path]:
    chosen: list[Path] = []
    missing: list[str] = []
    by_name = {entry.name: entry for entry in present}
    for name in listed:
        plain = _plain(name)
        entry = next((by_name[n] for n in (name, plain, f'{plain}.zstd') if n in by_name), None)
        if entry is None:
            missing.append(name)
        elif entry not in chosen:
            chosen.append(entry)
    if missing:
        names = ', '.join(missing[:3]) + (', …' if len(missing) > 3 else '')
        account.lose(
            METADATA,
            'missing',
            f'{len(missing)} of the {counted(len(listed), "file")} that {METADATA} lists '
            f'{"is" if len(missing) == 1 else "are"} missing: {names}',
        )
    series = {_series(name) for name in listed}
    listed_plain = {_plain(name) for name in listed}
    for entry in present:
        if entry in chosen or _plain(entry.name) in listed_plain:
            continue
        # After a crash, metadata.yaml may not know the last files of a split recording.
        if _series(entry.name) in series:
            chosen.append(entry)
            account.note((entry, 'unlisted'), f'{entry.name}: not listed in {METADATA}, read')
        else:
            account.lose(
                entry.name, 'unlisted', f'{entry.name}: not listed in {METADATA}, not read'
            )
    chosen.sort(key=lambda entry: _natural_key(entry.name))
    if not chosen:
        raise RecordingError(
            f'{present[0].parent} holds none of the files that its {METADATA} lists; '
            'give one of its files instead'
        )
    return chosen


def _only_series(path: Path, present: list[Path]) -> list[Path]:
    """The files if they are the parts of one recording; a compressed copy is not read twice."""
    if len({_series(entry.name) for entry in present}) > 1:
        names = ', '.join(entry.name for entry in present)
        raise RecordingError(f'{path} holds several recordings; give one of them: {names}')
    names_present = {entry.name for entry in present}
    return [
        entry
        for entry in present
        if not (entry.name.endswith('.zstd') and _plain(entry.name) in names_present)
    ]


def _plain(name: str) -> str:
    return name.removesuffix('.zstd').removesuffix('.active')


def _series(name: str) -> str:
    """What the parts of a split recording share: rosbag2 ends their names in _0, _1, and so on.

    ROS 1 puts the time of each part before that.
    """
    plain = _plain(name)
    if plain.endswith('.bag'):
        plain = re.sub(r'_\d{4}(-\d\d){5}(?=_\d+\.bag$)', '', plain)
    return re.sub(r'_\d+(?=\.[^.]*$)', '', plain)


def _natural_key(name: str) -> list[tuple[int, str]]:
    """Sorts bag_10 behind bag_9."""
    return [(int(part), '') if part.isdigit() else (-1, part) for part in re.split(r'(\d+)', name)]
