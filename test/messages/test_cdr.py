"""Results in CDR are what rclpy would have written, with zeros as padding."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import PointField
from support.node_outputs import messages_of
from visualization_msgs.msg import Marker

from mvuav_ros.messages import cdr
from mvuav_ros.messages import runway_messages as runway
from mvuav_ros.messages.cdr import cdr_header
from mvuav_ros.messages.definitions import decode_message
from mvuav_ros.messages.images import Frame
from mvuav_ros.messages.poses import Placement, encode_transform
from mvuav_ros.parameters.marker_tracker import MarkerTrackerParameters
from mvuav_ros.parameters.runway_detector import RunwayDetectorParameters
from mvuav_ros.processing.marker_processor import MarkerTrackerProcessor
from mvuav_ros.processing.processor import Processor
from mvuav_ros.processing.runway_processor import RunwayDetectorProcessor
from mvuav_ros.simulation.runway_flight import RunwayFlight
from mvuav_ros.simulation.settings import RunwaySettings, TankerSettings
from mvuav_ros.simulation.tanker_flight import TankerFlight
from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.image import Image
from mvuav_ros.vision.markers.marker_results import TANKER_NAMES

# Of every length that the alignment to eight bytes tells apart.
FRAME_IDS = ['', 'c', 'ca', 'cam', 'nose', 'left1', 'Kamera µ', 'a/b/opt', 'camera_1']
BLACK = Image(np.zeros((240, 320), np.uint8), 'mono8')

OWN_FRAMES = {
    ('marker_tracker', 'vision_pose'): 'tanker_747',
    ('runway_detector', 'pose'): 'runway',
    ('runway_detector', 'vision_pose'): 'runway',
}


def flight_of(processor: Processor, flight) -> Iterator[tuple[str, str, bytes]]:
    """Frame, topic and bytes of every output; each frame has another frame_id."""
    camera = flight.camera
    processor.set_camera(CameraModel(camera.width, camera.height, tuple(camera.matrix.ravel())))
    for index, given in enumerate([*flight, None]):
        frame_id = FRAME_IDS[index % len(FRAME_IDS)]
        image = BLACK if given is None else given.image
        frame = Frame(-5_000_000_007 + index * 33_333_333, frame_id, image)
        debug = processor.debug_topics if index % 4 == 0 else ()
        for topic, make in [*processor.process(frame), *processor.draw(debug)]:
            yield frame_id, topic, make()
    for frame_id in FRAME_IDS:
        for topic, make in processor.periodic(cdr_header(7, frame_id)):
            yield frame_id, topic, make()


def processors():
    tanker = TankerFlight(TankerSettings(frames=20, seed=3, failures='rudder@0.1-9'))
    approach = RunwayFlight(RunwaySettings(frames=20, width=320, height=240))
    named = {f'marker/{name}' for name in TANKER_NAMES}
    for values, missing in (
        ({}, set()),
        ({'mode': 'track_any'}, named | {'vision_pose'}),
        ({'mode': 'detect'}, set()),
    ):
        processor = MarkerTrackerProcessor(MarkerTrackerParameters.from_mapping(values))
        yield pytest.param(processor, tanker, missing, id=f'markers {values}')
    images = {'debug/confined', 'debug/edges', 'debug/hough'}
    for values, missing in (
        ({}, {'pose', 'vision_pose'}),
        ({'mode': 'approach', 'runway_width': 30.0}, images),
    ):
        processor = RunwayDetectorProcessor(RunwayDetectorParameters.from_mapping(values))
        yield pytest.param(processor, approach, missing, id=f'runway {values}')


@pytest.mark.parametrize(('processor', 'flight', 'missing'), processors())
def test_every_output_is_what_rclpy_would_have_written(processor, flight, missing):
    seen = set()
    for frame_id, topic, ours in flight_of(processor, flight):
        seen.add(topic)
        message = deserialize_message(ours, processor.message_types[topic])
        theirs = serialize_message(message)
        theirs += bytes(-len(theirs) % 4)  # as DDS hands it on
        assert len(ours) == len(theirs), topic
        # rclpy leaves chance bytes in the padding.
        padding = {a for a, b in zip(ours, theirs, strict=True) if a != b}
        assert padding <= {0}, topic
        own_frame = OWN_FRAMES.get((processor.name, topic), frame_id)
        assert message.header.frame_id == own_frame
    wanted = {*processor.topics, *processor.debug_topics, *processor.periodic_topics}
    assert wanted - seen == missing


def test_the_constants_are_those_of_the_messages():
    assert {int(number) for number in cdr._DATATYPES.values()} == {
        PointField.FLOAT32,
        PointField.UINT8,
    }
    assert (runway._LINE_LIST, runway._ADD, runway._DELETE) == (
        Marker.LINE_LIST,
        Marker.ADD,
        Marker.DELETE,
    )
    levels = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR
    expected = cdr.OK, cdr.WARN, cdr.ERROR
    assert tuple(level[0] for level in levels) == expected


def test_a_whole_runway_frame_field_by_field():
    processor = RunwayDetectorProcessor(
        RunwayDetectorParameters(peak_neighborhood_rho=301, peak_neighborhood_theta=301)
    )
    flight = RunwayFlight(RunwaySettings(frames=3, width=320, height=240))
    for given in flight:
        outputs = list(processor.process(Frame(given.stamp_ns, 'nose', given.image)))
    said = messages_of(processor, outputs)
    rows = cdr.view_points(said['line_params'])
    marker, corrections = said['lines'], said['corrections']
    found = np.isfinite(rows['x'])
    assert found.any() and not found.all() and not said['line_params'].is_dense
    assert said['line_params'].height == 1 and not said['line_params'].is_bigendian
    assert said['line_params'].row_step == 48 * len(rows) == len(said['line_params'].data)
    assert (marker.ns, marker.id, marker.type, marker.action) == ('runway', 0, 5, 0)
    assert (marker.pose.orientation.w, marker.scale.x) == (1.0, 2.0)
    assert not marker.frame_locked and marker.text == marker.mesh_resource == ''
    np.testing.assert_allclose(
        [(p.x, p.y, p.z) for p in marker.points[::2]],
        [(row['x'], row['y'], 0.0) for row in rows[found]],
        rtol=1e-5,
    )
    assert all(color.a == 1.0 for color in marker.colors)
    assert len(marker.colors) == len(marker.points) > 0
    for status, row in zip(corrections.status, rows, strict=True):
        values = {pair.key: pair.value for pair in status.values}
        assert list(values) == ['rho', 'theta_deg', 'rho_flag', 'theta_flag', 'corrected']
        assert float(values['rho']) == pytest.approx(float(row['rho']), abs=1e-4, nan_ok=True)
        assert status.level == (b'\0' if status.message == 'ok' else b'\1')
    assert math.isnan(said['vanishing_point'].point.x)


@pytest.mark.parametrize('frame_id', FRAME_IDS)
def test_a_transform_as_rosbags_reads_it(frame_id):
    """tf2_msgs is not everywhere, its definition is."""
    turn = np.array([(0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)])
    placement = Placement(turn, np.array((1.0, 2.0, 3.0)), np.eye(6))
    data = encode_transform(placement, cdr_header(5_000_000_007, frame_id), 'tanker')
    (transform,) = decode_message('tf2_msgs/msg/TFMessage', data).transforms
    assert (transform.header.stamp.sec, transform.header.stamp.nanosec) == (5, 7)
    assert (transform.header.frame_id, transform.child_frame_id) == (frame_id, 'tanker')
    translation, rotation = transform.transform.translation, transform.transform.rotation
    assert (translation.x, translation.y, translation.z) == (1.0, 2.0, 3.0)
    assert (rotation.x, rotation.y) == (0.0, 0.0)
    assert (rotation.z, rotation.w) == pytest.approx((math.sqrt(0.5), math.sqrt(0.5)))
