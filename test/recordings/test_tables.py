"""Results as tables and trajectories."""

from __future__ import annotations

import csv
import gc
import itertools
import json
import math
import re
import sys
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.commands import mvuav
from support.hostile_recordings import GOOD_CLOUD, cloud, write_clouds
from support.recording_samples import STORE, Sample, cdr, mcap_ends, pose_sample, write_mcap

from mvuav_ros.messages.cdr import PointLayout, cdr_header, stamped_doubles, view_points
from mvuav_ros.messages.marker_messages import encode_markers, encode_rpy
from mvuav_ros.messages.untrusted import MalformedMessageError
from mvuav_ros.recordings import result_rows, tables
from mvuav_ros.recordings.account import RecordingError
from mvuav_ros.recordings.tables import Csv
from mvuav_ros.recordings.tables import export as export_flights
from mvuav_ros.recordings.writing import RecordingWriter
from mvuav_ros.vision.image import Image
from mvuav_ros.vision.markers.marker_results import MarkerResult
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


def pose(x: float, turned: tuple[float, ...] = (0.0, 0.0, 0.0, 1.0)) -> bytes:
    types = STORE.types
    stamp = types['builtin_interfaces/msg/Time'](STAMP_NS // 10**9, STAMP_NS % 10**9)
    header = types['std_msgs/msg/Header'](stamp, 'camera')
    place = types['geometry_msgs/msg/Point'](x, 2.0, 3.0)
    turn = types['geometry_msgs/msg/Quaternion'](*turned)
    return cdr(types[POSE](header, types['geometry_msgs/msg/Pose'](place, turn)))


POSE_DATA = pose(0.1)


def interrupted_after(count: int) -> Callable[[Any], Any]:
    rows, calls = result_rows.ResultRows.of, itertools.count(1)

    def read(self: Any, message: Any) -> Any:
        if next(calls) > count:
            raise KeyboardInterrupt
        return rows(self, message)

    return read


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
    assert all(file.read_text() == 'mine' for file in folder.glob('*.csv'))
    assert not any(
        file.read_text() == 'mine' for file in export(results, folder, 'csv', overwrite=True)
    )


def test_what_was_lost_in_another_export_is_not_overwritten(results: Path, tmp_path: Path) -> None:
    folder = tmp_path / 'out'
    export(results, folder, 'csv')
    before = account(folder)
    assert before['lost'] == 1
    export(results, folder, 'tum')
    assert account(folder) == before
    # Of a flight with other topics, too.
    poses = write_mcap(tmp_path / 'poses.mcap', [sample_pose(0)])
    with pytest.raises(RecordingError, match=r'account_csv\.json exists'):
        export(poses, folder, 'csv')
    assert account(folder) == before


def foreign(path: Path, fields: str, row: tuple[float, ...]) -> Path:
    """A cloud of another program on a topic named as ours."""
    dtype = np.dtype([(name, 'f4') for name in fields.split()])
    data = PointLayout(dtype).encode([row], cdr_header(STAMP_NS, 'lidar'))
    with RecordingWriter(path) as writer:
        writer.write('/lidar/markers', 'sensor_msgs/msg/PointCloud2', STAMP_NS, data)
    return path


def test_clouds_of_other_programs_are_no_markers(tmp_path: Path) -> None:
    points = foreign(tmp_path / 'points.mcap', 'x y z', (1.0, 2.0, 3.0))
    with pytest.raises(RecordingError, match='nothing that can be exported as mot'):
        export(points, tmp_path / 'mot', 'mot')
    odd = foreign(tmp_path / 'odd.mcap', 'x y label state', (1.0, 2.0, math.nan, math.inf))
    (table,) = export(odd, tmp_path / 'csv', 'csv')
    (row,) = csv.DictReader(table.open())
    assert (row['label'], row['name'], row['state_name']) == ('nan', '', '')


def test_two_exports_of_one_file_at_the_same_time_do_not_mix(tmp_path: Path) -> None:
    path = tmp_path / 'roll.csv'
    with Csv(path, ('x',)) as first:
        first.add([(n,) for n in range(9_000)])
        with Csv(path, ('x',)) as second:
            second.add([(-1,)])
        assert path.read_text().split() == ['x', '-1']
    assert path.read_text().split() == ['x', *map(str, range(9_000))]
    assert [*tmp_path.iterdir()] == [path]


def test_mot_has_lights_by_their_numbers(tmp_path: Path) -> None:
    plain = foreign(tmp_path / 'any.mcap', 'x y label state area', (10.0, 20.0, 255.0, 1.0, 9.0))
    (table,) = export(plain, tmp_path / 'any', 'mot')
    assert table.read_text() == '1,-1,10.000,20.000,3.000,3.000,1,-1,-1,-1\n'
    fields, row = 'x y label state area id confidence', (10.0, 20.0, 255.0, 1.0, 9.0, 7.0, math.nan)
    path = foreign(tmp_path / 'lights.mcap', fields, row)
    (table,) = export(path, tmp_path / 'out', 'mot')
    assert table.read_text() == '1,7,10.000,20.000,3.000,3.000,1,-1,-1,-1\n'
    nowhere = foreign(tmp_path / 'nowhere.mcap', fields, (math.nan, *row[1:]))
    assert list(export(nowhere, tmp_path / 'other', 'mot').values()) == [0]


def test_tum_holds_known_poses_with_exact_stamps(results: Path, tmp_path: Path) -> None:
    files = export(results, tmp_path / 'out', 'tum')
    assert list(files.values()) == [1]
    (file,) = files
    assert file.read_text() == '1700000000.123456789 0.1 2.0 3.0 0.0 0.0 0.0 1.0\n'


def test_times_of_tum_rise_before_1970_too(tmp_path: Path) -> None:
    stamps = [-1_966_666_667, -1, 1]
    samples = [
        Sample('/pose', POSE, 1, stamped_doubles(cdr_header(stamp_ns, 'camera'), *range(7)))
        for stamp_ns in stamps
    ]
    (file,) = export(write_mcap(tmp_path / 'a.mcap', samples), tmp_path / 'out', 'tum')
    times = [line.split()[0] for line in file.read_text().splitlines()]
    assert times == ['-1.966666667', '-0.000000001', '0.000000001']


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


@pytest.mark.parametrize('form', ['csv', 'parquet', 'tum'])
def test_a_run_that_fails_leaves_nothing_in_the_way(
    results: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, form: str
) -> None:
    if form == 'parquet':
        pytest.importorskip('pyarrow.parquet')
    monkeypatch.setattr(result_rows.ResultRows, 'of', interrupted_after(1))
    with pytest.raises(KeyboardInterrupt):
        export(results, tmp_path / 'out', form)
    assert list((tmp_path / 'out').iterdir()) == []


def test_a_parquet_export_that_fails_says_nothing_more(
    results: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip('pyarrow.parquet')
    said: list[Any] = []
    monkeypatch.setattr(result_rows.ResultRows, 'of', interrupted_after(1))
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
    export(results, folder, 'csv')
    before = {file: file.read_bytes() for file in folder.iterdir()}

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


def account(folder: Path) -> dict[str, Any]:
    content: dict[str, Any] = json.loads((folder / 'account_csv.json').read_text())
    return content


def test_messages_that_do_not_decode_are_counted(results: Path, tmp_path: Path) -> None:
    run = mvuav('export', results, '-o', tmp_path / 'out')
    assert run.status == 0 and '7 kept, 1 lost' in run.err
    assert '1 message of /pose not exported' in run.err
    assert account(tmp_path / 'out')['lost'] == 1
    strict = mvuav('export', results, '-o', tmp_path / 'out', '--force', '--strict', '--json')
    assert strict.status == 1 and '--strict' in strict.error
    (said,) = json.loads(strict.out)['accounts']
    assert (said['kept'], said['lost'], said['is_exact']) == (7, 1, True)
    # One of several is enough.
    sound = write_mcap(tmp_path / 'sound.mcap', [pose_sample(0)])
    several = mvuav('export', sound, results, '-o', tmp_path / 'both', '--strict')
    assert several.status == 1 and '--strict' in several.error


def test_messages_of_a_recording_that_is_cut_are_counted(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / 'a.mcap', [sample_pose(n) for n in range(400)])
    content = bytearray(path.read_bytes())
    content[mcap_ends(path)[0] - 500] ^= 0xFF
    path.write_bytes(content)
    files = export(path, tmp_path / 'out', 'csv')
    lost = account(tmp_path / 'out')['lost']
    assert lost > 0 and sum(files.values()) + lost == 400


def sample_pose(number: int) -> Sample:
    return Sample('/pose', POSE, STAMP_NS + number, POSE_DATA)


def test_kinds_of_messages_of_one_topic_have_tables_of_their_own(tmp_path: Path) -> None:
    path = tmp_path / 'a.mcap'
    with RecordingWriter(path) as writer:
        for number in range(3):
            writer.write('/a', POSE, STAMP_NS + number, POSE_DATA)
        for data in (GOOD_CLOUD, cloud([('z', 0, 7)], 4, bytes(4)), GOOD_CLOUD):
            writer.write('/a', 'sensor_msgs/msg/PointCloud2', STAMP_NS, data)
    files = export(path, tmp_path / 'out', 'csv')
    assert {file.name: rows for file, rows in files.items()} == {
        'a.csv': 3, 'a_2.csv': 4, 'a_3.csv': 1
    }  # fmt: skip
    assert account(tmp_path / 'out')['lost'] == 0


@pytest.mark.parametrize(
    'bad',
    [
        cloud([(f'f{n}', 0, 2) for n in range(200)], 1, bytes(300_000)),
        cloud([('x', 0xFFFF_FFFF, 7)], 8, bytes(16)),
        cloud([('x', 0, 7), ('x', 4, 7)], 8, bytes(16)),
        cloud([('x', 0, 99)], 8, bytes(16)),
        cloud([('x', 0, 7)], 0, bytes(16)),
    ],
    ids=['over each other', 'far away', 'one name', 'no number', 'no step'],
)
def test_a_bad_cloud_costs_itself(tmp_path: Path, bad: bytes) -> None:
    path = write_clouds(tmp_path / 'a.mcap', GOOD_CLOUD, bad, GOOD_CLOUD)
    assert list(export(path, tmp_path / 'out', 'csv').values()) == [4]
    assert account(tmp_path / 'out')['lost'] == 1


def test_a_cloud_beyond_the_last_byte(tmp_path: Path) -> None:
    class Field:
        name, datatype, count, offset = 'x', 7, 1, 1 << 70

    class Cloud:
        fields, point_step, width, height, data = [Field], 8, 1, 1, bytes(8)
        is_bigendian = False

    with pytest.raises(MalformedMessageError):
        view_points(Cloud)


def test_angles_are_those_of_the_rotation_whatever_the_quaternions_length(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / 'a.mcap') as writer:
        for turned in ((0.51, 0.0, 0.0, 0.88), (0.0, 0.0, 0.0, 0.0)):
            writer.write('/pose', POSE, STAMP_NS, pose(0.1, turned))
    (file,) = export(tmp_path / 'a.mcap', tmp_path / 'out', 'csv')
    rounded, none = (float(row['roll']) for row in csv.DictReader(file.open()))
    assert rounded == pytest.approx(2.0 * math.atan2(0.51, 0.88)) and math.isnan(none)


def test_a_large_cloud_takes_no_memory(tmp_path: Path) -> None:
    data = cloud([(f'f{n}', n, 2) for n in range(200)], 200, bytes(10_000_000))
    path = write_clouds(tmp_path / 'a.mcap', data)
    tracemalloc.start()
    assert list(export(path, tmp_path / 'out', 'csv').values()) == [50_000]
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 90 << 20


def test_names_of_topics_are_no_paths_and_no_controls(tmp_path: Path) -> None:
    path = tmp_path / 'a.mcap'
    with RecordingWriter(path) as writer:
        writer.write('/../\x1b[2Ja\u202eb c\n', POSE, STAMP_NS, POSE_DATA)
    (file,) = export(path, tmp_path / 'out', 'csv')
    assert re.fullmatch(r'[\w.-]+', file.name)
    assert file.parent == tmp_path / 'out'
