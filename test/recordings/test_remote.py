"""Recordings that lie on an S3 server, a web server, or in memory."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest
from support.commands import mvuav
from support.recording_samples import image_samples, write_mcap, write_rosbag2

from mvuav_ros.recordings.errors import RecordingError
from mvuav_ros.recordings.remote import fetch, is_url, local_copy, remote_state
from mvuav_ros.recordings.sources.frame import SourceError
from mvuav_ros.recordings.sources.opening import open_source

fsspec = pytest.importorskip('fsspec')
COUNT = 12


@pytest.fixture(scope='module')
def s3() -> Iterator[str]:
    """A bucket on a server of this machine."""
    server_module = pytest.importorskip('moto.server')
    pytest.importorskip('s3fs')
    server = server_module.ThreadedMotoServer(ip_address='127.0.0.1', port=0)
    server.start()
    host, port = server.get_host_and_port()
    given = {
        'AWS_ENDPOINT_URL': f'http://{host}:{port}',
        'AWS_ACCESS_KEY_ID': 'test',
        'AWS_SECRET_ACCESS_KEY': 'test',
        'AWS_DEFAULT_REGION': 'us-east-1',
    }
    before = {name: os.environ.get(name) for name in given}
    os.environ.update(given)
    system = fsspec.filesystem('s3')
    system.mkdir('flights')
    yield 's3://flights'
    for name, value in before.items():
        os.environ.pop(name) if value is None else os.environ.update({name: value})
    server.stop()


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
    before = remote_state(f'{s3}/day/a.mcap')
    assert before == remote_state(f'{s3}/day/a.mcap')
    system.put(str(write_mcap(path, image_samples(COUNT + 1))), 'flights/day/a.mcap')
    assert before != remote_state(f'{s3}/day/a.mcap')
    with pytest.raises(SourceError, match='cannot be read'):
        open_source(f'{s3}/missing.mcap')


def test_https_and_what_is_removed_afterwards(tmp_path: Path) -> None:
    pytest.importorskip('aiohttp')
    write_mcap(tmp_path / 'a.mcap', image_samples(COUNT))
    handler = partial(SimpleHTTPRequestHandler, directory=str(tmp_path))
    with ThreadingHTTPServer(('127.0.0.1', 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        url = f'http://127.0.0.1:{server.server_port}/a.mcap'
        with local_copy(url) as path:
            assert path.read_bytes() == (tmp_path / 'a.mcap').read_bytes()
        assert not path.exists()
        with pytest.raises(RecordingError, match='cannot be read'):
            fetch(f'{url}.missing', tmp_path / 'copy')
        server.shutdown()


def test_memory(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / 'a.mcap', image_samples(COUNT))
    fsspec.filesystem('memory').put(str(path), '/flights/a.mcap')
    assert len(list(open_source('memory://flights/a.mcap').frames())) == COUNT


def test_what_is_an_url() -> None:
    assert is_url('s3://a/b.mcap') and is_url('https://a/b')
    assert not is_url('sim:tanker') and not is_url('/a/b.mcap')
