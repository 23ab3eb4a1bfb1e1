"""The same bag through the live nodes and through `mvuav replay`: the same bytes."""

from __future__ import annotations

import math
import signal
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PointStamped, PoseWithCovarianceStamped, Vector3Stamped
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import CameraInfo, Image, Imu, PointCloud2
from support.graph import ROOT, Graph, image_message
from visualization_msgs.msg import Marker

from mvuav_ros.messages.images import IMAGE
from mvuav_ros.messages.sensors import CAMERA_INFO, IMU, stamp_ns_of
from mvuav_ros.offline.frame_messages import frame_messages
from mvuav_ros.recordings.reading import open_recording
from mvuav_ros.recordings.writing import RecordingWriter
from mvuav_ros.sources.opening import open_source

TANKER = Path(ROOT) / 'bags' / 'tanker.mcap'
MARKER_TOPICS = {
    '/marker_tracker/markers': PointCloud2,
    '/marker_tracker/rpy': Vector3Stamped,
    '/marker_tracker/pose': PoseWithCovarianceStamped,
    '/marker_tracker/integrity': DiagnosticArray,
    '/marker_tracker/marker/left_stabilizer': PointStamped,
}
NODE = 'runway_detector'
RUNWAY_TOPICS = {
    '/runway_detector/line_params': PointCloud2,
    '/runway_detector/lines': Marker,
    '/runway_detector/corrections': DiagnosticArray,
}
APPROACH_TOPICS = {
    **RUNWAY_TOPICS,
    '/runway_detector/vanishing_point': PointStamped,
    '/runway_detector/pose': PoseWithCovarianceStamped,
    '/runway_detector/integrity': DiagnosticArray,
}
# Nothing may be dropped on the way, however fast the frames come.
INPUTS = ('image_raw', 'camera_info')


def keeping_all(end: str, topics: Iterable[str]) -> dict[str, str]:
    return {
        f'qos_overrides.{topic}.{end}.{policy}': value
        for topic in topics
        for policy, value in (('reliability', 'reliable'), ('history', 'keep_all'))
    }


SENDING, RECEIVING = (
    keeping_all(end, ('/image_raw', '/camera_info')) for end in ('publisher', 'subscription')
)


@pytest.fixture(scope='module')
def runway(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A colour flight: lines that sway, jump and vanish, so that every flag comes up."""
    path = tmp_path_factory.mktemp('bag') / 'runway.mcap'
    random = np.random.default_rng(7)
    with RecordingWriter(path) as writer:
        for index in range(150):
            frame = np.full((240, 320, 3), (40, 90, 60), np.uint8)
            sway = 5 * np.sin(index / 8) + (80 if index % 40 == 20 else 0)
            if index % 50 != 45:
                for left, right in ((-70, -60), (-4, 4), (60, 70)):
                    corners = [(160 + sway, 20), (160 + left, 240), (160 + right, 240)]
                    points = np.round(np.array(corners) * 16).astype(np.int32)
                    cv2.fillPoly(frame, [points], (230, 230, 230), cv2.LINE_AA, 4)
            frame += random.integers(0, 20, frame.shape, np.uint8)
            message = image_message(frame, index)
            stamp_ns = stamp_ns_of(message.header)
            writer.write('/nose/image_raw', IMAGE, stamp_ns, serialize_message(message))
    return path


def replayed(
    bag: Path,
    out: Path,
    node: str,
    topics: dict[str, type],
    parameters: dict[str, Any],
    *options: str,
) -> dict[str, list[bytes]]:
    command = [sys.executable, '-m', 'mvuav_ros', 'mvuav', 'replay', str(bag), '-o', str(out)]
    command += options
    for name, value in parameters.items():
        command += ['--param', f'{node}:{name}:={value}']
    subprocess.run(command, check=True, cwd=ROOT)
    found: dict[str, list[bytes]] = {topic: [] for topic in topics}
    with open_recording(out) as recording:
        for message in recording.messages(topics):
            found[message.topic].append(bytes(message.data))
    return found


def lived(
    graph: Graph, bag: Path, node: str, topics: dict[str, type], parameters: dict[str, Any]
) -> dict[str, list[bytes]]:
    """What the live node says to the same bag, published as fast as it goes."""
    with open_recording(bag) as recording:
        frames = sum(message.type == IMAGE for message in recording.messages())
    answering = {f'qos_overrides.{topic}.publisher.history': 'keep_all' for topic in topics}
    graph.start(node, **parameters, **RECEIVING, **answering)
    live = {topic: graph.listen(topic, kind, raw=True) for topic, kind in topics.items()}
    graph.start('video_source', source=bag, rate=1000.0, **SENDING)
    main = next(iter(topics))
    graph.until(lambda: len(live[main]) == frames, f'{frames} results')
    graph.spin(0.5)
    return live


@pytest.mark.parametrize('parameters', [{}, {'mode': 'detect', 'threshold': 0.5}])
def test_marker_tracker(graph: Graph, tmp_path: Path, parameters: dict[str, Any]) -> None:
    arguments = 'marker_tracker', MARKER_TOPICS, parameters
    expected = replayed(TANKER, tmp_path / 'out.mcap', *arguments)
    assert lived(graph, TANKER, *arguments) == expected
    assert [len(messages) for messages in expected.values()][:3] == [180, 180, 180]
    rpy = [deserialize_message(m, Vector3Stamped) for m in expected['/marker_tracker/rpy']]
    assert sum(not math.isnan(message.vector.y) for message in rpy) > 100
    assert len(expected['/marker_tracker/marker/left_stabilizer']) > 100


@pytest.mark.parametrize('parameters', [{}, {'num_peaks': 5, 'channel': 'intensity'}])
def test_runway_detector(
    graph: Graph, tmp_path: Path, runway: Path, parameters: dict[str, Any]
) -> None:
    arguments = 'runway_detector', RUNWAY_TOPICS, parameters
    expected = replayed(runway, tmp_path / 'out.mcap', *arguments)
    assert lived(graph, runway, *arguments) == expected
    assert [len(messages) for messages in expected.values()] == [150, 150, 150]
    corrections = expected['/runway_detector/corrections']
    assert any(b'corrected: the old' in message for message in corrections)
    assert any(b'not found' in message for message in corrections)


def test_the_attitude_of_an_autopilot(graph: Graph, tmp_path: Path) -> None:
    """A replay had no way to say what a node is told by a remapping."""
    bag, imu = tmp_path / 'approach.mcap', '/mavros/imu/data'
    flight = open_source('sim:runway?frames=20&width=320&height=240&seed=1')
    names = {name: f'/nose/{name}' for name in INPUTS} | {'imu': imu}
    with RecordingWriter(bag) as writer:
        for frame in flight.frames():
            for topic, kind, make in frame_messages(frame):
                if (name := topic.removeprefix('/')) in names:
                    writer.write(names[name], kind, frame.stamp_ns, make())
    parameters = {'mode': 'approach', 'runway_width': 30.0}
    arguments = NODE, APPROACH_TOPICS, parameters
    without = replayed(bag, tmp_path / 'without.mcap', *arguments)
    expected = replayed(bag, tmp_path / 'with.mcap', *arguments, '--imu-topic', imu)
    assert without != expected

    remap = tuple(f'{name}:={names[name]}' for name in INPUTS)
    unmapped = graph.start(NODE, remap=remap, **parameters)
    publish = publishers(graph, bag)
    graph.until(lambda: imu in graph.diagnostics(NODE)['message'], 'words about the imu')
    expected_words = f'no attitude: nothing publishes /imu; there is {imu}: remap imu'
    assert expected_words in graph.diagnostics(NODE)['message']
    unmapped.send_signal(signal.SIGINT)
    unmapped.wait()

    qos = keeping_all('subscription', names.values()) | keeping_all('publisher', APPROACH_TOPICS)
    graph.start(NODE, remap=(*remap, f'imu:={imu}'), **parameters, **qos)
    live = {topic: graph.listen(topic, kind, raw=True) for topic, kind in APPROACH_TOPICS.items()}
    graph.until(lambda: all(p.get_subscription_count() for p in publish.values()), 'subscribers')
    graph.spin(0.5)
    with open_recording(bag) as recording:
        for message in recording.messages():
            publish[message.topic].publish(bytes(message.data))
            graph.spin(0.02)
    main = next(iter(APPROACH_TOPICS))
    graph.until(lambda: len(live[main]) == len(expected[main]), 'all results')
    graph.spin(0.5)
    assert live == expected


def publishers(graph: Graph, bag: Path) -> dict[str, Any]:
    """One for each topic of a bag, reliable."""
    kinds = {IMAGE: Image, CAMERA_INFO: CameraInfo, IMU: Imu}
    with open_recording(bag) as recording:
        topics = recording.topics
    qos = QoSProfile(depth=1000)
    return {t.name: graph.probe.create_publisher(kinds[t.type], t.name, qos) for t in topics}
