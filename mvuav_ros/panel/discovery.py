"""Which processing nodes run: in any namespace, under any name."""

from __future__ import annotations

from dataclasses import dataclass

from rclpy.node import Node

from mvuav_ros.panel import foreign

_RESULTS = {
    'markers': ('marker_tracker', 'sensor_msgs/msg/PointCloud2'),
    'line_params': ('runway_detector', 'sensor_msgs/msg/PointCloud2'),
}
"""A node is known by the result that only its kind publishes."""
_MOST_NODES = 20
RAW, COMPRESSED = 'sensor_msgs/msg/Image', 'sensor_msgs/msg/CompressedImage'


@dataclass(frozen=True)
class Found:
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
        if not foreign.is_ros_name(full):
            continue
        try:
            kind = _kind(node, name, namespace, full)
            if kind and len(found) < _MOST_NODES:
                found[full] = Found(full, kind, *_input(node, name, namespace))
        except Exception as error:
            # It went away meanwhile; rclpy has no public exception for that.
            if 'NameNonExistent' not in type(error).__name__:
                raise
    return found


def _kind(node: Node, name: str, namespace: str, full: str) -> str:
    for topic, types in node.get_publisher_names_and_types_by_node(name, namespace):
        kind, wanted = _RESULTS.get(topic.removeprefix(f'{full}/'), ('', ''))
        if kind and wanted in types:
            return kind
    return ''


def _input(node: Node, name: str, namespace: str) -> tuple[str, bool]:
    """The topic of its images, and whether they are compressed."""
    for topic, types in node.get_subscriber_names_and_types_by_node(name, namespace):
        if (RAW in types or COMPRESSED in types) and foreign.is_ros_name(topic):
            return topic, COMPRESSED in types
    return '', False
