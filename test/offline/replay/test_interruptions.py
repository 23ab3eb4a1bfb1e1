"""Whatever ends a replay, its output can be read, and says whether it is whole."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from support.commands import ENVIRONMENT, ROOT, mvuav_process, stamp, started, write_flight
from support.interrupting import (
    FRAMES,
    SLOW,
    busy_processes,
    interrupt,
    results,
    start,
    wait_for,
)

NODE = ('--nodes', 'marker_tracker')
INTERRUPTIONS = int(os.environ.get('MVUAV_INTERRUPTIONS', '300'))
LIMIT_S = 10.0
"""In which an interrupted replay has ended, on a machine with eight others on it."""


@pytest.fixture(scope='module')
def flight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Long enough never to end before it is interrupted."""
    return write_flight(tmp_path_factory.mktemp('flight') / 'flight.mcap', FRAMES)


@pytest.mark.parametrize('seed', range(6))
def test_interrupted_at_any_moment_the_outputs_are_complete(
    flight: Path, tmp_path: Path, seed: int
) -> None:
    interrupt(flight, tmp_path, seed)


@pytest.mark.long
def test_hundreds_of_interruptions_on_a_busy_machine(flight: Path, tmp_path: Path) -> None:
    ends = []
    with busy_processes(8):
        for seed in range(INTERRUPTIONS):
            folder = tmp_path / str(seed)
            folder.mkdir()
            ends.append(interrupt(flight, folder, seed))
    slowest = max(end.seconds for end in ends)
    print(f'{len(ends)} interruptions, slowest {slowest:.1f} s')
    assert slowest <= LIMIT_S


def command_that_notes_chunks(then: str, *arguments: object) -> list[str]:
    """The command itself; ``then`` is run whenever the file ``self`` has taken a chunk."""
    code = f"""
import itertools, os, signal, sys
from mvuav_ros.cli.app import main
from mvuav_ros.recordings.writing import OutputFile
number = itertools.count(1)
class Noted(OutputFile):
    def append(self, data):
        super().append(data)
{then}
sys.modules[OutputFile.__module__].OutputFile = Noted
sys.argv = {['mvuav', 'replay', *map(str, arguments), '--jobs', '1']!r}
main()
"""
    return [sys.executable, '-c', code]


def test_what_was_interrupted_is_done_again(tmp_path: Path) -> None:
    flight = write_flight(tmp_path / 'flight.mcap', 3000)
    out = tmp_path / 'out' / 'flight.mcap'
    interrupted = """
        if next(number) == 5:
            os.kill(os.getpid(), signal.SIGINT)
"""
    command = command_that_notes_chunks(interrupted, flight, '-o', out.parent, *NODE)
    done = subprocess.run(command, env=ENVIRONMENT, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 130
    assert done.stderr == 'mvuav: interrupted\n'
    stamps, errors = results(out)
    assert errors == []
    assert len(stamps) < 3000
    # Complete as a file, but not finished.
    again = mvuav_process('replay', flight, '-o', out.parent, *NODE)
    assert 'results for 3000 of 3000 frames' in again.out and 'finished before' not in again.out


def test_processes_end_with_their_parent(flight: Path, tmp_path: Path) -> None:
    process = start(flight, '-o', tmp_path / 'out', '--jobs', 2)
    out = tmp_path / 'out' / 'flight.mcap'
    wait_for(process, out)
    process.kill()
    process.communicate()
    size, end = -1, time.monotonic() + 120
    while size != out.stat().st_size:
        assert time.monotonic() < end, 'it still grows'
        size = out.stat().st_size
        time.sleep(1.0)
    stamps, _ = results(out)
    assert 0 < len(stamps) < 20_000


def test_killed_replay_leaves_what_was_handed_to_the_file(flight: Path, tmp_path: Path) -> None:
    out, log = tmp_path / 'out.mcap', tmp_path / 'log'
    noted = f"""
        with open({str(log)!r}, 'a') as log:
            print(self.size, file=log)
"""
    command = command_that_notes_chunks(noted, flight, '-o', out, *SLOW)
    with started(command, env=ENVIRONMENT, cwd=ROOT) as process:
        deadline = time.monotonic() + 120
        while not log.exists() or len(log.read_text().splitlines()) < 12:
            assert process.poll() is None
            assert time.monotonic() < deadline, 'not a dozen chunks are written'
            time.sleep(0.01)
        process.kill()
    assert process.returncode == -signal.SIGKILL
    written = int(log.read_text().splitlines()[-1])
    assert out.stat().st_size >= written
    stamps, errors = results(out)
    # Half a second of the flight's own time is in each of the chunks after the header.
    assert len(stamps) >= 10 * 14
    assert stamps == [stamp(number) for number in range(len(stamps))]
    assert errors, 'it must not look complete'


def limit_file_size() -> None:
    resource.setrlimit(resource.RLIMIT_FSIZE, (300_000, 300_000))


@pytest.mark.parametrize('target', ['folder', pytest.param('out.mcap', marks=pytest.mark.long)])
def test_an_output_that_cannot_grow(flight: Path, tmp_path: Path, target: str) -> None:
    run = mvuav_process(
        'replay',
        flight,
        '-o',
        tmp_path / target,
        *NODE,
        '--keep-inputs',
        preexec_fn=limit_file_size,
    )
    assert_readable_prefix(run, tmp_path / target)


def test_full_disk(flight: Path, tmp_path: Path) -> None:
    disk = tmp_path / 'disk'
    disk.mkdir()
    mounted = subprocess.run(
        ['mount', '-t', 'tmpfs', '-o', 'size=300k', 'tmpfs', disk], capture_output=True, text=True
    )
    if mounted.returncode:
        pytest.skip(f'a small tmpfs cannot be mounted: {mounted.stderr.strip()}')
    try:
        run = mvuav_process('replay', flight, '-o', disk / 'out.mcap', *NODE)
        assert 'No space left on device' in run.error
        assert_readable_prefix(run, disk / 'out.mcap')
    finally:
        subprocess.run(['umount', disk], check=True)


def assert_readable_prefix(run: object, out: Path) -> None:
    assert run.status == 1
    assert 'cannot be written; what it holds so far can be read' in run.error
    assert len(run.err.splitlines()) == 1
    stamps, errors = results(out / 'flight.mcap' if out.is_dir() else out)
    assert stamps == [stamp(n) for n in range(len(stamps))]
    assert len(stamps) > 100
    assert errors, 'it must not look complete'
