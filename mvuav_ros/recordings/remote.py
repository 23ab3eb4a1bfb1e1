"""Recordings that lie elsewhere: s3://, https:// and whatever else fsspec reaches."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory
from typing import Any

from mvuav_ros.recordings.errors import RecordingError

_MARKS = ('ETag', 'LastModified', 'created', 'mtime')
_URL = re.compile(r'[a-z][a-z0-9+.-]+://', re.IGNORECASE)


def is_url(text: str) -> bool:
    """Whether a source is named by an URL, of whatever kind."""
    return bool(_URL.match(text))


@contextmanager
def local_copy(text: str) -> Iterator[Path]:
    """A source's path; of one that lies elsewhere, that of a copy which is removed at the end.

    Raises:
        RecordingError: it cannot be copied.
    """
    if not is_url(text):
        yield Path(text).expanduser()
        return
    with TemporaryDirectory(prefix='mvuav_') as folder:
        yield fetch(text, Path(folder))


def fetch(url: str, folder: Path) -> Path:
    """Copy a file or folder into a local folder and say where it is now.

    Raises:
        RecordingError: fsspec is missing, or nothing can be read from there.
    """
    target = folder / (PurePosixPath(url.split('?')[0].rstrip('/')).name or 'recording')
    try:
        system, path = _opened(url)
        is_folder = system.isdir(path) and not system.isfile(path)
        source = f'{path.rstrip("/")}/' if is_folder else path
        system.get(source, str(target), recursive=is_folder)
    except RecordingError:
        raise
    except Exception as error:
        raise _failure(url, error) from None
    return target


def remote_state(url: str) -> tuple[int, str]:
    """The bytes of a file or folder, and a digest that changes when it does.

    Raises:
        RecordingError: fsspec is missing, or nothing can be read from there.
    """
    digest, total = hashlib.sha256(), 0
    try:
        system, path = _opened(url)
        for name in sorted(system.find(path)):
            status = system.info(name)
            total += status['size'] or 0
            marks = [str(status.get(key)) for key in _MARKS]
            digest.update('\0'.join([name, str(status['size']), *marks]).encode())
    except RecordingError:
        raise
    except Exception as error:
        raise _failure(url, error) from None
    return total, digest.hexdigest()


def _failure(url: str, error: Exception) -> RecordingError:
    """Each protocol's library has errors of its own."""
    reason = ' '.join(f'{type(error).__name__}: {error}'.split())
    return RecordingError(f'{url} cannot be read: {reason}')


def _opened(url: str) -> tuple[Any, str]:
    try:
        import fsspec
    except ImportError as error:
        raise RecordingError(
            f'{url}: URLs need fsspec: pip install "mvuav_ros[remote]" ({error})'
        ) from error
    system, path = fsspec.core.url_to_fs(url)
    return system, str(path)
