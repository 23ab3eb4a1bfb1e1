"""Files that hold nothing that was written in part: one that only grows, and a whole text."""

from __future__ import annotations

import errno
import os
import tempfile
from contextlib import suppress
from pathlib import Path

from mvuav_ros.recordings.errors import RecordingError


class OutputFile:
    """A file that is appended to; ``size`` is what it holds by now, in bytes."""

    def __init__(self, path: Path, overwrite: bool) -> None:
        """Create the file, and its folder.

        Raises:
            RecordingError: it exists or cannot be created.
        """
        self.path = path
        self.size = 0
        if path.suffix != '.mcap':
            raise RecordingError(f'{path}: the name of a recording must end in .mcap')
        if path.is_dir():
            raise RecordingError(f'{path} is a folder; give the name of a file')
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise RecordingError(
                f'{path.parent} cannot be made: {error.strerror or error}'
            ) from None
        try:
            if overwrite:
                # Not truncated in place: someone may be reading the old file.
                path.unlink(missing_ok=True)
            flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC
            self._file = os.open(path, flags, 0o666)
        except FileExistsError:
            raise RecordingError(
                f'{path} exists; choose another name, or overwrite it (--force)'
            ) from None
        except OSError as error:
            raise RecordingError(f'{path} cannot be written: {error.strerror or error}') from None

    def append(self, data: bytes) -> None:
        """Write all of ``data``, or nothing if that fails.

        Raises:
            OSError: it failed.
        """
        view = memoryview(data)
        try:
            while view:
                view = view[os.write(self._file, view) :]
        except OSError:
            with suppress(OSError):
                os.ftruncate(self._file, self.size)
            raise
        self.size += len(data)

    @property
    def is_there(self) -> bool:
        """Whether the file is still the one of that name."""
        ours = os.fstat(self._file)
        try:
            there = self.path.lstat()
        except OSError:
            return False
        return (there.st_dev, there.st_ino) == (ours.st_dev, ours.st_ino)

    def close(self) -> None:
        """Let go of the file.

        Raises:
            OSError: the operating system says only now that it could not write, or the file is not
                there any more: another program has put its own in its place.
        """
        try:
            if not self.is_there:
                raise OSError(errno.ESTALE, 'another program has replaced it meanwhile')
        finally:
            os.close(self._file)

    def failure(self, error: Exception) -> RecordingError:
        """What to tell the user."""
        reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        return RecordingError(
            f'{reason}: {self.path} cannot be written; what it holds so far can be read'
        )


def write_whole(path: Path, content: str | bytes) -> None:
    """Write a file, and its folder; a file of that name is replaced as a whole or not at all.

    Raises:
        RecordingError: it cannot be written; what was there stays.
    """
    data = content.encode('utf-8', 'replace') if isinstance(content, str) else content
    new = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.is_dir():
            raise RecordingError(f'{path} is a folder; give the name of a file')
        with tempfile.NamedTemporaryFile(
            dir=path.parent, prefix=f'.{path.name}.', delete=False
        ) as file:
            new = Path(file.name)
            file.write(data)
        # What a file opened in the usual way may be read by.
        mask = os.umask(0)
        os.umask(mask)
        new.chmod(0o666 & ~mask)
        new.replace(path)
    except OSError as error:
        if new is not None:
            new.unlink(missing_ok=True)
        raise RecordingError(f'{path} cannot be written: {error.strerror or error}') from None
