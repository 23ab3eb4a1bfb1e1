"""Replays that are interrupted at random moments, and what is left of them."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from mvuav_ros.recordings.reading import open_recording
from support.commands import COMMAND, ENVIRONMENT, MARKERS, ROOT, stamp

FRAMES = 200_000
"""More than any replay with `SLOW` gets through before it is interrupted.

Whoever interrupts may not run for ten seconds, while the replay does: so it takes minutes.
"""
SLOW = (
    *('--nodes', 'marker_tracker,runway_detector'),
    *('--param', 'runway_detector:mode:=approach'),
)
DEADLINE = 120.0
"""Seconds to start or to end, whatever else the machine does."""
MANNERS = ('ctrl-c', 'parent', 'term', 'twice')
LAYOUTS = ('one process', 'two processes', 'two recordings')


class Interruption(NamedTuple):
    """How long a replay took to end (s), and the frames in its outputs."""

    seconds: float
    frames: list[int]


def results(path: Path) -> tuple[list[int], list[str]]:
    """The stamps of the results, and what cannot be read."""
    with open_recording(path) as recording:
        stamps = [message.stamp_ns for message in recording.messages({MARKERS})]
        return stamps, recording.account.errors


def start(*arguments: object) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [*COMMAND, 'replay', *map(str, arguments), *SLOW],
        env=ENVIRONMENT,
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def wait_for(process: subprocess.Popen[str], *outputs: Path, size: int = 20_000) -> None:
    deadline = time.monotonic() + DEADLINE
    while not all(path.exists() and path.stat().st_size > size for path in outputs):
        assert time.monotonic() < deadline, 'nothing is written'
        assert process.poll() is None, process.communicate()
        time.sleep(0.005)


@contextmanager
def busy_processes(count: int) -> Iterator[None]:
    """So many processes that take all the time they get."""
    others = [subprocess.Popen(['nice', 'python3', '-c', 'while True: pass']) for _ in range(count)]
    try:
        yield
    finally:
        for other in others:
            other.kill()
            other.wait()


def interrupt(flight: Path, folder: Path, seed: int) -> Interruption:
    """Begin a replay and interrupt it, all at random; its outputs must be complete files.

    Args:
        flight: a recording of `FRAMES` frames.
        folder: for the outputs.
        seed: makes the layout, the manner and the moment.
    """
    choose = random.Random(seed)
    layout, manner = LAYOUTS[seed % 3], MANNERS[seed // 3 % 4]
    outputs, arguments = [folder / 'out.mcap'], [flight, '-o', folder / 'out.mcap', '--jobs']
    if layout == 'two recordings':
        twin = folder / 'twin.mcap'
        twin.symlink_to(flight)
        outputs = [folder / 'out' / f'{name}.mcap' for name in (flight.stem, 'twin')]
        arguments = [flight, twin, '-o', folder / 'out', '--jobs']
    process = start(*arguments, 1 if layout == 'one process' else 2)
    anywhere = choose.random() < 0.15
    if anywhere:
        time.sleep(choose.uniform(0.5, 4.0))
    else:
        wait_for(process, *outputs, size=choose.choice((0, 1_000, 20_000)))
        time.sleep(choose.expovariate(4.0))
    assert process.poll() is None, process.communicate()
    begin = time.monotonic()
    number = signal.SIGTERM if manner == 'term' else signal.SIGINT
    _send(process, number, group=manner in ('ctrl-c', 'twice'))
    if manner == 'twice':
        time.sleep(choose.uniform(0.0, 0.3))
        _send(process, number, group=True)
    _, err = process.communicate(timeout=DEADLINE)
    seconds = time.monotonic() - begin
    frames = [len(_complete(output)) for output in outputs if output.exists()]
    what = (seed, layout, manner, anywhere, process.returncode, frames, err)
    if not frames and process.returncode in (-number, 1):
        # Python itself was still starting.
        return Interruption(seconds, [])
    assert process.returncode == 128 + number, what
    assert 'Traceback' not in err and 'Exception ignored' not in err, what
    assert anywhere or len(frames) == len(outputs), what
    assert all(count < FRAMES for count in frames), what
    return Interruption(seconds, frames)


def _send(process: subprocess.Popen[str], number: int, *, group: bool) -> None:
    try:
        (os.killpg if group else os.kill)(process.pid, number)
    except ProcessLookupError:
        assert process.poll() is not None


def _complete(output: Path) -> list[int]:
    stamps, errors = results(output)
    assert errors == [], (output, errors)
    assert stamps == [stamp(number) for number in range(len(stamps))]
    return stamps
