"""What holds for every executable before it is imported."""

import os
import sys
from types import ModuleType

import pytest

from mvuav_ros import __main__


@pytest.fixture
def executable(monkeypatch):
    """An executable that notes the threads it was given."""
    seen = []
    module = ModuleType('some_executable')
    module.main = lambda: seen.append(os.environ['OPENBLAS_NUM_THREADS'])
    monkeypatch.setitem(sys.modules, module.__name__, module)
    monkeypatch.setattr(__main__, '_executables', lambda: {'some': module.__name__})
    monkeypatch.setattr(__main__.signal, 'signal', lambda *_: None)
    return seen


def test_small_matrices_are_not_spread_over_threads(executable, monkeypatch):
    monkeypatch.delenv('OPENBLAS_NUM_THREADS', raising=False)
    __main__._run('some')
    assert executable == ['1']
    del os.environ['OPENBLAS_NUM_THREADS']


def test_who_asks_for_threads_gets_them(executable, monkeypatch):
    monkeypatch.setenv('OPENBLAS_NUM_THREADS', '3')
    __main__._run('some')
    assert executable == ['3']
