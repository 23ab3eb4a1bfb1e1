"""Where the real footage and reference results lie; never part of the project itself."""

from pathlib import Path

import pytest
from support.places import SHARED


def _shared(name: str) -> Path:
    path = SHARED / name
    if not path.exists():
        pytest.skip(f'{path} is not on this machine')
    return path


@pytest.fixture(scope='session')
def footage() -> Path:
    return _shared('footage')
