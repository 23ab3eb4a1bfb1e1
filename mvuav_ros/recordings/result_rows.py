"""The rows of tables in the messages of results.

Names, angles and covariances have columns of their own.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.messages.cdr import view_points
from mvuav_ros.messages.definitions import decode_message
from mvuav_ros.messages.sensors import stamp_ns_of
from mvuav_ros.messages.untrusted import MalformedMessageError, visible
from mvuav_ros.recordings.reading import Recording
from mvuav_ros.recordings.stored_file import RecordedMessage
from mvuav_ros.vision.frames import OPTICAL_FROM_BODY, Matrix, from_quaternion, rpy
from mvuav_ros.vision.markers.marker_results import TANKER_NAMES, MarkerState
from mvuav_ros.vision.runway.results import LineRole

Row = tuple[int | float | str, ...]
ROWS_AT_ONCE = 10_000
POSE_COLUMNS = ('x', 'y', 'z', 'qx', 'qy', 'qz', 'qw')
ANGLE_COLUMNS = ('roll', 'pitch', 'yaw', 'roll_deg', 'pitch_deg', 'yaw_deg')
_AXES = ('x', 'y', 'z', 'rx', 'ry', 'rz')
_UPPER = [(row, column) for row in range(6) for column in range(row, 6)]
COVARIANCE_COLUMNS = tuple(f'cov_{_AXES[row]}_{_AXES[column]}' for row, column in _UPPER)
"""m and rad: of the position, and of small turns about the axes of the pose's frame; of roll, pitch
and yaw in the runway detector's ``~/pose``."""
KEYS = ('flight', 'stamp_ns', 'stamp', 'row')
"""The columns that every table begins with."""
CLOUD, _POINT = 'sensor_msgs/msg/PointCloud2', 'geometry_msgs/msg/PointStamped'
_STATUSES = 'diagnostic_msgs/msg/DiagnosticArray'

Columns = tuple[str, ...]
Reader = Callable[[Any], tuple[Columns, Iterable[Row]]]


class ResultRows:
    """The rows in the messages of one recording of results, that of a named flight.

    ``kinds`` are the types of the topics that can be tables, by the topics' names.
    """

    def __init__(self, recording: Recording, flight: str) -> None:
        """Look at the topics; the names of markers may need a look at the first messages."""
        self._flight = visible(flight)
        self.kinds = {t.name: t.type for t in recording.topics if is_table(t.name, t.type)}
        trackers = [
            name.removesuffix('/markers')
            for name, kind in self.kinds.items()
            if kind == CLOUD and name.endswith('/markers')
        ]
        # Their poses are in the camera's optical frame.
        self._optical = {f'{tracker}/pose' for tracker in trackers}
        self._names = {f'{each}/markers': marker_names(recording, each) for each in trackers}
        tanker = dict(enumerate(TANKER_NAMES))
        for topic, names in self._names.items():
            # Of the tanker's markers those that were never seen have their names as well.
            if names and names.items() <= tanker.items():
                self._names[topic] = tanker

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
        if kind == CLOUD:
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
    numbers = {each.key: float(each.value.replace('none', 'nan')) for each in status.values}
    return ('state', 'reason', *numbers), [(state, reason, *numbers.values())]


def marker_names(recording: Recording, tracker: str) -> dict[int, str]:
    """The names of a tracker's markers by their labels, as far as its topics show them.

    Each is that of the topic which has the same position at the same time. The order of topics
    says nothing: `ros2 bag record` lists them as they were discovered.
    """
    above = f'{tracker}/marker/'
    missing = {
        topic.name
        for topic in recording.topics
        if topic.name.startswith(above) and topic.type == _POINT and topic.message_count != 0
    }
    names: dict[int, str] = {}
    labels: dict[tuple[int, float, float], int] = {}
    newest: dict[str, tuple[int, float, float]] = {}
    for recorded in recording.messages({f'{tracker}/markers', *missing} if missing else set()):
        try:
            message = decode_message(recorded.type, recorded.data)
            points = view_points(message) if recorded.type == CLOUD else None
        except MalformedMessageError:
            continue
        stamp_ns = stamp_ns_of(message.header)
        if recorded.topic in missing:
            x, y = np.array((message.point.x, message.point.y), np.float32).tolist()
            newest[recorded.topic] = stamp_ns, x, y
        elif points is not None and {'x', 'y', 'label'} <= set(points.dtype.names or ()):
            places = points[['label', 'x', 'y']].tolist()
            labels = {(stamp_ns, x, y): label for label, x, y in places}
        # Either of the two messages may come first.
        for topic in [topic for topic, at in newest.items() if at in labels]:
            names[labels[newest.pop(topic)]] = topic.removeprefix(above)
            missing.discard(topic)
        if not missing:
            break
    return names


def _markers(message: Any, names: dict[int, str]) -> tuple[Columns, Iterator[Row]]:
    columns, points = _points(message)
    label, state = columns.index('label'), columns.index('state')
    states = {int(each): each.name.lower() for each in MarkerState}
    rows = (
        (*row, _named(names, float(row[label])), _named(states, float(row[state])))
        for row in points
    )
    return (*columns, 'name', 'state_name'), rows


def _named(names: Mapping[int, str], number: float) -> str:
    """The name of a number, which may be any value of another program's."""
    return names.get(int(number), '') if math.isfinite(number) else ''


def _points(message: Any) -> tuple[Columns, Iterator[Row]]:
    points = view_points(message)
    names = points.dtype.names or ()
    if not {'theta', 'role'} <= set(names):
        return names, _in_blocks(points)
    theta, role = names.index('theta'), names.index('role')
    roles = {int(each): each.name.lower() for each in LineRole}
    rows = (
        (*row, math.degrees(row[theta]), _named(roles, row[role])) for row in _in_blocks(points)
    )
    return (*names, 'theta_deg', 'role_name'), rows


def _in_blocks(points: NDArray[np.void]) -> Iterator[Any]:
    """As Python's numbers, which take ten times the memory: some at a time."""
    for start in range(0, len(points), ROWS_AT_ONCE):
        yield from points[start : start + ROWS_AT_ONCE].tolist()


def _xyz(vector: Any) -> tuple[Columns, Iterable[Row]]:
    return ('x', 'y', 'z'), [(vector.x, vector.y, vector.z)]


def _pose(message: Any, outer: Matrix | None = None) -> tuple[Columns, Iterable[Row]]:
    """A pose, with its angles against its frame's axes or ``outer`` ones."""
    pose = getattr(message.pose, 'pose', message.pose)
    place, turn = pose.position, pose.orientation
    rotation = from_quaternion(turn.x, turn.y, turn.z, turn.w)
    rotation = rotation if outer is None else outer @ rotation
    angles = rpy(rotation) if np.isfinite(rotation).all() else (math.nan,) * 3
    row = (place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w, *_angles(*angles))
    if pose is message.pose:
        return (*POSE_COLUMNS, *ANGLE_COLUMNS), [row]
    covariance = [float(message.pose.covariance[6 * i + j]) for i, j in _UPPER]
    return (*POSE_COLUMNS, *ANGLE_COLUMNS, *COVARIANCE_COLUMNS), [(*row, *covariance)]


def _angles(roll: float, pitch: float, yaw: float) -> Row:
    return roll, pitch, yaw, math.degrees(roll), math.degrees(pitch), math.degrees(yaw)


_PLAIN: dict[str, Reader] = {
    CLOUD: _points,
    'geometry_msgs/msg/Vector3Stamped': lambda message: _xyz(message.vector),
    _POINT: lambda message: _xyz(message.point),
    'geometry_msgs/msg/PoseStamped': _pose,
    'geometry_msgs/msg/PoseWithCovarianceStamped': _pose,
}
