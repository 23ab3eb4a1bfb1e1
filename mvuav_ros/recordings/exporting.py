"""Results as tables for other tools: CSV, Parquet, and TUM trajectories for evo."""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

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


class Table(NamedTuple):
    """One topic's rows; the first two columns are the stamp (ns) and the row in its message."""

    columns: tuple[str, ...]
    rows: list[Row]


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
    write = _WRITERS[form]
    with open_recording(source) as recording:
        tables = _tables(recording, form)
    if not tables:
        raise RecordingError(f'{source} holds nothing that can be exported as {form}')
    files = {folder / f'{topic.strip("/").replace("/", "_")}.{form}': topic for topic in tables}
    for path in files:
        if path.exists() and not overwrite:
            raise RecordingError(f'{path} exists; choose another folder, or overwrite it (--force)')
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for path, topic in files.items():
            write(path, tables[topic])
    except OSError as error:
        raise RecordingError(f'{folder} cannot be written: {error.strerror or error}') from None
    return {path: len(tables[topic].rows) for path, topic in files.items()}


def _tables(recording: Recording, form: str) -> dict[str, Table]:
    kinds = {topic.name: topic.type for topic in recording.topics if topic.type in _READERS}
    if form == 'tum':
        kinds = {name: kind for name, kind in kinds.items() if 'Pose' in kind}
    tables: dict[str, Table] = {}
    for message in recording.messages(kinds):
        if message.type != kinds[message.topic]:
            continue
        try:
            columns, rows = _rows(message)
        except (MalformedMessageError, KeyError, TypeError, ValueError):
            continue
        table = tables.setdefault(message.topic, Table(('stamp_ns', 'row', *columns), []))
        if table.columns[2:] == columns:
            table.rows.extend(rows)
    return tables


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


def _write_csv(path: Path, table: Table) -> None:
    with path.open('w', newline='', encoding='utf-8') as stream:
        writer = csv.writer(stream)
        writer.writerow(table.columns)
        writer.writerows(table.rows)


def _write_parquet(path: Path, table: Table) -> None:
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError as error:
        raise RecordingError(
            f'parquet needs PyArrow: pip install "mvuav_ros[parquet]" ({error})'
        ) from error
    columns = zip(*table.rows, strict=True) if table.rows else ([] for _ in table.columns)
    content = {name: list(values) for name, values in zip(table.columns, columns, strict=True)}
    pyarrow.parquet.write_table(pyarrow.table(content), path)


def _write_tum(path: Path, table: Table) -> None:
    with path.open('w', encoding='utf-8') as stream:
        for stamp_ns, _, *pose in table.rows:
            if all(np.isfinite(pose)):
                seconds, rest = divmod(int(stamp_ns), _NS)
                numbers = ' '.join(repr(float(value)) for value in pose)
                stream.write(f'{seconds}.{rest:09d} {numbers}\n')


_WRITERS: dict[str, Callable[[Path, Table], None]] = {
    'csv': _write_csv,
    'parquet': _write_parquet,
    'tum': _write_tum,
}
