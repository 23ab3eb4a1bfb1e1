"""A node's newest messages as figures with a state of trust, and as a pose in space."""

import json
import math
import warnings
from types import SimpleNamespace

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import (
    PoseWithCovarianceStamped,
    Quaternion,
    Vector3,
    Vector3Stamped,
)
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import CameraInfo, PointCloud2
from support.marker_scenes import draw, tanker_at

from mvuav_ros.messages.cdr import PointLayout, cdr_header
from mvuav_ros.messages.marker_messages import encode_markers
from mvuav_ros.messages.poses import encode_integrity
from mvuav_ros.messages.runway_messages import LINE
from mvuav_ros.panel import live_results
from mvuav_ros.panel.live_results import (
    BAD,
    DOUBTFUL,
    GOOD,
    Figures,
    SeriesFeed,
    curves_of,
    rotation_of,
)
from mvuav_ros.parameters.marker_tracker import MarkerTrackerParameters
from mvuav_ros.processing.registry import PROCESSORS
from mvuav_ros.vision.image import Image
from mvuav_ros.vision.integrity import RunwayLevels
from mvuav_ros.vision.markers.marker_results import (
    TANKER_NAMES,
    Marker,
    MarkerResult,
    MarkerState,
)
from mvuav_ros.vision.markers.tracker import MarkerTracker
from mvuav_ros.vision.runway.results import LineFlag

APPROACH = {'mode': 'approach', 'runway_width': 30.0}
TRACK = {'mode': 'track', 'pose': True}
LEVEL = (1.0, 0.0, 0.0, 0.0)
AHEAD = (0.5, 0.5, -0.5, 0.5)
"""w, x, y, z of a body that flies as the camera does, in the camera's optical frame."""


def pose_message(place, turn, deviations=(1.0, 2.0, 3.0, 0.1, 0.2, 0.3)):
    message = PoseWithCovarianceStamped()
    pose = message.pose.pose
    pose.position.x, pose.position.y, pose.position.z = place
    pose.orientation = Quaternion(**dict(zip('wxyz', turn, strict=True)))
    message.pose.covariance = np.diag(np.square(deviations)).ravel()
    return message


def said(kind, values, place, turn, **more):
    figures = Figures(kind, lambda: values)
    figures.take('pose', pose_message(place, turn, **more))
    said = figures.said()
    assert json.loads(json.dumps(said, allow_nan=False))
    return {name: (value, deviation) for name, value, deviation in said['figures']}, said


def test_guidance_says_on_which_side_and_how_far_to_trust_it():
    turn = (math.cos(math.radians(-1.5)), 0.0, 0.0, math.sin(math.radians(-1.5)))
    figures, whole = said('runway_detector', APPROACH, (-500.0, 5.6, 50.0), turn)
    assert figures == {
        'left of centre': ('5.6 m', '± 2 m'),
        'height': ('50.0 m', '± 3 m'),
        'heading right': ('3.0°', '± 17°'),
        'to the near end': ('500.0 m', '± 1 m'),
    }
    assert whole['pose'][0] == [-500.0, 5.6, 50.0]


def test_the_tanker_is_ahead_and_to_the_right_in_the_axes_of_the_camera():
    figures, whole = said('marker_tracker', TRACK, (1.5, -2.0, 80.0), AHEAD)
    assert figures['ahead'] == ('80.0 m', '± 3 m') and figures['right'] == ('1.5 m', '± 1 m')
    assert figures['above'] == ('2.0 m', '± 2 m') and figures['roll'][0] == '0.0°'
    # Turns about the optical x, y and z (0.1, 0.2 and 0.3 rad) are those of pitch, yaw and roll.
    turned = {name: figures[name][1] for name in ('roll', 'pitch', 'yaw')}
    assert turned == {'roll': '± 17°', 'pitch': '± 5.7°', 'yaw': '± 11°'}
    place, turn = whole['pose']
    assert place == [80.0, -1.5, 2.0] and np.allclose(turn, np.eye(3), atol=1e-5)
    # A variance of 0 says that it is not known.
    figures, _ = said('marker_tracker', TRACK, (1.5, -2.0, 80.0), AHEAD, deviations=(0.0,) * 6)
    assert figures['ahead'] == ('80.0 m', '')


@pytest.mark.parametrize(('roll', 'shown'), [(0.1, '5.7°'), (-1e-9, '0.0°')])
def test_the_roll_of_rpy_is_shown_in_degrees(roll, shown):
    figures = Figures('marker_tracker', lambda: TRACK)
    figures.take('rpy', Vector3Stamped(vector=Vector3(x=roll)))
    assert figures.said()['figures'][0][:2] == ('roll', shown)


def test_what_is_known_to_millimetres_is_shown_so():
    near = (0.0123, -0.2, 3.1416), AHEAD
    figures, _ = said('marker_tracker', TRACK, *near, deviations=(0.002, 0.03, 0.4, 0.1, 0.1, 0.1))
    assert figures['right'] == ('0.012 m', '± 0.002 m')
    assert figures['above'] == ('0.20 m', '± 0.03 m')
    assert figures['ahead'] == ('3.1 m', '± 0.4 m')
    far = 8.3e-5, 0.03, 171.0, 0.1, 0.1, 0.1
    figures, _ = said('marker_tracker', TRACK, *near, deviations=far)
    assert (figures['right'][1], figures['ahead'][1]) == ('± 0.000083 m', '± 170 m')


@pytest.mark.parametrize('number', [math.nan, math.inf, 0.0, 1e308])
def test_what_is_no_pose_is_not_shown_as_one(number):
    for kind, values in (('marker_tracker', TRACK), ('runway_detector', APPROACH)):
        turn = (number,) * 4
        figures, whole = said(kind, values, (number,) * 3, turn, deviations=(number,) * 6)
        assert whole['pose'] is None and np.isnan(rotation_of(Quaternion())).sum() == 0
        assert figures.get('heading aside', figures.get('pitch'))[0] == '-'


@pytest.mark.parametrize('far', [1e6, -9e8])
def test_a_distance_that_no_camera_measures_is_none(far):
    figures, whole = said('marker_tracker', TRACK, (far, far, far), AHEAD)
    assert whole['pose'] is None and figures['ahead'] == ('-', '')
    figures, whole = said('runway_detector', APPROACH, (far, far, far), LEVEL)
    assert whole['pose'] is None and figures['height'] == figures['to the near end'] == ('-', '')


def lines(*rows):
    """A ~/line_params: rho and confidence, NaN where it is not found, and whether it is held."""
    table = np.zeros(len(rows), LINE)
    for row, (rho, confidence, held) in zip(table, rows, strict=True):
        row['rho'], row['confidence'] = rho, confidence
        row['flags'] = LineFlag.CORRECTED if held else 0
    data = PointLayout(LINE).encode(table, cdr_header(0, 'camera'))
    return deserialize_message(data, PointCloud2)


LOST = (math.nan, math.nan, False)


@pytest.mark.parametrize(
    ('rows', 'state', 'words'),
    [
        ([(9.0, 0.84, False)] * 2 + [LOST] * 3, DOUBTFUL, 'confidence 84 %, but no pose'),
        ([(9.0, 0.84, True), (9.0, 0.7, False)], DOUBTFUL, 'confidence 84 %, 1 held'),
        ([(9.0, 0.84, False), LOST], DOUBTFUL, 'confidence 84 %'),
        ([LOST] * 5, BAD, 'no runway'),
    ],
)
def test_the_trust_in_a_runway(rows, state, words):
    figures = Figures('runway_detector', lambda: APPROACH)
    figures.take('line_params', lines(*rows))
    assert figures.said()['trust'] == (state, words)


def test_a_runway_with_both_edges_and_a_pose_is_good_until_it_is_lost():
    figures = Figures('runway_detector', lambda: APPROACH)
    figures.take('pose', pose_message((-500.0, 0.0, 50.0), LEVEL))
    figures.take('line_params', lines((9.0, 0.9, False), (9.0, 0.9, False), LOST))
    assert figures.said()['trust'] == (GOOD, 'confidence 90 %')
    figures.take('line_params', lines(LOST, LOST, LOST))
    assert figures.said()['trust'][0] == BAD and figures.said()['pose'] is None


@pytest.mark.parametrize('mode', ['approach', 'thesis'])
def test_a_pose_that_does_not_come_any_more_is_not_shown(mode):
    values = {**APPROACH}
    figures = Figures('runway_detector', lambda: values)
    seen = lines((9.0, 0.9, False), (9.0, 0.9, False))
    for _ in range(20):
        figures.take('line_params', seen)
        figures.take('pose', pose_message((-500.0, 0.0, 50.0), LEVEL))
    assert figures.said()['figures'][1] == ('height', '50.0 m', '± 3 m')
    values |= {'mode': mode, 'runway_width': 0.0}
    for _ in range(20):
        figures.take('line_params', seen)
    said = figures.said()
    assert said['pose'] is None
    assert {value for name, value, _ in said['figures'] if name == 'height'} <= {'-'}


@pytest.mark.parametrize(
    ('levels', 'state', 'words'),
    [
        (RunwayLevels(2.1, 1.26, 0.01), GOOD, 'confidence 90 %, protection level 2.1 m'),
        (RunwayLevels(0.022, 0.01, 0.01), GOOD, 'confidence 90 %, protection level 0.02 m'),
        (RunwayLevels(2.1, 4.5, 0.01), DOUBTFUL, 'confidence 90 %, protection level alert: height'),
        (
            RunwayLevels(reason='confidence too low'),
            DOUBTFUL,
            'confidence 90 %, protection level not available: confidence too low',
        ),
    ],
)
def test_a_pose_is_trusted_as_its_protection_level_says(levels, state, words):
    figures = Figures('runway_detector', lambda: APPROACH)
    figures.take('pose', pose_message((-500.0, 0.0, 50.0), LEVEL))
    figures.take('line_params', lines((9.0, 0.9, False), (9.0, 0.9, False), LOST))
    data = encode_integrity(levels, (3.0, 4.0), 0.05, cdr_header(0, 'camera'))
    figures.take('integrity', deserialize_message(data, DiagnosticArray))
    assert figures.said()['trust'] == (state, words)


def test_the_thesis_scheme_needs_no_protection_level():
    figures = Figures('runway_detector', lambda: {'mode': 'thesis'})
    figures.take('line_params', lines((9.0, math.nan, False), (7.0, math.nan, False)))
    data = encode_integrity(
        RunwayLevels(reason='only mode approach has levels'), (0.0, 0.0), 0.05, cdr_header(0, '')
    )
    figures.take('integrity', deserialize_message(data, DiagnosticArray))
    assert figures.said()['trust'] == (GOOD, '2 of 2 lines')


def test_the_thesis_scheme_has_lines_and_those_held_are_doubted():
    figures = Figures('runway_detector', lambda: {'mode': 'thesis'})
    figures.take('line_params', lines((9.0, math.nan, False), (7.0, math.nan, True), LOST))
    said = figures.said()
    assert said['trust'] == (DOUBTFUL, '2 of 3 lines, 1 held')
    assert said['figures'][0] == ('line 1', '0.0°', 'rho 9 px')


def test_all_lines_are_counted_where_there_is_room_for_some():
    figures = Figures('runway_detector', lambda: {'mode': 'thesis'})
    figures.take('line_params', lines(*[(9.0, math.nan, False)] * 12, *[LOST] * 8))
    assert figures.said()['trust'] == (DOUBTFUL, '12 of 20 lines')
    assert len(figures.said()['figures']) == 12


def test_curves_bear_the_names_of_their_lights():
    chart = PROCESSORS['marker_tracker'].panel.charts['x']

    def curves(mode, labels, ids, names=(), state=MarkerState.DETECTED):
        markers = tuple(Marker(label, state, x=5.0, y=5.0) for label in labels)
        result = MarkerResult(markers, ids=ids)
        data = encode_markers(result, cdr_header(0, ''), numbered=mode == 'track_any')
        return curves_of(chart, deserialize_message(data, PointCloud2), names)

    def names(*given):
        return list(curves(*given))

    assert curves('track', (0,), (), (), MarkerState.LOST) == {'marker 1': None}
    assert names('track', (0, 4), (), TANKER_NAMES) == ['left wing', 'right wing']
    assert names('track', (0, 1), ()) == ['marker 1', 'marker 2']
    assert names('track_any', (255, 255), (7, 12), TANKER_NAMES) == ['marker 7', 'marker 12']


@pytest.mark.parametrize(
    ('states', 'state', 'words'),
    [
        ('DETECTED PREDICTED LOST', DOUBTFUL, '1 of 3 lights, 1 predicted'),
        ('DETECTED LOST LOST', BAD, '1 of 3 lights'),
        ('', BAD, '0 lights, without names'),
    ],
)
def test_the_trust_in_lights(states, state, words):
    markers = tuple(Marker(n, MarkerState[each]) for n, each in enumerate(states.split()))
    data = encode_markers(MarkerResult(markers), cdr_header(0, ''))
    figures = Figures('marker_tracker', lambda: TRACK)
    figures.take('markers', deserialize_message(data, PointCloud2))
    assert figures.said()['trust'] == (state, words)


def test_the_view_in_space_is_the_calibrations():
    figures = Figures('marker_tracker', lambda: TRACK)
    assert figures.said()['view'] is None
    k = [400.0, 0.0, 320.0, 0.0, 400.0, 240.0, 0.0, 0.0, 1.0]
    figures.take('camera_info', CameraInfo(width=640, height=480, k=k))
    assert figures.said()['view'] == (0.8, 0.6)
    figures.take('camera_info', CameraInfo(width=640, height=480, k=[1e-300] * 9))
    assert figures.said()['view'] == (0.8, 0.6)
    with warnings.catch_warnings(action='error'), pytest.raises(ArithmeticError):
        figures.take('camera_info', CameraInfo(width=640, height=480))


@pytest.mark.parametrize('mode', ['track', 'detect'])
def test_a_pose_in_alert_is_doubtful_in_every_mode_that_has_one(mode):
    image = Image(draw(tanker_at()), 'mono8')
    tracker = MarkerTracker(MarkerTrackerParameters(mode='detect'))
    markers = deserialize_message(
        encode_markers(tracker.process(image, 0), cdr_header(0, 'camera')), PointCloud2
    )
    figures = Figures('marker_tracker', lambda: {'mode': mode, 'pose': True})
    figures.take('pose', pose_message((1.5, -2.0, 80.0), AHEAD))
    figures.take('markers', markers)
    alert = DiagnosticStatus(level=DiagnosticStatus.WARN, message='alert: along')
    figures.take('integrity', DiagnosticArray(status=[alert]))
    assert figures.said()['trust'] == (DOUBTFUL, '5 of 5 lights, protection level alert: along')


def feed_of(values, news, camera_info_topic='/camera_info'):
    """The results of a node without ROS, and who takes its messages, by topic."""
    subscribed = {}

    def subscribe(kind, topic, take, qos):
        subscribed[topic] = take
        return lambda: subscribed.pop(topic)

    ros = SimpleNamespace(
        subscribe=subscribe,
        call_in_loop=lambda function, *arguments: function(*arguments),
    )
    node = SimpleNamespace(
        name='/tracker',
        kind='marker_tracker',
        values=values,
        camera_info_topic=camera_info_topic,
    )
    return SeriesFeed(ros, node, lambda: news.append(1)), subscribed


def test_the_calibration_of_a_camera_is_no_result_of_the_node():
    news = []
    feed, subscribed = feed_of(TRACK, news)
    subscribed['/camera_info'](CameraInfo())
    assert feed.take() == '' and not news
    subscribed['/tracker/pose'](pose_message((1.5, -2.0, 80.0), AHEAD))
    assert json.loads(feed.take())['pose'] and news


def test_the_calibration_is_that_of_the_topic_that_the_node_listens_to_now():
    """Of frames handed over in its process the topic is known from its diagnostics, later."""
    feed, subscribed = feed_of(TRACK, [], camera_info_topic='')
    assert not any('camera_info' in topic for topic in subscribed)

    def view(width):
        feed._due.clear()
        for topic, take in list(subscribed.items()):
            if topic.endswith('info'):
                take(
                    CameraInfo(
                        width=width, height=width, k=[100.0, 0.0, 0.0, 0.0, 100.0] + [0.0] * 4
                    )
                )
        subscribed['/tracker/pose'](pose_message((1.5, -2.0, 80.0), AHEAD))
        return json.loads(feed.take())['view']

    assert view(100) is None
    feed._node.camera_info_topic = '/camera_info'
    view(100)
    assert view(100) == [0.5, 0.5]
    # The node was started anew, with another camera.
    feed._node.camera_info_topic = '/nose/info'
    view(100)
    assert '/camera_info' not in subscribed
    assert view(300) == [1.5, 1.5]
    feed.close()
    assert not subscribed


@pytest.mark.parametrize(('rate', 'points'), [(30.0, 60), (120.0, 120)])
def test_curves_have_as_many_points_as_a_screen_shows(monkeypatch, rate, points):
    clock = SimpleNamespace(now=1000.0)
    monkeypatch.setattr(live_results, 'time', SimpleNamespace(monotonic=lambda: clock.now))
    feed, subscribed = feed_of(TRACK, [])
    for _ in range(round(2.0 * rate)):
        subscribed['/tracker/rpy'](Vector3Stamped())
        clock.now += 1.0 / rate
    assert len(json.loads(feed.take())['points']) == pytest.approx(points, abs=1)


@pytest.mark.parametrize(('layout', 'name'), [('', 'left wing'), ('rig.yaml', 'marker 1')])
def test_lights_of_a_rig_of_ones_own_have_no_names_of_the_tanker(layout, name):
    feed, subscribed = feed_of({**TRACK, 'layout': layout}, [])
    result = MarkerResult((Marker(0, MarkerState.DETECTED, x=5.0, y=5.0),))
    data = encode_markers(result, cdr_header(0, ''))
    subscribed['/tracker/markers'](deserialize_message(data, PointCloud2))
    points = json.loads(feed.take())['points']
    assert {curve for _, _, curves in points for curve in curves} == {name}
