"""From what results are made: the input, the version and the parameters."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
from collections.abc import Iterator
from glob import glob
from pathlib import Path
from typing import TYPE_CHECKING

import mvuav_ros
from mvuav_ros.recordings.remote import is_url, remote_state

if TYPE_CHECKING:
    from mvuav_ros.offline.replay.job import ReplaySettings

DESCRIPTION = 'mvuav_replay'
"""The metadata record at the beginning of a replayed file."""


def description(source: str, settings: ReplaySettings) -> dict[str, str]:
    """What tells results of the same input, version and parameters from others.

    Raises:
        RecordingError: the input cannot be reached.
        OSError: likewise.
    """
    return {
        'version': mvuav_ros.__version__,
        **fingerprint(source),
        'settings': json.dumps(dataclasses.asdict(settings), sort_keys=True),
    }


def fingerprint(source: str) -> dict[str, str]:
    """The input's path, and a digest of the names, sizes and times of its files."""
    if is_url(source):
        size, mark = remote_state(source)
        return {'input': source, 'input_bytes': str(size), 'input_files': mark}
    path = Path(source).expanduser()
    digest = hashlib.sha256()
    total = 0
    for file in _files(path):
        status = file.stat()
        total += status.st_size
        name = os.fsencode(file.name)
        digest.update(b'%s\0%d\0%d\n' % (name, status.st_size, status.st_mtime_ns))
    return {
        'input': os.fsencode(path.resolve()).decode('utf-8', 'replace'),
        'input_bytes': str(total),
        'input_files': digest.hexdigest(),
    }


def _files(path: Path) -> Iterator[Path]:
    if path.is_file():
        yield path
    elif path.is_dir():
        yield from sorted(entry for entry in path.iterdir() if entry.is_file())
    else:
        yield from sorted(file for file in map(Path, glob(str(path))) if file.is_file())  # noqa: PTH207
