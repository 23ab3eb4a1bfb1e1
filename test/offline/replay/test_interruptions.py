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
from support.commands import COMMAND, ENVIRONMENT, MARKERS, ROOT, mvuav_process, stamp, write_flight

from mvuav_ros.recordings.reading import open_recording

NODE = ('--nodes', 'marker_tracker')


@pytest.fixture(scope='module')
def flight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Long enough never to end before it is interrupted."""
    return write_flight(tmp_path_factory.mktemp('flight') / 'flight.mcap', 20_000)


def results(path: Path) -> tuple[list[int], list[str]]:
    with open_recording(path) as recording:
        stamps = [message.stamp_ns for message in recording.messages({MARKERS})]
        return stamps, recording.losses


def start(*arguments: object) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [*COMMAND, 'replay', *map(str, arguments), *NODE],
        env=ENVIRONMENT,
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def wait_for(process: subprocess.Popen[str], *outputs: Path) -> None:
    deadline = time.monotonic() + 30
    while not all(path.exists() and path.stat().st_size > 20_000 for path in outputs):
        assert time.monotonic() < deadline, 'nothing is written'
        assert process.poll() is None, process.communicate()
        time.sleep(0.02)


@pytest.mark.parametrize('times', [1, 3])
@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_interrupted_output_is_complete(
    flight: Path, tmp_path: Path, number: signal.Signals, times: int
) -> None:
    out = tmp_path / 'out.mcap'
    process = start(flight, '-o', out, '--keep-inputs')
    wait_for(process, out)
    for _ in range(times):
        process.send_signal(number)
        time.sleep(0.002)
    _, err = process.communicate(timeout=30)
    assert process.returncode == 128 + number
    assert err.splitlines()[-1] == 'mvuav: interrupted'
    assert 'Traceback' not in err
    stamps, losses = results(out)
    assert losses == []
    assert stamps == [stamp(n) for n in range(len(stamps))]
    assert 0 < len(stamps) < 20_000


@pytest.mark.parametrize('group', [True, False])
def test_interrupted_processes_close_their_outputs_and_are_done_again(
    flight: Path, tmp_path: Path, group: bool
) -> None:
    folder = tmp_path / 'out'
    second = tmp_path / 'second.mcap'
    second.symlink_to(flight)
    outputs = [folder / 'flight.mcap', folder / 'second.mcap']
    process = start(flight, second, '-o', folder, '--jobs', 2)
    wait_for(process, *outputs)
    # On a terminal, Ctrl-C reaches every process of the group.
    (os.killpg if group else os.kill)(process.pid, signal.SIGINT)
    _, err = process.communicate(timeout=30)
    assert process.returncode == 130
    assert err.splitlines()[-1] == 'mvuav: interrupted'
    assert 'Traceback' not in err
    for out in outputs:
        stamps, losses = results(out)
        assert losses == []
        assert 0 < len(stamps) < 20_000
    if not group:
        return
    # Complete as files, but not finished.
    again = start(flight, '-o', folder)
    out, _ = again.communicate(timeout=120)
    assert again.returncode == 0
    assert 'results for 20000 of 20000 frames' in out and 'finished before' not in out


def test_processes_end_with_their_parent(flight: Path, tmp_path: Path) -> None:
    process = start(flight, '-o', tmp_path / 'out')
    out = tmp_path / 'out' / 'flight.mcap'
    wait_for(process, out)
    process.kill()
    process.communicate()
    size, end = -1, time.monotonic() + 20
    while size != out.stat().st_size:
        assert time.monotonic() < end, 'it still grows'
        size = out.stat().st_size
        time.sleep(1.0)
    stamps, _ = results(out)
    assert 0 < len(stamps) < 20_000


def test_killed_replay_leaves_all_but_the_last_second(flight: Path, tmp_path: Path) -> None:
    out, log = tmp_path / 'out.mcap', tmp_path / 'log'
    # The command itself, with a note of each moment at which a result is written.
    code = f"""
import os, sys, time
from mvuav_ros.cli.app import main
from mvuav_ros.recordings.writing import RecordingWriter
log = os.open({str(log)!r}, os.O_WRONLY | os.O_CREAT)
write = RecordingWriter.write
def noted(self, topic, type, stamp_ns, *others):
    write(self, topic, type, stamp_ns, *others)
    if topic == {MARKERS!r}:
        os.write(log, f'{{stamp_ns}} {{time.monotonic()}}\\n'.encode())
RecordingWriter.write = noted
sys.argv = ['mvuav', 'replay', {str(flight)!r}, '-o', {str(out)!r}, *{NODE!r}]
main()
"""
    with subprocess.Popen([sys.executable, '-c', code], env=ENVIRONMENT, cwd=ROOT) as process:
        while not log.exists() and process.poll() is None:
            time.sleep(0.01)
        time.sleep(2.5)
        process.kill()
        killed = time.monotonic()
    assert process.returncode == -signal.SIGKILL
    noted = [line.split() for line in log.read_text().splitlines()]
    old = [int(stamp_ns) for stamp_ns, moment in noted if float(moment) < killed - 1.0]
    stamps, losses = results(out)
    assert len(old) > 100
    assert stamps[: len(old)] == old
    assert losses, 'it must not look complete'


def limit_file_size() -> None:
    resource.setrlimit(resource.RLIMIT_FSIZE, (300_000, 300_000))


@pytest.mark.parametrize('target', ['out.mcap', 'folder'])
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
    stamps, losses = results(out / 'flight.mcap' if out.is_dir() else out)
    assert stamps == [stamp(n) for n in range(len(stamps))]
    assert len(stamps) > 100
    assert losses, 'it must not look complete'
