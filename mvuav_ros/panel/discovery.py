"""Which processing nodes run: in any namespace, under any name."""

from __future__ import annotations

from typing import NamedTuple

from rclpy.node import Node

from mvuav_ros.panel import foreign

_RESULTS = {'markers': 'marker_tracker', 'line_params': 'runway_detector'}
"""A node is known by the point cloud that only its kind publishes."""
_MOST_NODES = 20
_CLOUD = 'sensor_msgs/msg/PointCloud2'
_RAW, _COMPRESSED = 'sensor_msgs/msg/Image', 'sensor_msgs/msg/CompressedImage'


class Found(NamedTuple):
    """A running node.

    Attributes:
        name: fully qualified.
        kind: ``marker_tracker`` or ``runway_detector``, however the node is called.
        image_topic: what it subscribes to; empty where frames are handed over in its process.
        compressed: whether those are compressed images.
    """

    name: str
    kind: str
    image_topic: str = ''
    compressed: bool = False


def find_nodes(node: Node) -> dict[str, Found]:
    """Ask the ROS graph."""
    found: dict[str, Found] = {}
    for name, namespace in dict.fromkeys(node.get_node_names_and_namespaces()):
        full = f'{namespace.rstrip("/")}/{name}'
        # Anybody on the network can announce anything; rcl then fails in its own way.
        if not foreign.is_ros_name(full) or len(found) >= _MOST_NODES:
            continue
        try:
            published = dict(node.get_publisher_names_and_types_by_node(name, namespace))
            subscribed = node.get_subscriber_names_and_types_by_node(name, namespace)
        except Exception as error:
            # It went away meanwhile; rclpy has no public exception for that.
            if 'NameNonExistent' not in type(error).__name__:
                raise
            continue
        for result, kind in _RESULTS.items():
            if _CLOUD in published.get(f'{full}/{result}', ()):
                found[full] = Found(full, kind, *_input(subscribed))
    return found


def _input(subscribed: list[tuple[str, list[str]]]) -> tuple[str, bool]:
    """The topic of its images, and whether they are compressed."""
    for topic, types in subscribed:
        if (_RAW in types or _COMPRESSED in types) and foreign.is_ros_name(topic):
            return topic, _COMPRESSED in types
    return '', False
