"""What the launch files start. ROS's launch is not on PyPI: small stand-ins record the calls."""

import runpy
import sys
import types

import pytest
from support.places import ROOT

from mvuav_ros.parameters.marker_tracker import MarkerTrackerParameters
from mvuav_ros.parameters.runway_detector import RunwayDetectorParameters
from mvuav_ros.parameters.video_source import VideoSourceParameters

SETS = {
    'marker_tracker': MarkerTrackerParameters,
    'runway_detector': RunwayDetectorParameters,
    'video_source': VideoSourceParameters,
}
OURS = 'mvuav_ros.nodes.launching'


class Recorded:
    def __init__(self, *arguments, **keywords):
        self.arguments = arguments
        self.__dict__.update(keywords)


class Configuration(Recorded):
    def perform(self, context):
        return context[self.arguments[0]]


@pytest.fixture
def launch(monkeypatch):
    """Run a launch file with arguments; returns the nodes by executable."""
    names = {
        'launch': ('LaunchContext', 'LaunchDescription'),
        'launch.actions': ('DeclareLaunchArgument', 'ExecuteProcess', 'OpaqueFunction', 'LogInfo'),
        'launch.conditions': ('IfCondition',),
        'launch.substitutions': (),
        'launch_ros': (),
        'launch_ros.actions': ('Node',),
    }
    for name, classes in names.items():
        module = types.ModuleType(name)
        module.__dict__.update({each: type(each, (Recorded,), {}) for each in classes})
        monkeypatch.setitem(sys.modules, name, module)
    sys.modules['launch.substitutions'].LaunchConfiguration = Configuration
    monkeypatch.delitem(sys.modules, OURS, raising=False)

    def run(file, **given):
        made = runpy.run_path(str(ROOT / 'launch' / file))['generate_launch_description']()
        (actions,) = made.arguments
        values = {}
        nodes = []
        for action in actions:
            kind = type(action).__name__
            if kind == 'DeclareLaunchArgument':
                (name,) = action.arguments
                values[name] = given.pop(name, getattr(action, 'default_value', None))
                assert action.description
                assert values[name] in getattr(action, 'choices', [values[name]])
            elif kind == 'OpaqueFunction':
                nodes += action.function(values)
            elif kind == 'Node':
                nodes.append(action)
        assert given == {}
        return nodes

    yield run
    sys.modules.pop(OURS, None)


def settings(node):
    return node.parameters[-1]


@pytest.mark.parametrize(
    ('file', 'executables'),
    [
        ('vision.launch.py', ['video_source', 'marker_tracker', 'runway_detector']),
        ('both.launch.py', ['video_source', 'marker_tracker', 'runway_detector']),
        ('markers.launch.py', ['video_source', 'marker_tracker']),
        ('runway.launch.py', ['video_source', 'runway_detector']),
        ('one_process.launch.py', ['vision_process']),
    ],
)
def test_short_cuts(launch, file, executables):
    nodes = launch(file)
    assert [node.executable for node in nodes] == executables
    wanted = 2 if 'process' in file else len(executables) - 1
    assert settings(nodes[0])['wait_for_subscribers'] == wanted
    assert 'frame_id' not in settings(nodes[0])
    for node in nodes:
        assert node.parameters[0] == str(ROOT / 'config' / 'default.yaml')
        assert not node.respawn and node.remappings == []
        given = {name: v for name, v in settings(node).items() if name != 'use_sim_time'}
        if 'process' in file:
            assert node.arguments == ['--nodes', 'marker_tracker,runway_detector,video_source']
            assert 'image_transport' not in given
        SETS[node.executable.replace('vision_process', 'video_source')].from_mapping(given)


@pytest.mark.parametrize('source', ['none', '', "''"])
def test_detectors_alone_for_another_image_topic(launch, source):
    nodes = launch(
        'vision.launch.py',
        source=source,
        detectors='runway',
        image_topic='/nose/camera/image',
        namespace='nose',
        use_sim_time='true',
        transport='compressed',
        respawn='True',
        autostart='false',
    )
    (node,) = nodes
    assert node.executable == 'runway_detector'
    assert (node.namespace, node.respawn) == ('nose', True)
    assert node.remappings == [
        ('image_raw', '/nose/camera/image'),
        ('camera_info', '/nose/camera/camera_info'),
    ]
    assert settings(node) == {
        'use_sim_time': True,
        'autostart': False,
        'image_transport': 'compressed',
    }


def test_calibration_and_attitude_from_topics_of_their_own(launch):
    topics = {'camera_info_topic': '/nose/info', 'imu_topic': '/mavros/imu/data'}
    own = [('camera_info', '/nose/info'), ('imu', '/mavros/imu/data')]
    for node in launch('both.launch.py', source='none', **topics):
        assert node.remappings == own
    (node,) = launch('runway.launch.py', source='none', image_topic='/image', **topics)
    assert node.remappings == [('image_raw', '/image'), *own]
    (node,) = launch('runway.launch.py', source='none', image_topic='/image')
    assert node.remappings == [('image_raw', '/image'), ('camera_info', '/camera_info')]


def test_arguments_that_are_not_given_leave_the_parameter_file_its_values(launch):
    """A file with another source, or compressed images, was overruled without a word."""
    source, tracker = launch('markers.launch.py')
    assert settings(source) == {'wait_for_subscribers': 1}
    assert settings(tracker) == {}
    source, tracker = launch('markers.launch.py', loop='true', transport='compressed')
    assert settings(source) == {'loop': True, 'wait_for_subscribers': 1}
    assert settings(tracker) == {'image_transport': 'compressed'}
    # Of a node without a name ROS has them under /**, which the file's own keys may overrule.
    assert (source.name, tracker.name) == ('video_source', 'marker_tracker')


@pytest.mark.parametrize('transport', ['raw', 'compressed', 'ffmpeg', 'foxglove'])
def test_every_transport_of_the_nodes_can_be_chosen(launch, transport):
    for node in launch('vision.launch.py', source='none', transport=transport):
        given = {'image_transport': settings(node).get('image_transport', 'raw')}
        assert SETS[node.executable].from_mapping(given).image_transport == transport


@pytest.mark.parametrize(
    ('given', 'words'),
    [
        ({'params_file': '/nowhere.yaml'}, '/nowhere.yaml does not exist'),
        ({'detectors': 'markers,lights'}, "'lights' is not one of markers, runway"),
        ({'one_process': 'true', 'transport': 'compressed'}, 'transport:=raw'),
        ({'transport': 'ffmpeg'}, 'transport:=raw or transport:=compressed'),
    ],
)
def test_mistakes_are_named(launch, given, words):
    with pytest.raises(RuntimeError, match=words):
        launch('vision.launch.py', **given)


@pytest.mark.parametrize('detectors', ['markers', 'runway', 'markers,runway'])
@pytest.mark.parametrize('source', ['none', '0'])
def test_one_process_of_any_nodes(launch, source, detectors):
    (node,) = launch('both.launch.py', one_process='true', source=source, detectors=detectors)
    names = {'markers': 'marker_tracker', 'runway': 'runway_detector'}
    wanted = [names[name] for name in detectors.split(',')] + ['video_source'] * (source == '0')
    assert node.executable == 'vision_process'
    assert node.arguments == ['--nodes', ','.join(wanted)]
    waited_for = len(wanted) - 1 if source == '0' else None
    assert settings(node).get('wait_for_subscribers') == waited_for


def test_a_cameras_frame_and_calibration(launch):
    given = {'frame_id': 'nose', 'camera_info_url': 'nose.yaml'}
    source, _ = launch('markers.launch.py', **given)
    assert given.items() <= settings(source).items()


def test_two_cameras_have_namespaces_and_frames_of_their_own(launch):
    nodes = launch('two_cameras.launch.py', left='0')
    mounts = [node for node in nodes if node.executable == 'static_transform_publisher']
    frames = [f'{side}_camera_optical_frame' for side in ('left', 'right')]
    assert [node.arguments[-3:] for node in mounts] == [
        ['base_link', '--child-frame-id', frame] for frame in frames
    ]
    ours = {
        (node.namespace, node.executable): settings(node) for node in nodes if node not in mounts
    }
    assert list(ours) == [
        ('left', 'marker_tracker'), ('left', 'video_source'), ('right', 'marker_tracker')
    ]  # fmt: skip
    for (side, executable), given in ours.items():
        SETS[executable].from_mapping(given)
        if executable == 'marker_tracker':
            assert given['camera_frame'] == f'{side}_camera_optical_frame'
            assert given['body_frame'] == f'tanker_747_{side}'


@pytest.mark.parametrize('detectors', ['markers', 'markers,', ' markers,markers', ',markers, '])
def test_a_bag_waits_for_the_detectors(launch, detectors):
    *detectors, player, resumer = launch(
        'bag.launch.py', bag='flight.mcap', play='--rate 2', namespace='nose', detectors=detectors
    )
    (node,) = detectors
    name = 'qos_overrides./nose/image_raw.subscription.reliability'
    assert settings(node)[name] == 'reliable'
    assert player.cmd == [
        'ros2', 'bag', 'play', '--start-paused', 'flight.mcap', '--rate', '2'
    ]  # fmt: skip
    assert resumer.cmd[1:] == ['-m', 'mvuav_ros', 'resume_bag', '1']


def test_the_demo_plays_the_sample_bags(launch, monkeypatch):
    monkeypatch.setattr('shutil.which', lambda name: f'/usr/bin/{name}')
    nodes = launch('demo.launch.py')
    assert [(node.executable, getattr(node, 'namespace', None)) for node in nodes] == [
        ('video_source', 'tanker'),
        ('marker_tracker', 'tanker'),
        ('video_source', 'runway'),
        ('runway_detector', 'runway'),
        ('static_transform_publisher', None),
        ('rviz2', None),
    ]
    assert [settings(node)['frame_id'] for node in nodes[:4:2]] == [
        'tanker_camera_optical_frame', 'runway_camera_optical_frame'
    ]  # fmt: skip
    for node in nodes[:-2]:
        SETS[node.executable].from_mapping(settings(node))
    assert nodes[-1].arguments == ['-d', str(ROOT / 'config' / 'mvuav.rviz')]
