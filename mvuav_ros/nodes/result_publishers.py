"""A processor's topics as publishers of a node."""

from __future__ import annotations

from typing import Any

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.qos_overriding_options import QoSOverridingOptions
from sensor_msgs.msg import Image

from mvuav_ros.processing.processor import Output, Processor, resolve


def create_result_publisher(node: Node, kind: type, topic: str) -> Any:
    """A reliable publisher, which any subscriber matches, with ``qos_overrides``."""
    return node.create_publisher(
        kind,
        topic,
        # One for each: rclpy writes the user's overrides into it.
        QoSProfile(depth=10),
        qos_overriding_options=QoSOverridingOptions.with_default_policies(),
    )


def is_heard(publisher: Any) -> bool:
    """Whether a message would reach a subscriber, now or, transient local, as a late joiner."""
    return bool(
        publisher.get_subscription_count() > 0
        or publisher.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
    )


class ResultPublishers:
    """Publishes a processor's outputs where somebody listens.

    The processor's topics are those that it has when this is made.
    """

    def __init__(self, node: Node, processor: Processor) -> None:
        self._node = node
        images = dict.fromkeys(processor.debug_topics, Image)
        self._results, self._debug = (
            {topic: create_result_publisher(node, kind, resolve(topic)) for topic, kind in kinds}
            for kinds in (processor.topics.items(), images.items())
        )
        self._periodic = {
            topic: node.create_publisher(kind, resolve(topic), 10)
            for topic, kind in processor.periodic_topics.items()
        }

    def publish(self, outputs: list[Output]) -> None:
        """Make and send the messages that anybody would get."""
        for topic, make in outputs:
            publisher = self._results.get(topic) or self._debug[topic]
            if is_heard(publisher):
                publisher.publish(make())

    def publish_periodic(self, outputs: list[Output]) -> None:
        """Send what is said once a second."""
        for topic, make in outputs:
            self._periodic[topic].publish(make())

    def debug_wanted(self) -> list[str]:
        """The debug topics that somebody looks at."""
        return [topic for topic, publisher in self._debug.items() if is_heard(publisher)]

    def destroy(self) -> None:
        """Take the topics off the graph."""
        for publishers in (self._results, self._debug, self._periodic):
            for publisher in publishers.values():
                self._node.destroy_publisher(publisher)
