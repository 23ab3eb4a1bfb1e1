"""Large images arrive, and a node whose images are lost says so."""

import os
import signal
import xml.etree.ElementTree as ET
from types import SimpleNamespace
from unittest.mock import MagicMock

import cv2
import numpy as np
import pytest
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy, qos_profile_sensor_data
from sensor_msgs.msg import Image, Imu, PointCloud2
from support.live_stream import RESULTS

from mvuav_ros.nodes import running as transport
from mvuav_ros.nodes.publishing import ResultPublishers

# Fast DDS as it comes: a segment of 512 kB.
DEFAULTS = {'FASTDDS_BUILTIN_TRANSPORTS': 'DEFAULT'}
VARIABLES = ('FASTRTPS_DEFAULT_PROFILES_FILE', 'FASTDDS_BUILTIN_TRANSPORTS')


@pytest.fixture
def folder(tmp_path):
    """Six colour frames of 1920x1080."""
    for index in range(6):
        image = np.full((1080, 1920, 3), 20 * index, np.uint8)
        cv2.imwrite(str(tmp_path / f'frame{index}.bmp'), image)
    return tmp_path


def start_source(graph, folder, rate, reliability='best_effort', **environment):
    return graph.start(
        'video_source',
        source=folder,
        rate=rate,
        loop=True,
        stamp='now',
        environment=environment,
        **{'qos_overrides./image_raw.publisher.reliability': reliability},
    )


@pytest.mark.parametrize('discovery', ['SUBNET', 'LOCALHOST'])
def test_large_images_arrive_by_default(graph, folder, discovery):
    """6 MB a frame, best effort, between processes; by default one in five or fewer would."""
    graph.start('marker_tracker', environment={'ROS_AUTOMATIC_DISCOVERY_RANGE': discovery})
    start_source(graph, folder, 5.0, ROS_AUTOMATIC_DISCOVERY_RANGE=discovery)

    def received() -> int:
        return int(graph.diagnostics('marker_tracker')['frames_received'])

    graph.until(lambda: received() >= 20, '20 images')
    values = graph.diagnostics('marker_tracker')
    # A node that waits long for the processor loses some as well.
    assert int(values['frames_lost_in_transport']) < int(values['frames_received']), values
    assert values['image'] == '1920x1080 bgr8'


def test_lost_images_are_reported_with_the_remedy(graph, folder):
    graph.start('marker_tracker')
    start_source(graph, folder, 30.0, **DEFAULTS)

    def values():
        return graph.diagnostics('marker_tracker')

    graph.until(lambda: int(values()['frames_lost_in_transport']) > 20, 'images to be lost')
    words = values()
    assert words['level'] in (1, 3)
    assert 'lost' in words['message'] and 'docs/transport.md' in words['message']
    assert 'shared-memory segment' in words['message']


@pytest.mark.parametrize('chosen', [None, 'best_effort'])
def test_lost_images_of_a_reliable_publisher_are_asked_for_again(graph, folder, chosen):
    """Unless the user has said how they are to come."""
    name = 'qos_overrides./image_raw.subscription.reliability'
    graph.start('marker_tracker', **({name: chosen} if chosen else {}))
    source = start_source(graph, folder, 20.0, reliability='reliable', **DEFAULTS)

    def lost() -> int:
        return int(graph.diagnostics('marker_tracker')['frames_lost_in_transport'])

    def is_reliable() -> bool:
        # While the node subscribes again there is none, or there are two.
        found = graph.probe.get_subscriptions_info_by_topic('/image_raw')
        return [info.qos_profile.reliability for info in found] == [ReliabilityPolicy.RELIABLE]

    if chosen:
        graph.until(lambda: lost() > 3, 'images to be lost')
        graph.diagnostics('marker_tracker')
        assert not is_reliable()
    else:
        graph.until(is_reliable, 'the node to ask for reliable delivery')
        graph.until(images_come(graph), 'images')
        # A camera that sends nothing again is heard as well.
        source.send_signal(signal.SIGINT)
        source.wait(timeout=60)
        start_source(graph, folder, 20.0)
        graph.until(images_come(graph), 'images of a camera that is best effort')


def images_come(graph):
    """Whether ten more have come than by now."""
    more = int(graph.diagnostics('marker_tracker')['frames_received']) + 10
    return lambda: int(graph.diagnostics('marker_tracker')['frames_received']) > more


def test_a_publisher_whose_qos_does_not_fit_is_named(graph):
    asked = {'reliability': 'reliable', 'durability': 'transient_local'}
    overrides = {f'qos_overrides./image_raw.subscription.{k}': v for k, v in asked.items()}
    graph.start('marker_tracker', **overrides)
    graph.probe.create_publisher(Image, '/image_raw', qos_profile_sensor_data)
    graph.spin(1.0)
    values = graph.diagnostics('marker_tracker')
    assert values['message'].startswith(
        'no images: /probe publishes /image_raw with an incompatible QoS'
    )
    assert 'RELIABILITY' in values['message'].upper()
    for name, offered in zip(overrides, ('best_effort', 'volatile'), strict=True):
        assert f'{name} to {offered}' in values['message']
    assert values['incompatible_publishers'] == '1'


def test_one_process_gives_the_same_topics_and_answers(graph, folder):
    answers = {}
    for node, topic in RESULTS.items():
        kept = answers[node] = []
        graph.probe.create_subscription(PointCloud2, f'/{node}/{topic}', kept.append, 100)
    process = graph.spawn('vision_process', source=folder, rate=30.0, loop=True, stamp='now')
    graph.until(lambda: all(len(kept) > 40 for kept in answers.values()), 'answers')
    names = set(graph.probe.get_node_names())
    assert {'video_source', 'marker_tracker', 'runway_detector'} <= names
    for node in RESULTS:
        values = graph.diagnostics(node)
        assert values['image_publishers'] == 'this process'
        assert values['frames_rejected'] == '0'
    assert graph.diagnostics('video_source')['state'] == 'playing'
    assert graph.set_parameter('runway_detector', 'num_peaks', 5).successful
    answers['runway_detector'].clear()
    graph.until(lambda: len(answers['runway_detector']) > 3, 'answers')
    assert answers['runway_detector'][-1].width == 5
    # The images themselves are published only for others.
    images = graph.listen('/image_raw', Image)
    graph.until(lambda: len(images) > 3, 'images')
    assert process.poll() is None


def test_attitude_reaches_the_nodes_of_one_process(graph, folder):
    given = {'runway_detector:mode': 'approach', 'runway_detector:horizon_source': 'imu'}
    graph.spawn('vision_process', source=folder, rate=30.0, loop=True, stamp='now', **given)
    sensor = graph.add_node('sensor')
    imu = sensor.create_publisher(Imu, '/imu', 10)

    def measure() -> None:
        message = Imu()
        message.orientation.w = 1.0
        message.header.stamp = sensor.get_clock().now().to_msg()
        imu.publish(message)

    sensor.create_timer(0.01, measure)

    def says(words: str) -> bool:
        return words in graph.diagnostics('runway_detector')['message']

    # It is no longer missed; what is missing now is the calibration.
    graph.until(lambda: says('attitude is of no use without a calibrated camera_info'), 'attitude')


def test_a_wrong_source_ends_the_one_process_with_one_line(graph):
    process = graph.spawn('vision_process', source='/nowhere.mcap')
    output, _ = process.communicate(timeout=120)
    assert process.returncode == 2
    assert 'no such file' in output and 'Traceback' not in output


@pytest.fixture
def environment(monkeypatch):
    for name in VARIABLES:
        # Set first, so that monkeypatch takes away what prepare_transport puts there.
        monkeypatch.setenv(name, '')
        monkeypatch.delenv(name)
    return monkeypatch


def test_the_users_own_set_up_is_left_alone(environment):
    for name in VARIABLES:
        environment.setenv(name, 'mine')
        before = dict(os.environ)
        transport.prepare_transport()
        assert dict(os.environ) == before
        environment.delenv(name)


def test_publishers_of_images_get_the_larger_segment(environment):
    transport.prepare_transport()
    assert os.environ['FASTRTPS_DEFAULT_PROFILES_FILE'] == str(transport.PROFILE)
    environment.delenv('FASTRTPS_DEFAULT_PROFILES_FILE')
    transport.prepare_transport(camera_images=False)
    assert os.environ['FASTDDS_BUILTIN_TRANSPORTS'] == 'DEFAULT?sockets_size=4MB'
    root = ET.parse(transport.PROFILE).getroot()
    sizes = [int(e.text) for e in root.iter() if e.tag.endswith('segment_size')]
    assert sizes == [16 << 20]


def test_a_small_shared_memory_is_left_to_fast_dds(environment, capsys):
    """A segment that does not fit would switch shared memory off."""
    full = SimpleNamespace(free=1000 * 4096)
    environment.setattr(transport.shutil, 'disk_usage', lambda _: full)
    transport.prepare_transport()
    assert not any(name in os.environ for name in VARIABLES)
    assert '--shm-size' in capsys.readouterr().err


@pytest.mark.parametrize(
    'durability', [DurabilityPolicy.VOLATILE, DurabilityPolicy.TRANSIENT_LOCAL]
)
def test_what_is_latched_is_published_though_nobody_listens_yet(durability):
    node = MagicMock()
    publisher = node.create_publisher.return_value
    publisher.get_subscription_count.return_value = 0
    publisher.qos_profile.durability = durability
    publishers = ResultPublishers(node, MagicMock(message_types={'~/markers': PointCloud2}))
    publishers.publish([('~/markers', bytes)])
    assert publisher.publish.called == (durability == DurabilityPolicy.TRANSIENT_LOCAL)
