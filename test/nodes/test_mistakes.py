"""The mistakes of docs/ros.md, each made, and what the nodes say to it."""

import subprocess
import sys

import numpy as np
import pytest
from lifecycle_msgs.srv import ChangeState
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from support.graph import CLEAN, image_message
from support.headers import header_bytes
from support.marker_scenes import draw, tanker_at
from support.places import ROOT

from mvuav_ros.messages.sensors import encode_camera_info
from mvuav_ros.vision.camera import CameraModel

TABLE = (ROOT / 'docs' / 'ros.md').read_text().partition('## What the nodes say')[2]
MARKERS, RUNWAY = 'marker_tracker', 'runway_detector'
OTHER_SIZE = CameraModel(320, 240, (500.0, 0, 160, 0, 500, 120, 0, 0, 1))


def documented(words: str) -> str:
    """The words, which the table of the page must have."""
    assert words in TABLE, words
    return words


class Mistakes:
    """Both detectors in one process, which expect reliable images; nothing is published yet."""

    def __init__(self, graph):
        self.graph = graph
        given = {
            'treshold': 0.5,
            'runway_width': 45.0,
            'qos_overrides./image_raw.subscription.reliability': 'reliable',
        }
        nodes = ('--nodes', f'{MARKERS},{RUNWAY}')
        remap = 'imu:=/fcu/imu', f'/{MARKERS}/rpy:=/roll', '/nose/image:=image_raw'
        self.process = graph.spawn('vision_process', arguments=nodes, remap=remap, **given)
        graph.until(lambda: graph.probe.count_subscribers('/image_raw') == 2, 'the detectors')
        self.index = 0

    def says(self, words, node=MARKERS):
        documented(words)
        said = []

        def heard():
            said.append(self.graph.diagnostics(node)['message'])
            return words in said[-1]

        self.graph.until(heard, lambda: f'{words!r}; {node} says {said[-1]!r}', timeout=60.0)

    def while_published(self, kind, topic, words, qos=10):
        publisher = self.graph.probe.create_publisher(kind, topic, qos)
        self.says(words)
        self.graph.probe.destroy_publisher(publisher)

    def sends(self, publisher, message, words, node=MARKERS, inform=None):
        """Publish such images until the words come; before each, inform the nodes of its header."""
        documented(words)
        self.graph.diagnostics(node)
        messages = self.graph.received['/diagnostics']

        def heard():
            self.index += 1
            message.header = image_message(np.zeros((1, 1), np.uint8), self.index).header
            if inform is not None:
                inform(message.header)
            publisher.publish(message)
            self.graph.spin(0.03)
            said = [s.message for m in messages for s in m.status if s.name == f'/{node}']
            return any(words in each for each in said)

        self.graph.until(heard, words, timeout=60.0)


@pytest.fixture
def mistakes(graph):
    return Mistakes(graph)


def test_a_running_node_names_each(mistakes):
    graph, probe = mistakes.graph, mistakes.graph.probe
    mistakes.says('nothing publishes /image_raw')
    mistakes.says('treshold (did you mean threshold?)')
    mistakes.says('remappings without effect: /nose/image:=image_raw')
    mistakes.says('runway_width has no effect: it counts with mode approach', RUNWAY)
    mistakes.while_published(Image, '/nose/image', 'there is /nose/image: remap image_raw')
    words = 'there is /image_raw/compressed: set image_transport to compressed'
    mistakes.while_published(CompressedImage, '/image_raw/compressed', words)
    words = 'publishes /image_raw as CompressedImage, not Image; set image_transport'
    mistakes.while_published(CompressedImage, '/image_raw', words)
    words = 'publishes /image_raw as CameraInfo, not Image; remap image_raw'
    mistakes.while_published(CameraInfo, '/image_raw', words)
    words = 'with an incompatible QoS (best effort publisher and reliable subscription)'
    mistakes.while_published(Image, '/image_raw', words, qos_profile_sensor_data)
    publisher = probe.create_publisher(Image, '/image_raw', QoSProfile(depth=100))
    mistakes.says('no image arrives: is it paused, or its camera silent?')

    dark = image_message(np.zeros((480, 640), np.uint8), 0)
    mistakes.sends(publisher, dark, 'nothing publishes /camera_info')
    # That of another camera is not named.
    topics = {'/tail/image': Image, '/tail/camera_info': CameraInfo, '/nose/info': CameraInfo}
    others = [probe.create_publisher(kind, topic, 10) for topic, kind in topics.items()]
    words = 'nothing publishes /camera_info; there is /nose/info: remap camera_info'
    mistakes.sends(publisher, dark, words)
    for each in others:
        probe.destroy_publisher(each)
    mistakes.sends(publisher, dark, '0 of 5 markers')
    bright = image_message(np.full((480, 640), 255, np.uint8), 0)
    mistakes.sends(publisher, bright, '% of the frame is above the threshold')
    depth = Image(width=4, height=1, step=16, encoding='32FC1', data=bytes(16))
    mistakes.sends(publisher, depth, 'holds measured values without a full scale')
    tanker = image_message(draw(tanker_at()), 0)
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    infos = probe.create_publisher(CameraInfo, '/camera_info', latched)
    words = 'as it is latched, set qos_overrides./camera_info'
    mistakes.sends(publisher, tanker, words)
    probe.destroy_publisher(infos)
    infos = probe.create_publisher(CameraInfo, '/camera_info', QoSProfile(depth=100))
    graph.until(lambda: infos.get_subscription_count() == 2, 'subscribers of camera_info')
    for camera, words in (
        (OTHER_SIZE, 'camera_info is for 320 x 240 px, the images are 640 x 480 px'),
        (CameraModel(640, 480, (0.0,) * 9), 'camera_info is all zeros'),
    ):

        def inform(header, camera=camera):
            # With each image: a single one is lost where a node does not know the publisher yet.
            infos.publish(encode_camera_info(camera, header_bytes(header)))

        mistakes.sends(publisher, tanker, words, inform=inform)

    zero = image_message(draw(tanker_at()), 0)
    zero.header.stamp.sec = zero.header.stamp.nanosec = 0
    for _ in range(3):
        publisher.publish(zero)
        graph.spin(0.05)
    mistakes.says('images have no stamp, as their publisher sets none or waits for /clock')
    second = graph.add_node('second').create_publisher(Image, '/image_raw', 10)
    graph.until(lambda: second.get_subscription_count() == 2, 'the detectors')
    words = 'publishers on /image_raw: their images are mixed'
    mistakes.sends(publisher, tanker, words, inform=lambda _: second.publish(tanker))


def refused(words, *arguments, name=MARKERS):
    command = [sys.executable, '-m', 'mvuav_ros', name, *arguments]
    run = subprocess.run(command, cwd=ROOT, env=CLEAN, capture_output=True, text=True, timeout=120)
    assert run.returncode == 2, run
    assert 'Traceback' not in run.stderr
    assert documented(words) in run.stderr
    return run.stderr


def test_what_no_node_can_start_with(tmp_path):
    refused('not used; arguments of ROS follow --ros-args', '--params-file', 'x.yaml')
    refused('not arguments of ROS', '--ros-args', 'threshold:=0.5')
    refused('nowhere.yaml: No such file', '--ros-args', '--params-file', 'nowhere.yaml')
    rig = ['-p', f'layout:={tmp_path}/nowhere.yaml']
    refused('nowhere.yaml', '--ros-args', *rig)
    words = 'camera_mount_rpy_deg: takes 3 numbers, not [0.0]'
    refused(words, '--ros-args', '-p', 'camera_mount_rpy_deg:=[0.0]')
    words = 'a list of several types; write [0.0, 20.0, 0.0], not [0.0, 20, 0.0]'
    refused(words, '--ros-args', '-p', 'camera_mount_rpy_deg:=[0.0, 20, 0.0]')
    file = tmp_path / 'mixed.yaml'
    file.write_text(f'{MARKERS}:\n  ros__parameters:\n    camera_mount_rpy_deg: [0, 20.0, 0]\n')
    error = refused(words, '--ros-args', '--params-file', str(file))
    assert error.endswith(f'\n{file}: {words}, in line 3\n')
    words = 'must not begin with a slash'
    refused(words, '--ros-args', '-p', 'frame_id:=/nose', name='video_source')


def test_parameters_for_a_node_elsewhere(graph, tmp_path):
    file = tmp_path / 'mine.yaml'
    file.write_text(f'{MARKERS}:\n  ros__parameters:\n    threshold: 0.5\n')
    files = ('--ros-args', '--params-file', str(file), '--')
    process = graph.spawn(MARKERS, remap=('__ns:=/left',), arguments=files, source=7)
    node = f'left/{MARKERS}'
    graph.until(lambda: graph.probe.count_subscribers('/left/image_raw') == 1, node)
    said = graph.diagnostics(node)['message']
    process.terminate()
    log, _ = process.communicate(timeout=60)
    assert f'(nothing in it for /{node})' in log
    for words in (f'write /**/{MARKERS} for /{node}', 'source (it is one of video_source)'):
        assert documented(words) in said and words in log


def test_read_only_until_it_is_cleaned_up(graph, tmp_path):
    """A rig's file that is misspelt needs no restart; nor does another image_transport."""
    graph.start(MARKERS, autostart=False)

    def change(label):
        request = ChangeState.Request()
        request.transition.label = label
        return graph.call(ChangeState, f'/{MARKERS}/change_state', request).success

    assert graph.set_parameter(MARKERS, 'layout', '/nowhere.yaml').successful
    # It would have no effect any more.
    said = graph.set_parameter(MARKERS, 'autostart', True)
    assert (said.successful, said.reason) == (False, 'autostart: can be set at the start')
    assert not change('configure')
    rig = str(ROOT / 'config' / 'tanker_747.yaml')
    assert graph.set_parameter(MARKERS, 'layout', rig).successful
    assert change('configure')
    said = graph.set_parameter(MARKERS, 'layout', '')
    assert not said.successful
    assert documented('while the node is unconfigured') in said.reason
    (descriptor,) = graph.describe_parameters(MARKERS, ['layout'])
    assert descriptor.read_only
    assert change('activate') and change('deactivate') and change('cleanup')
    assert graph.set_parameter(MARKERS, 'image_transport', 'compressed').successful
    assert graph.set_parameter(MARKERS, 'publish_tf', False).successful
    assert graph.get_parameter(MARKERS, 'publish_tf') == 'off'
    assert change('configure') and change('activate')
    # Another way to write what is set already, as ros2 param load sends it.
    assert graph.set_parameter(MARKERS, 'publish_tf', False).successful
    topic = '/image_raw/compressed'
    graph.until(lambda: graph.probe.count_subscribers(topic) == 1, f'a subscriber of {topic}')
    assert not graph.set_parameter(MARKERS, 'autostart', True).successful
    # rclpy reads it once for each topic, whatever the node's state.
    override = f'qos_overrides.{topic}.subscription.reliability'
    assert change('deactivate') and change('cleanup')
    said = graph.set_parameter(MARKERS, override, 'reliable')
    assert said.reason == f'{override}: can be set at the start'


def test_a_camera_is_set_by_its_number_as_at_the_start(graph):
    graph.start('video_source', autostart=False, source=77)
    assert graph.set_parameter('video_source', 'source', 1).successful
    assert graph.get_parameter('video_source', 'source') == '1'


def test_camera_info_is_taken_from_where_it_is_remapped_to(graph):
    rules = ('image_raw:=/nose/image', 'camera_info:=/calibration/camera_info')
    graph.start(MARKERS, remap=rules)
    for topic in ('/nose/image', '/calibration/camera_info'):
        graph.until(
            lambda t=topic: graph.probe.count_subscribers(t) == 1, f'a subscriber of {topic}'
        )
    assert graph.probe.count_subscribers('/nose/camera_info') == 0


def test_source_and_detector_with_one_remapping_agree_about_camera_info(graph):
    """The source kept /camera_info, which the detector did not look at: no pose."""
    rules = ('image_raw:=/nose/image',)
    source = ROOT / 'bags' / 'tanker.mcap'
    graph.start('video_source', remap=rules, source=source, wait_for_subscribers=9)
    graph.start(MARKERS, remap=rules)
    topic = '/nose/camera_info'
    graph.until(
        lambda: graph.probe.count_publishers(topic) == graph.probe.count_subscribers(topic) == 1,
        f'a publisher and a subscriber of {topic}',
    )
