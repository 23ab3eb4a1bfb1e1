"""Results of one or many flights as tables: rows of messages, and one file for each topic.

Names, angles and covariances have columns of their own. CSV and Parquet take any rows, TUM poses,
MOTChallenge markers.
"""

from __future__ import annotations

import csv
import json
import math
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, ExitStack
from itertools import islice
from pathlib import Path
from secrets import token_hex
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.messages.cdr import view_points
from mvuav_ros.messages.definitions import decode_message
from mvuav_ros.messages.sensors import stamp_ns_of
from mvuav_ros.messages.untrusted import MalformedMessageError, visible
from mvuav_ros.recordings.account import Account, RecordingError, counted
from mvuav_ros.recordings.reading import Recording, open_recording
from mvuav_ros.recordings.remote import write_text
from mvuav_ros.recordings.stored_file import RecordedMessage
from mvuav_ros.vision.frames import OPTICAL_FROM_BODY, Matrix, from_quaternion, rpy
from mvuav_ros.vision.markers.marker_results import TANKER_NAMES, Label, MarkerState
from mvuav_ros.vision.runway.results import LineRole

Row = tuple[int | float | str, ...]
ROWS_AT_ONCE = 10_000
_NS = 1_000_000_000
POSE_COLUMNS = ('x', 'y', 'z', 'qx', 'qy', 'qz', 'qw')
ANGLE_COLUMNS = ('roll', 'pitch', 'yaw', 'roll_deg', 'pitch_deg', 'yaw_deg')
_AXES = ('x', 'y', 'z', 'rx', 'ry', 'rz')
_UPPER = [(row, column) for row in range(6) for column in range(row, 6)]
COVARIANCE_COLUMNS = tuple(f'cov_{_AXES[row]}_{_AXES[column]}' for row, column in _UPPER)
"""m and rad: of the position, and of small turns about the axes of the pose's frame; of roll, pitch
and yaw in the runway detector's ``~/pose``."""
KEYS = ('flight', 'stamp_ns', 'stamp', 'row')
"""The columns that every table begins with."""
_CLOUD, _POINT = 'sensor_msgs/msg/PointCloud2', 'geometry_msgs/msg/PointStamped'
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
            if kind == _CLOUD and name.endswith('/markers')
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
            points = view_points(message) if recorded.type == _CLOUD else None
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
    _CLOUD: _points,
    'geometry_msgs/msg/Vector3Stamped': lambda message: _xyz(message.vector),
    _POINT: lambda message: _xyz(message.point),
    'geometry_msgs/msg/PoseStamped': _pose,
    'geometry_msgs/msg/PoseWithCovarianceStamped': _pose,
}


class Table(AbstractContextManager['Table']):
    """One topic's file, a context manager; there when all of it is, else the one before stays.

    Attributes:
        count: of the rows written.
        ending: of the files' names.
        needs: columns without which there is no such table.
        one_flight: whether there is no column for the flight, and so a file for each.
        kinds, topics: parts of the messages' types, and the ends of their topics, that it takes.
    """

    ending: ClassVar[str]
    kinds: ClassVar[str] = ''
    topics: ClassVar[str] = ''
    needs: ClassVar[frozenset[str]] = frozenset()
    one_flight: ClassVar[bool] = False

    def __init__(self, path: Path, columns: Columns) -> None:
        """Begin a file; its folder is made."""
        self.path = path
        self.count = 0
        self._columns = columns
        path.parent.mkdir(parents=True, exist_ok=True)
        # Another export may write the same file meanwhile.
        self._part = path.with_name(f'.{path.name}.{token_hex(4)}')
        self._file = self._part.open('x', encoding='utf-8', newline='')

    @classmethod
    def takes(cls, topic: str, kind: str) -> bool:
        """Whether it can hold the messages of a topic of that type."""
        return is_table(topic, kind) and topic.endswith(cls.topics) and cls.kinds in kind

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        try:
            try:
                if kind is None:
                    self._end()
            finally:
                self._close()
            if kind is None:
                self._part.replace(self.path)
        finally:
            self._part.unlink(missing_ok=True)

    def add(self, rows: Iterable[Row], number: int | None = None) -> None:
        """Write the rows, which may be very many, of a message of this number in its recording."""
        remaining = iter(rows)
        while block := list(islice(remaining, ROWS_AT_ONCE)):
            self.count += self._write(block)

    def _write(self, rows: list[Row]) -> int:
        lines = [line for line in map(self._line, rows) if line]
        self._file.writelines(lines)
        return len(lines)

    def _line(self, row: Row) -> str:
        """A row as text; empty if it is none."""
        raise NotImplementedError

    def _end(self) -> None:
        pass

    def _close(self) -> None:
        self._file.close()


class Csv(Table):
    """Comma-separated values, with a line of names."""

    ending = 'csv'

    def __init__(self, path: Path, columns: Columns) -> None:
        super().__init__(path, columns)
        self._writer = csv.writer(self._file)
        self._writer.writerow(columns)

    def _write(self, rows: list[Row]) -> int:
        self._writer.writerows(rows)
        return len(rows)


class Parquet(Table):
    """Apache Parquet, in groups of rows."""

    ending = 'parquet'

    def __init__(self, path: Path, columns: Columns) -> None:
        try:
            import pyarrow
            import pyarrow.parquet
        except ImportError as error:
            raise RecordingError(
                f'parquet needs PyArrow: pip install "mvuav_ros[parquet]" ({error})'
            ) from error
        super().__init__(path, columns)
        self._arrow = pyarrow
        self._rows: list[Row] = []
        self._writer: Any = None

    def _write(self, rows: list[Row]) -> int:
        self._rows += rows
        if len(self._rows) >= ROWS_AT_ONCE:
            self._flush()
        return len(rows)

    def _flush(self) -> None:
        columns = zip(*self._rows, strict=True) if self._rows else ([] for _ in self._columns)
        content = {name: list(rows) for name, rows in zip(self._columns, columns, strict=True)}
        schema = None if self._writer is None else self._writer.schema
        try:
            table = self._arrow.table(content, schema=schema)
        except (ValueError, TypeError, OverflowError) as error:
            raise RecordingError(f'{self.path}: its columns change: {error}') from None
        if self._writer is None:
            self._writer = self._arrow.parquet.ParquetWriter(self._file.buffer, table.schema)
        self._writer.write_table(table)
        self._rows.clear()

    def _end(self) -> None:
        if self._rows or self._writer is None:
            self._flush()

    def _close(self) -> None:
        try:
            # Before the file: it writes that one's end, at the latest when it is collected.
            if self._writer is not None:
                self._writer.close()
        finally:
            super()._close()


class Tum(Table):
    """Time (s), position (m) and quaternion of every pose that is known, as evo reads it."""

    ending = 'tum'
    kinds = 'Pose'
    one_flight = True

    def __init__(self, path: Path, columns: Columns) -> None:
        super().__init__(path, columns)
        self._places = [columns.index(name) for name in ('stamp_ns', *POSE_COLUMNS)]

    def _line(self, row: Row) -> str:
        stamp_ns, *pose = (row[place] for place in self._places)
        numbers = [float(number) for number in pose]
        if not all(map(math.isfinite, numbers)):
            return ''
        seconds, rest = divmod(int(stamp_ns), _NS)
        return f'{seconds}.{rest:09d} {" ".join(map(repr, numbers))}\n'


class Mot(Table):
    """MOTChallenge: a line for each marker that was measured, as TrackEval reads it.

    frame (from 1), id (the marker's label and 1, or the light's number, or -1 of a light without
    one), left, top, width and height of a box with the marker's area (px, the first pixel's corner
    at 1), confidence (1 where there is none), and -1 three times.
    """

    ending = 'txt'
    kinds = _CLOUD
    topics = '/markers'
    needs = frozenset(('label', 'state', 'x', 'y', 'area'))
    one_flight = True
    _frame = 0

    def add(self, rows: Iterable[Row], number: int | None = None) -> None:
        """See `Table`; each message is a frame. Others, without one, are counted in its number."""
        self._frame = max(self._frame + 1, number or 0)
        super().add(rows)

    def _line(self, row: Row) -> str:
        of = dict(zip(self._columns, row, strict=True))
        label = float(of['label'])
        light = float(of.get('id', -1.0 if label == Label.UNLABELLED else label + 1.0))
        x, y, area = (float(of[name]) for name in ('x', 'y', 'area'))
        if of['state'] != MarkerState.DETECTED or not math.isfinite(light + x + y + area):
            return ''
        side = math.sqrt(max(area, 1.0))
        left, top = x - 0.5 * side + 1.5, y - 0.5 * side + 1.5
        confidence = float(of.get('confidence', math.nan))
        known = confidence if math.isfinite(confidence) else 1.0
        box = f'{left:.3f},{top:.3f},{side:.3f},{side:.3f}'
        return f'{self._frame},{int(light)},{box},{known:g},-1,-1,-1\n'


TABLES: dict[str, type[Table]] = {'csv': Csv, 'parquet': Parquet, 'tum': Tum, 'mot': Mot}
"""By the form's name."""


_MAX_NAME = 200
_MAX_REASON = 200
_MAX_TABLES = 500


def export(
    flights: Mapping[str, Path], folder: Path, form: str, *, overwrite: bool = False
) -> dict[Path, int]:
    """Write one file for each topic that can be a table, with the rows of all flights.

    Tables are made of PointCloud2 (markers, lines), Vector3Stamped (roll), PointStamped, and
    poses with and without covariance. Of several flights each has TUM and MOT files of its own, in
    a folder for each topic. What was lost is in ``account_FORM.json`` beside them: messages that
    do not decode, too.

    Args:
        flights: recordings of results by the names of their flights.
        folder: where the files go; it is made.
        form: 'csv', 'parquet', 'tum' or 'mot'.
        overwrite: replace files that exist.

    Returns:
        The tables with the number of their rows.

    Raises:
        RecordingError: there is nothing to export, or a file exists.
    """
    accounts: list[Account] = []
    try:
        with ExitStack() as stack:
            files = _Files(folder, form, overwrite, several=len(flights) > 1)
            for flight, source in flights.items():
                accounts.append(_export(flight, source, files, stack))
        if files.tables:
            content = [account.record() for account in accounts]
            record = content[0] if len(content) == 1 else {'flights': content}
            write_text(str(files.account), json.dumps(record, indent=2))
    except OSError as error:
        raise RecordingError(f'{folder} cannot be written: {error.strerror or error}') from None
    if not files.tables:
        names = ', '.join(map(str, flights.values()))
        raise RecordingError(f'{names} holds nothing that can be exported as {form}')
    return {table.path: table.count for table in files.tables.values()}


def _export(flight: str, source: Path, files: _Files, stack: ExitStack) -> Account:
    lost: Counter[tuple[str, str]] = Counter()
    with open_recording(source) as recording, ExitStack() as own:
        rows = ResultRows(recording, flight)
        takes = files.table_type.takes
        wanted = {name: kind for name, kind in rows.kinds.items() if takes(name, kind)}
        for topic in wanted:  # before anything is written
            files.refuse_to_overwrite(topic, flight)
        for message in recording.messages(wanted):
            if not takes(message.topic, message.type):
                continue
            try:
                columns, values = rows.of(message)
                if missing := files.table_type.needs - set(columns):
                    raise MalformedMessageError(f'it has no {", ".join(sorted(missing))}')
            except MalformedMessageError as error:
                lost[message.topic, str(error)[:_MAX_REASON]] += 1
                continue
            until = own if files.table_type.one_flight else stack
            files.table(message.topic, flight, columns, until).add(values, message.sequence)
        for (name, reason), count in lost.items():
            said = f'{counted(count, "message")} of {name} not exported: {reason}'
            recording.account.lose('export', (name, reason), said, count)
    return recording.account


class _Files:
    """A file for each table, of a name of its own.

    ``tables`` are those begun, by topic, columns and, where each flight has its own, flight;
    what was lost goes into the file ``account``.
    """

    def __init__(self, folder: Path, form: str, overwrite: bool, *, several: bool) -> None:
        self._folder, self._overwrite, self._several = folder, overwrite, several
        self.table_type = TABLES[form]
        self.account = folder / f'account_{form}.json'
        self.tables: dict[tuple[str, Columns, str], Table] = {}

    def refuse_to_overwrite(self, topic: str, flight: str) -> None:
        """Raise RecordingError where the topic's file exists, before anything is written."""
        if not self.tables:
            self._refuse(self.account)
        of = flight if self.table_type.one_flight else ''
        if not any(known == topic and its == of for known, _, its in self.tables):
            self._free_path(topic, flight)

    def table(self, topic: str, flight: str, columns: Columns, stack: ExitStack) -> Table:
        """The table of a topic's messages with these columns; others have one of their own.

        Raises:
            RecordingError: its file exists, or there are too many.
        """
        key = topic, columns, flight if self.table_type.one_flight else ''
        if key not in self.tables:
            if len(self.tables) == _MAX_TABLES:
                raise RecordingError(f'it would be more than {_MAX_TABLES} tables')
            path = self._free_path(topic, flight)
            self.tables[key] = stack.enter_context(self.table_type(path, columns))
        return self.tables[key]

    def _free_path(self, topic: str, flight: str) -> Path:
        name = re.sub(r'[^\w.-]', '_', topic.strip('/'))[:_MAX_NAME] or 'root'
        inner = f'/{flight}' if self.table_type.one_flight and self._several else ''
        taken = {table.path for table in self.tables.values()}
        path, number = self._folder / f'{name}{inner}.{self.table_type.ending}', 1
        while path in taken:
            number += 1
            path = self._folder / f'{name}_{number}{inner}.{self.table_type.ending}'
        self._refuse(path)
        return path

    def _refuse(self, path: Path) -> None:
        if path.exists() and not self._overwrite:
            raise RecordingError(f'{path} exists; choose another folder, or overwrite it (--force)')
