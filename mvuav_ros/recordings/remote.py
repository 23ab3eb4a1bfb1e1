"""Places that are files here, or lie elsewhere: s3:// and whatever else fsspec reaches."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path, PurePosixPath
from secrets import token_hex
from tempfile import TemporaryDirectory
from typing import Any

from mvuav_ros.recordings.account import RecordingError, needed_for

_URL = re.compile(r'[a-z][a-z0-9+.-]+://', re.IGNORECASE)
_READ_ONLY = ('http', 'https')


def is_url(text: str) -> bool:
    """Whether a place is named by an URL, of whatever kind.

    >>> is_url('s3://flights/a.mcap'), is_url('/flights/a.mcap'), is_url('sim:tanker')
    (True, False, False)
    """
    return bool(_URL.match(text))


def inside(folder: str, name: str) -> str:
    """The place of that name in a folder.

    >>> inside('s3://flights/day/', 'a.mcap')
    's3://flights/day/a.mcap'
    """
    return f'{folder.rstrip("/")}/{name}' if is_url(folder) else str(Path(folder) / name)


@contextmanager
def local_copy(text: str) -> Iterator[Path]:
    """A source's path; of one that lies elsewhere, that of a copy which is removed at the end.

    Raises:
        RecordingError: fsspec is missing, or nothing can be read from there.
    """
    if not is_url(text):
        yield Path(text).expanduser()
        return
    with TemporaryDirectory(prefix='mvuav_') as folder:
        target = Path(folder) / (_name(text) or 'recording')
        with reached(text, 'read') as (system, path):
            is_folder = system.isdir(path) and not system.isfile(path)
            source = f'{path.rstrip("/")}/' if is_folder else path
            system.get(source, str(target), recursive=is_folder)
        yield target


@contextmanager
def local_output(text: str) -> Iterator[Path]:
    """Where to write what is to lie at a place: what lies elsewhere is sent there at the end.

    After an exception nothing is sent, so that whatever is there is whole.

    Raises:
        RecordingError: it cannot be sent.
    """
    if not is_url(text):
        yield Path(text)
        return
    _refuse_read_only(text)
    with TemporaryDirectory(prefix='mvuav_') as folder:
        path = Path(folder) / (_name(text) or 'output')
        yield path
        with reached(text, 'written') as (system, target):
            if path.is_dir():
                target = target.rstrip('/')
                # Of a folder that is replaced, parts that this one does not have.
                for old in system.glob(f'{target}/{path.name}_*.mcap'):
                    system.rm_file(old)
                for file in sorted(path.iterdir()):
                    system.put_file(str(file), f'{target}/{file.name}')
            else:
                system.put_file(str(path), target)


def size_at(text: str) -> int | None:
    """The bytes of the file or folder at a place; None if there is nothing, or nothing in it.

    Raises:
        RecordingError: it cannot be said.
    """
    if is_url(text):
        _refuse_read_only(text)
        with reached(text, 'read') as (system, path):
            system.invalidate_cache()
            return int(system.du(path)) if system.exists(path) else None
    here = Path(text)
    if here.is_dir():
        files = [*here.iterdir()]
        return sum(file.stat().st_size for file in files) if files else None
    return here.stat().st_size if here.exists() else None


def read_text(text: str) -> str:
    """The text of the file at a place; '' if there is none.

    Raises:
        RecordingError: it cannot be read.
        OSError: likewise.
    """
    if size_at(text) is None:
        return ''
    if is_url(text):
        with reached(text, 'read') as (system, path):
            return str(system.cat_file(path).decode())
    return Path(text).read_text('utf-8')


def write_text(text: str, content: str) -> None:
    """Replace a file in one step: whoever reads it finds the old one or the new one.

    Raises:
        RecordingError: it cannot be written.
    """
    if is_url(text):
        with reached(text, 'written') as (system, path):
            system.pipe_file(path, content.encode())
        return
    write_whole(Path(text), content)


def _name(url: str) -> str:
    return PurePosixPath(url.split('?')[0].rstrip('/')).name


def _refuse_read_only(url: str) -> None:
    if url.split('://')[0].lower() in _READ_ONLY:
        raise RecordingError(f'{url}: web servers are read-only; give a file or s3://…')


@contextmanager
def reached(url: str, done: str) -> Iterator[tuple[Any, str]]:
    """The file system of an URL, and the path in it; whatever goes wrong is a RecordingError."""
    with needed_for(url):
        import fsspec
    try:
        system, path = fsspec.core.url_to_fs(url)
        yield system, str(path)
    except RecordingError:
        raise
    except Exception as error:  # each protocol's library has errors of its own
        reason = ' '.join(f'{type(error).__name__}: {error}'.split())
        raise RecordingError(f'{url} cannot be {done}: {reason}') from None


def write_whole(path: Path, content: str | bytes) -> None:
    """Write a file, and its folder; a file of that name is replaced as a whole or not at all.

    Raises:
        RecordingError: it cannot be written; what was there stays.
    """
    data = content.encode('utf-8', 'replace') if isinstance(content, str) else content
    new = path.parent / f'.{path.name}.{token_hex(4)}'  # a path like '.' has no name to replace
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.is_dir():
            raise RecordingError(f'{path} is a folder; give the name of a file')
        with new.open('xb') as file:
            file.write(data)
        new.replace(path)
    except OSError as error:
        with suppress(OSError):
            new.unlink()
        raise RecordingError(f'{path} cannot be written: {error.strerror or error}') from None
