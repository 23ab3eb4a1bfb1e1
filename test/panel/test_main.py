"""The start of the panel's process."""

import os
import subprocess
import sys

import pytest
from support.places import ROOT

pytest.importorskip('nicegui', reason='the extra panel is not installed')


@pytest.mark.parametrize(
    ('arguments', 'environment', 'said'),
    [
        (['--ros-args', '-p', 'port:=high'], {}, "argument --port: invalid int value: 'high'"),
        (['--ros-args', '-r', 'nonsense'], {}, "Couldn't parse remap rule"),
        (['--ros-args', '-r', 'nonsense', '--'], {}, "Couldn't parse remap rule"),
        ([], {'ROS_DOMAIN_ID': 'ten'}, 'ROS_DOMAIN_ID is not an integral number'),
    ],
)
def test_a_mistake_in_the_arguments_of_ros_is_said_without_a_traceback(
    arguments, environment, said
):
    command = [sys.executable, '-m', 'mvuav_ros', 'tuning_panel', '--port', '0', *arguments]
    ended = subprocess.run(
        command, cwd=ROOT, env={**os.environ, **environment}, capture_output=True, text=True
    )
    assert ended.returncode == 2
    assert said in ended.stderr and 'Traceback' not in ended.stderr


def test_parameters_of_ros_count_and_those_that_do_not_are_said(tmp_path):
    command = [sys.executable, '-m', 'mvuav_ros', 'tuning_panel', '--port', '1', '--ros-args']
    command += ['-p', 'port:=0', '-p', f'folder:={tmp_path}', '-p', 'prot:=5']
    environment = {**os.environ, 'PYTHONUNBUFFERED': '1'}
    with subprocess.Popen(
        command, cwd=ROOT, env=environment, stdout=-1, stderr=subprocess.STDOUT, text=True
    ) as process:
        warning = process.stdout.readline()
        address = process.stdout.readline()
        process.terminate()
    assert warning.strip().endswith('parameters without effect: prot (did you mean port?)')
    assert address.startswith('tuning_panel: http://127.0.0.1:') and ':1/' not in address
