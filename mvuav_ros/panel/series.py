"""A node's results as curves over time, subscribed only while somebody looks."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from geometry_msgs.msg import PoseWithCovarianceStamped, Vector3Stamped
from rclpy.qos import QoSProfile
from sensor_msgs.msg import PointCloud2

from mvuav_ros.panel.ros_thread import RosThread
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

Point = tuple[float, str, dict[str, float]]
"""Time (s), chart, value by curve; NaN where there is none."""


@dataclass(frozen=True)
class Listener:
    """Called in the loop with what a node has found.

    Attributes:
        point: with points of the curves.
        pose: with the newest pose.
        runway_width: gives the width of the runway, m; 0: not known.
    """

    point: Callable[[Point], None]
    pose: Callable[[Sketch], None]
    runway_width: Callable[[], float]


class SeriesFeed:
    """Follows one node's results; made, and closed, in the loop."""

    def __init__(self, ros: RosThread, name: str, kind: str, listener: Listener) -> None:
        """Subscribe.

        Args:
            ros: our own node.
            name: the other node's.
            kind: what it is.
            listener: is told.
        """
        self._ros, self._name, self._kind, self._listener = ros, name, kind, listener
        self._subscriptions: list[Any] = []
        self._due: dict[str, float] = {}
        ros.do(self._open)

    def close(self) -> None:
        """Unsubscribe."""
        self._ros.do(self._destroy)

    def _open(self) -> None:
        if self._kind == 'marker_tracker':
            self._subscribe('markers', PointCloud2, self._curves(_marker_points))
            self._subscribe('rpy', Vector3Stamped, self._curves(_roll_points))
        else:
            self._subscribe('line_params', PointCloud2, self._curves(_line_points))
        self._subscribe('pose', PoseWithCovarianceStamped, self._pose)

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
        qos = QoSProfile(depth=5)
        qos.reliability = qos.reliability.BEST_EFFORT
        self._subscriptions.append(
            self._ros.node.create_subscription(kind, f'{self._name}/{topic}', arrived, qos)
        )

    def _curves(
        self, points: Callable[[Any], dict[str, dict[str, float]]]
    ) -> Callable[[Any, float], None]:
        def take(message: Any, now: float) -> None:
            for chart, values in points(message).items():
                self._ros.tell(self._listener.point, (now, chart, values))

        return take

    def _pose(self, message: PoseWithCovarianceStamped, _: float) -> None:
        pose = message.pose.pose
        position = (pose.position.x, pose.position.y, pose.position.z)
        rotation = rotation_of(pose.orientation)
        if self._kind == 'marker_tracker':
            sketch = sketch_tanker(position, rotation)
        else:
            sketch = sketch_runway(position, rotation, self._listener.runway_width())
        self._ros.tell(self._listener.pose, sketch)

    def _destroy(self) -> None:
        for subscription in self._subscriptions:
            self._ros.node.destroy_subscription(subscription)
        self._subscriptions = []


def _rows(message: PointCloud2) -> Any:
    """The first rows; a message says itself how large it is."""
    if len(message.fields) > 50 or message.width * message.height > _MOST_VALUES:
        raise ValueError('no result of our nodes')
    return decode_points(message)[:_MOST_ROWS]


def _number(value: float) -> float:
    number = float(value)
    return number if abs(number) < _LARGEST else math.nan


def _marker_points(message: PointCloud2) -> dict[str, dict[str, float]]:
    charts: dict[str, dict[str, float]] = {'x': {}, 'y': {}}
    for index, row in enumerate(_rows(message), 1):
        label = int(row['label'])
        known = label != Label.UNLABELLED and label < len(TANKER_NAMES)
        name = TANKER_NAMES[label].replace('_', ' ') if known else f'marker {index}'
        lost = row['state'] == MarkerState.LOST
        for axis in ('x', 'y'):
            charts[axis][name] = math.nan if lost else _number(row[axis])
    return charts


def _roll_points(message: Vector3Stamped) -> dict[str, dict[str, float]]:
    return {'roll': {'roll': math.degrees(_number(message.vector.x))}}


def _line_points(message: PointCloud2) -> dict[str, dict[str, float]]:
    charts: dict[str, dict[str, float]] = {'rho': {}, 'theta': {}}
    # From 1, as the lines are numbered in the images.
    for index, row in enumerate(_rows(message), 1):
        charts['rho'][f'line {index}'] = _number(row['rho'])
        charts['theta'][f'line {index}'] = math.degrees(_number(row['theta']))
    return charts
