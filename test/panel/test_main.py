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
