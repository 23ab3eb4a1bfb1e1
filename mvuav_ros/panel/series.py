"""A node's results as curves over time and as figures, subscribed only while somebody looks."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from functools import partial
from typing import Any

from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import CameraInfo

from mvuav_ros.panel.controls import value_text
from mvuav_ros.panel.figures import TOPICS, Figures, rows_of
from mvuav_ros.panel.live_node import LiveNode, same_value
from mvuav_ros.panel.ros_thread import RosThread
from mvuav_ros.vision.markers.results import TANKER_NAMES, Label, MarkerState

CURVES = {
    'marker_tracker': {'roll': ('Roll', '°'), 'x': ('Marker x', 'px'), 'y': ('Marker y', 'px')},
    'runway_detector': {'rho': ('Line rho', 'px'), 'theta': ('Line theta', '°')},
}
"""Charts of each kind of node: title and unit."""
_HIGHEST_RATE = 30.0
"""Points per second of a curve; a screen shows no more."""
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
        self._figures = Figures(node.kind, lambda: node.values)
        self._points: list[tuple[float, str, Curves]] = []
        self._values = dict(node.values)
        self._marks: list[tuple[float, str]] = []
        self._due: dict[str, float] = {}
        self._new = False
        self._subscriptions = ExitStack()
        topics = {
            topic: (kind, f'{node.name}/{topic}') for topic, kind in TOPICS[node.kind].items()
        }
        if node.image_topic:
            base = node.image_topic.removesuffix('/compressed').rpartition('/')[0]
            topics['camera_info'] = CameraInfo, f'{base}/camera_info'
        # Best effort connects to every publisher and never slows one down.
        qos = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
        for topic, (kind, name) in topics.items():
            arrived = partial(self._arrived, topic)
            self._subscriptions.callback(ros.subscribe(kind, name, arrived, qos))
        self.close = self._subscriptions.close

    def take(self) -> str:
        """What was heard since the last time; empty where nothing was.

        As JSON: ``{"series": node, "points": [[time, chart, {curve: value}], …], "marks": [[time,
        change], …]}`` and what `Figures.said` gives.
        """
        if not self._new:
            return ''
        said = {'series': self.name, 'points': self._points, 'marks': self._marks}
        self._points, self._marks, self._new = [], [], False
        return json.dumps({**said, **self._figures.said()})

    def _arrived(self, topic: str, message: Any) -> None:
        now = time.monotonic()
        if now >= self._due.get(topic, 0.0):
            self._due[topic] = now + 0.5 / _HIGHEST_RATE
            self._ros.tell(self._keep, topic, message, round(now, 3))

    def _keep(self, topic: str, message: Any, now: float) -> None:
        # What is no such message of our nodes says nothing.
        with suppress(ArithmeticError, ValueError, LookupError, TypeError):
            self._figures.take(topic, message)
            if topic in _CHARTS:
                self._points += [(now, *chart) for chart in _CHARTS[topic](message).items()]
        for name, value in self._node.values.items():
            if not same_value(self._values.get(name, value), value):
                self._marks.append((now, f'{name} {value_text(value)}'))
        self._values = dict(self._node.values)
        self._new = True
        self._heard()


def _number(value: float) -> float | None:
    return round(float(value), 3) if abs(value) < _LARGEST else None


def _markers(message: Any) -> dict[str, Curves]:
    charts: dict[str, Curves] = {'x': {}, 'y': {}}
    for index, row in enumerate(rows_of(message), 1):
        label = int(row['label'])
        known = label != Label.UNLABELLED and label < len(TANKER_NAMES)
        name = TANKER_NAMES[label].replace('_', ' ') if known else f'marker {index}'
        lost = row['state'] == MarkerState.LOST
        for axis in ('x', 'y'):
            charts[axis][name] = None if lost else _number(row[axis])
    return charts


def _roll(message: Any) -> dict[str, Curves]:
    return {'roll': {'roll': _number(math.degrees(message.vector.x))}}


def _lines(message: Any) -> dict[str, Curves]:
    charts: dict[str, Curves] = {'rho': {}, 'theta': {}}
    # From 1, as the lines are numbered in the images.
    for index, row in enumerate(rows_of(message), 1):
        charts['rho'][f'line {index}'] = _number(row['rho'])
        charts['theta'][f'line {index}'] = _number(math.degrees(row['theta']))
    return charts


_CHARTS: dict[str, Callable[[Any], dict[str, Curves]]] = {
    'markers': _markers,
    'rpy': _roll,
    'line_params': _lines,
}
"""The topics with curves."""
