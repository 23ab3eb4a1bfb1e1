"""What the launch files have in common; the only part that needs ROS's ``launch``.

Every launch file takes the same arguments and differs in their defaults.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from mvuav_ros.parameters.marker_tracker import MarkerTrackerParameters

DETECTORS = {'markers': 'marker_tracker', 'runway': 'runway_detector'}
_ARGUMENTS = {
    'source': ('0', 'Parameter source of video_source; none: a camera driver publishes the images'),
    'loop': ('false', 'Play a recording again and again'),
    'detectors': ('markers,runway', 'markers, runway, or both, separated by a comma'),
    'one_process': (
        'false',
        'Source and both detectors in one process, without copies (docs/transport.md)',
    ),
    'image_topic': ('image_raw', 'Topic of the images; camera_info is expected beside it'),
    'transport': ('raw', 'Image transport of the detectors (parameter image_transport)'),
    'namespace': ('', 'Namespace of the nodes'),
    'params_file': ('', "The nodes' parameters; thesis.yaml has the values of the thesis"),
    'use_sim_time': ('false', 'Take the time from /clock'),
    'respawn': ('false', 'Start a node again when it ends by itself'),
    'autostart': ('true', 'Configure and activate the nodes; false: a lifecycle manager does it'),
    'log_level': ('info', 'Log level of the nodes: debug, info, warn, error'),
}
"""Default and description."""
_TRANSPORTS = list(MarkerTrackerParameters.spec('image_transport').choices)


def launch_vision(launch_file: str, **defaults: str) -> LaunchDescription:
    """A source of images and the detectors that look at them.

    ``config`` lies beside the launch file's folder; ``defaults`` are of arguments, where they
    differ from those of ``vision.launch.py``.
    """
    config = Path(launch_file).resolve().parent.parent / 'config'
    defaults = {'params_file': str(config / 'default.yaml'), **defaults}
    arguments = []
    for name, (default, words) in _ARGUMENTS.items():
        choices = _TRANSPORTS if name == 'transport' else None
        if default in ('true', 'false'):
            choices = ['true', 'false', 'True', 'False']
        more = {'choices': choices} if choices else {}
        value = defaults.get(name, default)
        arguments.append(
            DeclareLaunchArgument(name, default_value=value, description=words, **more)
        )
    return LaunchDescription([*arguments, OpaqueFunction(function=_nodes)])


def _nodes(context: LaunchContext) -> list[Node]:
    given = {name: LaunchConfiguration(name).perform(context) for name in _ARGUMENTS}
    switches = {name for name, value in given.items() if value.lower() == 'true'}
    params_file = Path(given['params_file']).expanduser()
    if not params_file.is_file():
        raise RuntimeError(f'params_file: {params_file} does not exist')
    names = [name.strip() for name in given['detectors'].split(',') if name.strip()]
    for name in names:
        if name not in DETECTORS:
            raise RuntimeError(f'detectors: {name!r} is not one of {", ".join(DETECTORS)}')
    shared = {name: name in switches for name in ('use_sim_time', 'autostart')}
    seeing = {**shared, 'image_transport': given['transport']}
    playing = {
        **shared,
        'source': given['source'],
        'loop': 'loop' in switches,
        'wait_for_subscribers': len(DETECTORS if 'one_process' in switches else names),
    }

    def node(executable: str, settings: dict[str, Any]) -> Node:
        return Node(
            package='mvuav_ros',
            executable=executable,
            namespace=given['namespace'],
            parameters=[str(params_file), settings],
            remappings=_remappings(given['image_topic']),
            respawn='respawn' in switches,
            respawn_delay=1.0,
            output='screen',
            ros_arguments=['--log-level', given['log_level']],
        )

    # ros2 launch does not take an empty value: '' reaches it as two quotes, or not at all.
    none = given['source'].strip('\'"') in ('', 'none')
    if 'one_process' in switches:
        if none or set(names) != set(DETECTORS) or given['transport'] != 'raw':
            raise RuntimeError('one_process: takes a source, both detectors and transport:=raw')
        return [node('vision_process', playing)]
    source = [] if none else [node('video_source', playing)]
    return [*source, *(node(DETECTORS[name], seeing) for name in names)]


def _remappings(image_topic: str) -> list[tuple[str, str]]:
    """camera_info stays beside the images, as image_transport has it."""
    if image_topic == 'image_raw':
        return []
    namespace, slash, _ = image_topic.rpartition('/')
    return [('image_raw', image_topic), ('camera_info', f'{namespace}{slash}camera_info')]
