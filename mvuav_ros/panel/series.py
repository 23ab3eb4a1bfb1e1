"""A node's results as curves over time, subscribed only while somebody looks."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import Any

from geometry_msgs.msg import PoseWithCovarianceStamped, Vector3Stamped
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import PointCloud2

from mvuav_ros.panel import foreign
from mvuav_ros.panel.live_system import LiveNode
from mvuav_ros.panel.ros_thread import RosThread, Subscriptions
from mvuav_ros.panel.sketch import Sketch, rotation_of, sketch_runway, sketch_tanker
from mvuav_ros.processing.messages.points import decode_points
from mvuav_ros.vision.markers.results import TANKER_NAMES, Label, MarkerState

CURVES = {
    'marker_tracker': {'roll': ('Roll', '°'), 'x': ('Marker x', 'px'), 'y': ('Marker y', 'px')},
    'runway_detector': {'rho': ('Line rho', 'px'), 'theta': ('Line theta', '°')},
}
"""Charts of each kind of node: title and unit."""
_MOST_ROWS = 12
_HIGHEST_RATE = 30.0
"""Points per second of a curve; a screen shows no more."""

_MOST_VALUES = 100_000
_LARGEST = 1e9

Charts = dict[str, dict[str, float]]
"""Values by chart and curve."""
Point = tuple[float, str, dict[str, float]]
"""Time (s), chart, value by curve; NaN where there is none."""


class SeriesFeed:
    """Follows one node's results; made, and closed, in the loop."""

    def __init__(
        self,
        ros: RosThread,
        node: LiveNode,
        point: Callable[[Point], None],
        pose: Callable[[Sketch], None],
    ) -> None:
        """Subscribe.

        Args:
            ros: our own node.
            node: the other node.
            point: called in the loop with points of the curves.
            pose: called in the loop with the newest pose.
        """
        self._ros, self._node, self._point, self._sketch = ros, node, point, pose
        self._subscriptions = Subscriptions(ros.node)
        self._due: dict[str, float] = {}
        ros.do(self._open)

    def close(self) -> None:
        """Unsubscribe."""
        self._ros.do(self._subscriptions.close)

    def _open(self) -> None:
        for topic, kind, points in _SOURCES[self._node.kind]:
            self._subscribe(topic, kind, partial(self._tell_points, points))
        self._subscribe('pose', PoseWithCovarianceStamped, self._tell_pose)

    def _subscribe(self, topic: str, kind: type, take: Callable[[Any, float], None]) -> None:
        def arrived(message: Any) -> None:
            now = time.monotonic()
            if now < self._due.get(topic, 0.0):
                return
            self._due[topic] = now + 0.5 / _HIGHEST_RATE
            # What is no such message of our nodes says nothing.
            with suppress(ValueError, KeyError, TypeError, IndexError, OverflowError):
                take(message, now)

        # Best effort connects to every publisher and never slows one down.
        qos = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
        self._subscriptions.add(kind, f'{self._node.name}/{topic}', arrived, qos)

    def _tell_points(self, points: Callable[[Any], Charts], message: Any, now: float) -> None:
        for chart, values in points(message).items():
            self._ros.tell(self._point, (now, chart, values))

    def _tell_pose(self, message: PoseWithCovarianceStamped, _: float) -> None:
        pose = message.pose.pose
        position = (pose.position.x, pose.position.y, pose.position.z)
        rotation = rotation_of(pose.orientation)
        if self._node.kind == 'marker_tracker':
            sketch = sketch_tanker(position, rotation)
        else:
            width = foreign.number(self._node.values.get('runway_width', 0.0))
            sketch = sketch_runway(position, rotation, width)
        self._ros.tell(self._sketch, sketch)


def _rows(message: PointCloud2) -> Any:
    """The first rows; a message says itself how large it is."""
    if len(message.fields) > 50 or message.width * message.height > _MOST_VALUES:
        raise ValueError('no result of our nodes')
    return decode_points(message)[:_MOST_ROWS]


def _number(value: float) -> float:
    number = float(value)
    return number if abs(number) < _LARGEST else math.nan


def _marker_points(message: PointCloud2) -> Charts:
    charts: Charts = {'x': {}, 'y': {}}
    for index, row in enumerate(_rows(message), 1):
        label = int(row['label'])
        known = label != Label.UNLABELLED and label < len(TANKER_NAMES)
        name = TANKER_NAMES[label].replace('_', ' ') if known else f'marker {index}'
        lost = row['state'] == MarkerState.LOST
        for axis in ('x', 'y'):
            charts[axis][name] = math.nan if lost else _number(row[axis])
    return charts


def _roll_points(message: Vector3Stamped) -> Charts:
    return {'roll': {'roll': math.degrees(_number(message.vector.x))}}


def _line_points(message: PointCloud2) -> Charts:
    charts: Charts = {'rho': {}, 'theta': {}}
    # From 1, as the lines are numbered in the images.
    for index, row in enumerate(_rows(message), 1):
        charts['rho'][f'line {index}'] = _number(row['rho'])
        charts['theta'][f'line {index}'] = math.degrees(_number(row['theta']))
    return charts


_SOURCES: dict[str, tuple[tuple[str, type, Callable[[Any], Charts]], ...]] = {
    'marker_tracker': (
        ('markers', PointCloud2, _marker_points),
        ('rpy', Vector3Stamped, _roll_points),
    ),
    'runway_detector': (('line_params', PointCloud2, _line_points),),
}
"""Topic, type and what is drawn of a message."""
