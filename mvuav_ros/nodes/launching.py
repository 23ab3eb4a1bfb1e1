"""What the launch files have in common; the only part that needs ROS's ``launch``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue


def launch_flight(launch_file: str, source: str, *detectors: str) -> LaunchDescription:
    """A source of images and the nodes that look at them.

    Args:
        launch_file: its own path; ``config`` lies beside its folder.
        source: the executable that takes the arguments ``source`` and ``loop``.
        detectors: the other executables.
    """
    config = Path(launch_file).resolve().parent.parent / 'config'
    params_file = LaunchConfiguration('params_file')
    settings: dict[str, Any] = {
        'source': ParameterValue(LaunchConfiguration('source'), value_type=str),
        'loop': ParameterValue(LaunchConfiguration('loop'), value_type=bool),
    }
    if len(detectors) > 1:
        settings['wait_for_subscribers'] = len(detectors)
    return LaunchDescription(
        [
            DeclareLaunchArgument('source', default_value='0', description='See video_source.'),
            DeclareLaunchArgument('loop', default_value='false', description='Play it again.'),
            DeclareLaunchArgument(
                'params_file',
                default_value=str(config / 'default.yaml'),
                description='Parameters of the nodes; thesis.yaml has the values of the thesis.',
            ),
            _node(source, [params_file, settings]),
            *(_node(detector, [params_file]) for detector in detectors),
        ]
    )


def _node(executable: str, parameters: list[Any]) -> Node:
    return Node(package='mvuav_ros', executable=executable, parameters=parameters, output='screen')
