"""Results as tables for other tools: CSV, Parquet, and TUM trajectories for evo."""

from __future__ import annotations

import csv
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack
from io import TextIOWrapper
from pathlib import Path
from typing import Any

import numpy as np

from mvuav_ros.recordings.errors import MalformedMessageError, RecordingError
from mvuav_ros.recordings.images import decode_message
from mvuav_ros.recordings.reading import Recording, open_recording
from mvuav_ros.recordings.recording import RecordedMessage
from mvuav_ros.recordings.serialization.messages import stamp_ns_of

_NS = 1_000_000_000
POSE_COLUMNS = ('x', 'y', 'z', 'qx', 'qy', 'qz', 'qw')
_NUMBERS = {1: 'i1', 2: 'u1', 3: 'i2', 4: 'u2', 5: 'i4', 6: 'u4', 7: 'f4', 8: 'f8'}
"""NumPy's names of sensor_msgs/PointField's datatypes."""

Row = tuple[int | float, ...]
_ROWS_AT_ONCE = 10_000
_LONGEST_NAME = 200


def export(source: Path, folder: Path, form: str, *, overwrite: bool = False) -> dict[Path, int]:
    """Write one file for each topic that can be a table.

    Tables are made of PointCloud2 (markers, lines), Vector3Stamped (roll), PointStamped, and
    poses with and without covariance. TUM has poses only, and of them those that are known.

    Args:
        source: the recording of results.
        folder: where the files go; it is made.
        form: 'csv', 'parquet' or 'tum'.
        overwrite: replace files that exist.

    Returns:
        The files with the number of their rows.

    Raises:
        RecordingError: there is nothing to export, or a file exists.
    """
    tables: dict[str, _Table] = {}
    try:
        with open_recording(source) as recording, ExitStack() as stack:
            kinds = {topic.name: topic.type for topic in recording.topics if topic.type in _READERS}
            if form == 'tum':
                kinds = {name: kind for name, kind in kinds.items() if 'Pose' in kind}
            files = _files(folder, kinds, form)
            for path in files.values():
                if path.exists() and not overwrite:
                    raise RecordingError(
                        f'{path} exists; choose another folder, or overwrite it (--force)'
                    )
            for topic, columns, rows in _contents(recording, kinds):
                if topic not in tables:
                    folder.mkdir(parents=True, exist_ok=True)
                    tables[topic] = _TABLES[form](files[topic], ('stamp_ns', 'row', *columns))
                    stack.enter_context(tables[topic])
                tables[topic].add(('stamp_ns', 'row', *columns), rows)
    except OSError as error:
        raise RecordingError(f'{folder} cannot be written: {error.strerror or error}') from None
    if not tables:
        raise RecordingError(f'{source} holds nothing that can be exported as {form}')
    return {table.path: table.count for table in tables.values()}


def _files(folder: Path, topics: Iterable[str], form: str) -> dict[str, Path]:
    """A file for each topic, of a name of its own."""
    files: dict[str, Path] = {}
    for topic in topics:
        name = re.sub(r'[/\0]', '_', topic.strip('/'))[:_LONGEST_NAME] or 'root'
        path, number = folder / f'{name}.{form}', 1
        while path in files.values():
            number += 1
            path = folder / f'{name}_{number}.{form}'
        files[topic] = path
    return files


def _contents(
    recording: Recording, kinds: Mapping[str, str]
) -> Iterator[tuple[str, tuple[str, ...], list[Row]]]:
    """Each message's topic, columns and rows."""
    for message in recording.messages(kinds):
        if message.type != kinds[message.topic]:
            continue
        try:
            columns, rows = _rows(message)
        except (MalformedMessageError, KeyError, TypeError, ValueError):
            continue
        yield message.topic, columns, rows


def _rows(recorded: RecordedMessage) -> tuple[tuple[str, ...], list[Row]]:
    message = decode_message(recorded.type, recorded.data)
    stamp_ns = stamp_ns_of(message.header)
    columns, values = _READERS[recorded.type](message)
    return columns, [(stamp_ns, number, *row) for number, row in enumerate(values)]


def _points(message: Any) -> tuple[tuple[str, ...], Iterator[Row]]:
    names = tuple(field.name for field in message.fields)
    dtype = np.dtype(
        {
            'names': names,
            'formats': [_NUMBERS[field.datatype] for field in message.fields],
            'offsets': [field.offset for field in message.fields],
            'itemsize': message.point_step,
        }
    )
    points = np.frombuffer(message.data, dtype, count=message.width * message.height)
    return names, iter(points.tolist())


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

    def add(self, columns: tuple[str, ...], rows: list[Row]) -> None:
        """Write a message's rows; those of other columns are left out."""
        if columns == self._columns:
            self.count += self._write(rows)

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
