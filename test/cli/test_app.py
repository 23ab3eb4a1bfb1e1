"""How `mvuav` reads its options, and how it ends."""

import inspect
import subprocess
import sys

import pytest
from support.commands import mvuav
from support.places import ROOT

from mvuav_ros.cli.app import application

LANDING = """
import os, signal, sys, time
from mvuav_ros.cli import app

def command(**_):
    # What functools makes of an interrupt in the midst of an import, up to Python 3.11.
    try:
        os.kill(os.getpid(), getattr(signal, sys.argv[1]))
        time.sleep(60)
    except BaseException as error:
        raise RuntimeError('Error calling __set_name__') from error

app.application = lambda names: command
app.main()
"""


@pytest.mark.parametrize(('name', 'status'), [('SIGINT', 130), ('SIGTERM', 143)])
def test_an_interrupt_that_became_another_error_is_one_line(name, status):
    run = subprocess.run(
        [sys.executable, '-c', LANDING, name], cwd=ROOT, capture_output=True, text=True
    )
    assert (run.returncode, run.stderr) == (status, 'mvuav: interrupted\n')


def test_a_replay_that_fails_prints_no_success(capsys):
    from mvuav_ros.cli.commands.replay import _report
    from mvuav_ros.offline.replay.job import ReplayOutcome

    _report(ReplayOutcome('a.mcap', 's3://nobody/a.mcap', 5, 5, failure='there is no bucket'))
    said = capsys.readouterr()
    assert said.out == '' and said.err == 'mvuav: there is no bucket\n'


def test_help_does_not_wait_for_what_only_the_work_needs():
    # An older typer brings rich.
    script = (
        'import sys, typer; own = set(sys.modules); '
        'from mvuav_ros.cli.app import application; application(); '
        "print(*sorted({'numpy', 'cv2', 'scipy', 'yaml', 'rich', 'rosbags', 'rclpy'}"
        ' & (set(sys.modules) - own)))'
    )
    run = subprocess.run([sys.executable, '-c', script], cwd=ROOT, capture_output=True, text=True)
    assert (run.returncode, run.stdout) == (0, '\n'), run.stderr + run.stdout


def test_reading_a_recording_does_not_wait_for_the_simulator():
    script = (
        'import sys; from mvuav_ros import open_source; next(open_source(sys.argv[1]).frames());'
        "print(*sorted(name for name in sys.modules if 'simulation' in name))"
    )
    command = [sys.executable, '-c', script, 'bags/tanker.mcap']
    run = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert (run.returncode, run.stdout) == (0, '\n'), run.stderr + run.stdout


def test_no_option_is_annotated_with_text():
    """Of such options typer 0.9, which apt has, knows no short names, nor which are arguments."""
    apps, callbacks = [application()], []
    for app in apps:
        apps += [group.typer_instance for group in app.registered_groups]
        registered = [*app.registered_commands, *filter(None, [app.registered_callback])]
        callbacks += [each.callback for each in registered if each.callback is not None]
    assert len(callbacks) > 15
    for callback in callbacks:
        for parameter in inspect.signature(callback).parameters.values():
            assert not isinstance(parameter.annotation, str), (callback, parameter)


@pytest.mark.parametrize('place', ['~/my out', 'file://{}/my%20out'])
def test_a_home_and_a_file_url_are_places_whatever_command_writes_there(
    tmp_path, monkeypatch, place
):
    """The shell leaves ~ as it is behind ``--output=``."""
    monkeypatch.setenv('HOME', str(tmp_path))
    (tmp_path / 'here').mkdir()
    monkeypatch.chdir(tmp_path / 'here')
    place = place.format(tmp_path)
    for command in (
        ('simulate', 'tanker', '--frames', 2, f'--output={place}/flight.mcap'),
        ('replay', f'{place}/flight.mcap', f'--output={place}/results.mcap'),
        ('export', f'{place}/results.mcap', f'--output={place}/tables'),
        ('sweep', f'{place}/flight.mcap', '--nodes', 'marker_tracker', f'--output={place}/sweep'),
    ):
        assert mvuav(*command).status == 0
    names = {path.name for path in (tmp_path / 'my out').iterdir()}
    assert names == {'flight.mcap', 'results.mcap', 'tables', 'sweep'}
    assert list((tmp_path / 'here').iterdir()) == []


@pytest.mark.parametrize('group', [(), ('rig',), ('evaluate',)])
def test_without_arguments_the_help_is_as_it_is(group):
    command = [sys.executable, '-m', 'mvuav_ros', 'mvuav', *group]
    run = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    # An older click takes it for a question.
    assert run.returncode in (0, 2)
    said = [line.strip() for line in (run.stdout + run.stderr).splitlines() if line.strip()]
    # An older typer draws boxes.
    assert said[0].startswith('Usage: mvuav') and 'Commands' in ''.join(said[1:])
    assert len(said) > 6


def test_a_place_that_cannot_be_written_is_named_with_the_reason(tmp_path):
    (tmp_path / 'file').touch()
    run = mvuav('evaluate', 'sim:tanker', '-o', tmp_path / 'file' / 'report')
    assert (run.status, run.err) == (1, f'mvuav: {tmp_path}/file/report: Not a directory\n')


@pytest.mark.parametrize(
    ('command', 'help_of'),
    [
        # Of a pattern without quotes the shell makes several arguments.
        (('calibrate', 'a.png', 'b.png', '--board', '9x6', '--square', 0.03), 'mvuav calibrate'),
        (('rig', 'check', '--dist', 2), 'mvuav rig check'),
        (('replya',), 'mvuav'),
    ],
)
def test_a_mistake_names_the_help_of_its_command(command, help_of):
    run = mvuav(*command)
    assert run.status == 2 and run.error.endswith(f' (see {help_of} --help)')
