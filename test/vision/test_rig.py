"""Bodies other than the tanker."""

import math
from itertools import combinations, islice

import numpy as np
import pytest
from support.node_outputs import messages_of
from support.places import ROOT

from mvuav_ros.messages.cdr import view_points
from mvuav_ros.messages.images import Frame
from mvuav_ros.parameters.declaration import ParameterError
from mvuav_ros.parameters.marker_tracker import MarkerTrackerParameters
from mvuav_ros.processing.marker_processor import MarkerTrackerProcessor
from mvuav_ros.simulation.settings import TankerSettings
from mvuav_ros.simulation.tanker_flight import TankerFlight
from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.image import Image
from mvuav_ros.vision.markers.lights import Lens
from mvuav_ros.vision.markers.marker_results import Label, MarkerState
from mvuav_ros.vision.markers.rig_view import WeakPerspective
from mvuav_ros.vision.markers.tracker import MarkerTracker
from mvuav_ros.vision.rig import TANKER_747, MarkerRig, RigError, load_rig, parse_rig

DRONE = """
name: drone
markers:
  port: [0.0, 0.30, 0.0]
  starboard: [0.0, -0.30, 0.0]
  top: [-0.25, 0.0, 0.22]
  tail: [-0.35, 0.10, -0.12]
"""
THREE = '\n'.join(DRONE.splitlines()[:-1])
SEVEN = """
name: seven
markers:
  a: [0.0, 10.0, 0.0]
  b: [0.0, 5.0, 4.0]
  c: [-3.0, 1.0, 6.0]
  d: [0.0, 0.0, -3.0]
  e: [-3.0, -4.0, 3.0]
  f: [0.0, -9.0, 1.0]
  g: [-2.0, -6.0, -4.0]
"""


@pytest.fixture(params=[DRONE, SEVEN, THREE], ids=['drone', 'seven', 'three'])
def layout(request, tmp_path):
    path = tmp_path / 'body.yaml'
    path.write_text(request.param)
    return path


def test_its_markers_get_their_names(layout):
    flight = TankerFlight(
        TankerSettings(
            layout=str(layout), motion='erratic', frames=90, view='lab', background='plain', seed=2
        )
    )
    pipeline = MarkerTracker(rig=load_rig(layout))
    seen = 0
    for frame in flight:
        result = pipeline.process(frame.image, frame.stamp_ns)
        assert len(result.markers) == len(flight.rig.names)
        assert [m.label for m in result.markers] == list(range(len(result.markers)))
        for marker, true in zip(result.markers, frame.truth.markers, strict=True):
            if marker.state is MarkerState.DETECTED:
                seen += 1
                assert math.hypot(marker.x - true.x, marker.y - true.y) < 2.0
        assert math.isnan(result.roll)
    assert seen > 0.95 * 90 * len(flight.rig.names)


def test_hidden_markers_of_a_larger_body(tmp_path):
    path = tmp_path / 'seven.yaml'
    path.write_text(SEVEN)
    flight = TankerFlight(
        TankerSettings(
            layout=str(path),
            motion='roll',
            frames=180,
            view='lab',
            background='plain',
            failures='a@1-3, d@1-3, all@4-5',
        )
    )
    pipeline = MarkerTracker(rig=load_rig(path))
    for frame in flight:
        result = pipeline.process(frame.image, frame.stamp_ns)
        for marker, true in zip(result.markers, frame.truth.markers, strict=True):
            if marker.state is MarkerState.DETECTED:
                assert math.hypot(marker.x - true.x, marker.y - true.y) < 4.0
    assert all(m.state is MarkerState.DETECTED for m in result.markers)


def test_topics_rows_and_pose_follow_the_layout(layout):
    parameters = MarkerTrackerParameters(layout=str(layout))
    processor = MarkerTrackerProcessor()
    processor.configure(parameters)
    flight = TankerFlight(
        TankerSettings(
            layout=str(layout), motion='still', frames=6, view='lab', background='plain', noise=0.0
        )
    )
    names = flight.rig.names
    topics = {f'marker/{name}' for name in names}
    assert topics <= set(processor.topics)
    assert 'marker/left_wing' not in processor.topics
    camera = flight.camera
    processor.set_camera(CameraModel(640, 480, tuple(camera.matrix.ravel())))
    for frame in flight:
        given = Frame(frame.stamp_ns, 'cam', frame.image)
        outputs = messages_of(processor, processor.process(given))
    assert topics <= set(outputs)
    rows = view_points(outputs['markers'])
    assert list(rows['label']) == list(range(len(names)))
    position = outputs['pose'].pose.pose.position
    if len(names) == 3:
        assert math.isnan(position.z), 'nothing would show another light in the place of one'
        return
    distance = np.linalg.norm(frame.truth.translation)
    error = np.subtract((position.x, position.y, position.z), frame.truth.translation)
    assert np.linalg.norm(error) < 0.01 * distance
    roll = outputs['rpy'].vector.x
    assert roll == pytest.approx(0.0, abs=0.02)


@pytest.mark.parametrize(
    ('text', 'reason'),
    [
        (None, 'No such file'),
        ('markers: 5', 'markers'),
        ('markers: {one: [0.0, 1.0, 0.0]}', '2 to 255'),
        ('markers: {"a b": [0, 1, 0], c: [0, 2, 0], d: [0, 0, 1]}', 'part of a topic'),
        ('markers: {a: [0, 500, 0], b: [0, -500, 0], c: [0, 0, 80]}', '1000 m across cannot be'),
        ('{', 'not YAML'),
        ('name: 2024-13-45', 'not YAML: month must be in'),
        ('name: !!int ""', 'not YAML'),
    ],
)
def test_a_layout_that_cannot_be_used_is_refused(tmp_path, text, reason):
    path = tmp_path / 'layout.yaml'
    if text is not None:
        path.write_text(text)
    with pytest.raises(ParameterError, match=reason) as refusal:
        MarkerTrackerProcessor().configure(MarkerTrackerParameters(layout=str(path)))
    assert refusal.value.name == 'layout'
    assert str(path) in str(refusal.value)


SQUARE = 'markers: {a: [0, 1, 1], b: [0, -1, 1], c: [0, -1, -1], d: [0, 1, -1]}'


@pytest.mark.parametrize(
    ('text', 'reason'),
    [
        ('markers: {a: [0, 1, 0], b: [0, 2, 1]}', 'too few for a pose'),
        ('markers: {a: [0, 1, 0], b: [0, 2, 0], c: [0, 4, 0]}', 'one line'),
        (SQUARE, 'a -> b -> c -> d are exchanged by a rotation of 90 deg'),
    ],
)
def test_a_doubtful_layout_needs_to_be_allowed(tmp_path, text, reason):
    path = tmp_path / 'layout.yaml'
    path.write_text(text)
    with pytest.raises(ParameterError, match=reason) as refusal:
        MarkerTrackerProcessor().configure(MarkerTrackerParameters(layout=str(path)))
    assert refusal.value.name == 'layout'
    processor = MarkerTrackerProcessor()
    processor.configure(MarkerTrackerParameters(layout=str(path), allow_ambiguous=True))
    image = np.zeros((48, 64), np.uint8)
    list(processor.process(Frame(1, 'cam', Image(image, 'mono8'))))
    assert reason in processor.status


def test_the_shipped_layout_is_the_built_in_one():
    assert load_rig(ROOT / 'config' / 'tanker_747.yaml') == TANKER_747


@pytest.mark.parametrize(
    ('content', 'reason'),
    [
        (None, 'must be a mapping'),
        ({}, 'must map at least one name'),
        ({'markers': {}}, 'must map at least one name'),
        ({'markers': {'a': [1, 2]}}, 'a must be .x, y, z. in metres'),
        ({'markers': {'a': [1, 2, float('nan')]}}, 'a must be'),
        ({'markers': {'a': [1, 2, 'x']}}, 'a must be'),
        ({'markers': {'a': [1, 2, True]}}, 'a must be'),
        ({'markers': {'a': [1, 0, 0]}}, 'on the x axis'),
        ({'markers': {'a': [0, 1, 0]}, 'wings': 2}, 'unknown key wings'),
        ({'markers': {'a': [0, 1, 0]}, 'dock': [1]}, 'dock must be'),
    ],
)
def test_what_is_no_rig_is_refused_with_the_reason(content, reason):
    with pytest.raises(RigError, match=reason):
        parse_rig(content)


def test_what_a_rig_file_leaves_out():
    """It is docked at the middle of its lights, where its boom is then, too."""
    rig = parse_rig({'markers': {'a': [0, 3, 0], 'b': [2, -3, 4]}}, 'drone')
    assert (rig.name, rig.dock, rig.boom) == ('drone', (1.0, 0.0, 2.0), (1.0, 0.0, 2.0))
    assert rig.reach == 5.0


@pytest.mark.parametrize('name', [None, ''])
def test_a_name_that_is_left_empty_is_none(name):
    """The body's frame was called None, or nothing."""
    assert parse_rig({'name': name, 'markers': {'a': [0, 3, 0]}}, 'drone').name == 'drone'


def test_coordinates_may_have_an_exponent_or_begin_with_a_point(tmp_path):
    path = tmp_path / 'rig.yaml'
    path.write_text(
        'markers: {a: [0, 1e-1, 0], b: [0, -2e-1, -.01], c: [0, 0.3, 1], d: [1, 0, 5e-1]}'
    )
    assert load_rig(path).positions[:2].tolist() == [[0.0, 0.1, 0.0], [0.0, -0.2, -0.01]]


@pytest.mark.parametrize('given', [{'prediction': 'velocity'}, {'mode': 'detect'}])
@pytest.mark.parametrize('lights', [4, 5])
def test_the_thesis_programs_name_the_tanker_alone(given, lights):
    """They take five lights for its markers by their order: of another body that is wrong."""
    markers = TANKER_747.markers[::-1][:lights]
    rig = MarkerRig('mirrored', markers, TANKER_747.dock, TANKER_747.boom)
    tracker = MarkerTracker(MarkerTrackerParameters(**given), rig)
    flight = TankerFlight(TankerSettings(frames=3, motion='still', noise=0.0))
    for frame in flight:
        result = tracker.process(frame.image, frame.stamp_ns)
        assert {marker.label for marker in result.markers} == {Label.UNLABELLED}
        assert math.isnan(result.roll) and 'the markers of mirrored have no names' in result.status
    assert sum(marker.state is MarkerState.DETECTED for marker in result.markers) == 5


def test_the_nodes_work_survives_a_rig_of_four_in_a_mode_of_the_thesis(tmp_path):
    path = tmp_path / 'rig.yaml'
    path.write_text(DRONE)
    processor = MarkerTrackerProcessor()
    processor.configure(MarkerTrackerParameters(layout=str(path), mode='detect'))
    processor.set_camera(CameraModel(640, 480, (600, 0, 320, 0, 600, 240, 0, 0, 1)))
    for frame in TankerFlight(TankerSettings(frames=3, motion='still', noise=0.0)):
        given = Frame(frame.stamp_ns, 'cam', frame.image)
        outputs = messages_of(processor, processor.process(given))
        assert math.isnan(outputs['pose'].pose.pose.position.z)
        assert not any(topic.startswith('marker/') for topic in outputs)


@pytest.mark.parametrize('count', [5, 8, 12])
def test_a_triangle_is_left_however_many_markers_are_hidden(count):
    places = np.random.default_rng(count).uniform(-1, 1, (count, 3)).tolist()
    rig = MarkerRig(
        'body',
        tuple((f'm{i}', tuple(place)) for i, place in enumerate(places)),
        (0, 0, 0),
        (0, 0, 0),
    )
    shape = WeakPerspective.of(rig, Lens((640, 480), None))
    for hidden in range(count - 3):
        triangles = [set(three) for three in shape.triangles(hidden)]
        for out in islice(combinations(range(count), hidden), 200):
            assert any(three.isdisjoint(out) for three in triangles)
