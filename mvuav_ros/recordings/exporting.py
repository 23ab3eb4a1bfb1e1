"""Results as tables for other tools: CSV, Parquet, and TUM trajectories for evo."""

from __future__ import annotations

import csv
import json
import re
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from io import TextIOWrapper
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.recordings.errors import MalformedMessageError, RecordingError
from mvuav_ros.recordings.images import decode_message
from mvuav_ros.recordings.reading import open_recording
from mvuav_ros.recordings.recording import RecordedMessage, counted
from mvuav_ros.recordings.remote import write_text
from mvuav_ros.recordings.serialization.messages import stamp_ns_of
from mvuav_ros.recordings.serialization.points import view_points

_NS = 1_000_000_000
POSE_COLUMNS = ('x', 'y', 'z', 'qx', 'qy', 'qz', 'qw')
ACCOUNT = 'account.json'
"""Beside the tables: what could not be read or exported."""

Row = tuple[int | float, ...]
_ROWS_AT_ONCE = 10_000
_LONGEST_NAME = 200
_LONGEST_REASON = 200
_MOST_TABLES = 500


def export(source: Path, folder: Path, form: str, *, overwrite: bool = False) -> dict[Path, int]:
    """Write one file for each topic that can be a table.

    Tables are made of PointCloud2 (markers, lines), Vector3Stamped (roll), PointStamped, and
    poses with and without covariance. TUM has poses only, and of them those that are known.

    Args:
        source: the recording of results.
        folder: where the files go; it is made.
        form: 'csv', 'parquet' or 'tum'.
        overwrite: replace files that exist.

    What was lost is in ``account.json`` beside them: messages that do not decode, too.

    Returns:
        The tables with the number of their rows.

    Raises:
        RecordingError: there is nothing to export, or a file exists.
    """
    tables: dict[_Shape, _Table] = {}
    lost: Counter[tuple[str, str]] = Counter()
    try:
        with open_recording(source) as recording, ExitStack() as stack:
            files = _Files(folder, form, overwrite)
            for topic in recording.topics:  # before anything is written
                if _is_wanted(topic.type, form):
                    files.of(topic.name)
            for message in recording.messages():
                if not _is_wanted(message.type, form):
                    continue
                try:
                    columns, rows = _rows(message)
                except (MalformedMessageError, KeyError, TypeError, ValueError) as error:
                    lost[message.topic, str(error)[:_LONGEST_REASON]] += 1
                    continue
                shape = message.topic, ('stamp_ns', 'row', *columns)
                if shape not in tables:
                    path = files.of(message.topic, taken=any(t == shape[0] for t, _ in tables))
                    folder.mkdir(parents=True, exist_ok=True)
                    tables[shape] = stack.enter_context(_TABLES[form](path, shape[1]))
                tables[shape].add(rows)
            for (name, reason), count in lost.items():
                said = f'{counted(count, "message")} of {name} not exported: {reason}'
                recording.account.lose('export', (name, reason), said, count)
        if tables:
            write_text(str(folder / ACCOUNT), json.dumps(recording.account.record(), indent=2))
    except OSError as error:
        raise RecordingError(f'{folder} cannot be written: {error.strerror or error}') from None
    if not tables:
        raise RecordingError(f'{source} holds nothing that can be exported as {form}')
    return {table.path: table.count for table in tables.values()}


_Shape = tuple[str, tuple[str, ...]]
"""A topic, and its columns: messages of others have a table of their own."""


def _is_wanted(type_name: str, form: str) -> bool:
    return type_name in _READERS and (form != 'tum' or 'Pose' in type_name)


class _Files:
    """A file for each table, of a name of its own."""

    def __init__(self, folder: Path, form: str, overwrite: bool) -> None:
        self._folder, self._form, self._overwrite = folder, form, overwrite
        self._first: dict[str, Path] = {}
        self._taken: set[Path] = set()

    def of(self, topic: str, *, taken: bool = False) -> Path:
        """The topic's file, or another one where that is taken by its messages of another kind.

        Raises:
            RecordingError: it exists, or there are too many.
        """
        if topic in self._first and not taken:
            return self._first[topic]
        name = re.sub(r'[^\w.-]', '_', topic.strip('/'))[:_LONGEST_NAME] or 'root'
        path, number = self._folder / f'{name}.{self._form}', 1
        while path in self._taken:
            number += 1
            path = self._folder / f'{name}_{number}.{self._form}'
        if path.exists() and not self._overwrite:
            raise RecordingError(f'{path} exists; choose another folder, or overwrite it (--force)')
        if len(self._taken) == _MOST_TABLES:
            raise RecordingError(f'it would be more than {_MOST_TABLES} tables')
        self._first.setdefault(topic, path)
        self._taken.add(path)
        return path


def _rows(recorded: RecordedMessage) -> tuple[tuple[str, ...], Iterator[Row]]:
    message = decode_message(recorded.type, recorded.data)
    stamp_ns = stamp_ns_of(message.header)
    columns, values = _READERS[recorded.type](message)
    return columns, ((stamp_ns, number, *row) for number, row in enumerate(values))


def _points(message: Any) -> tuple[tuple[str, ...], Iterator[Row]]:
    points = view_points(message)
    return points.dtype.names or (), _in_blocks(points)


def _in_blocks(points: NDArray[np.void]) -> Iterator[Row]:
    """As Python's numbers, which take ten times the memory: some at a time."""
    for start in range(0, len(points), _ROWS_AT_ONCE):
        yield from points[start : start + _ROWS_AT_ONCE].tolist()


def _vector(message: Any) -> tuple[tuple[str, ...], Iterator[Row]]:
    return ('x', 'y', 'z'), iter([(message.vector.x, message.vector.y, message.vector.z)])


def _point(message: Any) -> tuple[tuple[str, ...], Iterator[Row]]:
    return ('x', 'y', 'z'), iter([(message.point.x, message.point.y, message.point.z)])


def _pose(message: Any) -> tuple[tuple[str, ...], Iterator[Row]]:
    pose = getattr(message.pose, 'pose', message.pose)
    place, turn = pose.position, pose.orientation
    return POSE_COLUMNS, iter([(place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w)])


_READERS: dict[str, Callable[[Any], tuple[tuple[str, ...], Iterator[Row]]]] = {
    'sensor_msgs/msg/PointCloud2': _points,
    'geometry_msgs/msg/Vector3Stamped': _vector,
    'geometry_msgs/msg/PointStamped': _point,
    'geometry_msgs/msg/PoseStamped': _pose,
    'geometry_msgs/msg/PoseWithCovarianceStamped': _pose,
}


class _Table:
    """One topic's file; the first two columns are the stamp (ns) and the row in its message.

    Attributes:
        path: of the file, which is there when all of it is; after an error the one before stays.
        count: of the rows written.
    """

    def __init__(self, path: Path, columns: tuple[str, ...]) -> None:
        self.path = path
        self.count = 0
        self._columns = columns
        self._part = path.with_name(f'.{path.name}.part')
        self._file = self._part.open('wb')

    def __enter__(self) -> _Table:
        return self

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

    def add(self, rows: Iterator[Row]) -> None:
        """Write a message's rows."""
        while block := list(islice(rows, _ROWS_AT_ONCE)):
            self.count += self._write(block)

    def _write(self, rows: list[Row]) -> int:
        raise NotImplementedError

    def _end(self) -> None:
        pass

    def _close(self) -> None:
        self._file.close()


class _Csv(_Table):
    def __init__(self, path: Path, columns: tuple[str, ...]) -> None:
        super().__init__(path, columns)
        self._text = TextIOWrapper(self._file, 'utf-8', newline='', write_through=True)
        self._writer = csv.writer(self._text)
        self._writer.writerow(columns)

    def _write(self, rows: list[Row]) -> int:
        self._writer.writerows(rows)
        return len(rows)

    def _end(self) -> None:
        self._text.flush()


class _Parquet(_Table):
    def __init__(self, path: Path, columns: tuple[str, ...]) -> None:
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
        if len(self._rows) >= _ROWS_AT_ONCE:
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
            self._writer = self._arrow.parquet.ParquetWriter(self._file, table.schema)
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


class _Tum(_Table):
    def _write(self, rows: list[Row]) -> int:
        known = [row for row in rows if all(np.isfinite(row))]
        for stamp_ns, _, *pose in known:
            seconds, rest = divmod(int(stamp_ns), _NS)
            numbers = ' '.join(repr(float(value)) for value in pose)
            self._file.write(f'{seconds}.{rest:09d} {numbers}\n'.encode())
        return len(known)


_TABLES: dict[str, type[_Table]] = {'csv': _Csv, 'parquet': _Parquet, 'tum': _Tum}
