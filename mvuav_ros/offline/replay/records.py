"""What a replayed file says about itself: from what it was made, and that it is finished."""

from __future__ import annotations

import hashlib
import json
import struct
from collections.abc import Iterator
from enum import Enum
from glob import glob
from pathlib import Path
from typing import Any

from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.records import Header, Metadata
from mcap.stream_reader import StreamReader

from mvuav_ros.recordings.remote import is_url, remote_state
from mvuav_ros.recordings.writing import LIBRARY

DESCRIPTION = 'mvuav_replay'
"""The metadata record at the file's beginning: input, version and parameters."""
RESULT = 'mvuav_replay_result'
"""The metadata record at the end of a file whose input was read to its end."""
_DAMAGE = (McapError, struct.error, UnicodeDecodeError, ValueError, KeyError, EOFError)


class State(Enum):
    """What stands where an output is to go."""

    ABSENT = 'absent'
    FINISHED = 'finished'
    UNFINISHED = 'interrupted'
    OTHER = 'other'


def state_of(output: Path, description: dict[str, str]) -> tuple[State, dict[str, Any]]:
    """Whether an output is there already, and the result that it records if it is finished.

    Finished is a complete file that was made from the same input, by the same version, with the
    same parameters, and whose input was read to its end. Unfinished is one that was begun so.
    """
    if not output.exists():
        return State.ABSENT, {}
    if not output.is_file():
        return State.OTHER, {}
    if output.stat().st_size == 0:
        return State.UNFINISHED, {}
    if _beginning(output) != description:
        return State.OTHER, {}
    try:
        with output.open('rb') as stream:
            records = {m.name: m.metadata for m in make_reader(stream).iter_metadata()}
        return State.FINISHED, json.loads(records[RESULT]['json'])
    except _DAMAGE:
        return State.UNFINISHED, {}


def _beginning(output: Path) -> dict[str, str] | None:
    """The description that a file of ours begins with; None of another file."""
    try:
        with output.open('rb') as stream:
            records = iter(StreamReader(stream, emit_chunks=True).records)
            header, record = next(records), next(records)
    except (*_DAMAGE, StopIteration):
        return None
    ours = isinstance(header, Header) and header.library == LIBRARY
    if ours and isinstance(record, Metadata) and record.name == DESCRIPTION:
        return dict(record.metadata)
    return None


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
        digest.update(f'{file.name}\0{status.st_size}\0{status.st_mtime_ns}\n'.encode())
    return {
        'input': str(path.resolve()),
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
