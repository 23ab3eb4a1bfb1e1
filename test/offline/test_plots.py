"""Tables and pictures of several flights, as `mvuav export` makes them."""

from __future__ import annotations

import csv
import dataclasses
import math
import os
import tracemalloc
from collections.abc import Callable, Iterable
from pathlib import Path

import cv2
import numpy as np
import pytest
from matplotlib.figure import Figure
from support.commands import mvuav

from mvuav_ros.messages import marker_messages, runway_messages
from mvuav_ros.messages.cdr import PointLayout, cdr_header, stamped_doubles
from mvuav_ros.messages.marker_messages import encode_marker, encode_markers
from mvuav_ros.offline.plots import (
    Curves,
    Diagram,
    FlightPlot,
    _draw,
    _summarise,
    collect,
    overview,
    page,
)
from mvuav_ros.recordings.reading import open_recording
from mvuav_ros.recordings.writing import RecordingWriter
from mvuav_ros.vision.image import Image
from mvuav_ros.vision.markers.marker_results import MarkerState
from mvuav_ros.vision.markers.tracker import MarkerTracker
from mvuav_ros.vision.rig import parse_rig

FRAMES = (6, 9)
CLOUD, POINT = 'sensor_msgs/msg/PointCloud2', 'geometry_msgs/msg/PointStamped'


@pytest.fixture(scope='module')
def season(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results of two flights of a tanker that begin at the same time, and one of a runway."""
    folder = tmp_path_factory.mktemp('season')
    for number, frames in enumerate(FRAMES):
        given = ('--frames', frames, '--seed', number, '--motion', 'still')
        flight = folder / 'flights' / f'flight_{number}.mcap'
        assert mvuav('simulate', 'tanker', '-o', flight, *given).status == 0
    runway = folder / 'flights' / 'approach.mcap'
    assert mvuav('simulate', 'runway', '-o', runway, '--frames', 5, '--size', '320x240').status == 0
    run = mvuav(
        'replay', folder / 'flights', '-o', folder / 'results',
        *('--param', 'runway_detector:mode:=approach'),
        *('--param', 'runway_detector:runway_width:=30.0'),
    )  # fmt: skip
    assert run.status == 0
    return folder / 'results'


@pytest.fixture(scope='module')
def tables(season: Path) -> Path:
    out = season.parent / 'tables'
    run = mvuav('export', season, '-o', out, '--plot')
    assert run.status == 0
    return out


DARK = MarkerTracker().process(Image(np.zeros((48, 64), np.uint8), 'mono8'), 0)
LIGHTS = PointLayout(marker_messages.POINT).encode
LINES = PointLayout(runway_messages.LINE).encode


def drawn_of(
    path: Path, stamps_ns: Iterable[int], encode: Callable[[int, bytes], bytes]
) -> FlightPlot:
    """What is drawn of markers: ``encode`` has a frame's number and its header."""
    with RecordingWriter(path) as writer:
        for number, stamp_ns in enumerate(stamps_ns):
            data = encode(number, cdr_header(stamp_ns, 'camera'))
            writer.write('/marker_tracker/markers', CLOUD, stamp_ns, data)
    with open_recording(path) as recording:
        return collect(recording, 'flight')


def read(path: Path) -> list[dict[str, str]]:
    with path.open(newline='') as stream:
        return list(csv.DictReader(stream))


def test_one_table_has_all_flights(tables: Path) -> None:
    rows = [row for row in read(tables / 'marker_tracker_rpy.csv') if row['flight'] != 'approach']
    assert [row['flight'] for row in rows] == ['flight_0'] * 6 + ['flight_1'] * 9
    for name in ('flight_0', 'flight_1'):
        stamps = [int(row['stamp_ns']) for row in rows if row['flight'] == name]
        assert stamps == sorted(stamps)
    for row in rows:
        assert float(row['stamp']) == pytest.approx(int(row['stamp_ns']) * 1e-9)
        assert float(row['roll_deg']) == pytest.approx(math.degrees(float(row['roll'])))


def test_poses_have_angles_and_covariances(tables: Path) -> None:
    poses = read(tables / 'marker_tracker_pose.csv')
    angles = {(r['flight'], r['stamp_ns']): r for r in read(tables / 'marker_tracker_rpy.csv')}
    known = [row for row in poses if math.isfinite(float(row['z']))]
    assert len(known) >= 12
    for row in known:
        same = angles[row['flight'], row['stamp_ns']]
        assert float(row['pitch']) == pytest.approx(float(same['pitch']), abs=1e-9)
        assert float(row['yaw_deg']) == pytest.approx(float(same['yaw_deg']), abs=1e-7)
        assert 0 < float(row['cov_z_z']) < 1 and 0 < float(row['cov_rx_rx']) < 0.1
    runway = read(tables / 'runway_detector_pose.csv')
    assert any(20 < float(row['z']) < 80 and float(row['cov_y_y']) > 0 for row in runway)
    lines = read(tables / 'runway_detector_line_params.csv')
    edge = next(row for row in lines if row['role_name'] == 'left_edge' and row['theta'] != 'nan')
    assert float(edge['theta_deg']) == pytest.approx(math.degrees(float(edge['theta'])))


def test_protection_levels_have_numbers_and_a_state(tables: Path) -> None:
    rows = read(tables / 'marker_tracker_integrity.csv')
    known = [row for row in rows if row['state'] == 'available']
    assert len(known) >= 12
    poses = {(r['flight'], r['stamp_ns']): r for r in read(tables / 'marker_tracker_pose.csv')}
    for row in known:
        variance = float(poses[row['flight'], row['stamp_ns']]['cov_z_z'])
        assert float(row['along']) > 3 * math.sqrt(variance)
        assert row['alert_limit_along'] == 'nan' and float(row['risk']) == 1e-7
    runway = read(tables / 'runway_detector_integrity.csv')
    assert {row['state'] for row in runway} <= {'available', 'not available'}
    assert all(row['reason'] for row in runway if row['state'] == 'not available')


def test_markers_have_names_and_states(tables: Path) -> None:
    rows = [r for r in read(tables / 'marker_tracker_markers.csv') if r['flight'] == 'flight_0'][:5]
    assert [row['name'] for row in rows] == [
        'left_wing', 'left_stabilizer', 'rudder', 'right_stabilizer', 'right_wing'
    ]  # fmt: skip
    assert {row['state_name'] for row in rows} == {'detected'}


@pytest.mark.parametrize(
    ('in_sight', 'names'), [(((1, 2), (0, 1, 2)), ['nose', 'left', 'right', '']), (((),), [''] * 4)]
)
def test_names_of_another_rig_are_those_of_its_topics(
    tmp_path: Path, in_sight: tuple[tuple[int, ...], ...], names: list[str]
) -> None:
    """Also where the first one is seen late; a marker that is never seen has none."""
    markers = {'nose': [0, 0, 0], 'left': [0, 1, 0], 'right': [0.2, -1.5, 0], 'top': [0, 0, 2]}
    rig = parse_rig({'markers': markers})
    result = MarkerTracker(rig=rig).process(Image(np.zeros((48, 64), np.uint8), 'mono8'), 0)
    path = tmp_path / 'results.mcap'
    with RecordingWriter(path) as writer:
        for index, seen in enumerate(in_sight):
            shown = [
                m._replace(x=10.1 + 7 * m.label, y=20.3, state=MarkerState.DETECTED)
                if m.label in seen
                else m
                for m in result.markers
            ]
            header = cdr_header(index, 'camera')
            frame = dataclasses.replace(result, markers=shown)
            writer.write('/ns/marker_tracker/markers', CLOUD, index, encode_markers(frame, header))
            for label in seen:
                topic = f'/ns/marker_tracker/marker/{rig.names[label]}'
                writer.write(topic, POINT, index, encode_marker(shown[label], header))
    assert mvuav('export', path, '-o', tmp_path / 'out').status == 0
    rows = read(tmp_path / 'out' / 'ns_marker_tracker_markers.csv')
    assert [row['name'] for row in rows] == names * len(in_sight)


@pytest.mark.parametrize(
    ('form', 'topic', 'ending'), [('tum', 'pose', 'tum'), ('mot', 'markers', 'txt')]
)
def test_trajectories_have_a_file_for_each_flight(
    season: Path, tmp_path: Path, form: str, topic: str, ending: str
) -> None:
    assert mvuav('export', season, '-o', tmp_path / 'out', '--format', form).status == 0
    folder = tmp_path / 'out' / f'marker_tracker_{topic}'
    assert {path.name for path in folder.iterdir()} >= {f'flight_{n}.{ending}' for n in (0, 1)}
    lines = [line.split(',') for line in (folder / f'flight_1.{ending}').read_text().splitlines()]
    if form == 'mot':
        assert {int(line[0]) for line in lines} == set(range(1, 10))
        assert {int(line[1]) for line in lines} == {1, 2, 3, 4, 5}
        assert all(len(line) == 10 and line[7:] == ['-1'] * 3 for line in lines)
    else:
        assert all(len(line[0].split()) == 8 for line in lines)


def test_every_flight_has_a_page_and_there_is_an_overview(tables: Path) -> None:
    names = {'approach.png', 'flight_0.png', 'flight_1.png', 'overview.png'}
    assert {path.name for path in (tables / 'plots').iterdir()} == names
    for name in names:
        assert cv2.imread(str(tables / 'plots' / name)).std() > 10


def test_a_page_draws_what_is_in_the_results(season: Path) -> None:
    with open_recording(season / 'flight_1.mcap') as recording:
        flight = collect(recording, 'flight_1')
    tracker = next(part for part in flight.parts if not part.is_runway)
    assert (tracker.frames, tracker.poses) == (9, 9)
    assert np.array(tracker.states).shape == (9, 5)
    axes = {axis.get_ylabel(): axis for axis in page(flight).figure.axes}
    roll = axes['roll [°]'].lines[0].get_ydata()
    assert len(roll) == 9 and np.isfinite(roll).all()
    assert axes['distance ahead [m]'].collections, 'the bounds'


def test_a_long_flight_is_drawn_by_its_extremes_in_little_memory() -> None:
    tracemalloc.start()
    curves = Curves(('wave', 'nothing'), 90_000)
    for index in range(90_000):
        curves.add(index / 30, {'wave': 1e6 if index == 71_234 else math.sin(index)})
    drawn = curves.by_name()
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert len(drawn['seconds'][0]) <= 3000 and peak < 3 << 20
    # One frame of 90,000 that stands out is on the page.
    assert np.nanmax(drawn['wave'][2]) == 1e6
    assert np.isnan(drawn['nothing'][0]).all()


def test_the_curve_of_a_long_flight_goes_through_what_was_said() -> None:
    """An angle may jump between the two ends of its range in every frame."""
    curves = Curves(('theta', 'sometimes'), 9_000)
    for index in range(9_000):
        of = {'theta': 89.0 if index % 2 else -89.0}
        curves.add(index / 30, of | ({'sometimes': float(index)} if index % 3 == 0 else {}))
    drawn = curves.by_name()
    assert set(np.abs(drawn['theta'][0])) == {89.0}
    assert (drawn['theta'][1] == -89.0).all() and (drawn['theta'][2] == 89.0).all()
    assert drawn['sometimes'][0].tolist() == list(range(0, 9_000, 3))
    np.testing.assert_allclose(drawn['seconds'][0] * 30, np.arange(1, 9_000, 3))


def test_what_cannot_be_drawn_is_one_line_and_nothing_is_overwritten(
    season: Path, tables: Path, tmp_path: Path
) -> None:
    before = {path: path.stat().st_mtime_ns for path in tables.rglob('*')}
    assert 'exists' in mvuav('export', season, '-o', tables, '--plot').error
    assert {path: path.stat().st_mtime_ns for path in tables.rglob('*')} == before
    (tmp_path / 'empty').mkdir()
    assert 'holds no recording' in mvuav('export', tmp_path / 'empty', '-o', tmp_path / 'o').error
    twin = tmp_path / 'flight_0.mcap'
    twin.write_bytes((season / 'flight_0.mcap').read_bytes())
    error = mvuav('export', season, twin, '-o', tmp_path / 'o').error
    assert 'would both become flight_0' in error
    assert not (tmp_path / 'o').exists()


def test_tables_and_pictures_may_lie_beside_the_results(season: Path, tmp_path: Path) -> None:
    for flight in ('flight_0.mcap', 'flight_1.mcap'):
        (tmp_path / flight).write_bytes((season / flight).read_bytes())
    for _ in range(2):
        assert mvuav('export', tmp_path, '-o', tmp_path, '--plot', '--force').status == 0
    assert len(list((tmp_path / 'plots').iterdir())) == 3


def test_a_flight_may_be_called_overview(season: Path, tmp_path: Path) -> None:
    results = tmp_path / 'overview.mcap'
    results.write_bytes((season / 'flight_0.mcap').read_bytes())
    run = mvuav('export', results, '-o', tmp_path / 'out', '--plot')
    assert run.status == 0
    names = {path.name for path in (tmp_path / 'out' / 'plots').iterdir()}
    assert names == {'overview.png', 'overview_of_all.png'}


def test_a_flight_without_results_to_draw_does_not_keep_the_others_from_a_page(
    season: Path, tmp_path: Path
) -> None:
    bare = tmp_path / 'bare.mcap'
    with RecordingWriter(bare) as writer:
        writer.write(
            '/aim', POINT, 10**9, stamped_doubles(cdr_header(10**9, 'nose'), 1.0, 2.0, 0.0)
        )
    run = mvuav('export', bare, season / 'flight_0.mcap', '-o', tmp_path / 'out', '--plot')
    assert run.status == 0
    assert f'note: {bare} holds no results that can be drawn' in run.err
    plots = tmp_path / 'out' / 'plots'
    assert {path.name for path in plots.iterdir()} == {'flight_0.png', 'overview.png'}
    assert 'bare' not in run.out


@pytest.mark.parametrize('kind', ['markers', 'line_params'])
def test_other_programs_topics_of_that_name_are_not_drawn(
    season: Path, tmp_path: Path, kind: str
) -> None:
    path = tmp_path / 'flight.mcap'
    cloud = PointLayout(np.dtype([('x', 'f4'), ('y', 'f4'), ('z', 'f4')])).encode
    with RecordingWriter(path) as writer:
        writer.write(f'/lidar/{kind}', CLOUD, 10**9, cloud([(1, 2, 3)], cdr_header(10**9, 'l')))
    run = mvuav('export', path, '-o', tmp_path / 'alone', '--plot')
    assert 'holds no results that can be drawn' in run.error
    with open_recording(season / 'flight_0.mcap') as other, RecordingWriter(path, True) as writer:
        for message in other.messages():
            writer.write(*message)
        writer.write(f'/lidar/{kind}', CLOUD, 10**9, cloud([(1, 2, 3)], cdr_header(10**9, 'l')))
    with open_recording(path) as recording:
        nodes = {part.node for part in collect(recording, 'flight').parts}
    assert 'marker_tracker' in nodes and 'lidar' not in nodes


def test_the_time_begins_at_the_first_frame_whatever_its_stamp(tmp_path: Path) -> None:
    stamps = range(0, 600_000_000, 100_000_000)
    flight = drawn_of(tmp_path / 'video.mcap', stamps, lambda _, head: encode_markers(DARK, head))
    assert flight.seconds == pytest.approx(0.5)
    assert flight.parts[0].times == pytest.approx([0.0, 0.1, 0.2, 0.3, 0.4, 0.5])


def test_every_loss_of_one_frame_is_seen_on_the_page_of_a_long_flight(tmp_path: Path) -> None:
    seen = [m._replace(x=9.0, y=9.0, state=MarkerState.DETECTED) for m in DARK.markers]
    bright = dataclasses.replace(DARK, markers=seen)

    def encode(number: int, header: bytes) -> bytes:
        return encode_markers(DARK if number % 401 == 300 else bright, header)

    stamps = (number * 33_000_000 for number in range(2900))
    figure = page(drawn_of(tmp_path / 'flight.mcap', stamps, encode)).figure
    figure.savefig(tmp_path / 'page.png')
    left, low, right, _ = figure.axes[-1].get_window_extent().extents.round().astype(int)
    row = cv2.imread(str(tmp_path / 'page.png'))[-low - 9, left + 2 : right - 2]
    is_grey = row[:, 0].astype(int) > 190
    assert np.count_nonzero(np.diff(is_grey.astype(int)) == 1) == 7


def test_frames_without_a_light_are_drawn_as_zero_lights(tmp_path: Path) -> None:
    counts, light = (0, 2, 0, 1, 0), (1.0,) * 8 + (255, 1, 1.0)
    stamps = range(0, 5 * 10**9, 10**9)
    flight = drawn_of(
        tmp_path / 'flight.mcap', stamps, lambda n, head: LIGHTS([light] * counts[n], head)
    )
    (part,) = flight.parts
    assert (part.frames, flight.seconds) == (5, 4.0)
    assert part.curves['markers'].by_name()['lights'][0].tolist() == [0, 2, 0, 1, 0]
    _summarise(flight)
    (axis,) = overview([flight]).figure.axes
    assert axis.get_xlabel() == 'lights without names: least, median, greatest'
    assert [line.get_xdata().tolist() for line in axis.lines] == [[0, 2], [0]]


@pytest.mark.parametrize(
    ('roles', 'names'),
    [
        ((0,) * 6, [f'line {number}' for number in range(1, 7)]),
        ((1, 2, 3, 4, 5), ['left edge', 'right edge', 'centreline', 'far end', 'near end']),
    ],
)
def test_every_line_is_drawn_by_its_role_or_number(
    tmp_path: Path, roles: tuple[int, ...], names: list[str]
) -> None:
    path = tmp_path / 'flight.mcap'
    with RecordingWriter(path) as writer:
        for stamp_ns in (0, 10**9):
            rows = [(*[1.0] * 6, 0.1 * n, *[1.0] * 3, 0, role, 0.9) for n, role in enumerate(roles)]
            data = LINES(rows, cdr_header(stamp_ns, 'camera'))
            writer.write('/runway_detector/line_params', CLOUD, stamp_ns, data)
    with open_recording(path) as recording:
        axes = {axis.get_ylabel(): axis for axis in page(collect(recording, 'x')).figure.axes}
    drawn = {line.get_label(): line.get_ydata() for line in axes['theta [°]'].lines}
    assert [*drawn] == names
    for number, degrees in enumerate(drawn.values()):
        assert degrees == pytest.approx([math.degrees(0.1 * number)] * 2)


def test_a_flight_whose_clock_jumps_back_has_a_length(tmp_path: Path) -> None:
    stamps = (seconds * 10**9 for seconds in (50, 52, 2, 3))
    flight = drawn_of(tmp_path / 'flight.mcap', stamps, lambda _, head: encode_markers(DARK, head))
    assert flight.seconds == pytest.approx(50.0)
    axis = Figure().subplots()
    curves = {'y': np.arange(12.0).reshape(3, 4), 'seconds': np.array([[0.0, 1.0, 0.5, 0.7]] * 3)}
    _draw(axis, Diagram(1.0, 'y', 'markers', (('y', 'y', ''),)), curves)
    # No line runs back.
    assert np.isnan(axis.lines[0].get_ydata()).tolist() == [False, False, True, False]


def test_names_are_no_formulas(season: Path, tmp_path: Path) -> None:
    results = tmp_path / 'x${y$_{.mcap'
    results.write_bytes((season / 'flight_0.mcap').read_bytes())
    run = mvuav('export', results, '-o', tmp_path / 'out', '--plot')
    assert run.status == 0
    assert (tmp_path / 'out' / 'plots' / 'x${y$_{.png').exists()


@pytest.mark.filterwarnings('error:Glyph')
def test_a_name_in_letters_that_the_font_lacks_is_drawn_without_a_word(
    season: Path, tmp_path: Path
) -> None:
    results = tmp_path / '飛行.mcap'
    results.write_bytes((season / 'flight_0.mcap').read_bytes())
    run = mvuav('export', results, '-o', tmp_path / 'out', '--plot')
    assert run.status == 0


def test_the_rig_may_change_in_the_middle_of_a_recording(tmp_path: Path) -> None:
    def encode(number: int, header: bytes) -> bytes:
        labels = range(5 if number % 4 else 4)
        return LIGHTS([(1.0,) * 8 + (label, 1, 1.0) for label in labels], header)

    path = tmp_path / 'flight.mcap'
    (part,) = drawn_of(path, range(6), encode).parts
    assert mvuav('export', path, '-o', tmp_path / 'out', '--plot').status == 0
    assert part.counts == [4 * 2 + 5 * 4, 0, 0]
    assert [len(states) for states in part.states] == [4, 5, 5, 5, 5, 5]
    assert part.states[4] == [0, 0, 0, 0, 2]


def test_a_name_that_is_not_utf_8_is_shown(season: Path, tmp_path: Path) -> None:
    results = tmp_path / os.fsdecode(b'fl\xffight.mcap')
    results.write_bytes((season / 'flight_0.mcap').read_bytes())
    run = mvuav('export', results, '-o', tmp_path / 'out', '--plot')
    assert run.status == 0
    rows = read(tmp_path / 'out' / 'marker_tracker_rpy.csv')
    assert {row['flight'] for row in rows} == {'fl\N{REPLACEMENT CHARACTER}ight'}
