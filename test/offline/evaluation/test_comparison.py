import math
from contextlib import closing
from types import SimpleNamespace

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped, Vector3, Vector3Stamped
from rclpy.serialization import serialize_message
from support.commands import mvuav
from support.flights import write_bag
from support.headers import make_header

from mvuav_ros.messages.cdr import PointLayout, cdr_header
from mvuav_ros.offline.evaluation.bag_report import bag_report
from mvuav_ros.offline.evaluation.evaluation_run import EvaluationRun, nodes_for, read_bag, replay
from mvuav_ros.offline.evaluation.metrics import (
    line_errors,
    marker_errors,
    metrics_of,
    pose_errors,
    roll_errors,
)
from mvuav_ros.offline.replay.job import ReplaySettings
from mvuav_ros.processing.marker_processor import MarkerTrackerProcessor
from mvuav_ros.processing.registry import PROCESSORS
from mvuav_ros.recordings.reading import open_recording
from mvuav_ros.recordings.result_rows import marker_names
from mvuav_ros.recordings.writing import RecordingWriter
from mvuav_ros.sources.opening import open_source
from mvuav_ros.sources.source import SourceError
from mvuav_ros.vision.markers.marker_results import TANKER_NAMES, MarkerState
from mvuav_ros.vision.runway.results import LineFlag

TANKER = 'sim:tanker?frames=12&motion=roll&fps=15&noise=0'
TYPES = {'markers': 'sensor_msgs/msg/PointCloud2', 'rpy': 'geometry_msgs/msg/Vector3Stamped'}
RUNWAY = 'sim:runway?frames=6&width=320&height=240&motion=low_pass&start_distance=-20&speed=25'


def values(observed):
    return {metric.name: metric.value for metric in metrics_of(observed)}


def test_a_replayed_flight_is_close_to_its_truth():
    observed = replay(TANKER, ReplaySettings({'marker_tracker': {}}))
    measured = values(observed)
    assert observed.frames == measured['frames'] == 12
    assert measured['markers detected'] == 100.0
    assert 0.0 < measured['detected markers, RMS error'] < 0.2
    assert 0.0 < measured['roll, RMS error'] < 0.05
    assert measured['wrong names'] == 0
    assert measured['poses'] == 100.0
    assert 0.0 < measured['pose, RMS error/distance'] < 0.3
    assert 0.0 < measured['attitude, RMS error'] < 0.3
    assert observed.milliseconds > 0.0


def test_parameters_reach_the_replay():
    few = values(replay(TANKER, ReplaySettings({'marker_tracker': {'min_area': 100000}})))
    assert few['markers lost'] == 100.0
    assert math.isnan(few['detected markers, RMS error'])


def test_a_detector_without_truth_is_replayed_and_timed(monkeypatch):
    """As CONTRIBUTING.md says of a new one: it runs in sweeps too."""
    lights = type('Lights', (MarkerTrackerProcessor,), {'name': 'lights'})
    monkeypatch.setitem(PROCESSORS, 'lights', lights)
    measured = values(replay(TANKER, ReplaySettings({'lights': {}})))
    assert measured['frames'] == 12 and measured['time per frame'] > 0.0


def shifted(observed, dx=0.0, order=(0, 1, 2, 3, 4)):
    for stamp, rows in observed.results.markers.items():
        changed = rows.copy()
        changed['x'] = observed.truth.markers[stamp]['x'][list(order)] + dx
        changed['y'] = observed.truth.markers[stamp]['y'][list(order)]
        observed.results.markers[stamp] = changed
    return observed


def test_errors_are_those_that_were_made():
    errors = marker_errors(shifted(replay(TANKER, ReplaySettings({'marker_tracker': {}})), dx=1.5))
    assert np.allclose(errors.offset[..., 0], 1.5, atol=1e-4)
    assert np.allclose(errors.offset[..., 1], 0.0, atol=1e-4)
    assert not errors.wrong.any()


def test_exchanged_names_are_noticed():
    swapped = shifted(replay(TANKER, ReplaySettings({'marker_tracker': {}})), order=(4, 1, 2, 3, 0))
    errors = marker_errors(swapped)
    assert errors.wrong[:, [0, 4]].all()
    assert not errors.wrong[:, 1:4].any()
    assert values(swapped)['wrong names'] == 24
    # Of a prediction, and of what is near no light, no name is judged.
    first, second, *_ = swapped.results.markers.values()
    first['state'] = MarkerState.PREDICTED
    second['x'] += 6.0
    assert values(swapped)['wrong names'] == 20


def test_roll_error_is_taken_the_short_way():
    observed = EvaluationRun('by hand')
    for target, roll in ((observed.results, 3.1), (observed.truth, -3.1)):
        message = Vector3Stamped(header=make_header(7, 'camera'), vector=Vector3(x=roll))
        target.add('rpy', serialize_message(message))
    assert roll_errors(observed).error[0] == pytest.approx(6.2 - 2 * math.pi)


def posed(kind, stamp_ns, place, quaternion, frame='camera'):
    """A pose of the results, or of the truth, as `Observations.add` takes it."""
    message = (PoseStamped if kind == 'true pose' else PoseWithCovarianceStamped)()
    message.header = make_header(stamp_ns, frame)
    pose = message.pose if kind == 'true pose' else message.pose.pose
    for target, numbers in ((pose.position, place), (pose.orientation, quaternion)):
        for axis, number in zip('xyzw', numbers, strict=False):
            setattr(target, axis, number)
    return kind, serialize_message(message)


def test_errors_of_a_pose_are_those_that_were_made():
    observed, nan = EvaluationRun('by hand'), math.nan
    half = math.radians(15.0)
    for stamp_ns, place, turn in (
        (1, (3.0, 0.0, 14.0), (-math.sin(half), 0.0, 0.0, -math.cos(half))),
        (2, (nan, nan, nan), (nan, nan, nan, nan)),
        (3, (0.0, 0.0, 10.0), (0.0, 0.0, 0.0, 1.0)),
    ):
        observed.results.add(*posed('pose', stamp_ns, place, turn))
        observed.truth.add(*posed('true pose', stamp_ns, (0.0, 0.0, 10.0), (0.0, 0.0, 0.0, 1.0)))
    # A truth without attitude, one in another frame, and one of no image.
    observed.truth.add(*posed('true pose', 3, (0.0, 0.0, 10.0), (0.0, 0.0, 0.0, 0.0)))
    observed.results.add(*posed('pose', 4, (0.0, 0.0, 5.0), (0.0, 0.0, 0.0, 1.0)))
    observed.truth.add(*posed('true pose', 4, (0.0, 0.0, 9.0), (0.0, 0.0, 0.0, 1.0), 'runway'))
    observed.truth.add(*posed('true pose', 5, (0.0, 0.0, 9.0), (0.0, 0.0, 0.0, 1.0)))
    errors = pose_errors(observed)
    assert errors.place == pytest.approx([5.0, nan, 0.0], nan_ok=True)
    assert errors.share == pytest.approx([0.5, nan, 0.0], nan_ok=True)
    assert np.degrees(errors.turn) == pytest.approx([30.0, nan, nan], nan_ok=True)
    measured = values(observed)
    assert measured['poses'] == pytest.approx(200 / 3)
    assert measured['pose, RMS error'] == pytest.approx(5000.0 / math.sqrt(2))
    (table,) = [t for t in bag_report(observed, {}).tables() if t.key == 'pose']
    assert table.rows[0][3] == 5000.0 and table.rows[0][7] == pytest.approx(30.0)


def test_true_lines_turned_about_their_middles_are_found_with_that_error():
    observed = replay(RUNWAY, ReplaySettings({'runway_detector': {}}))
    assert line_errors(observed).frames == 6
    for stamp, rows in observed.truth.lines.items():
        turned = observed.results.lines[stamp] = rows.copy()
        theta = turned['theta'] + 0.01
        x, y = (rows['x'] + rows['x2']) / 2, (rows['y'] + rows['y2']) / 2
        turned['theta'], turned['rho'] = theta, x * np.cos(theta) + y * np.sin(theta)
        turned['flags'] = LineFlag.RHO_ERROR
    errors = line_errors(observed)
    assert len(errors.matches) == sum(errors.visible) > 0
    assert max(abs(match.distance) for match in errors.matches) < 1e-3
    assert max(abs(match.dtheta - 0.01) for match in errors.matches) < 1e-5
    measured = values(observed)
    assert measured['true lines found'] == 100.0
    assert (measured['rho flags'], measured['theta flags']) == (6.0, 0.0)


@pytest.mark.parametrize('name', ['rho', 'theta'])
@pytest.mark.parametrize('number', [math.inf, math.nan])
def test_a_line_with_a_damaged_number_is_none(name, number):
    observed = replay(RUNWAY, ReplaySettings({'runway_detector': {}}))
    first = min(observed.results.lines)
    for lines in (observed.results.lines, observed.truth.lines):
        lines[first] = lines[first].copy()
        lines[first][name] = number
    errors = line_errors(observed)
    assert errors.visible == [5, 5, 5]
    assert math.isfinite(values(observed)['line 1 rho mean'])


def test_results_in_a_bag_equal_a_replay_of_it(tmp_path):
    path = write_bag(tmp_path / 'flight.mcap', results=True)
    stored, again = read_bag(path), replay(str(path), ReplaySettings({'marker_tracker': {}}))
    assert len(stored.results.markers) == 6
    for observed in (stored, again):
        assert len(observed.truth.markers) == 6
    for stamp, rows in stored.results.markers.items():
        assert rows.tobytes() == again.results.markers[stamp].tobytes()
    assert stored.results.rpy == again.results.rpy


RIG = """
name: drone
markers:
  left_arm: [0.0, 0.30, 0.0]
  right_arm: [0.0, -0.30, 0.0]
  nose: [0.25, 0.10, -0.12]
  tail: [-0.35, 0.0, 0.05]
"""


def test_a_rig_of_ones_own_has_its_names_and_the_roll_of_its_pose(tmp_path):
    rig, bag, results = (tmp_path / name for name in ('rig.yaml', 'bag.mcap', 'results.mcap'))
    rig.write_text(RIG)
    layout = f'marker_tracker:layout:={rig}'
    flight = ('--layout', rig, '--no-airframe', '--background', 'plain', '--frames', 6)
    assert mvuav('simulate', 'tanker', '-o', bag, *flight, '--motion', 'roll').status == 0
    kept = ('--nodes', 'marker_tracker', '--param', layout, '--keep-inputs')
    assert mvuav('replay', bag, '-o', results, *kept).status == 0
    stored = read_bag(results)
    for run in (stored, replay(str(bag), ReplaySettings({'marker_tracker': {'layout': str(rig)}}))):
        assert marker_errors(run).names == ('left arm', 'right arm', 'nose', 'tail')
        assert values(run)['frames'] == 6
        assert values(run)['wrong names'] == 0
        assert 0 < values(run)['roll, RMS error'] < 0.2
    page = bag_report(stored, {})
    markers, roll, pose = page.sections[1:]
    assert [row[0] for row in markers.items[0].rows][-2:] == ['tail', 'all 4']
    for section in (roll, pose):
        assert section.items[0].rows[0][:2] == (6, 100.0)


@pytest.mark.parametrize(
    ('topics', 'nodes'),
    [
        (['/truth/rpy'], ['marker_tracker']),
        (['/truth/markers', '/truth/lines'], ['marker_tracker', 'runway_detector']),
        (['/truth/pose'], ['marker_tracker', 'runway_detector']),
    ],
)
def test_a_truth_says_which_nodes_it_judges(tmp_path, topics, nodes):
    with RecordingWriter(path := tmp_path / 'a.mcap') as writer:
        for topic in topics:
            writer.write(topic, TYPES['rpy'], 1, serialize_message(Vector3Stamped()))
    assert nodes_for(str(path)) == nodes


def test_names_do_not_follow_the_order_of_topics(tmp_path):
    run = read_bag(write_bag(tmp_path / 'flight.mcap', results=True))
    with open_recording(tmp_path / 'flight.mcap') as recording:
        turned = SimpleNamespace(
            topics=recording.topics,
            messages=lambda topics: reversed(list(recording.messages(topics))),
        )
        assert marker_names(turned, '/marker_tracker') == run.names
    assert [run.names[label] for label in range(5)] == list(TANKER_NAMES)


def test_markers_without_topics_of_their_own_have_numbers(tmp_path):
    run = read_bag(write_bag(tmp_path / 'flight.mcap', results=True))
    run.names = {}
    assert marker_errors(run).names[4] == 'marker 4'


def test_a_truth_without_roll_is_said(tmp_path):
    run = read_bag(write_bag(tmp_path / 'flight.mcap', results=True))
    run.truth.rpy = dict.fromkeys(run.truth.rpy, math.nan)
    assert roll_errors(run) is None
    assert bag_report(run, {}).sections[-1].paragraphs == (
        'The truth holds no roll for these frames.',
    )


def test_a_flight_is_flown_with_its_calibration(monkeypatch):
    given = []
    monkeypatch.setattr(
        MarkerTrackerProcessor, 'set_camera', lambda self, camera: given.append(camera)
    )
    replay('sim:tanker?frames=2&fov_deg=50', ReplaySettings({'marker_tracker': {}}))
    with closing(open_source('sim:tanker?frames=2&fov_deg=50')) as source:
        (frame, *_) = source.frames()
    assert given and all(camera == frame.camera for camera in given)


@pytest.mark.parametrize('value', ['[', '2024-13-45'])
def test_a_setting_that_is_not_yaml_is_refused(value):
    with pytest.raises(SourceError, match=r'motion=.* is not YAML'):
        replay(f'sim:tanker?motion={value}', ReplaySettings({'marker_tracker': {}}))


def test_a_truth_of_ones_own_may_lack_rows(tmp_path):
    run = read_bag(write_bag(tmp_path / 'flight.mcap', results=True))
    first = min(run.truth.markers)
    for observed in (run.truth, run.results):
        observed.markers[first] = observed.markers[first][:0]
    assert len(marker_errors(run).time) == 5
    run.truth.markers = {first: run.truth.markers[first]}
    assert marker_errors(run) is None
    runway = replay(RUNWAY, ReplaySettings({'runway_detector': {}}))
    seen = line_errors(runway).visible
    runway.truth.lines = {stamp: rows[:2] for stamp, rows in runway.truth.lines.items()}
    assert line_errors(runway).visible == [*seen[:2], 0]


def test_a_truth_without_the_fields_is_refused_with_the_reason(tmp_path):
    poor = PointLayout(np.dtype([(name, np.float32) for name in 'xyz']))
    with RecordingWriter(tmp_path / 'poor.mcap') as writer:
        data = poor.encode([(1.0, 2.0, 3.0)], cdr_header(0, ''))
        writer.write('/truth/markers', TYPES['markers'], 0, data)
    refused = mvuav('evaluate', tmp_path / 'poor.mcap', '-o', tmp_path / 'out')
    assert refused.status == 1
    assert '1 message of /truth/markers not used: it has no label, state' in refused.err


def test_messages_that_are_no_truth_are_said_in_one_line(tmp_path):
    with RecordingWriter(tmp_path / 'odd.mcap') as writer:
        for n in range(20):
            message = bytes([0, 1, 0, 0]) + bytes(n)
            writer.write('/truth/markers', TYPES['markers'], n, message)
    (line,) = read_bag(tmp_path / 'odd.mcap').errors
    assert '20 messages of /truth/markers not used: ' in line
    assert len(line) < 300
