"""A node's results as curves over time, subscribed only while somebody looks."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from functools import partial
from typing import Any

from geometry_msgs.msg import PoseWithCovarianceStamped, Vector3Stamped
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import PointCloud2

from mvuav_ros.panel import foreign
from mvuav_ros.panel.live_node import LiveNode
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

Curves = dict[str, float | None]
"""Values by curve; None where there is none."""


class SeriesFeed:
    """Follows one node's results until `close` and keeps them until they are sent.

    Called from the loop; ``heard`` is, too, whenever there is something to be sent.
    """

    def __init__(self, ros: RosThread, node: LiveNode, heard: Callable[[], None]) -> None:
        self.name = node.name
        self._ros, self._node, self._heard = ros, node, heard
        self._points: list[tuple[float, str, Curves]] = []
        self._pose: Sketch | None = None
        self._due: dict[str, float] = {}
        self._subscriptions = ExitStack()
        # Best effort connects to every publisher and never slows one down.
        qos = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
        for topic, (kind, shown) in _SOURCES[node.kind].items():
            arrived = partial(self._arrived, topic, shown)
            self._subscriptions.callback(ros.subscribe(kind, f'{node.name}/{topic}', arrived, qos))
        self.close = self._subscriptions.close

    def take(self) -> str:
        """What was heard since the last time; empty where nothing was.

        As JSON: ``{"series": node, "points": [[time, chart, {curve: value}], …], "pose": …}``.
        """
        if not (self._points or self._pose):
            return ''
        pose = self._pose._asdict() if self._pose else None
        said = {'series': self.name, 'points': self._points, 'pose': pose}
        self._points, self._pose = [], None
        return json.dumps(said)

    def _arrived(self, topic: str, shown: Callable[[Any, LiveNode], Any], message: Any) -> None:
        now = time.monotonic()
        if now >= self._due.get(topic, 0.0):
            self._due[topic] = now + 0.5 / _HIGHEST_RATE
            # What is no such message of our nodes says nothing.
            with suppress(ValueError, KeyError, TypeError, IndexError, OverflowError):
                self._ros.tell(self._keep, round(now, 3), shown(message, self._node))

    def _keep(self, now: float, shown: dict[str, Curves] | Sketch) -> None:
        if isinstance(shown, dict):
            self._points += [(now, chart, curves) for chart, curves in shown.items()]
        else:
            self._pose = shown
        self._heard()


def _sketch(message: PoseWithCovarianceStamped, node: LiveNode) -> Sketch:
    pose = message.pose.pose
    position = (pose.position.x, pose.position.y, pose.position.z)
    rotation = rotation_of(pose.orientation)
    if node.kind == 'marker_tracker':
        return sketch_tanker(position, rotation)
    width = foreign.number(node.values.get('runway_width', 0.0))
    return sketch_runway(position, rotation, width)


def _rows(message: PointCloud2) -> Any:
    """The first rows; a message says itself how large it is."""
    if len(message.fields) > 50 or message.width * message.height > _MOST_VALUES:
        raise ValueError('no result of our nodes')
    return decode_points(message)[:_MOST_ROWS]


def _number(value: float) -> float | None:
    return round(float(value), 3) if abs(value) < _LARGEST else None


def _markers(message: PointCloud2, _: LiveNode) -> dict[str, Curves]:
    charts: dict[str, Curves] = {'x': {}, 'y': {}}
    for index, row in enumerate(_rows(message), 1):
        label = int(row['label'])
        known = label != Label.UNLABELLED and label < len(TANKER_NAMES)
        name = TANKER_NAMES[label].replace('_', ' ') if known else f'marker {index}'
        lost = row['state'] == MarkerState.LOST
        for axis in ('x', 'y'):
            charts[axis][name] = None if lost else _number(row[axis])
    return charts


def _roll(message: Vector3Stamped, _: LiveNode) -> dict[str, Curves]:
    return {'roll': {'roll': _number(math.degrees(message.vector.x))}}


def _lines(message: PointCloud2, _: LiveNode) -> dict[str, Curves]:
    charts: dict[str, Curves] = {'rho': {}, 'theta': {}}
    # From 1, as the lines are numbered in the images.
    for index, row in enumerate(_rows(message), 1):
        charts['rho'][f'line {index}'] = _number(row['rho'])
        charts['theta'][f'line {index}'] = _number(math.degrees(row['theta']))
    return charts


_POSE = (PoseWithCovarianceStamped, _sketch)
_SOURCES: dict[str, dict[str, tuple[type, Callable[[Any, LiveNode], Any]]]] = {
    'marker_tracker': {
        'markers': (PointCloud2, _markers),
        'rpy': (Vector3Stamped, _roll),
        'pose': _POSE,
    },
    'runway_detector': {'line_params': (PointCloud2, _lines), 'pose': _POSE},
}
"""Topics, with their types and what is shown of a message."""
