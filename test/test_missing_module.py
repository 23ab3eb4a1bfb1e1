"""A robot without matplotlib or typer: one line that names it."""

import subprocess
import sys

import pytest
from support.places import ROOT

from mvuav_ros.missing_module import explain_missing_module

ROS = (
    'builtin_interfaces,diagnostic_msgs,geometry_msgs,lifecycle_msgs,rcl_interfaces,rclpy,'
    'sensor_msgs,std_msgs,std_srvs,visualization_msgs'
)
RUN = """
import sys
sys.modules.update(dict.fromkeys(sys.argv[1].split(',')))
sys.argv[1:2] = []
from mvuav_ros.__main__ import main
main()
"""


def run(missing, *arguments):
    command = [sys.executable, '-c', RUN, missing, *arguments]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=60)


@pytest.mark.parametrize(
    ('missing', 'arguments', 'words'),
    [
        ('typer', ('mvuav', 'info', 'bags'), 'needs typer: apt install python3-typer'),
        ('rich', ('mvuav', 'info', 'bags'), 'needs rich: apt install python3-rich'),
        ('rclpy', ('marker_tracker',), 'marker_tracker needs ROS 2 (rclpy): source it'),
        ('yaml', ('video_source',), 'needs yaml: apt install python3-yaml'),
        ('matplotlib', ('mvuav', 'demo'), 'demo needs matplotlib: apt install python3-matplotlib'),
        ('matplotlib', ('mvuav', 'evaluate', 'bags/tanker.mcap'), 'evaluate needs matplotlib'),
        ('fsspec', ('mvuav', 'info', 's3://a/b.mcap'), "pip install '.[remote]' in a checkout"),
        (
            'sensor_msgs',
            ('mvuav', 'replay', 'bags/tanker.mcap', '-o', 'x.mcap'),
            "needs ROS 2 (sensor_msgs): source it, or pip install '.[ros]' in a checkout",
        ),
        ('nicegui', ('tuning_panel',), "pip install '.[panel]' in a checkout of mvuav_ros"),
    ],
)
def test_an_error_names_what_is_missing(missing, arguments, words):
    outcome = run(missing, *arguments)
    assert outcome.returncode == 1
    assert words in outcome.stderr
    assert len(outcome.stderr.splitlines()) == 1, outcome.stderr


def test_a_rig_is_checked_without_ros():
    """As docs/quick-start.md says of `pip install .`."""
    outcome = run(ROS, 'mvuav', 'rig', 'check', 'config/tanker_747.yaml')
    assert outcome.returncode == 0, outcome.stderr
    assert outcome.stdout.startswith('tanker_747: 5 markers')


def test_what_no_package_has_is_left_as_it_is():
    error = ImportError('cannot import name spam', name='mvuav_ros.vision')
    assert explain_missing_module('replay', error) == 'replay cannot start: cannot import name spam'
    unknown = ModuleNotFoundError('No module named zzz', name='zzz.y')
    assert explain_missing_module('replay', unknown) == 'replay needs zzz: pip install zzz'
    cv2 = explain_missing_module('replay', ModuleNotFoundError('No module', name='cv2'))
    assert cv2.endswith('apt install python3-opencv, or pip install opencv-python-headless')
