"""Frames: what tf2, RViz and an autopilot make of the poses, by way of the messages' bytes."""

import math
import runpy
import sys
from types import ModuleType

import numpy as np
import pytest

pytest.importorskip('sensor_msgs')

from geometry_msgs.msg import PoseWithCovarianceStamped
from rclpy.serialization import deserialize_message
from rosbags.typesys import Stores, get_typestore
from sensor_msgs.msg import PointCloud2
from visualization_msgs.msg import Marker

from mvuav_ros.messages import detections, poses
from mvuav_ros.messages.cdr import view_points
from mvuav_ros.messages.images import Frame
from mvuav_ros.parameters.declaration import ParameterError
from mvuav_ros.parameters.runway_detector import RunwayDetectorParameters
from mvuav_ros.processing.marker_processor import MarkerTrackerProcessor
from mvuav_ros.processing.runway_processor import RunwayDetectorProcessor
from mvuav_ros.simulation.runway_flight import RunwayFlight
from mvuav_ros.simulation.settings import RunwaySettings, TankerSettings
from mvuav_ros.simulation.tanker_flight import TankerFlight
from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.frames import OPTICAL_FROM_BODY, about_x, about_y, about_z
from mvuav_ros.vision.markers.marker_results import MarkerState
from mvuav_ros.vision.pose import Pose

TYPES = get_typestore(Stores.ROS2_JAZZY)
CAMERA_FRAME = 'camera_optical_frame'
WIDTH = 30.0
RUNWAY = RunwayFlight(RunwaySettings(frames=40, runway_width=WIDTH))
TANKER = TankerFlight(TankerSettings(motion='docking', frames=90, seed=3, failures='all@1-9'))


@pytest.fixture(autouse=True)
def tf2_msgs(monkeypatch):
    """tf2_msgs is not on PyPI; its definition is in rosbags, whose reader is not ours."""
    monkeypatch.setattr(poses, 'TF_TYPE', TYPES.types['tf2_msgs/msg/TFMessage'])


def matrix(translation, quaternion):
    """4 x 4, from the quaternion's definition: not the code under test."""
    x, y, z, w = quaternion
    placed = np.eye(4)
    placed[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    placed[:3, 3] = translation
    return placed


def numbers(message):
    return [getattr(message, name) for name in 'xyzw' if hasattr(message, name)]


def tf(output):
    """Parent, child and the child's place in the parent."""
    message = TYPES.deserialize_cdr(output, 'tf2_msgs/msg/TFMessage')
    (stamped,) = message.transforms
    placed = stamped.transform
    place = matrix(numbers(placed.translation), numbers(placed.rotation))
    return stamped.header.frame_id, stamped.child_frame_id, place


def pose_of(data):
    message = deserialize_message(data, PoseWithCovarianceStamped)
    pose = message.pose.pose
    return message.header.frame_id, matrix(numbers(pose.position), numbers(pose.orientation))


def project(point, place, model):
    """Px of a point of the child's frame, in the camera's image."""
    x, y, z = (place @ [*point, 1.0])[:3]
    k = model.k
    return k[0] * x / z + k[2], k[4] * y / z + k[5]


def fly(processor, flight, *, camera=True):
    """The outputs of every frame, as bytes by topic."""
    said = []
    model = flight.camera if camera else None
    for frame in flight:
        outputs = processor.process(Frame(frame.stamp_ns, CAMERA_FRAME, frame.image, model))
        said.append({topic: make() for topic, make in outputs})
    return said


def approach(**values):
    given = {'mode': 'approach', 'runway_width': WIDTH, **values}
    return RunwayDetectorProcessor(RunwayDetectorParameters.from_mapping(given))


def test_a_point_of_the_runways_edge_lands_on_the_edges_pixel():
    """On that of the line that was found, and of the edge where it truly is."""
    processor = approach()
    said, model = fly(processor, RUNWAY), RUNWAY.camera
    assert processor.topics['/tf'] is poses.TF_TYPE
    checked = 0
    for outputs, frame in zip(said, RUNWAY, strict=True):
        if '/tf' not in outputs:
            continue
        parent, child, place = tf(outputs['/tf'])
        assert (parent, child) == (CAMERA_FRAME, 'runway')
        rows = view_points(deserialize_message(outputs['line_params'], PointCloud2))
        truth = frame.truth
        for index, y in ((0, WIDTH / 2), (1, -WIDTH / 2)):
            found, edge = rows[index], truth.lines[index]
            # On the runway, ahead of the aircraft and in the picture.
            for ahead in (150.0, 300.0, 600.0):
                start = max(truth.pose.position[0], 0.0)
                pixel = project((start + ahead, y, 0.0), place, model)
                if not (0 <= pixel[0] < model.width and 0 <= pixel[1] < model.height):
                    continue
                for rho, theta in ((found['rho'], found['theta']), (edge.rho, edge.theta)):
                    distance = pixel[0] * math.cos(theta) + pixel[1] * math.sin(theta) - rho
                    assert abs(distance) < 2.0
                checked += 1
    assert checked > 50


def test_the_pose_in_the_runways_frame_is_the_inverse_of_the_transform():
    said = fly(approach(runway_frame='rwy_09'), RUNWAY)
    both = [outputs for outputs in said if '/tf' in outputs]
    assert len(both) > 10
    for outputs in both:
        _, child, place = tf(outputs['/tf'])
        body = np.eye(4)
        body[:3, :3] = OPTICAL_FROM_BODY
        for topic in ('pose', 'vision_pose'):
            frame_id, camera = pose_of(outputs[topic])
            assert frame_id == child == 'rwy_09'
            np.testing.assert_allclose(place @ camera, body, atol=1e-6)
    # What is not known in full is said on ~/pose and kept from those who take no NaN.
    for outputs in said:
        known = 'pose' in outputs and np.isfinite(pose_of(outputs['pose'])[1]).all()
        assert known == ('vision_pose' in outputs) == ('/tf' in outputs)


def test_the_tankers_markers_land_on_their_pixels():
    said, model = fly(MarkerTrackerProcessor(), TANKER), TANKER.camera
    checked = 0
    for outputs in said:
        assert ('/tf' in outputs) == ('vision_pose' in outputs)
        if '/tf' not in outputs:
            continue
        parent, child, place = tf(outputs['/tf'])
        assert (parent, child) == (CAMERA_FRAME, 'tanker_747')
        rows = view_points(deserialize_message(outputs['markers'], PointCloud2))
        for point, row in zip(TANKER.rig.positions, rows, strict=True):
            if row['state'] == MarkerState.DETECTED:
                assert math.dist(project(point, place, model), (row['x'], row['y'])) < 2.0
                checked += 1
        frame_id, camera = pose_of(outputs['vision_pose'])
        assert frame_id == 'tanker_747'
        body = np.eye(4)
        body[:3, :3] = OPTICAL_FROM_BODY
        np.testing.assert_allclose(place @ camera, body, atol=1e-6)
    assert checked > 20


def test_an_autopilot_gets_its_message_complete_or_not_at_all():
    """By the definition that robot_localization and MAVROS's vision_pose/pose_cov are built on."""
    said = [*fly(MarkerTrackerProcessor(), TANKER), *fly(approach(), RUNWAY)]
    poses = [outputs['vision_pose'] for outputs in said if 'vision_pose' in outputs]
    assert 10 < len(poses) < len(said)
    for data in poses:
        pose = TYPES.deserialize_cdr(data, 'geometry_msgs/msg/PoseWithCovarianceStamped').pose
        orientation = numbers(pose.pose.orientation)
        assert np.isfinite([*numbers(pose.pose.position), *orientation]).all()
        assert math.hypot(*orientation) == pytest.approx(1.0)
        covariance = pose.covariance.reshape(6, 6)
        assert np.linalg.eigvalsh(covariance).min() > 0
        assert covariance.max() < 1e6


def test_the_covariance_follows_the_change_of_frame():
    """Against samples of the pose that are turned round one by one."""
    chance = np.random.default_rng(5)
    rotation = about_z(0.3) @ about_y(-0.2) @ about_x(1.4)
    translation = np.array([2.0, -1.0, 30.0])
    root = np.diag([0.1, 0.2, 0.5, 1e-3, 2e-3, 3e-3]) @ (np.eye(6) + 0.2 * np.ones((6, 6)))
    covariance = root @ root.T
    given = poses.camera_in_body(Pose(rotation, translation, covariance, np.zeros((0, 2)), 0.0))
    samples = []
    for sample in chance.multivariate_normal(np.zeros(6), covariance, 20_000):
        turn = about_x(sample[3]) @ about_y(sample[4]) @ about_z(sample[5])
        turned = turn @ rotation
        place = -turned.T @ (translation + sample[:3])
        error = (turned.T @ OPTICAL_FROM_BODY) @ given.rotation.T
        angles = error[2, 1], error[0, 2], error[1, 0]
        samples.append([*(place - given.translation), *angles])
    measured = np.cov(np.array(samples).T)
    scale = np.sqrt(np.outer(np.diag(given.covariance), np.diag(given.covariance)))
    assert np.abs((measured - given.covariance) / scale).max() < 0.05


@pytest.mark.parametrize('mode', ['thesis', 'approach'])
def test_lines_on_the_plane_overlay_those_on_the_image(mode):
    model = RUNWAY.camera
    plain, drawn = (
        [
            deserialize_message(outputs['lines'], Marker)
            for outputs in fly(approach(mode=mode), RUNWAY, camera=calibrated)
        ]
        for calibrated in (False, True)
    )
    assert any(message.points for message in drawn)
    for pixels, metres in zip(plain, drawn, strict=True):
        assert len(pixels.points) == len(metres.points)
        for pixel, point in zip(pixels.points, metres.points, strict=True):
            assert (pixel.z, point.z) == (0.0, 1.0)
            x, y = model.k[0] * point.x + model.k[2], model.k[4] * point.y + model.k[5]
            assert math.dist((x, y), (pixel.x, pixel.y)) < 0.01
        assert metres.scale.x == pytest.approx(pixels.scale.x / model.k[0])


def test_lines_of_another_size_than_the_calibrations_stay_pixels():
    processor = approach(mode='thesis')
    processor.set_camera(CameraModel(64, 48, tuple(RUNWAY.camera.matrix.ravel())))
    frame = RUNWAY.frame(0)
    outputs = dict(processor.process(Frame(frame.stamp_ns, CAMERA_FRAME, frame.image)))
    assert deserialize_message(outputs['lines'](), Marker).scale.x == 2.0


@pytest.mark.parametrize('make', [MarkerTrackerProcessor, RunwayDetectorProcessor])
def test_tf_can_be_switched_off_and_needs_tf2_msgs(make, monkeypatch):
    assert '/tf' in make().topics
    off = make(make.parameters_type(publish_tf='off'))
    assert '/tf' not in off.topics
    monkeypatch.setattr(poses, 'TF_TYPE', None)
    without = make()
    assert '/tf' not in without.topics
    assert without.status == ''


def test_the_runways_frame_needs_a_name():
    with pytest.raises(ParameterError, match='runway_frame'):
        RunwayDetectorParameters(runway_frame='')


@pytest.mark.parametrize(('module', 'package'), [(poses, 'tf2_msgs'), (detections, 'vision_msgs')])
def test_a_message_package_that_is_broken_is_not_taken_for_a_missing_one(
    module: ModuleType, package: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in (package, f'{package}.msg'):
        monkeypatch.setitem(sys.modules, name, ModuleType(name))
    with pytest.raises(ImportError, match=package):
        runpy.run_path(str(module.__file__))
