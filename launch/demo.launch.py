"""The sample bags, looping, and RViz if it is there: ros2 launch mvuav_ros demo.launch.py."""

import shutil
from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, LogInfo
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

SHARE = Path(__file__).resolve().parent.parent


def generate_launch_description():
    return LaunchDescription(
        [
            DeclareLaunchArgument('rviz', default_value='true', description='Start rviz2'),
            *_flight('tanker', 'marker_tracker', {}),
            *_flight('runway', 'runway_detector', {'mode': 'approach', 'runway_width': 30.0}),
            *_rviz(SHARE / 'config' / 'mvuav.rviz'),
        ]
    )


def _flight(name, detector, settings):
    """A bag in a namespace of its own, and the detector that looks at it."""
    source = {
        'source': str(SHARE / 'bags' / f'{name}.mcap'),
        'loop': True,
        'frame_id': f'{name}_camera_optical_frame',
    }
    for executable, parameters in (('video_source', source), (detector, settings)):
        yield Node(
            package='mvuav_ros',
            executable=executable,
            namespace=name,
            parameters=[parameters],
            output='screen',
        )


def _rviz(config):
    if shutil.which('rviz2') is None:
        return [LogInfo(msg='rviz2 is not installed: see the topics in another viewer')]
    # One world for both scenes, side by side.
    apart = ['--x', '300', '--frame-id', 'runway_camera_optical_frame']
    apart += ['--child-frame-id', 'tanker_camera_optical_frame']
    return [
        Node(package='tf2_ros', executable='static_transform_publisher', arguments=apart),
        Node(
            package='rviz2',
            executable='rviz2',
            arguments=['-d', str(config)],
            condition=IfCondition(LaunchConfiguration('rviz')),
        ),
    ]
