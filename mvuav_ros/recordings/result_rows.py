"""Messages of results as rows of a table: names, angles and covariances in columns of their own."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.recordings.errors import MalformedMessageError
from mvuav_ros.recordings.images import decode_message
from mvuav_ros.recordings.reading import Recording
from mvuav_ros.recordings.recording import RecordedMessage
from mvuav_ros.recordings.serialization.messages import stamp_ns_of
from mvuav_ros.recordings.serialization.points import view_points
from mvuav_ros.recordings.tables import POSE_COLUMNS, ROWS_AT_ONCE, Row
from mvuav_ros.vision.frames import OPTICAL_FROM_BODY, Matrix, from_unit_quaternion, rpy
from mvuav_ros.vision.markers.results import TANKER_NAMES, MarkerState
from mvuav_ros.vision.runway.results import LineRole

ANGLE_COLUMNS = ('roll', 'pitch', 'yaw', 'roll_deg', 'pitch_deg', 'yaw_deg')
_AXES = ('x', 'y', 'z', 'rx', 'ry', 'rz')
_UPPER = [(row, column) for row in range(6) for column in range(row, 6)]
COVARIANCE_COLUMNS = tuple(f'cov_{_AXES[row]}_{_AXES[column]}' for row, column in _UPPER)
"""m and rad: of the position, and of small turns about the axes of the pose's frame."""
_STRAIGHT: Matrix = np.eye(3)
KEYS = ('flight', 'stamp_ns', 'stamp', 'row')
"""The columns that every table begins with."""
_CLOUD, _POINT = 'sensor_msgs/msg/PointCloud2', 'geometry_msgs/msg/PointStamped'
_STATUSES = 'diagnostic_msgs/msg/DiagnosticArray'

Columns = tuple[str, ...]
Reader = Callable[[Any], tuple[Columns, Iterable[Row]]]


class ResultRows:
    """The rows in the messages of one recording of results.

    Attributes:
        kinds: the types of the topics that can be tables, by the topics' names.
    """

    def __init__(self, recording: Recording, flight: str) -> None:
        """Look at the topics; the names of markers may need a look at the first messages.

        Args:
            recording: open.
            flight: what the first column says.
        """
        self._flight = flight
        self.kinds = {t.name: t.type for t in recording.topics if is_table(t.name, t.type)}
        trackers = [
            name.removesuffix('/markers')
            for name, kind in self.kinds.items()
            if kind == _CLOUD and name.endswith('/markers')
        ]
        # Their poses are in the camera's optical frame.
        self._optical = {f'{tracker}/pose' for tracker in trackers}
        self._names = {
            f'{tracker}/markers': _marker_names(recording, tracker) for tracker in trackers
        }

    def of(self, recorded: RecordedMessage) -> tuple[Columns, Iterator[Row]]:
        """A message's columns and rows: a PointCloud2's are its points, of others there is one.

        Raises:
            MalformedMessageError: it does not decode.
        """
        message = decode_message(recorded.type, recorded.data)
        try:
            stamp_ns = stamp_ns_of(message.header)
            columns, values = self._read(recorded.topic, recorded.type, message)
        except (KeyError, TypeError, ValueError) as error:
            raise MalformedMessageError(str(error)) from error
        key = (self._flight, stamp_ns, stamp_ns * 1e-9)
        return (*KEYS, *columns), ((*key, i, *row) for i, row in enumerate(values))

    def _read(self, topic: str, kind: str, message: Any) -> tuple[Columns, Iterable[Row]]:
        if kind == _CLOUD:
            fields = {field.name for field in message.fields}
            is_markers = topic in self._names and {'label', 'state'} <= fields
            return _markers(message, self._names[topic]) if is_markers else _points(message)
        if topic.endswith('/rpy') and kind == 'geometry_msgs/msg/Vector3Stamped':
            turn = message.vector
            return ANGLE_COLUMNS, [_angles(turn.x, turn.y, turn.z)]
        if topic in self._optical:
            return _pose(message, OPTICAL_FROM_BODY.T)
        return _integrity(message) if kind == _STATUSES else _PLAIN[kind](message)


def is_table(topic: str, kind: str) -> bool:
    """Whether the messages of a topic of that type have rows."""
    return kind in _PLAIN or (kind == _STATUSES and topic.endswith('/integrity'))


def _integrity(message: Any) -> tuple[Columns, Iterable[Row]]:
    """Protection levels: numbers, NaN where there are none or no limit, and the state in words."""
    (status,) = message.status
    state, _, reason = status.message.partition(': ')
    numbers = {each.key: _number(each.value) for each in status.values}
    return ('state', 'reason', *numbers), [(state, reason, *numbers.values())]


def _number(text: str) -> float:
    return math.nan if text == 'none' else float(text)


def _marker_names(recording: Recording, tracker: str) -> dict[int, str]:
    """The names of a tracker's markers by their labels.

    Each is that of the topic which has the same position at the same time. A marker that was
    never seen has the tanker's name if the others have, and none otherwise.
    """
    above = f'{tracker}/marker/'
    missing = {
        topic.name
        for topic in recording.topics
        if topic.name.startswith(above) and topic.type == _POINT and topic.message_count != 0
    }
    names: dict[int, str] = {}
    labels: dict[tuple[int, float, float], int] = {}
    wanted = {f'{tracker}/markers', *missing} if missing else set()
    for recorded in recording.messages(wanted):
        if not missing:
            break
        try:
            message = decode_message(recorded.type, recorded.data)
            points = view_points(message) if recorded.type == _CLOUD else None
        except MalformedMessageError:
            continue
        stamp_ns = stamp_ns_of(message.header)
        if recorded.topic in missing:
            place = message.point
            at = stamp_ns, float(np.float32(place.x)), float(np.float32(place.y))
            if at in labels:
                names[labels[at]] = recorded.topic.removeprefix(above)
                missing.discard(recorded.topic)
        elif points is not None and {'x', 'y', 'label'} <= set(points.dtype.names or ()):
            places = points[['label', 'x', 'y']].tolist()
            labels = {(stamp_ns, x, y): label for label, x, y in places}
    tanker = dict(enumerate(TANKER_NAMES))
    return {**tanker, **names} if names.items() <= tanker.items() else names


def _markers(message: Any, names: dict[int, str]) -> tuple[Columns, Iterator[Row]]:
    columns, points = _points(message)
    label, state = columns.index('label'), columns.index('state')
    states = {int(each): each.name.lower() for each in MarkerState}
    rows = (
        (*row, names.get(int(row[label]), ''), states.get(int(row[state]), '')) for row in points
    )
    return (*columns, 'name', 'state_name'), rows


def _points(message: Any) -> tuple[Columns, Iterator[Row]]:
    points = view_points(message)
    names = points.dtype.names or ()
    if not {'theta', 'role'} <= set(names):
        return names, _in_blocks(points)
    theta, role = names.index('theta'), names.index('role')
    roles = {int(each): each.name.lower() for each in LineRole}
    rows = (
        (*row, math.degrees(row[theta]), roles.get(int(row[role]), ''))
        for row in _in_blocks(points)
    )
    return (*names, 'theta_deg', 'role_name'), rows


def _in_blocks(points: NDArray[np.void]) -> Iterator[Any]:
    """As Python's numbers, which take ten times the memory: some at a time."""
    for start in range(0, len(points), ROWS_AT_ONCE):
        yield from points[start : start + ROWS_AT_ONCE].tolist()


def _vector(message: Any) -> tuple[Columns, Iterable[Row]]:
    return ('x', 'y', 'z'), [(message.vector.x, message.vector.y, message.vector.z)]


def _point(message: Any) -> tuple[Columns, Iterable[Row]]:
    return ('x', 'y', 'z'), [(message.point.x, message.point.y, message.point.z)]


def _pose(message: Any, outer: Matrix = _STRAIGHT) -> tuple[Columns, Iterable[Row]]:
    """A pose, with its angles against ``outer`` axes."""
    pose = getattr(message.pose, 'pose', message.pose)
    place, turn = pose.position, pose.orientation
    rotation = outer @ from_unit_quaternion(turn.x, turn.y, turn.z, turn.w)
    angles = rpy(rotation) if np.isfinite(rotation).all() else (math.nan,) * 3
    row = (place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w, *_angles(*angles))
    if pose is message.pose:
        return (*POSE_COLUMNS, *ANGLE_COLUMNS), [row]
    covariance = [float(message.pose.covariance[6 * i + j]) for i, j in _UPPER]
    return (*POSE_COLUMNS, *ANGLE_COLUMNS, *COVARIANCE_COLUMNS), [(*row, *covariance)]


def _angles(roll: float, pitch: float, yaw: float) -> Row:
    return roll, pitch, yaw, math.degrees(roll), math.degrees(pitch), math.degrees(yaw)


_PLAIN: dict[str, Reader] = {
    _CLOUD: _points,
    'geometry_msgs/msg/Vector3Stamped': _vector,
    _POINT: _point,
    'geometry_msgs/msg/PoseStamped': _pose,
    'geometry_msgs/msg/PoseWithCovarianceStamped': _pose,
}
