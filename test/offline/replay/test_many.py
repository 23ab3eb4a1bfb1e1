"""Several recordings into a folder: in processes, on a Dask cluster, and once more."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import pytest
from mcap.reader import make_reader
from rich.progress import Progress
from support.commands import (
    COMMAND,
    ENVIRONMENT,
    NO_POSE,
    ROOT,
    mvuav,
    mvuav_process,
    notes_of,
    read,
    stamps,
    started,
    write_flight,
)
from support.interrupting import FRAMES, SLOW
from support.recording_samples import image_samples, write_mcap, write_rosbag2

from mvuav_ros.cli.commands.replay import replay_all
from mvuav_ros.offline.replay.batch import plan
from mvuav_ros.offline.replay.job import (
    JobProgress,
    ReplayJob,
    ReplayOutcome,
    ReplaySettings,
    attempt,
)
from mvuav_ros.offline.stopping import Stop
from mvuav_ros.recordings.stored_file import RecordedMessage

NODE = ('--nodes', 'marker_tracker')


@pytest.fixture
def bags(tmp_path: Path) -> list[Path]:
    """Of different lengths, the longest first: the order of the ends is not that of the starts."""
    lengths = (60, 20, 40)
    return [write_mcap(tmp_path / f'flight{n}.mcap', image_samples(n)) for n in lengths]


@pytest.mark.parametrize('absolute', [False, True])
def test_a_folder_to_be_made_is_known_by_its_slash(tmp_path: Path, absolute: bool) -> None:
    output = f'{tmp_path}/day.1/'
    jobs, folder = plan(['a.mcap'], output, ReplaySettings({}), absolute=absolute)
    assert (jobs[0].output, folder) == (f'{tmp_path}/day.1/a.mcap', output)


def content(path: Path) -> tuple[list[RecordedMessage], dict[str, dict[str, str]]]:
    """All but the chunks' borders: on a machine slower than the recording, the clock sets them."""
    with path.open('rb') as stream:
        metadata = {record.name: record.metadata for record in make_reader(stream).iter_metadata()}
    assert set(metadata) == {'mvuav_replay'}
    return read(path), metadata


@pytest.fixture
def without_processes(monkeypatch: pytest.MonkeyPatch) -> None:
    """The jobs in this process: what is tested is not the pool, and starting takes a second."""

    def run(
        jobs: Sequence[ReplayJob], _: int, __: None, stop: Stop, ___: object
    ) -> Iterator[tuple[int, ReplayOutcome]]:
        for number, job in enumerate(jobs):
            yield number, attempt(job, lambda _: None, stop)

    monkeypatch.setattr('mvuav_ros.offline.replay.batch.run_jobs', run)


def test_jobs_give_what_single_runs_give(bags: list[Path], tmp_path: Path) -> None:
    several, one = tmp_path / 'several', tmp_path / 'one'
    run = mvuav_process('replay', *bags, '-o', several, '--jobs', 2)
    throughout = 'note: runway_detector, every frame: rows 50 to 130 are outside the 48 rows\n'
    assert run.status == 0
    assert sorted(run.err.splitlines()) == notes_of(bags, NO_POSE + throughout)
    assert len(run.out.splitlines()) == 3
    assert mvuav_process('replay', *bags, '-o', one, '--jobs', 1).status == 0
    for bag in bags:
        single = tmp_path / 'single.mcap'
        assert mvuav('replay', bag, '-o', single, '--force').status == 0
        assert content(several / bag.name) == content(one / bag.name) == content(single)


def test_a_failed_one_does_not_stop_the_rest(bags: list[Path], tmp_path: Path) -> None:
    bags[0].write_bytes(b'nothing that could be read')
    out = tmp_path / 'out'
    run = mvuav_process('replay', *bags, tmp_path / 'missing.mcap', '-o', out, *NODE)
    assert run.status == 1
    *errors, last = [line for line in run.err.splitlines() if line.startswith('mvuav: ')]
    assert last == 'mvuav: 2 of 4 recordings failed'
    # As they end.
    assert len(errors) == 2
    assert all(any(name in error for error in errors) for name in (str(bags[0]), 'missing.mcap'))
    assert [len(stamps(out / bag.name)) for bag in bags[1:]] == [20, 40]


@pytest.mark.usefixtures('without_processes')
def test_what_is_finished_is_not_done_again(bags: list[Path], tmp_path: Path) -> None:
    out = tmp_path / 'out'
    options = ('-o', out, *NODE)
    assert mvuav('replay', *bags[:2], *options).status == 0
    written = {bag.name: (out / bag.name).stat().st_mtime_ns for bag in bags[:2]}
    run = mvuav('replay', *bags, *options)
    assert run.status == 0
    assert run.out.count('finished before') == 2
    for name, moment in written.items():
        assert (out / name).stat().st_mtime_ns == moment
    assert len(stamps(out / bags[2].name)) == 40
    run = mvuav('replay', *bags, *options, '--force')
    assert 'finished before' not in run.out
    assert all((out / name).stat().st_mtime_ns != moment for name, moment in written.items())


@pytest.mark.parametrize(
    'change', ['parameter', 'part', 'input', 'foreign file', 'topics', 'another maker']
)
@pytest.mark.usefixtures('without_processes')
def test_results_of_something_else_are_not_overwritten(
    bags: list[Path], tmp_path: Path, change: str
) -> None:
    bag, out = bags[1], tmp_path / 'out'
    assert mvuav('replay', bag, '-o', out, *NODE).status == 0
    result = out / bag.name
    options: tuple[str, ...] = ()
    if change == 'parameter':
        options = ('--param', 'marker_tracker:threshold:=0.5')
    elif change == 'part':
        options = ('--every', '2')
    elif change == 'topics':
        options = ('--keep-inputs',)
    elif change == 'input':
        os.utime(bag, (1, 1))
    elif change == 'foreign file':
        result.write_bytes(b'mine')
    else:
        shutil.copy(bag, result)
    before = result.read_bytes()
    run = mvuav('replay', bag, '-o', out, *NODE, *options)
    assert run.status == 1
    assert '--force overwrites it' in run.error
    assert result.read_bytes() == before
    assert mvuav('replay', bag, '-o', out, *NODE, *options, '--force').status == 0
    assert result.read_bytes() != before


@pytest.mark.parametrize('left', ['nothing', 'half', 'all'])
@pytest.mark.usefixtures('without_processes')
def test_what_the_manifest_says_was_begun_is_done_again(
    bags: list[Path], tmp_path: Path, left: str
) -> None:
    bag, out = bags[0], tmp_path / 'out'
    assert mvuav('replay', bag, '-o', out, *NODE).status == 0
    result, manifest = out / bag.name, out / 'manifest.json'
    whole, messages = result.read_bytes(), read(result)
    result.write_bytes(whole[: {'nothing': 0, 'half': len(whole) // 2, 'all': len(whole)}[left]])
    # As a batch leaves it whose machine lost its power.
    manifest.write_text(manifest.read_text().replace('"finished"', '"begun"'))
    run = mvuav('replay', bag, '-o', out, *NODE)
    assert run.status == 0
    assert 'finished before' not in run.out
    assert read(result) == messages
    assert 'finished before' in mvuav('replay', bag, '-o', out, *NODE).out


@pytest.mark.parametrize('manifest', [None, '', '{"recordings": [{"output": 3}]}', '[]'])
@pytest.mark.usefixtures('without_processes')
def test_without_a_sound_manifest_nothing_is_overwritten(
    bags: list[Path], tmp_path: Path, manifest: str | None
) -> None:
    bag, out = bags[1], tmp_path / 'out'
    assert mvuav('replay', bag, '-o', out, *NODE).status == 0
    (out / 'manifest.json').unlink()
    if manifest is not None:
        (out / 'manifest.json').write_text(manifest)
    before = (out / bag.name).read_bytes()
    for _ in range(2):
        run = mvuav('replay', bag, '-o', out, *NODE)
        assert run.status == 1 and '--force overwrites it' in run.error
    assert (out / bag.name).read_bytes() == before


@pytest.mark.usefixtures('without_processes')
def test_warnings_of_what_is_finished_are_repeated(tmp_path: Path) -> None:
    bag = write_mcap(tmp_path / 'cut.mcap', image_samples(30))
    bag.write_bytes(bag.read_bytes()[:-20_000])
    out = tmp_path / 'out'
    runs = [mvuav('replay', bag, '-o', out, *NODE, *strict) for strict in ((), ())]
    assert [run.status for run in runs] == [0, 0]
    assert runs[0].err == runs[1].err != ''
    run = mvuav('replay', bag, '-o', out, *NODE, '--strict')
    assert run.status == 1
    assert 'finished before' in run.out


def test_a_process_that_dies_costs_its_own_recording_only(tmp_path: Path) -> None:
    long = write_flight(tmp_path / 'long.mcap', FRAMES)
    short = write_flight(tmp_path / 'short.mcap', 20)
    out = tmp_path / 'out'
    jobs = ('--jobs', '1')
    command = [*COMMAND, 'replay', str(long), str(short), '-o', str(out), *SLOW, *jobs]
    with started(command, env=ENVIRONMENT, cwd=ROOT, stderr=subprocess.PIPE, text=True) as process:
        os.kill(_child_at_work(process, out / 'long.mcap'), signal.SIGKILL)
        _, err = process.communicate(timeout=300)
    assert process.returncode == 1
    assert f'mvuav: {long}: its process ended with SIGKILL' in err
    assert len(stamps(out / 'short.mcap')) == 20


def _wait_for(process: subprocess.Popen[str], output: Path) -> None:
    deadline = time.monotonic() + 300
    while not (output.exists() and output.stat().st_size > 10_000):
        assert time.monotonic() < deadline and process.poll() is None
        time.sleep(0.02)


def _child_at_work(process: subprocess.Popen[str], output: Path) -> int:
    _wait_for(process, output)
    children = Path(f'/proc/{process.pid}/task/{process.pid}/children').read_text().split()
    (child,) = children
    return int(child)


def test_names_of_outputs(tmp_path: Path) -> None:
    folder = write_rosbag2(tmp_path / 'day.one', image_samples(2))
    settings = ReplaySettings({})
    sources = [str(folder), 'a/x.tar.mcap', 'b/y.db3.zstd', 'c/z.bag', 'film.avi', 'set/*.png']
    jobs, out = plan(sources, str(tmp_path / 'out'), settings)
    assert [Path(job.output).name for job in jobs] == [
        'day.one.mcap', 'x.tar.mcap', 'y.mcap', 'z.mcap', 'film.mcap', 'set.mcap'
    ]  # fmt: skip
    assert out == str(tmp_path / 'out')
    (single,), out = plan(['a.bag'], str(tmp_path / 'b.mcap'), settings)
    assert (single.output, out) == (str(tmp_path / 'b.mcap'), None)
    jobs, out = plan(['s3://day/a.bag?x=1', 'b.mcap'], 's3://results/1.5/', settings, absolute=True)
    assert [job.output for job in jobs] == ['s3://results/1.5/a.mcap', 's3://results/1.5/b.mcap']
    assert jobs[1].source == str(Path('b.mcap').absolute())
    folders = ReplaySettings({}, split_bytes=0)
    assert plan(['a.bag'], 'flight', folders)[1] is None
    assert plan(['a.bag', 'b.bag'], 's3://x', folders)[0][1].output == 's3://x/b'


def test_outputs_that_do_not_fit(bags: list[Path], tmp_path: Path) -> None:
    error = mvuav('replay', *bags, '-o', tmp_path / 'out.mcap').error
    assert 'several inputs need a folder' in error
    other = tmp_path / 'other'
    other.mkdir()
    twin = shutil.copy(bags[0], other / bags[0].name)
    error = mvuav('replay', bags[0], twin, '-o', tmp_path / 'out').error
    assert f'{bags[0]} and {twin} would both become' in error
    (tmp_path / 'file').touch()
    assert 'File exists' in mvuav('replay', *bags, '-o', tmp_path / 'file').error


@pytest.mark.parametrize('with_files', [True, False])
def test_dask_missing_or_away(
    bags: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, with_files: bool
) -> None:
    address = 'tcp://127.0.0.1:1'
    if with_files:
        pytest.importorskip('distributed', reason='Dask is not installed')
        monkeypatch.setattr('mvuav_ros.offline.tasks._CONNECT_TIME', 1)
        words = 'no Dask scheduler answers there'
    else:
        monkeypatch.setitem(__import__('sys').modules, 'distributed', None)
        words = "pip install '.[dask]' in a checkout"
    run = mvuav('replay', *bags, '-o', tmp_path / 'out', '--dask', address)
    assert run.status == 1
    assert words in run.error
    assert len(run.err.splitlines()) == 1


@pytest.mark.parametrize('address', ['tcp://127.0.0.1', 'somewhere', 'nix://127.0.0.1:1'])
def test_no_address_of_a_scheduler_is_refused_at_once(
    bags: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, address: str
) -> None:
    distributed = pytest.importorskip('distributed', reason='Dask is not installed')
    # It would be left half made, and end with a traceback 20 s later.
    monkeypatch.setattr(distributed, 'Client', None)
    run = mvuav('replay', *bags, '-o', tmp_path / 'out', '--dask', address)
    assert run.status == 1
    assert run.error.endswith('write tcp://HOST:8786')


@pytest.mark.long
def test_dask_gives_what_jobs_give(bags: list[Path], tmp_path: Path) -> None:
    distributed = pytest.importorskip('distributed', reason='Dask is not installed')
    missing = tmp_path / 'missing.mcap'
    local, remote = tmp_path / 'local', tmp_path / 'remote'
    assert mvuav_process('replay', *bags, '-o', local, '--jobs', 1).status == 0
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None, env=ENVIRONMENT
    ) as cluster:
        address = cluster.scheduler_address
        run = mvuav_process('replay', *bags, missing, '-o', remote, '--dask', address)
        assert run.status == 1
        assert str(missing) in run.err and '1 of 4 recordings failed' in run.err
        again = mvuav_process('replay', *bags, '-o', remote, '--dask', address)
        interrupted = _interrupt_on_cluster(tmp_path, address)
    assert again.status == 0
    assert 0 < len(stamps(interrupted)) < FRAMES
    assert again.out.count('finished before') == 3
    assert {path.name for path in remote.glob('*.mcap')} == {bag.name for bag in bags}
    for bag in bags:
        assert content(remote / bag.name) == content(local / bag.name)


def _interrupt_on_cluster(folder: Path, address: str) -> Path:
    flight = write_flight(folder / 'long.mcap', FRAMES)
    output = folder / 'interrupted' / 'long.mcap'
    command = [*COMMAND, 'replay', str(flight), '-o', str(output.parent), *SLOW, '--dask', address]
    with started(command, env=ENVIRONMENT, cwd=ROOT, stderr=subprocess.PIPE, text=True) as process:
        _wait_for(process, output)
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=300)
    assert process.returncode == 130
    assert err == 'mvuav: interrupted\n'
    return output


def test_outcomes_are_in_the_order_of_the_inputs(
    bags: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def run(jobs: Sequence[ReplayJob], *_: object) -> Iterator[tuple[int, ReplayOutcome]]:
        for number, job in reversed(list(enumerate(jobs))):
            yield number, ReplayOutcome(job.source, job.output, frames=1)

    monkeypatch.setattr('mvuav_ros.offline.replay.batch.run_jobs', run)
    done = mvuav('replay', *bags, '-o', tmp_path / 'out', '--json')
    found = [recording['source'] for recording in json.loads(done.out)['recordings']]
    assert found == [str(bag) for bag in bags]


def test_bars_of_recordings_have_a_total_only_where_it_is_known(
    bags: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bars = Progress(disable=True)

    def run(
        _: object, __: int, ___: None, ____: Stop, show: Callable[[int, JobProgress], None]
    ) -> Iterator[tuple[int, ReplayOutcome]]:
        show(0, JobProgress('a video', 1, None))
        show(1, JobProgress('a bag', 1, 60))
        yield from ()

    monkeypatch.setattr('mvuav_ros.offline.replay.batch.run_jobs', run)
    monkeypatch.setattr('mvuav_ros.cli.commands.replay.frame_progress', lambda **_: bars)
    planned = plan(list(map(str, bags)), str(tmp_path / 'out'), ReplaySettings({}))
    replay_all(planned, 1, None, Stop())
    assert {each.description: each.total for each in bars.tasks} == {
        'recordings': 3,
        'a video': None,
        'a bag': 60,
    }
