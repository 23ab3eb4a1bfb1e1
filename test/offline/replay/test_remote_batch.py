"""A batch whose inputs and outputs lie on an S3 server."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from support.commands import (
    COMMAND,
    NO_LIGHT,
    ROOT,
    environment,
    mvuav_process,
    notes_of,
    read,
    started,
    write_flight,
)
from support.s3_server import fsspec, s3_bucket

from mvuav_ros.recordings.remote import local_copy, read_text

distributed = pytest.importorskip('distributed', reason='Dask is not installed')
NODE = ('--nodes', 'marker_tracker')
LENGTHS = {'long': 4000, 'middle': 1500, 'short': 40, 'other': 60}


@pytest.fixture(scope='module')
def s3() -> Iterator[str]:
    with s3_bucket('batch') as url:
        yield url


def put_flights(folder: Path, url: str, lengths: dict[str, int]) -> list[str]:
    folder.mkdir()
    system = fsspec.filesystem('s3')
    for name, count in lengths.items():
        system.put(str(write_flight(folder / f'{name}.mcap', count)), f'{url}/{name}.mcap')
    return [f'{url}/{name}.mcap' for name in lengths]


def outcomes(url: str) -> dict[str, str]:
    content = json.loads(read_text(f'{url}/manifest.json'))
    return {entry['output']: entry['outcome'] for entry in content['recordings']}


def test_a_batch_in_processes_and_once_more(s3: str, tmp_path: Path) -> None:
    flights = put_flights(tmp_path / 'in', f'{s3}/small', {'a': 12, 'b': 20})
    out = f'{s3}/small/out'
    run = mvuav_process('replay', *flights, '-o', out, *NODE, '--jobs', 2)
    assert run.status == 0
    assert sorted(run.err.splitlines()) == notes_of(flights, NO_LIGHT)
    assert outcomes(out) == {'a.mcap': 'finished', 'b.mcap': 'finished'}
    local = tmp_path / 'b.mcap'
    assert mvuav_process('replay', tmp_path / 'in' / 'b.mcap', '-o', local, *NODE).status == 0
    with local_copy(f'{out}/b.mcap') as fetched:
        assert read(fetched) == read(local)
    again = mvuav_process('replay', *flights, '-o', out, *NODE)
    assert again.out.count('finished before') == 2


@pytest.mark.long
def test_two_workers_of_which_one_is_killed_in_the_middle(s3: str, tmp_path: Path) -> None:
    flights = put_flights(tmp_path / 'in', f'{s3}/day', LENGTHS)
    local = tmp_path / 'local'
    inputs = sorted((tmp_path / 'in').iterdir())
    assert mvuav_process('replay', *inputs, '-o', local, *NODE, '--jobs', 1).status == 0
    out = f'{s3}/day/out'
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None, env=environment()
    ) as cluster:
        command = [*COMMAND, 'replay', *flights, '-o', out, '--dask', cluster.scheduler_address]
        with started(
            [*command, *NODE], env=environment(), cwd=ROOT, stderr=subprocess.PIPE, text=True
        ) as process:
            os.kill(worker_with_the_long_one(cluster), signal.SIGKILL)
            _, err = process.communicate(timeout=300)
        assert process.returncode == 0
        assert sorted(err.splitlines()) == notes_of(flights, NO_LIGHT)
        assert outcomes(out) == dict.fromkeys((f'{name}.mcap' for name in LENGTHS), 'finished')
        for name in LENGTHS:
            with local_copy(f'{out}/{name}.mcap') as fetched:
                assert read(fetched) == read(local / f'{name}.mcap')
        # One is lost, one is not finished: those two are done again.
        system = fsspec.filesystem('s3')
        system.rm_file(f'{out}/middle.mcap')
        manifest = read_text(f'{out}/manifest.json')
        content: Any = json.loads(manifest)
        for entry in content['recordings']:
            entry['outcome'] = 'begun' if entry['output'] == 'short.mcap' else entry['outcome']
        system.pipe_file(f'{out}/manifest.json', json.dumps(content).encode())
        address = cluster.scheduler_address
        again = mvuav_process('replay', *flights, '-o', out, *NODE, '--dask', address)
    assert again.status == 0
    assert again.out.count('finished before') == 2
    assert {line.split(':')[1] for line in again.out.splitlines() if 'before' in line} == {
        f'{out}/{name}.mcap'.split(':')[1] for name in ('long', 'other')
    }
    with local_copy(f'{out}/middle.mcap') as fetched:
        assert read(fetched) == read(local / 'middle.mcap')


def worker_with_the_long_one(cluster: distributed.LocalCluster) -> int:
    """The process that is at it, once it is in the middle of the work."""
    with distributed.Client(cluster) as client:
        deadline = time.monotonic() + 120
        while time.monotonic() < deadline:
            for address, calls in client.call_stack().items():
                if any('run_job' in line for call in calls.values() for line in call):
                    return int(client.run(os.getpid, workers=[address])[address])
            time.sleep(0.05)
    raise AssertionError('no worker ever began')
