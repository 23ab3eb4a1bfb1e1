"""The `mvuav` command as a user runs it, in this process or in one of its own."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any, NamedTuple

from mvuav_ros.cli.app import main
from mvuav_ros.recordings.reading import open_recording
from mvuav_ros.recordings.stored_file import RecordedMessage
from mvuav_ros.recordings.writing import RecordingWriter
from support.places import ROOT
from support.recording_samples import START_NS, STEP_NS, cdr, image

MARKERS = '/marker_tracker/markers'
NO_CAMERA = 'no pose: no calibration comes with the images, and --camera-info names none\n'
NO_POSE = f'note: marker_tracker, every frame: {NO_CAMERA}'
NO_LIGHT = (
    'note: marker_tracker, every frame: 0 of 5 markers in view; no pixel is above the threshold; '
    f'the brightest is 0; {NO_CAMERA}'
)
"""What a replay of dark images says at its end."""


def notes_of(recordings: Iterable[object], notes: str) -> list[str]:
    """The same of several, sorted: each note names its recording."""
    lines = [line.removeprefix('note: ') for line in notes.splitlines()]
    return sorted(f'note: {recording}: {line}' for recording in recordings for line in lines)


COMMAND = [sys.executable, '-m', 'mvuav_ros', 'mvuav']
ENVIRONMENT = {**os.environ, 'PYTHONPATH': str(ROOT), 'COLUMNS': '200'}


def environment() -> dict[str, str]:
    """`ENVIRONMENT` with what fixtures have set since."""
    return {**os.environ, **ENVIRONMENT}


@contextmanager
def started(*arguments: Any, **options: Any) -> Iterator[subprocess.Popen[Any]]:
    """A process that is waited for, and killed where the test fails: else that waits for ever."""
    with subprocess.Popen(*arguments, **options) as process:
        try:
            yield process
        except BaseException:
            process.kill()
            raise


class Run(NamedTuple):
    status: int
    out: str
    err: str

    @property
    def error(self) -> str:
        """The one line that a failed command ends with."""
        assert self.status != 0
        last = self.err.splitlines()[-1]
        assert last.startswith('mvuav: ')
        return last


def mvuav(*arguments: Any) -> Run:
    """Run the command in this process; a traceback would come out as an exception."""
    out, err = StringIO(), StringIO()
    argv = sys.argv
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    if arguments[0] == 'replay' and '--jobs' not in arguments:
        # This process has threads and must not fork.
        arguments = (*arguments, '--jobs', '1')
    sys.argv = ['mvuav', *map(str, arguments)]
    try:
        with redirect_stdout(out), redirect_stderr(err):
            main()
    except SystemExit as end:
        status = end.code
    finally:
        sys.argv = argv
        for number, handler in handlers.items():
            signal.signal(number, handler)
    assert isinstance(status, int)
    return Run(status, out.getvalue(), err.getvalue())


def mvuav_process(*arguments: Any, **options: Any) -> Run:
    """Run the command in a process of its own."""
    done = subprocess.run(
        [*COMMAND, *map(str, arguments)],
        capture_output=True,
        text=True,
        env=environment(),
        cwd=ROOT,
        timeout=600,
        **options,
    )
    assert 'Traceback' not in done.stderr
    return Run(done.returncode, done.stdout, done.stderr)


def read(path: Path) -> list[RecordedMessage]:
    """Every message of a recording that must be whole."""
    with open_recording(path) as recording:
        messages = list(recording.messages())
        assert recording.account.errors == []
    return messages


def renamed(path: Path, copy: Path, topics: dict[str, str]) -> None:
    """Copy the messages of some topics under other names."""
    with RecordingWriter(copy) as writer:
        for message in read(path):
            if message.topic in topics:
                to = topics[message.topic]
                writer.write(to, message.type, message.stamp_ns, message.data)


def counts(path: Path) -> Counter[str]:
    return Counter(message.topic for message in read(path))


def stamps(path: Path, topic: str = MARKERS) -> list[int]:
    return [message.stamp_ns for message in read(path) if message.topic == topic]


def stamp(number: int) -> int:
    """Of frame ``number`` of the sample recordings."""
    return START_NS + number * STEP_NS


def write_flight(path: Path, frames: int, width: int = 64, height: int = 48) -> Path:
    """An even image in every frame: quick to make, to compress and to process."""
    message = image(0, width, height, noisy=False)
    with RecordingWriter(path) as writer:
        for number in range(frames):
            message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp(number), 10**9)
            writer.write('/camera/image_raw', message.__msgtype__, stamp(number), cdr(message))
    return path
