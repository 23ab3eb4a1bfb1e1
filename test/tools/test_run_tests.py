"""One verdict over all parts, whatever fails."""

import importlib.util
import sys

import pytest
from support.places import ROOT


@pytest.fixture(scope='module')
def runner():
    spec = importlib.util.spec_from_file_location('run_tests', ROOT / 'tools' / 'run_tests.py')
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def says(line, status=0):
    return [sys.executable, '-c', f'import sys; print({line!r}); sys.exit({status})']


@pytest.mark.parametrize(
    ('command', 'counts'),
    [
        (says('== 7 passed, 2 skipped in 3.00s =='), (7, 0, 2)),
        (says('== 1 failed, 7 passed, 1 error in 3.00s ==', 1), (7, 2, 0)),
        (says('== 7 passed in 3.00s ==', 3), (7, 1, 0)),
        (says('Success'), (1, 0, 0)),
        (says('Found 3 errors', 1), (0, 3, 0)),
        (says('no tests ran in 0.01s', 5), (0, 1, 0)),
    ],
)
def test_a_part_is_counted_as_it_ended(runner, command, counts):
    assert runner.run(runner.Part('part', lambda: [command]))[1:4] == counts


def test_a_later_command_runs_although_an_earlier_one_failed(runner, tmp_path):
    late = tmp_path / 'late'
    commands = [says('1 failed, 2 passed', 1), [sys.executable, '-c', f'open({str(late)!r}, "w")']]
    outcome = runner.run(runner.Part('part', lambda: commands))
    assert late.exists() and outcome.failed == 1 and outcome.passed == 3


def test_what_the_machine_lacks_is_said(runner):
    outcome = runner.run(runner.Part('Python 3.99', lambda: []))
    assert outcome.skipped == 1 and 'no such Python' in outcome.note


def test_one_line_and_one_status(runner, capsys):
    good, bad = runner.Outcome('a', 5, 0, 1, 2.0), runner.Outcome('b', 3, 2, 0, 1.0)
    assert runner.summarize([good]) == 0
    assert runner.summarize([good, bad]) == 1
    assert capsys.readouterr().out.splitlines()[-1] == '8 passed, 2 failed, 1 skipped'


def test_another_python_does_not_take_this_ones_libraries_of_ros(runner, monkeypatch):
    monkeypatch.setenv('_ROS_WHEELS_BOOTSTRAP_COMPLETE', '1')
    monkeypatch.setenv('LD_LIBRARY_PATH', f'{ROOT}/.venv/lib:/opt/ros/jazzy/lib')
    environment = runner.environment()
    assert '_ROS_WHEELS_BOOTSTRAP_COMPLETE' not in environment
    assert environment['LD_LIBRARY_PATH'] == '/opt/ros/jazzy/lib'
    monkeypatch.setenv('LD_LIBRARY_PATH', f'{ROOT}/.venv/lib')
    assert 'LD_LIBRARY_PATH' not in runner.environment()
