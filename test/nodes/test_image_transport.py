"""Topics and types of images by the names of image_transport."""

from __future__ import annotations

import math
import sys
import time
from threading import Event
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import rclpy
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.parameter import Parameter
from rclpy.qos import ReliabilityPolicy
from sensor_msgs.msg import CompressedImage, Image, Imu
from support.graph import Graph

from mvuav_ros.messages.cdr import cdr_header
from mvuav_ros.messages.images import Frame
from mvuav_ros.messages.sensors import UNKNOWN_ATTITUDE, encode_imu
from mvuav_ros.nodes.image_input import (
    ImageInput,
    ReceivedImage,
    SynchronizedTopic,
    image_topic,
    subscribe,
)
from mvuav_ros.parameters.declaration import ParameterError
from mvuav_ros.vision.frames import Attitude
from mvuav_ros.vision.image import Image as ImagePixels


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
        subscription = subscribe(node, Image, 'image_raw', reliability=reliability)
        assert subscription.qos_profile.depth == 50
        asked = reliability or ReliabilityPolicy.BEST_EFFORT
        assert subscription.qos_profile.reliability == asked
        node.destroy_subscription(subscription)
    node.destroy_node()


def imu_topic(graph: Graph) -> tuple[Any, SynchronizedTopic, Any]:
    """A node, its topic of attitudes, and a publisher that has found it."""
    node = graph.add_node('other')
    topic = SynchronizedTopic(node, Imu, 'imu', lambda: True)
    publisher = graph.probe.create_publisher(Imu, 'imu', 100)
    graph.until(lambda: publisher.get_subscription_count() == 1, 'the subscription')
    graph.until(lambda: topic.subscription.get_publisher_count() == 1, 'the publisher')
    return node, topic, publisher


def test_no_attitude_is_lost_while_an_image_is_answered(graph: Graph) -> None:
    """Of a fast IMU more of them come in that time than a queue for images holds."""
    _, topic, publisher = imu_topic(graph)
    for number in range(60):
        publisher.publish(
            encode_imu(Attitude.from_roll_pitch(0.0, 0.0), cdr_header(1 + number, 'imu'))
        )
    known = topic._pairing._infos

    def all_are_known() -> bool:
        topic.take()
        return len(known) == 60

    with topic.subscription.handle:
        graph.until(all_are_known, lambda: f'60 attitudes, not {len(known)}', timeout=20.0)


def test_what_cannot_be_read_holds_no_image_up(graph: Graph) -> None:
    """Each such message cost a pause of 0.1 s: a camera's calibrations let no image through."""
    _, topic, publisher = imu_topic(graph)
    good = encode_imu(Attitude.from_roll_pitch(0.0, 0.0), cdr_header(1, 'imu'))
    for message in (encode_imu(UNKNOWN_ATTITUDE, cdr_header(1, 'x' * 2000)), good):
        publisher.publish(message)
    known = topic._pairing._infos

    def is_known() -> bool:
        topic.take()
        return len(known) == 1

    with topic.subscription.handle:
        graph.until(is_known, 'the attitude behind it', timeout=20.0)


def test_an_image_finds_what_came_while_the_one_before_was_answered(graph: Graph) -> None:
    """The first image takes a node longer than an image is held: the second got no attitude."""
    node, topic, publisher = imu_topic(graph)
    black = ImagePixels(np.zeros((2, 2), np.uint8), 'mono8')
    long_ago = time.perf_counter() - 10.0
    images = [ReceivedImage(Frame(each, '', black), each, math.nan, long_ago) for each in (1, 2)]

    def publish(stamp_ns: int, roll: float) -> None:
        publisher.publish(
            encode_imu(Attitude.from_roll_pitch(roll, 0.0), cdr_header(stamp_ns, 'imu'))
        )
        wait_until_ready(topic.subscription, node)

    with topic.subscription.handle:
        publish(1, 0.1)
        topic.take()
        answered = topic.completed(images)
        first = next(answered)
        publish(2, 0.2)
        second = next(answered)
    assert [each.stamp_ns for each in (first, second)] == [1, 2]
    rolls = [2 * math.asin(each.attitude.x) for each in (first, second)]
    assert rolls == pytest.approx([0.1, 0.2])


def test_a_thread_that_is_long_at_an_image_ends_after_it(
    graph: Graph, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Subscribed anew meanwhile, two threads took the images from then on."""
    node, entered, go_on = graph.add_node('other'), Event(), Event()

    def answer(_image: ReceivedImage) -> None:
        entered.set()
        go_on.wait()

    images = ImageInput(node, 'image_raw', answer, kind=Image)
    images.start()
    first: Any = images._thread
    publisher = graph.probe.create_publisher(Image, 'image_raw', 10)
    graph.until(lambda: publisher.get_subscription_count() == 1, 'the subscription')
    publisher.publish(Image())
    graph.until(entered.is_set, 'the image')
    monkeypatch.setattr(first, 'join', lambda timeout: None)
    images._subscribe_anew(ReliabilityPolicy.RELIABLE)
    go_on.set()
    graph.until(lambda: not first.is_alive(), 'the end of the first thread', timeout=20.0)
    images.close()


def wait_until_ready(subscription: Any, node: Any) -> None:
    with node.context.handle, subscription.handle:
        wait_set = rclpy_implementation.WaitSet(1, 0, 0, 0, 0, 0, node.context.handle)
        wait_set.clear_entities()
        wait_set.add_subscription(subscription.handle)
        wait_set.wait(60_000_000_000)
        assert wait_set.get_ready_entities('subscription')


def test_images_without_a_stamp_count_from_their_sending(graph: Graph) -> None:
    """As in a replay from their recording; all but the first were refused."""
    received: list[ReceivedImage] = []
    node = graph.add_node('other')
    images = ImageInput(node, 'image_raw', received.append, kind=Image)
    images.start()
    publisher = graph.probe.create_publisher(Image, 'image_raw', 10)
    graph.until(lambda: publisher.get_subscription_count() == 1, 'the subscription')
    before_ns = time.time_ns()
    for _ in range(3):
        publisher.publish(Image())
    graph.until(lambda: len(received) == 3, 'three images')
    assert images.poll().events.unstamped == 3
    images.close()
    times_ns = [before_ns, *(each.stamp_ns for each in received), time.time_ns()]
    assert times_ns == sorted(times_ns)
