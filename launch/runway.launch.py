"""A source of images and runway_detector: ros2 launch mvuav_ros runway.launch.py source:=0."""

from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

CONFIG = Path(__file__).resolve().parent.parent / 'config'


def generate_launch_description():
    return LaunchDescription(
        [
            DeclareLaunchArgument('source', default_value='0', description='See video_source.'),
            DeclareLaunchArgument('loop', default_value='false', description='Play it again.'),
            DeclareLaunchArgument(
                'params_file',
                default_value=str(CONFIG / 'default.yaml'),
                description='Parameters of the nodes; thesis.yaml has the values of the thesis.',
            ),
            Node(
                package='mvuav_ros',
                executable='video_source',
                parameters=[
                    LaunchConfiguration('params_file'),
                    {
                        'source': ParameterValue(LaunchConfiguration('source'), value_type=str),
                        'loop': ParameterValue(LaunchConfiguration('loop'), value_type=bool),
                    },
                ],
                output='screen',
            ),
            Node(
                package='mvuav_ros',
                executable='runway_detector',
                parameters=[LaunchConfiguration('params_file')],
                output='screen',
            ),
        ]
    )
