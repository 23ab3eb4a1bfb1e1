"""Recordings that lie on an S3 server, a web server, or in memory."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest
from support.commands import mvuav
from support.recording_samples import image_samples, write_mcap, write_rosbag2
from support.s3_server import fsspec, s3_bucket

from mvuav_ros.recordings.account import RecordingError
from mvuav_ros.recordings.layout import fingerprint
from mvuav_ros.recordings.reading import open_recording
from mvuav_ros.recordings.remote import (
    is_url,
    local_copy,
    local_output,
    read_text,
    size_at,
    write_text,
)
from mvuav_ros.sources.opening import open_source
from mvuav_ros.sources.source import SourceError

COUNT = 12


@pytest.fixture(scope='module')
def s3() -> Iterator[str]:
    """A bucket on a server of this machine."""
    with s3_bucket('flights') as url:
        yield url


def test_s3(s3: str, tmp_path: Path) -> None:
    path = write_mcap(tmp_path / 'a.mcap', image_samples(COUNT))
    folder = write_rosbag2(tmp_path / 'bag', image_samples(COUNT), 'sqlite3')
    system = fsspec.filesystem('s3')
    system.put(str(path), 'flights/day/a.mcap')
    system.put(str(folder), 'flights/day/bag', recursive=True)
    for name in ('day/a.mcap', 'day/bag'):
        assert len(list(open_source(f'{s3}/{name}').frames())) == COUNT
        info = mvuav('info', f'{s3}/{name}')
        assert (info.status, f'{COUNT} messages' in info.out) == (0, True)
    before = fingerprint(f'{s3}/day/a.mcap')
    assert before == fingerprint(f'{s3}/day/a.mcap')
    system.put(str(write_mcap(path, image_samples(COUNT + 1))), 'flights/day/a.mcap')
    assert before != fingerprint(f'{s3}/day/a.mcap')
    with pytest.raises(SourceError, match='cannot be read'):
        open_source(f'{s3}/missing.mcap')


def test_https_and_what_is_removed_afterwards(tmp_path: Path) -> None:
    write_mcap(tmp_path / 'a.mcap', image_samples(COUNT))
    handler = partial(SimpleHTTPRequestHandler, directory=str(tmp_path))
    with ThreadingHTTPServer(('127.0.0.1', 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        url = f'http://127.0.0.1:{server.server_port}/a.mcap'
        with local_copy(url) as path:
            assert path.read_bytes() == (tmp_path / 'a.mcap').read_bytes()
        assert not path.exists()
        with pytest.raises(RecordingError, match='cannot be read'), local_copy(f'{url}.missing'):
            pass
        server.shutdown()


def test_memory(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / 'a.mcap', image_samples(COUNT))
    fsspec.filesystem('memory').put(str(path), '/flights/a.mcap')
    assert len(list(open_source('memory://flights/a.mcap').frames())) == COUNT


def test_what_is_an_url() -> None:
    assert is_url('s3://a/b.mcap') and is_url('https://a/b')
    assert not is_url('sim:tanker') and not is_url('/a/b.mcap')


@pytest.mark.parametrize('kind', ['s3', 'memory', 'here'])
def test_a_file_is_written_whole_or_not_at_all(s3: str, tmp_path: Path, kind: str) -> None:
    place = {'s3': f'{s3}/new', 'memory': 'memory://new', 'here': str(tmp_path)}[kind] + '/a.txt'
    assert (size_at(place), read_text(place)) == (None, '')
    for text in ('first', 'and second'):
        write_text(place, text)
        assert (size_at(place), read_text(place)) == (len(text), text)
    if kind == 'here':
        return
    with pytest.raises(ZeroDivisionError), local_output(place) as path:
        path.write_text('half')
        raise ZeroDivisionError
    assert read_text(place) == 'and second'


def test_nothing_is_written_to_a_web_server(tmp_path: Path) -> None:
    bag = write_mcap(tmp_path / 'a.mcap', image_samples(2))
    for command in ('replay', 'repair', 'export'):
        run = mvuav(command, bag, '-o', 'https://127.0.0.1/a.mcap')
        assert 'web servers are read-only' in run.error


def test_a_file_url_is_the_path_that_it_names(tmp_path: Path) -> None:
    bag = write_mcap(tmp_path / 'a b.mcap', image_samples(2))
    before, url = bag.read_bytes(), bag.as_uri()
    for source, output in ((bag, url), (url, bag)):
        for command in (('replay', '--nodes', 'marker_tracker'), ('repair',)):
            run = mvuav(*command, source, '-o', output, '--force')
            assert 'the input itself' in run.error
    assert bag.read_bytes() == before
    out = (tmp_path / 'new').as_uri()
    assert mvuav('replay', url, '-o', f'{out}/', '--nodes', 'marker_tracker').status == 0
    assert (tmp_path / 'new' / 'a b.mcap').exists()


def test_repair_and_export_from_s3_to_s3(s3: str, tmp_path: Path) -> None:
    damaged = write_mcap(tmp_path / 'a.mcap', image_samples(COUNT))
    damaged.write_bytes(damaged.read_bytes()[:-200])
    fsspec.filesystem('s3').put(str(damaged), 'flights/damaged/a.mcap')
    options = {'a file': ('out.mcap',), 'parts': ('out', '--format', 'rosbag2')}
    for name, *more in options.values():
        for force in ((), ('--force',)):
            run = mvuav(
                'repair', f'{s3}/damaged/a.mcap', '-o', f'{s3}/damaged/{name}', *more, *force
            )
            assert (run.status, f'{s3}/damaged/{name}: {COUNT} messages' in run.out) == (0, True)
        assert 'exists' in mvuav('repair', damaged, '-o', f'{s3}/damaged/{name}', *more).error
        with local_copy(f'{s3}/damaged/{name}') as path, open_recording(path) as recording:
            assert (len(list(recording.messages())), recording.account.errors) == (COUNT, [])
    results = f'{s3}/damaged/results.mcap'
    replayed = mvuav('replay', f'{s3}/damaged/out', '-o', results, '--nodes', 'marker_tracker')
    assert replayed.status == 0
    run = mvuav('export', results, '-o', f'{s3}/damaged/tables')
    assert f'{s3}/damaged/tables/marker_tracker_markers.csv: {5 * COUNT} rows' in run.out
    text = read_text(f'{s3}/damaged/tables/marker_tracker_markers.csv')
    assert len(text.splitlines()) == 5 * COUNT + 1
    assert 'exists' in mvuav('export', results, '-o', f'{s3}/damaged/tables').error
