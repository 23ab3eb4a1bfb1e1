"""Topics and types of images by the names of image_transport."""

from __future__ import annotations

import sys
from types import ModuleType

import pytest
import rclpy
from rclpy.parameter import Parameter
from rclpy.qos import ReliabilityPolicy
from sensor_msgs.msg import CompressedImage, Image, Imu
from support.graph import Graph

from mvuav_ros.messages.sensors import encode_imu, make_header
from mvuav_ros.nodes.image_input import SynchronizedTopic, image_topic, subscribe
from mvuav_ros.parameters.declaration import ParameterError


def test_topics_beside_the_image_topic() -> None:
    # rclpy resolves and remaps the image topic itself.
    assert image_topic('raw', '/nose/image') == ('image_raw', Image)
    compressed = image_topic('compressed', '/nose/image')
    assert compressed == ('/nose/image/compressed', CompressedImage)


@pytest.mark.parametrize(
    ('transport', 'package', 'name'),
    [
        ('ffmpeg', 'ffmpeg_image_transport_msgs', 'FFMPEGPacket'),
        ('foxglove', 'foxglove_msgs', 'CompressedVideo'),
    ],
)
def test_messages_of_packages_that_may_be_missing(
    monkeypatch: pytest.MonkeyPatch, transport: str, package: str, name: str
) -> None:
    monkeypatch.setitem(sys.modules, f'{package}.msg', None)
    with pytest.raises(ParameterError, match=f'apt install ros-jazzy-{package}'.replace('_', '-')):
        image_topic(transport, '/image_raw')
    module = ModuleType(f'{package}.msg')
    setattr(module, name, str)
    monkeypatch.setitem(sys.modules, package, ModuleType(package))
    monkeypatch.setitem(sys.modules, f'{package}.msg', module)
    assert image_topic(transport, '/image_raw') == (f'/image_raw/{transport}', str)


def test_what_the_user_says_of_a_topic_holds_when_it_is_subscribed_anew(graph: Graph) -> None:
    """As a node does that loses images, or whose publisher comes back as another one."""
    given = [Parameter('qos_overrides./image_raw.subscription.depth', value=50)]
    node = rclpy.create_node('other', context=graph.probe.context, parameter_overrides=given)
    for reliability in (None, ReliabilityPolicy.RELIABLE, ReliabilityPolicy.BEST_EFFORT):
        subscription = subscribe(node, Image, 'image_raw', raw=True, reliability=reliability)
        assert subscription.qos_profile.depth == 50
        asked = reliability or ReliabilityPolicy.BEST_EFFORT
        assert subscription.qos_profile.reliability == asked
        node.destroy_subscription(subscription)
    node.destroy_node()


def test_no_attitude_is_lost_while_an_image_is_answered(graph: Graph) -> None:
    """Of a fast IMU more of them come in that time than a queue for images holds."""
    node = graph.add_node('other')
    topic = SynchronizedTopic(node, Imu, 'imu', lambda: True)
    publisher = graph.probe.create_publisher(Imu, 'imu', 100)
    graph.until(lambda: publisher.get_subscription_count() == 1, 'the subscription')
    graph.until(lambda: topic.subscription.get_publisher_count() == 1, 'the publisher')
    for number in range(60):
        publisher.publish(encode_imu((0.0, 0.0, 0.0, 1.0), 0.0, make_header(1 + number, 'imu')))
    known = topic._pairing._infos

    def all_are_known() -> bool:
        topic.take([topic.subscription.handle.pointer])
        return len(known) == 60

    with topic.subscription.handle:
        graph.until(all_are_known, lambda: f'60 attitudes, not {len(known)}', timeout=20.0)
