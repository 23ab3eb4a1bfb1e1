"""What the launch files have in common; the only part that needs ROS's ``launch``.

Every launch file takes the same arguments and differs in their defaults.
"""

from __future__ import annotations

import shlex
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from mvuav_ros.detectors import DETECTORS
from mvuav_ros.messages.sensors import topic_beside
from mvuav_ros.parameters.common_parameters import TRANSPORTS

NODES = {detector.word: name for name, detector in DETECTORS.items()}
"""The detectors by what they are called here."""
_ARGUMENTS = {
    'source': ('0', 'Parameter source of video_source; none: a camera driver publishes the images'),
    'loop': ('false', 'Play a recording again and again'),
    'detectors': ('markers,runway', f'One or several of {", ".join(NODES)}, separated by commas'),
    'one_process': (
        'false',
        'The nodes in one process, without copies from source to detectors (docs/transport.md)',
    ),
    'image_topic': ('image_raw', 'Topic of the images'),
    'camera_info_topic': ('', 'Topic of their calibration; empty: camera_info beside them'),
    'imu_topic': ('imu', "Topic of the attitude, such as an autopilot's /mavros/imu/data"),
    'transport': ('raw', 'Image transport of the detectors (parameter image_transport)'),
    'frame_id': ('', "Parameter frame_id of video_source; empty: the source's own"),
    'camera_info_url': ('', 'Parameter camera_info_url of video_source: a calibration file'),
    'namespace': ('', 'Namespace of the nodes'),
    'params_file': ('', "The nodes' parameters; thesis.yaml has the values of the thesis"),
    'use_sim_time': ('false', 'Take the time from /clock'),
    'respawn': ('false', 'Start a node again when it ends by itself'),
    'autostart': ('true', 'Configure and activate the nodes; false: a lifecycle manager does it'),
    'log_level': ('info', 'Log level of the nodes: debug, info, warn, error'),
}
"""Default and description."""
_SWITCHES = {name for name, (default, _) in _ARGUMENTS.items() if default in ('true', 'false')}


def launch_vision(launch_file: str, **defaults: str) -> LaunchDescription:
    """A source of images and the detectors that look at them.

    ``defaults`` are those of arguments that differ from ``vision.launch.py``.
    """
    arguments = _declared(launch_file, defaults)
    return LaunchDescription([*arguments, OpaqueFunction(function=_nodes)])


def launch_bag(launch_file: str) -> LaunchDescription:
    """``ros2 bag play``, which waits for the detectors; for ``launch_file`` see `launch_vision`."""
    words = 'More arguments of ros2 bag play'
    arguments = [
        DeclareLaunchArgument('bag', description='Recording, as ros2 bag play takes it'),
        DeclareLaunchArgument('play', default_value='', description=words),
        *_declared(launch_file, {'source': 'none'}),
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=_bag)])


def _declared(launch_file: str, defaults: Mapping[str, str]) -> list[DeclareLaunchArgument]:
    config = Path(launch_file).resolve().parent.parent / 'config'
    defaults = {'params_file': str(config / 'default.yaml'), **defaults}
    choices = {name: ['true', 'false', 'True', 'False'] for name in _SWITCHES}
    choices['transport'] = ['raw', *TRANSPORTS]
    return [
        DeclareLaunchArgument(
            name,
            default_value=defaults.get(name, default),
            description=words,
            **({'choices': choices[name]} if name in choices else {}),
        )
        for name, (default, words) in _ARGUMENTS.items()
    ]


def _bag(context: LaunchContext) -> list[Any]:
    names = ('bag', 'play', 'namespace', 'image_topic', 'transport', 'detectors')
    given = {name: LaunchConfiguration(name).perform(context) for name in names}
    topic, namespace = given['image_topic'], given['namespace'].strip('/')
    if not topic.startswith('/'):
        topic = '/'.join(['', *filter(None, [namespace]), topic])
    topic += '' if given['transport'] == 'raw' else f'/{given["transport"]}'
    detectors = _nodes(context, {f'qos_overrides.{topic}.subscription.reliability': 'reliable'})
    play = ['ros2', 'bag', 'play', '--start-paused', given['bag'], *shlex.split(given['play'])]
    count = str(len(_detectors(given['detectors'])))
    resume = [sys.executable, '-m', 'mvuav_ros', 'resume_bag', count]
    return [*detectors, *(ExecuteProcess(cmd=cmd, output='screen') for cmd in (play, resume))]


def _detectors(names: str) -> list[str]:
    """Each once, as two nodes of one name would disturb each other."""
    return list(dict.fromkeys(name.strip() for name in names.split(',') if name.strip()))


def _nodes(context: LaunchContext, more: Mapping[str, Any] | None = None) -> list[Node]:
    """The nodes; ``more`` are parameters of the detectors."""
    given = {name: LaunchConfiguration(name).perform(context) for name in _ARGUMENTS}
    switches = {name for name, value in given.items() if value.lower() == 'true'}
    params_file = Path(given['params_file']).expanduser()
    if not params_file.is_file():
        raise RuntimeError(f'params_file: {params_file} does not exist')
    names = _detectors(given['detectors'])
    for name in names:
        if name not in NODES:
            raise RuntimeError(f'detectors: {name!r} is not one of {", ".join(NODES)}')

    def chosen(**arguments: str) -> dict[str, Any]:
        """Parameters by their arguments, but for those at their defaults: as the file has them."""
        return {
            parameter: name in switches if name in _SWITCHES else given[name]
            for parameter, name in arguments.items()
            if given[name] != _ARGUMENTS[name][0]
        }

    shared = chosen(use_sim_time='use_sim_time', autostart='autostart')
    seeing = {**shared, **chosen(image_transport='transport'), **(more or {})}
    playing = {
        **shared,
        **chosen(source='source', loop='loop'),
        **chosen(frame_id='frame_id', camera_info_url='camera_info_url'),
        'wait_for_subscribers': len(names),
    }

    def node(executable: str, settings: dict[str, Any], *arguments: str) -> Node:
        return Node(
            package='mvuav_ros',
            executable=executable,
            # Settings of a named node win over a section /** of the file.
            name=None if executable == 'vision_process' else executable,
            namespace=given['namespace'],
            parameters=[str(params_file), settings],
            remappings=_remappings(given),
            respawn='respawn' in switches,
            respawn_delay=1.0,
            output='screen',
            arguments=list(arguments),
            ros_arguments=['--log-level', given['log_level']],
        )

    # ros2 launch does not take an empty value: '' reaches it as two quotes, or not at all.
    has_source = given['source'].strip('\'"') not in ('', 'none')
    offered = ['raw'] if 'one_process' in switches else ['raw', 'compressed']
    if has_source and given['transport'] not in offered:
        words = ' or '.join(f'transport:={name}' for name in offered)
        raise RuntimeError(f'transport: detectors take the images of a source by {words}')
    if 'one_process' in switches:
        nodes = [NODES[name] for name in names] + ['video_source'] * has_source
        settings = {**(playing if has_source else {}), **seeing}
        return [node('vision_process', settings, '--nodes', ','.join(nodes))]
    source = [node('video_source', playing)] if has_source else []
    return [*source, *(node(NODES[name], seeing) for name in names)]


def _remappings(given: Mapping[str, str]) -> list[tuple[str, str]]:
    """camera_info stays beside the images, as image_transport has it, unless it is said where."""
    images = given['image_topic']
    beside = topic_beside(images, 'camera_info') if '/' in images else 'camera_info'
    topics = {'image_raw': images, 'camera_info': given['camera_info_topic'] or beside}
    topics['imu'] = given['imu_topic']
    return [(name, topic) for name, topic in topics.items() if topic != name]
