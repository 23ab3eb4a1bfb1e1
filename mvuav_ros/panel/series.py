"""A node's results as curves over time, subscribed only while somebody looks."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

from geometry_msgs.msg import Vector3Stamped
from rclpy.qos import QoSProfile
from sensor_msgs.msg import PointCloud2

from mvuav_ros.panel.ros_thread import RosThread
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

Point = tuple[float, str, dict[str, float]]
"""Time (s), chart, value by curve; NaN where there is none."""


class SeriesFeed:
    """Follows one node's results; made, and closed, in the loop."""

    def __init__(
        self, ros: RosThread, name: str, kind: str, arrived: Callable[[Point], None]
    ) -> None:
        """Subscribe.

        Args:
            ros: our own node.
            name: the other node's.
            kind: what it is.
            arrived: called in the loop.
        """
        self._ros, self._name, self._kind, self._arrived = ros, name, kind, arrived
        self._subscriptions: list[Any] = []
        self._due: dict[str, float] = {}
        ros.do(self._open)

    def close(self) -> None:
        """Unsubscribe."""
        self._ros.do(self._destroy)

    def _open(self) -> None:
        if self._kind == 'marker_tracker':
            self._subscribe('markers', PointCloud2, _marker_points)
            self._subscribe('rpy', Vector3Stamped, _roll_points)
        else:
            self._subscribe('line_params', PointCloud2, _line_points)

    def _subscribe(
        self, topic: str, kind: type, points: Callable[[Any], dict[str, dict[str, float]]]
    ) -> None:
        def take(message: Any) -> None:
            now = time.monotonic()
            if now < self._due.get(topic, 0.0):
                return
            self._due[topic] = now + 0.5 / _HIGHEST_RATE
            for chart, values in points(message).items():
                self._ros.tell(self._arrived, (now, chart, values))

        name = f'{self._name}/{topic}'
        # Best effort connects to every publisher and never slows one down.
        qos = QoSProfile(depth=5)
        qos.reliability = qos.reliability.BEST_EFFORT
        self._subscriptions.append(self._ros.node.create_subscription(kind, name, take, qos))

    def _destroy(self) -> None:
        for subscription in self._subscriptions:
            self._ros.node.destroy_subscription(subscription)
        self._subscriptions = []


def _marker_points(message: PointCloud2) -> dict[str, dict[str, float]]:
    charts: dict[str, dict[str, float]] = {'x': {}, 'y': {}}
    for index, row in enumerate(decode_points(message)[:_MOST_ROWS]):
        label = int(row['label'])
        known = label != Label.UNLABELLED and label < len(TANKER_NAMES)
        name = TANKER_NAMES[label].replace('_', ' ') if known else f'light {index}'
        lost = row['state'] == MarkerState.LOST
        for axis in ('x', 'y'):
            charts[axis][name] = math.nan if lost else float(row[axis])
    return charts


def _roll_points(message: Vector3Stamped) -> dict[str, dict[str, float]]:
    return {'roll': {'roll': math.degrees(message.vector.x)}}


def _line_points(message: PointCloud2) -> dict[str, dict[str, float]]:
    charts: dict[str, dict[str, float]] = {'rho': {}, 'theta': {}}
    for index, row in enumerate(decode_points(message)[:_MOST_ROWS]):
        charts['rho'][f'line {index}'] = float(row['rho'])
        charts['theta'][f'line {index}'] = math.degrees(float(row['theta']))
    return charts
