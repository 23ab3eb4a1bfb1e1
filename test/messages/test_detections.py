"""Results as vision_msgs has them, read by rosbags; the package itself is not on PyPI."""

import math

import numpy as np
import pytest

pytest.importorskip('sensor_msgs')

from mvuav_ros.messages import detections
from mvuav_ros.messages.cdr import view_points
from mvuav_ros.messages.definitions import decode_message, schema_of, typestore
from mvuav_ros.messages.images import Frame
from mvuav_ros.messages.sensors import type_name
from mvuav_ros.parameters.runway_detector import RunwayDetectorParameters
from mvuav_ros.processing.marker_processor import MarkerTrackerProcessor
from mvuav_ros.processing.runway_processor import RunwayDetectorProcessor
from mvuav_ros.simulation.runway_flight import RunwayFlight
from mvuav_ros.simulation.settings import RunwaySettings, TankerSettings
from mvuav_ros.simulation.tanker_flight import TankerFlight
from mvuav_ros.vision.frames import from_quaternion

KINDS = {name: f'vision_msgs/msg/Detection{n}Array' for name, n in
         (('detections', '2D'), ('detections_3d', '3D'))}  # fmt: skip


@pytest.fixture(autouse=True)
def vision_msgs(monkeypatch):
    types = {name: typestore().types[kind] for name, kind in KINDS.items()}
    monkeypatch.setattr(detections, 'TYPES', types)
    monkeypatch.setattr(
        'mvuav_ros.processing.runway_processor._DETECTIONS', {'detections': types['detections']}
    )


def fly(processor, flight):
    for frame in flight:
        camera = flight.camera
        outputs = dict(processor.process(Frame(frame.stamp_ns, 'nose', frame.image, camera)))
        said = {}
        for topic in KINDS.keys() & outputs.keys():
            data = outputs[topic]()
            said[topic] = typestore().deserialize_cdr(data, KINDS[topic])
            # Nothing is missing and nothing left over, by another writer.
            again = bytes(typestore().serialize_cdr(said[topic], KINDS[topic]))
            assert again == data.rstrip(b'\0') + bytes(len(again) - len(data.rstrip(b'\0')))
        yield frame, said, outputs


def xyz(message):
    return np.array((message.x, message.y, message.z))


def test_markers_and_their_body():
    processor = MarkerTrackerProcessor()
    assert KINDS.keys() <= processor.topics.keys()
    flight = TankerFlight(
        TankerSettings(motion='docking', frames=12, seed=3, failures='rudder@0.2-0.4')
    )
    hidden = with_pose = 0
    for frame, said, outputs in fly(processor, flight):
        rows = view_points(decode_message('sensor_msgs/msg/PointCloud2', outputs['markers']()))
        found = said['detections'].detections
        assert said['detections'].header.frame_id == 'nose'
        names = [each.id for each in found]
        hidden += 'rudder' not in names
        for each in found:
            true = frame.truth.markers[flight.rig.names.index(each.id)]
            centre, (result,) = each.bbox.center.position, each.results
            assert math.dist((centre.x, centre.y), (true.x, true.y)) < 1.0
            assert (result.hypothesis.class_id, result.hypothesis.score) == (each.id, 1.0)
            (area,) = rows['area'][rows['label'] == flight.rig.names.index(each.id)]
            assert each.bbox.size_x == each.bbox.size_y == pytest.approx(math.sqrt(area))
            assert math.isnan(result.pose.pose.position.x)
        for body in said['detections_3d'].detections:
            with_pose += 1
            (result,) = body.results
            assert result.hypothesis.class_id == body.id == 'tanker_747'
            place, turn = xyz(result.pose.pose.position), result.pose.pose.orientation
            assert place == pytest.approx(frame.truth.translation, rel=0.05)
            low, high = flight.rig.positions.min(axis=0), flight.rig.positions.max(axis=0)
            middle = from_quaternion(turn.x, turn.y, turn.z, turn.w) @ (low + high) / 2
            assert xyz(body.bbox.center.position) == pytest.approx(place + middle)
            assert xyz(body.bbox.size) == pytest.approx(high - low)
            assert np.linalg.eigvalsh(result.pose.covariance.reshape(6, 6)).min() > 0
    assert 0 < hidden < 12 and with_pose > 6


def test_a_runway_in_its_box():
    given = {'mode': 'approach', 'runway_width': 30.0}
    processor = RunwayDetectorProcessor(RunwayDetectorParameters.from_mapping(given))
    assert 'detections' in processor.topics and 'detections_3d' not in processor.topics
    flight = RunwayFlight(RunwaySettings(frames=5))
    scores = []
    for _, said, _ in fly(processor, flight):
        assert said.keys() == {'detections'}
        for each in said['detections'].detections:
            assert each.id == 'runway' and each.bbox.size_x > 20 and each.bbox.size_y > 5
            scores.append(each.results[0].hypothesis.score)
    assert len(scores) >= 3 and all(0.5 <= score < 1.0 for score in scores)


def test_a_recording_has_their_definitions():
    for name, kind in detections.TYPES.items():
        schema = schema_of(KINDS[name])
        assert type_name(kind).endswith('Array')
        assert 'ObjectHypothesisWithPose[] results' in schema.text
