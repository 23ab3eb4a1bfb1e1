"""A node's newest results: a few large figures, how far to trust them, a pose in space, curves.

Subscribed only while somebody looks.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, suppress
from functools import partial
from operator import attrgetter
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseWithCovarianceStamped
from numpy.typing import NDArray
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import CameraInfo, PointCloud2

from mvuav_ros.messages.cdr import view_points
from mvuav_ros.panel import sanitized
from mvuav_ros.panel.controls import value_text
from mvuav_ros.panel.live_nodes import LiveNode, same_value
from mvuav_ros.panel.ros_thread import RosThread
from mvuav_ros.processing.processor import Chart
from mvuav_ros.processing.registry import PROCESSORS
from mvuav_ros.vision.frames import OPTICAL_FROM_BODY, from_quaternion, rpy
from mvuav_ros.vision.markers.marker_results import TANKER_NAMES, Label, MarkerState
from mvuav_ros.vision.runway.results import LineFlag

TOPICS: dict[str, dict[str, type]] = {
    kind: {
        topic: message
        for topic, message in processor.topics.items()
        if topic in {'pose', 'integrity', *(c.topic for c in processor.panel.charts.values())}
    }
    for kind, processor in PROCESSORS.items()
}
"""What figures and curves are made of, below a node's name."""
GOOD, DOUBTFUL, BAD = 'good', 'doubtful', 'bad'
_LEVELS = ('horizontal', 'vertical', 'offset', 'height')
"""Protection levels (m) in a status of ``integrity``; the largest is shown."""
_MAX_MISSED = 5
"""Results without a pose after which the last one is not shown; one may be lost on its way."""
_MAX_ROWS = 12
"""Figures and curves of as many lights or lines; the words count all of them."""
_MAX_VALUES = 100_000
_MAX_VALUE, _MAX_DISTANCE = 1e9, 1e5
"""The latter in m; a camera sees nothing farther away that it could measure."""
_MAX_RANGE = 10.0
"""Half of a view's width over its distance; no calibration of a camera is wider."""

Figure = tuple[str, str, str]
"""What it is, its value with unit, and its standard deviation; ``-`` and empty if not known."""
_MAX_RATE = 30.0
"""Points per second of a curve; a screen shows no more."""


class Figures:
    """Collects the newest messages of one node; ValueError and the like for what is none of ours.

    ``values`` gives the node's parameters.
    """

    def __init__(self, kind: str, values: Callable[[], Mapping[str, Any]]) -> None:
        self._kind, self._values = kind, values
        self._trust = (BAD, 'no results yet')
        self._integrity = True, ''
        self._roll, self._lines = math.nan, list[Figure]()
        self._place, self._turn = np.full(3, math.nan), np.full((3, 3), math.nan)
        self._deviations, self._missed = np.full(6, math.nan), 0
        self._view: tuple[float, float] | None = None

    def take(self, topic: str, message: Any) -> None:
        """A message of one of `TOPICS`, or the ``camera_info`` of the node's images."""
        if topic == 'camera_info':
            # Without a calibration they are 0: an error for float, a warning in the log for NumPy.
            focal_x, focal_y = float(message.k[0]), float(message.k[4])
            half_width, half_height = message.width / 2 / focal_x, message.height / 2 / focal_y
            if 0 < half_width < _MAX_RANGE and 0 < half_height < _MAX_RANGE:
                self._view = half_width, half_height
        elif topic == 'rpy':
            self._roll = math.degrees(message.vector.x)
        elif topic == 'pose':
            self._take_pose(message)
        elif topic == 'integrity':
            self._take_integrity(message)
        elif topic == 'markers':
            self._trust = _trust_in_markers(rows_of(message))
        elif topic == 'line_params':
            self._take_lines(rows_of(message))
        else:
            self._take_charts(topic, message)

    def said(self) -> dict[str, Any]:
        """For the page, as JSON takes it: ``trust``, ``figures``, ``pose`` and ``view``.

        The pose is where something is, m, and its axes as rows of a matrix, x forward, y left, z
        up: the body before the camera, or the camera in the runway's frame. The view is half the
        width and height of what the camera sees at a distance of 1.
        """
        known = bool(np.isfinite((*self._place[1:], *self._turn.flat)).all())
        trust = self._trust
        if self._wants_pose and trust[0] != BAD:
            is_safe, integrity = self._integrity
            words = ', '.join(filter(None, (trust[1], integrity)))
            if trust[0] == GOOD and not known:
                trust = DOUBTFUL, f'{trust[1]}, but no pose'
            else:
                trust = trust[0] if is_safe else DOUBTFUL, words
        place = np.nan_to_num(self._place)
        pose = [place.round(3).tolist(), self._turn.round(5).tolist()] if known else None
        return {'trust': trust, 'figures': self._figures(), 'pose': pose, 'view': self._view}

    @property
    def _wants_pose(self) -> bool:
        values = self._values()
        if self._kind == 'marker_tracker':
            return bool(values.get('pose')) and values.get('mode') in ('track', 'detect')
        return self._is_approach and values.get('runway_width', 0.0) != 0.0

    @property
    def _is_approach(self) -> bool:
        return self._values().get('mode') == 'approach'

    def _figures(self) -> list[Figure]:
        (x, y, z), (sx, sy, sz) = self._place, self._deviations[:3]
        whole = np.isfinite(self._turn).all()
        roll, pitch, yaw = np.degrees(rpy(self._turn)) if whole else (math.nan,) * 3
        s_roll, s_pitch, s_yaw = np.degrees(self._deviations[3:])
        if self._kind == 'marker_tracker':
            return [
                _figure('roll', roll if math.isnan(self._roll) else self._roll, s_roll, '°'),
                _figure('ahead', x, sx, ' m'),
                _figure(_side(y), abs(y), sy, ' m'),
                _figure('above' if z > 0 else 'below', abs(z), sz, ' m'),
                _figure('pitch', pitch, s_pitch, '°'),
                _figure('yaw', yaw, s_yaw, '°'),
            ]
        if not self._is_approach:
            return self._lines
        return [
            _figure(f'{_side(y)} of centre', abs(y), sy, ' m'),
            _figure('height', z, sz, ' m'),
            _figure(f'heading {_side(yaw)}', abs(yaw), s_yaw, '°'),
            _figure('to the near end', -x, sx, ' m'),
        ]

    def _take_pose(self, message: PoseWithCovarianceStamped) -> None:
        pose = message.pose.pose
        place = np.array([pose.position.x, pose.position.y, pose.position.z])
        self._place = np.where(np.abs(place) < _MAX_DISTANCE, place, math.nan)
        self._turn = rotation_of(pose.orientation)
        variances = np.diagonal(np.reshape(message.pose.covariance, (6, 6)))
        self._deviations = np.sqrt(np.where(variances > 0, variances, math.nan))
        self._missed = 0
        if self._kind == 'marker_tracker':
            self._place = OPTICAL_FROM_BODY.T @ self._place
            self._turn = OPTICAL_FROM_BODY.T @ self._turn
            # The body's axes are the optical z, x and y, the latter two turned round.
            self._deviations = self._deviations.reshape(2, 3)[:, [2, 0, 1]].ravel()

    def _take_charts(self, topic: str, message: Any) -> None:
        """A result that has no figures of its own: those of its curves."""
        self._lines = [
            _figure(name, math.nan if value is None else value, math.nan, f' {chart.unit}')
            for chart in PROCESSORS[self._kind].panel.charts.values()
            if chart.topic == topic
            for name, value in curves_of(chart, message).items()
        ]
        found = sum(value != '-' for _, value, _ in self._lines)
        words = f'{found} of {len(self._lines)} numbers'
        self._trust = (GOOD if found == len(self._lines) else BAD, words)

    def _take_integrity(self, message: DiagnosticArray) -> None:
        """Whether the pose may be used, and its protection level, or why it may not."""
        status = message.status[0]
        said = sanitized.words(status.message)
        if is_safe := status.level == DiagnosticStatus.OK:
            levels = sanitized.key_values(status.values)
            largest = max(sanitized.number(levels[name]) for name in _LEVELS if name in levels)
            said = _written(largest, ' m', largest)
        self._integrity = is_safe, f'protection level {said}'

    def _take_lines(self, rows: Any) -> None:
        found = np.isfinite(rows['rho'])
        held = int(((rows['flags'] & LineFlag.CORRECTED) != 0)[found].sum())
        words = f'{found.sum()} of {len(rows)} lines'
        if self._is_approach:
            confidence = float(np.nan_to_num(rows['confidence'][found]).max(initial=0.0))
            words = f'confidence {100 * confidence:.0f} %' if found.any() else 'no runway'
        words += f', {held} held' if held else ''
        good = found[: 2 if self._is_approach else None].all() and not held
        self._trust = (GOOD if good else DOUBTFUL if found.any() else BAD, words)
        self._missed += 1
        if not found.any() or self._missed > _MAX_MISSED:
            self._place[:], self._turn[:], self._deviations[:] = math.nan, math.nan, math.nan
        self._lines = [
            (
                f'line {number}',
                _written(math.degrees(row['theta']), '°'),
                f'rho {row["rho"]:.0f} px' if known else '',
            )
            for number, (row, known) in enumerate(zip(rows[:_MAX_ROWS], found, strict=False), 1)
        ]


def rows_of(message: PointCloud2) -> Any:
    """Its rows; a message says itself how large it is."""
    if len(message.fields) > 50 or message.width * message.height > _MAX_VALUES:
        raise ValueError('no result of our nodes')
    return view_points(message)


def rotation_of(quaternion: Any) -> NDArray[np.float64]:
    """A geometry_msgs/Quaternion as a matrix; NaN where it is none."""
    parts = quaternion.x, quaternion.y, quaternion.z, quaternion.w
    known = all(abs(part) < 1e3 for part in parts)
    return from_quaternion(*parts) if known else np.full((3, 3), math.nan)


def _trust_in_markers(rows: Any) -> tuple[str, str]:
    detected, predicted = (
        int((rows['state'] == state).sum())
        for state in (MarkerState.DETECTED, MarkerState.PREDICTED)
    )
    if (rows['label'] == Label.UNLABELLED).all():
        return (GOOD if detected else BAD), f'{detected} lights, without names'
    words = f'{detected} of {len(rows)} lights' + (f', {predicted} predicted' if predicted else '')
    good = detected == len(rows)
    return (GOOD if good else DOUBTFUL if detected + predicted > 1 else BAD), words


def _side(value: float) -> str:
    return 'aside' if math.isnan(value) else 'left' if value > 0 else 'right'


def _figure(name: str, value: float, deviation: float, unit: str) -> Figure:
    known = deviation < _MAX_VALUE and not math.isnan(value)
    shown = _written(value, unit, deviation if known else 1.0)
    plain = np.format_float_positional(deviation, 2, fractional=False, trim='-')  # no 1e-05
    return name, shown, f'± {plain}{unit}' if known else ''


def _written(value: float, unit: str, exact: float = 1.0) -> str:
    # A tenth is too coarse for a body of 1 m: to the digit that is known, and the third at most.
    digits = 1 if exact >= 0.1 else 2 if exact >= 0.01 else 3
    # Adding 0 makes -0.0 a 0.0.
    return f'{round(value, digits) + 0.0:.{digits}f}{unit}' if abs(value) < _MAX_VALUE else '-'


class SeriesFeed:
    """Follows one node's results until `close` and keeps them until they are sent.

    Called from the loop; ``on_news`` is, too, whenever there is something to be sent.
    """

    def __init__(self, ros: RosThread, node: LiveNode, on_news: Callable[[], None]) -> None:
        self.name = node.name
        self._ros, self._node, self._on_news = ros, node, on_news
        self._figures = Figures(node.kind, lambda: node.values)
        self._charts = PROCESSORS[node.kind].panel.charts
        self._points: list[tuple[float, str, dict[str, float | None]]] = []
        self._values = dict(node.values)
        self._marks: list[tuple[float, str]] = []
        self._due: dict[str, float] = {}
        self._new = False
        self._subscriptions, self._camera = ExitStack(), ExitStack()
        self._subscriptions.callback(self._camera.close)
        self.close = self._subscriptions.close
        for topic, kind in TOPICS[node.kind].items():
            self._listen(self._subscriptions, topic, kind, f'{node.name}/{topic}')
        self._camera_topic = ''
        self._follow_camera()

    def _listen(self, until: ExitStack, topic: str, kind: type, name: str) -> None:
        # Best effort connects to every publisher and never slows one down.
        qos = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
        arrived = partial(self._arrived, topic)
        until.callback(self._ros.subscribe(kind, name, arrived, qos))

    def _follow_camera(self) -> None:
        """Of a node that has just begun it is not known yet; one that begins anew has another."""
        name = self._node.camera_info_topic
        if name != self._camera_topic:
            self._camera.close()
            self._camera_topic = name
            if name:
                self._listen(self._camera, 'camera_info', CameraInfo, name)

    def take(self) -> str:
        """What was received since the last time; empty where nothing was.

        As JSON: ``{"series": node, "points": [[time, chart, {curve: value}], …], "marks": [[time,
        change], …]}`` and what `Figures.said` gives.
        """
        if not self._new:
            return ''
        self._follow_camera()
        said = {'series': self.name, 'points': self._points, 'marks': self._marks}
        self._points, self._marks, self._new = [], [], False
        return json.dumps({**said, **self._figures.said()})

    def _arrived(self, topic: str, message: Any) -> None:
        now = time.monotonic()
        if now >= self._due.get(topic, 0.0):
            self._due[topic] = now + 0.5 / _MAX_RATE
            self._ros.call_in_loop(self._keep, topic, message, round(now, 3))

    def _keep(self, topic: str, message: Any, now: float) -> None:
        # What is no such message of our nodes says nothing.
        with suppress(ArithmeticError, ValueError, LookupError, TypeError):
            self._figures.take(topic, message)
            for name, chart in self._charts.items():
                if chart.topic == topic:
                    # A rig of the user's has its own names, which its node does not say.
                    names = () if self._node.values.get('layout') else TANKER_NAMES
                    self._points.append((now, name, curves_of(chart, message, names)))
        for name, value in self._node.values.items():
            if not same_value(self._values.get(name, value), value):
                self._marks.append((now, f'{name} {value_text(value)}'))
        self._values = dict(self._node.values)
        # The camera is no sign of life of the node.
        if topic != 'camera_info':
            self._new = True
            self._on_news()


def _number(value: float) -> float | None:
    return round(float(value), 3) if abs(value) < _MAX_VALUE else None


def curves_of(chart: Chart, message: Any, names: Sequence[str] = ()) -> dict[str, float | None]:
    """The newest values of a chart's curves, None where there is none; ``names`` are of labels."""
    scale = 180.0 / math.pi if chart.unit == '°' else 1.0
    if not isinstance(message, PointCloud2):
        value = attrgetter(chart.field)(message)
        return {chart.title.lower(): _number(scale * value)}
    curves: dict[str, float | None] = {}
    # From 1, as the lines are numbered in the images.
    for index, row in enumerate(rows_of(message)[:_MAX_ROWS], 1):
        fields = row.dtype.names
        # A light of track_any has another row whenever one before it is lost, but always its id.
        name = f'{chart.rows} {int(row["id"]) if "id" in fields else index}'
        if 'label' in fields and int(row['label']) < len(names):
            name = names[int(row['label'])].replace('_', ' ')
        lost = 'state' in fields and row['state'] == MarkerState.LOST
        curves[name] = None if lost else _number(scale * row[chart.field])
    return curves
