"""An S3 server on this machine."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

fsspec = pytest.importorskip('fsspec', reason='the extra remote is not installed')
server = pytest.importorskip('moto.server', reason='moto is not installed')


@contextmanager
def s3_bucket(name: str) -> Iterator[str]:
    """An empty bucket; this process and its children reach it by its URL."""
    moto = server.ThreadedMotoServer(ip_address='127.0.0.1', port=0)
    moto.start()
    host, port = moto.get_host_and_port()
    given = {
        'AWS_ENDPOINT_URL': f'http://{host}:{port}',
        'AWS_ACCESS_KEY_ID': 'test',
        'AWS_SECRET_ACCESS_KEY': 'test',
        'AWS_DEFAULT_REGION': 'us-east-1',
    }
    before = {variable: os.environ.get(variable) for variable in given}
    os.environ.update(given)
    fsspec.filesystem('s3', skip_instance_cache=True).mkdir(name)
    # One that an earlier server gave its address to would be asked again.
    fsspec.get_filesystem_class('s3').clear_instance_cache()
    yield f's3://{name}'
    for variable, value in before.items():
        os.environ.pop(variable) if value is None else os.environ.update({variable: value})
    moto.stop()
