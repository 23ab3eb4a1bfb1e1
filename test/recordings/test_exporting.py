"""Results as tables and trajectories."""

from __future__ import annotations

import csv
import gc
import math
import sys
import tracemalloc
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.recording_samples import STORE, cdr

from mvuav_ros.processing.messages.markers import encode_markers, encode_rpy
from mvuav_ros.recordings import tables
from mvuav_ros.recordings.errors import RecordingError
from mvuav_ros.recordings.exporting import export as export_flights
from mvuav_ros.recordings.reading import Recording
from mvuav_ros.recordings.serialization.cdr import cdr_header
from mvuav_ros.recordings.writing import RecordingWriter
from mvuav_ros.vision.image import Image
from mvuav_ros.vision.markers.results import MarkerResult
from mvuav_ros.vision.markers.tracker import MarkerTracker

STAMP_NS = 1_700_000_000_123_456_789
POSE = 'geometry_msgs/msg/PoseStamped'


def export(path: Path, *given: Any, **options: Any) -> dict[Path, int]:
    """One flight's."""
    return export_flights({'flight': path}, *given, **options)


def marker_result() -> MarkerResult:
    pixels = np.zeros((480, 640), np.uint8)
    pixels[100:106, 200:206] = 255
    return MarkerTracker().process(Image(pixels, 'mono8'), STAMP_NS)


def pose(x: float) -> bytes:
    types = STORE.types
    stamp = types['builtin_interfaces/msg/Time'](STAMP_NS // 10**9, STAMP_NS % 10**9)
    header = types['std_msgs/msg/Header'](stamp, 'camera')
    place = types['geometry_msgs/msg/Point'](x, 2.0, 3.0)
    turn = types['geometry_msgs/msg/Quaternion'](0.0, 0.0, 0.0, 1.0)
    return cdr(types[POSE](header, types['geometry_msgs/msg/Pose'](place, turn)))


POSE_DATA = pose(0.1)


@pytest.fixture
def results(tmp_path: Path) -> Path:
    path = tmp_path / 'results.mcap'
    header = cdr_header(STAMP_NS, 'camera')
    result = marker_result()
    with RecordingWriter(path) as writer:
        for _ in range(3):
            write = (STAMP_NS, encode_markers(result, header))
            writer.write('/marker_tracker/markers', 'sensor_msgs/msg/PointCloud2', *write)
        roll = (STAMP_NS, encode_rpy(result, header))
        writer.write('/marker_tracker/rpy', 'geometry_msgs/msg/Vector3Stamped', *roll)
        writer.write('/pose', POSE, STAMP_NS, pose(0.1))
        writer.write('/pose', POSE, STAMP_NS, pose(math.nan))
        writer.write('/pose', POSE, STAMP_NS, b'\0\1\0\0damage')
    return path


def test_csv_holds_every_row(results: Path, tmp_path: Path) -> None:
    files = export(results, tmp_path / 'out', 'csv')
    markers = tmp_path / 'out' / 'marker_tracker_markers.csv'
    assert files[markers] == 15
    with markers.open(newline='') as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == 15
    assert {row['stamp_ns'] for row in rows} == {str(STAMP_NS)}
    assert [int(row['label']) for row in rows[:5]] == [0, 1, 2, 3, 4]
    assert files[tmp_path / 'out' / 'pose.csv'] == 2


def test_tables_are_kept_unless_overwritten(results: Path, tmp_path: Path) -> None:
    folder = tmp_path / 'out'
    for file in export(results, folder, 'csv'):
        file.write_text('mine')
    with pytest.raises(RecordingError, match='exists'):
        export(results, folder, 'csv')
    assert all(file.read_text() == 'mine' for file in folder.iterdir())
    assert not any(
        file.read_text() == 'mine' for file in export(results, folder, 'csv', overwrite=True)
    )


def test_tum_holds_known_poses_with_exact_stamps(results: Path, tmp_path: Path) -> None:
    files = export(results, tmp_path / 'out', 'tum')
    assert list(files.values()) == [1]
    (file,) = files
    assert file.read_text() == '1700000000.123456789 0.1 2.0 3.0 0.0 0.0 0.0 1.0\n'


def test_parquet_holds_the_same(results: Path, tmp_path: Path) -> None:
    parquet = pytest.importorskip('pyarrow.parquet')
    export(results, tmp_path / 'out', 'parquet')
    table = parquet.read_table(tmp_path / 'out' / 'marker_tracker_markers.parquet')
    assert table.num_rows == 15
    assert table['stamp_ns'].to_pylist() == [STAMP_NS] * 15
    assert table.column_names[:5] == ['flight', 'stamp_ns', 'stamp', 'row', 'x']


@pytest.mark.parametrize('form', ['csv', 'parquet', 'tum'])
def test_a_flight_of_any_length_takes_no_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, form: str
) -> None:
    if form == 'parquet':
        pytest.importorskip('pyarrow.parquet')
    monkeypatch.setattr(tables, 'ROWS_AT_ONCE', 500)
    count = 8_000
    path = tmp_path / 'results.mcap'
    with RecordingWriter(path) as writer:
        for number in range(count):
            writer.write('/pose', POSE, STAMP_NS + number * 10_000_000, POSE_DATA)
    export(path, tmp_path / 'imports', form)  # the libraries themselves
    tracemalloc.start()
    files = export(path, tmp_path / 'out', form)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert list(files.values()) == [count]
    assert peak < 200 * count


def interrupt_at_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    messages = Recording.messages

    def interrupted(recording: Recording, topics: Any = None) -> Iterator[Any]:
        yield from messages(recording, topics)
        if topics and '/pose' in topics:
            raise KeyboardInterrupt

    monkeypatch.setattr(Recording, 'messages', interrupted)


@pytest.mark.parametrize('form', ['csv', 'parquet', 'tum', 'mot'])
def test_a_run_that_fails_leaves_nothing_in_the_way(
    results: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, form: str
) -> None:
    if form == 'parquet':
        pytest.importorskip('pyarrow.parquet')
    interrupt_at_the_end(monkeypatch)
    with pytest.raises(KeyboardInterrupt):
        export(results, tmp_path / 'out', form)
    assert list((tmp_path / 'out').iterdir()) == []


def test_a_parquet_export_that_fails_says_nothing_more(
    results: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip('pyarrow.parquet')
    said: list[Any] = []
    interrupt_at_the_end(monkeypatch)
    monkeypatch.setattr(tables, 'ROWS_AT_ONCE', 1)
    monkeypatch.setattr(sys, 'unraisablehook', said.append)
    with pytest.raises(KeyboardInterrupt):
        export(results, tmp_path / 'out', 'parquet')
    gc.collect()
    assert said == [] and list((tmp_path / 'out').iterdir()) == []


def test_a_run_that_fails_keeps_what_was_there(
    results: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / 'out'
    before = {file: file.read_bytes() for file in export(results, folder, 'csv')}

    def fail(_table: Any) -> None:
        raise RecordingError('no space')

    monkeypatch.setattr(tables.Csv, '_end', fail)
    with pytest.raises(RecordingError, match='no space'):
        export(results, folder, 'csv', overwrite=True)
    assert {file: file.read_bytes() for file in folder.iterdir()} == before


def test_every_topic_has_a_file_of_its_own(tmp_path: Path) -> None:
    path = tmp_path / 'results.mcap'
    with RecordingWriter(path) as writer:
        for topic in ('/a/b', '/a_b', '/', '/x\0y', '/' + 'z' * 300):
            writer.write(topic, POSE, STAMP_NS, POSE_DATA)
    files = export(path, tmp_path / 'out', 'csv')
    names = [file.stem for file in files]
    assert names == ['a_b', 'a_b_2', 'root', 'x_y', 'z' * 200]
    assert list(files.values()) == [1] * 5
    assert all(file.is_file() for file in files)


def test_nothing_to_export(tmp_path: Path) -> None:
    path = tmp_path / 'empty.mcap'
    RecordingWriter(path).close()
    with pytest.raises(RecordingError, match='nothing that can be exported'):
        export(path, tmp_path / 'out', 'csv')
