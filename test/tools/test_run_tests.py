"""One verdict over all parts, whatever fails."""

import os
import signal
import subprocess
import sys

import pytest
from support.commands import started
from support.places import ROOT, load_tool

runner = load_tool('run_tests')


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
def test_a_part_is_counted_as_it_ended(command, counts):
    assert runner.run(runner.Part('part', lambda: [command]))[1:4] == counts


def test_a_later_command_runs_although_an_earlier_one_failed(tmp_path):
    late = tmp_path / 'late'
    commands = [says('1 failed, 2 passed', 1), [sys.executable, '-c', f'open({str(late)!r}, "w")']]
    outcome = runner.run(runner.Part('part', lambda: commands))
    assert late.exists() and outcome.failed == 1 and outcome.passed == 3


@pytest.mark.parametrize(
    'ignores', ['', 'import signal; signal.signal(signal.SIGINT, lambda *_: 0);']
)
def test_a_command_that_does_not_end_is_ended_and_has_failed(monkeypatch, ignores):
    monkeypatch.setattr(runner, 'MAX_ENDING_SECONDS', 0.5)
    asleep = f'{ignores} import time\nwhile True: time.sleep(600)'
    part = runner.Part('part', lambda: [[sys.executable, '-c', asleep]], max_seconds=0.5)
    assert runner.run(part)[1:4] == (0, 1, 0)


def test_what_only_computes_leaves_the_cores_to_what_waits_for_an_answer():
    said = [sys.executable, '-c', 'import os; print(f"{os.nice(0)} passed")']
    counts = [runner.run(runner.Part('part', lambda: [said], yields=y)).passed for y in (0, 1)]
    assert counts == [os.nice(0), min(os.nice(0) + int(runner.NICE), 19)]
    (lanes,) = runner.stages('test')
    yielding = {part.name for lane in lanes for part in lane if part.yields}
    assert yielding == {'library', 'commands'}


def test_no_part_of_make_test_goes_on_for_ever():
    parts = [part for lanes in runner.stages('test') for lane in lanes for part in lane]
    assert all(part.max_seconds for part in parts)


def test_the_tests_are_not_told_that_this_is_ci(monkeypatch):
    """Else pytest prints the whole difference of two images, which takes an hour."""
    monkeypatch.setenv('CI', 'true')
    assert 'CI' not in runner.environment()


def test_what_the_machine_lacks_is_said():
    outcome = runner.run(runner.Part('Python 3.99', lambda: []))
    assert outcome.skipped == 1 and 'no such Python' in outcome.note


def test_the_tutorials_are_in_the_gate_and_run_once():
    commands = [
        ' '.join(command)
        for lanes in runner.stages('test')
        for lane in lanes
        for part in lane
        for command in part.commands()
    ]
    ran = [c for c in commands if 'test/docs/test_tutorials.py' in c.split()]
    assert len(ran) == 1 and 'long' not in ran[0]
    left_out = [c for c in commands if '--ignore=test/docs/test_tutorials.py' in c]
    assert len(left_out) == 1


def test_one_line_and_one_status(capsys):
    good, bad = runner.Outcome('a', 5, 0, 1, 2.0), runner.Outcome('b', 3, 2, 0, 1.0)
    assert runner.summarize([good]) == 0
    assert runner.summarize([good, bad]) == 1
    assert capsys.readouterr().out.splitlines()[-1] == '8 passed, 2 failed, 1 skipped'


def test_the_end_of_the_output_names_what_failed(capsys):
    lines = ['E   assert 1 == 2', 'FAILED test/test_it.py::test_that', '1 failed, 2 passed']
    failed = runner.run(runner.Part('tests', lambda: [says('\n'.join(lines), 1)]))
    without_tests = runner.run(runner.Part('lint', lambda: [says('Found 3 errors', 1)]))
    passed = runner.run(runner.Part('others', lambda: [says('E ver\n3 passed')]))
    capsys.readouterr()
    assert runner.summarize([failed, without_tests, passed]) == 1
    *_, first, second, third, _ = capsys.readouterr().out.splitlines()
    assert [first, second] == [f'tests | {line}' for line in lines[:2]]
    assert third.startswith('lint | ') and third.endswith('Found 3 errors')


def test_another_python_does_not_take_this_ones_libraries_of_ros(monkeypatch):
    monkeypatch.setenv('_ROS_WHEELS_BOOTSTRAP_COMPLETE', '1')
    monkeypatch.setenv('LD_LIBRARY_PATH', f'{ROOT}/.venv/lib:/opt/ros/jazzy/lib')
    environment = runner.environment()
    assert '_ROS_WHEELS_BOOTSTRAP_COMPLETE' not in environment
    assert environment['LD_LIBRARY_PATH'] == '/opt/ros/jazzy/lib'
    monkeypatch.setenv('LD_LIBRARY_PATH', f'{ROOT}/.venv/lib')
    assert 'LD_LIBRARY_PATH' not in runner.environment()


WAITING = """
import sys, time
from pathlib import Path
end = time.monotonic() + 120
while not Path(sys.argv[1]).exists():
    assert time.monotonic() < end
    time.sleep(0.01)
"""


def test_lanes_run_side_by_side_and_are_told_in_order(tmp_path):
    there = tmp_path / 'there'
    first = runner.Part('first', lambda: [[sys.executable, '-c', WAITING, str(there)]])
    second = runner.Part('second', lambda: [[sys.executable, '-c', f'open({str(there)!r}, "w")']])
    outcomes = runner.run_lanes([[first], [second]])
    assert [(o.name, o.passed, o.failed) for o in outcomes] == [('first', 1, 0), ('second', 1, 0)]


INTERRUPTED = """
import importlib.util, sys
spec = importlib.util.spec_from_file_location('run_tests', 'tools/run_tests.py')
runner = importlib.util.module_from_spec(spec)
spec.loader.exec_module(runner)
code = 'import os, time; print(os.getpid(), flush=True); time.sleep(600)'
lane = [runner.Part('asleep', lambda: [[sys.executable, '-c', code]])]
runner.stages = lambda which: [[lane, lane]]
sys.exit(runner.main())
"""


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_ends_all_parts(number):
    with started(
        [sys.executable, '-c', INTERRUPTED], cwd=ROOT, stdout=subprocess.PIPE, text=True
    ) as process:
        sleeping: list[int] = []
        while len(sleeping) < 2:
            line = process.stdout.readline()
            assert line, 'it ended before both parts ran'
            if line.startswith('asleep | '):
                sleeping.append(int(line.split()[-1]))
        process.send_signal(number)
        process.stdout.read()
    assert process.returncode == 130
    for pid in sleeping:
        with pytest.raises(ProcessLookupError):
            os.kill(pid, 0)
