"""The vehicle's pose and the tree of frames, against the arithmetic of those who take them."""

import math
from dataclasses import astuple, replace
from itertools import islice
from types import SimpleNamespace as Some

import numpy as np
import pytest

pytest.importorskip('sensor_msgs')

from rosbags.typesys import Stores, get_typestore
from support.marker_scenes import draw, tanker_at

from mvuav_ros import track
from mvuav_ros.messages import poses
from mvuav_ros.messages.cdr import view_points
from mvuav_ros.messages.definitions import decode_message
from mvuav_ros.messages.images import Frame
from mvuav_ros.parameters.declaration import ParameterError
from mvuav_ros.parameters.marker_tracker import MarkerTrackerParameters
from mvuav_ros.parameters.runway_detector import RunwayDetectorParameters
from mvuav_ros.processing.marker_processor import MarkerTrackerProcessor
from mvuav_ros.processing.runway_processor import RunwayDetectorProcessor
from mvuav_ros.simulation.runway_flight import RunwayFlight
from mvuav_ros.simulation.settings import RunwaySettings, TankerSettings
from mvuav_ros.simulation.tanker_flight import TankerFlight
from mvuav_ros.vision.approach.approach_results import Guidance
from mvuav_ros.vision.frames import (
    OPTICAL_FROM_BODY,
    Attitude,
    about_x,
    about_y,
    about_z,
    east_north_up,
    from_quaternion,
    from_rpy,
    north_east_down,
    quaternion,
    rpy,
)
from mvuav_ros.vision.image import Image

TYPES = get_typestore(Stores.ROS2_JAZZY)
TF = '/tf'
DOWN_20 = (0.0, 20.0, 0.0)
XYZ = (1.2, -0.3, 0.4)
WIDTH = 30.0
CAMERA = 'nose_optical'


@pytest.fixture(autouse=True)
def tf2_msgs(monkeypatch):
    monkeypatch.setattr(poses, 'TF_TYPE', TYPES.types['tf2_msgs/msg/TFMessage'])


def runway(**values):
    given = {'mode': 'approach', 'runway_width': WIDTH, **values}
    return RunwayDetectorProcessor(RunwayDetectorParameters.from_mapping(given))


def tanker(**values):
    return MarkerTrackerProcessor(MarkerTrackerParameters.from_mapping(values))


FLIGHT = RunwayFlight(RunwaySettings(frames=8, runway_width=WIDTH, camera_pitch_deg=20.0))
RUNWAY, RUNWAY_CAMERA = list(FLIGHT), FLIGHT.camera
LEVEL = Attitude.from_roll_pitch(0.0, 0.0)
ROWS = 'sensor_msgs/msg/PointCloud2'
TANKER_FLIGHT = TankerFlight(TankerSettings(motion='docking', frames=90, seed=3))


def fly(processor, frames, camera, frame_id=CAMERA):
    said = []
    for frame in frames:
        outputs = processor.process(Frame(frame.stamp_ns, frame_id, frame.image, camera))
        said.append({topic: make() for topic, make in outputs if topic in ('vision_pose', TF)})
    return said


def fly_tanker(processor, frame_id=CAMERA):
    return fly(processor, islice(TANKER_FLIGHT, 4), TANKER_FLIGHT.camera, frame_id)


def place(data):
    """4 x 4 and covariance of a PoseWithCovarianceStamped."""
    pose = TYPES.deserialize_cdr(data, 'geometry_msgs/msg/PoseWithCovarianceStamped').pose
    p, q = pose.pose.position, pose.pose.orientation
    return homogeneous(p, q), np.reshape(pose.covariance, (6, 6))


def homogeneous(p, q):
    made = np.eye(4)
    made[:3, :3] = from_quaternion(q.x, q.y, q.z, q.w)
    made[:3, 3] = p.x, p.y, p.z
    return made


def tf(data):
    (each,) = TYPES.deserialize_cdr(data, 'tf2_msgs/msg/TFMessage').transforms
    there = homogeneous(each.transform.translation, each.transform.rotation)
    return each.header.frame_id, each.child_frame_id, there


class Listener:
    """Frames as tf2 keeps them: the newest transform says who a frame's one parent is."""

    def __init__(self, *transforms_):
        self.parents, self.disputed = {}, set()
        for parent, child, there in transforms_:
            before = self.parents.get(child)
            if before is not None and before[0] != parent:
                self.disputed.add(child)
            self.parents[child] = parent, there

    def lookup(self, target, source):
        def up(frame):
            there, chain = np.eye(4), []
            while True:
                chain.append((frame, there))
                if frame not in self.parents:
                    return chain
                frame, step = self.parents[frame]
                there = step @ there

        of_target = dict(up(target))
        for frame, there in up(source):
            if frame in of_target:
                return np.linalg.inv(of_target[frame]) @ there
        raise LookupError(f'{target} and {source} are in two trees')


def static(parent, child, there):
    x, y, z, w = quaternion(there[:3, :3])
    p = there[:3, 3]
    transform = Some(translation=Some(x=p[0], y=p[1], z=p[2]), rotation=Some(x=x, y=y, z=z, w=w))
    header = Some(frame_id=parent)
    return Some(transforms=[Some(header=header, child_frame_id=child, transform=transform)])


def mounted(rpy_deg=DOWN_20, xyz=XYZ):
    """base_link from the camera's optical axes."""
    made = np.eye(4)
    made[:3, :3] = from_rpy(*np.radians(rpy_deg)) @ OPTICAL_FROM_BODY.T
    made[:3, 3] = xyz
    return made


def test_a_camera_20_degrees_down_is_no_pitch_of_the_vehicle():
    """The simulated vehicle flies level, its camera looks down."""
    given = {'base_frame': 'base_link', 'camera_mount_rpy_deg': DOWN_20}
    both = [fly(runway(**more), RUNWAY, RUNWAY_CAMERA) for more in ({}, given)]
    cameras, vehicles = (
        [place(each['vision_pose'])[0] for each in said if 'vision_pose' in each] for said in both
    )
    assert len(vehicles) == len(cameras) > 3
    for camera, vehicle in zip(cameras, vehicles, strict=True):
        assert math.degrees(rpy(camera[:3, :3])[1]) == pytest.approx(20.0, abs=2.5)
        assert math.degrees(rpy(vehicle[:3, :3])[1]) == pytest.approx(0.0, abs=2.5)
        np.testing.assert_allclose(vehicle[:3, 3], camera[:3, 3])


@pytest.mark.parametrize('source', ['parameters', 'tf_static'])
def test_the_mount_comes_from_the_parameters_or_from_tf_static(source):
    given = {'camera_mount_rpy_deg': DOWN_20, 'camera_mount_xyz': XYZ}
    processor = tanker(base_frame='base_link', **(given if source == 'parameters' else {}))
    if source == 'tf_static':
        halfway = mounted(rpy_deg=(0.0, 0.0, 0.0), xyz=(1.0, 0.0, 0.0))
        processor.static_transforms.add(static('base_link', 'gimbal', halfway))
        rest = np.linalg.inv(halfway) @ mounted()
        processor.static_transforms.add(static('gimbal', CAMERA, rest))
    vehicles, cameras = fly_tanker(processor), fly_tanker(tanker())
    assert len(vehicles) == 4
    for vehicle, camera in zip(vehicles, cameras, strict=True):
        optical_in_body = np.linalg.inv(tf(camera[TF])[2])
        expected = optical_in_body @ np.linalg.inv(mounted())
        np.testing.assert_allclose(place(vehicle['vision_pose'])[0], expected, atol=1e-9)
    assert processor.frames_problem == ''


ON_ITS_SIDE = from_rpy(*np.radians((90.0, 0.0, 30.0)))
"""base_link from the axes of a sensor."""
BY_TF, BY_PARAMETERS = {}, {'camera_mount_rpy_deg': DOWN_20}
"""Where the camera's mount comes from."""


@pytest.mark.parametrize(
    ('mount', 'attitude'),
    [
        (BY_TF, LEVEL),
        (BY_TF, Attitude(*quaternion(ON_ITS_SIDE), sensor='imu_link')),
        (BY_PARAMETERS, Attitude(*quaternion(ON_ITS_SIDE), sensor='imu_link')),
        (BY_TF, Attitude(*astuple(LEVEL)[:4], sensor='base_link')),
        (BY_TF, Attitude(*astuple(LEVEL)[:4], sensor='nowhere')),
    ],
)
def test_the_horizon_of_an_attitude_has_the_mounts_of_tf_static(mount, attitude):
    """It was that of a camera, and of a sensor, with the vehicle's axes."""

    def nearest(rows):
        return rows['rho'] * np.exp(1j * rows['theta'])

    def rows(processor, attitude):
        said = []
        for frame in RUNWAY:
            seen = Frame(frame.stamp_ns, CAMERA, frame.image, RUNWAY_CAMERA, attitude)
            outputs = dict(processor.process(seen))
            said.append(view_points(decode_message(ROWS, outputs['line_params']())).copy())
        assert processor.status == ''
        return np.stack(said)

    expected = rows(runway(camera_mount_rpy_deg=DOWN_20), LEVEL)
    processor = runway(base_frame='base_link', **mount)
    processor.static_transforms.add(static('base_link', CAMERA, mounted()))
    sensor = np.eye(4)
    sensor[:3, :3] = ON_ITS_SIDE
    processor.static_transforms.add(static('base_link', 'imu_link', sensor))
    found = rows(processor, attitude)
    for name in ('x', 'y', 'confidence'):
        # The horizons differ by rounding, by which places are rounded to other pixels.
        np.testing.assert_allclose(found[name], expected[name], atol=0.2)
    # A level line has two angles; its point next to the corner has not.
    np.testing.assert_allclose(nearest(found), nearest(expected), atol=0.2)
    assert np.isfinite(found['rho'][:, :2]).all()


@pytest.mark.parametrize('attitude', [None, LEVEL])
@pytest.mark.parametrize('mount', [BY_TF, {'camera_mount_rpy_deg': (180.0, 20.0, 0.0)}])
def test_a_camera_that_hangs_upside_down_shows_the_same_vehicle(mount, attitude):
    def vehicles(processor, turned, rpy_deg):
        there = mounted(rpy_deg)
        there[:3, 3] = 0.0
        processor.static_transforms.add(static('base_link', CAMERA, there))
        for frame in RUNWAY:
            image = Image(frame.image.pixels[::turned, ::turned], frame.image.encoding)
            seen = Frame(frame.stamp_ns, CAMERA, image, RUNWAY_CAMERA, attitude)
            for topic, make in processor.process(seen):
                if topic == 'vision_pose':
                    yield place(make())[0]

    upright = list(vehicles(runway(base_frame='base_link'), 1, DOWN_20))
    found = list(vehicles(runway(base_frame='base_link', **mount), -1, (180.0, 20.0, 0.0)))
    assert len(found) == len(upright) > 3
    for one, other in zip(upright, found, strict=True):
        np.testing.assert_allclose(other[:3, :3], one[:3, :3], atol=2e-3)
        np.testing.assert_allclose(other[:3, 3], one[:3, 3], rtol=0.02, atol=0.3)


@pytest.mark.parametrize('rpy_deg', [(0.0, 0.0, 0.0), (180.0, 20.0, 0.0)])
def test_markers_before_a_camera_that_hangs_upside_down_have_their_own_names(rpy_deg):
    """Lights that are not quite the rig's are named by the level body before either camera."""
    lights = tanker_at(roll_deg=-rpy_deg[0]) * (1.0, 0.8) + (0.0, 40.0)
    processor = tanker(base_frame='base_link')
    processor.static_transforms.add(static('base_link', CAMERA, mounted(rpy_deg)))
    for number in range(6):
        if number == 4:
            # Another parameter leaves the mount, and what has been followed, as they are.
            given = {'base_frame': 'base_link', 'search_radius': 20}
            processor.configure(MarkerTrackerParameters.from_mapping(given))
        image = Image(draw(lights), 'mono8')
        outputs = dict(processor.process(Frame((1 + number) * 33_000_000, CAMERA, image)))
        rows = view_points(decode_message(ROWS, outputs['markers']()))
        if number > 2:
            seen = np.column_stack((rows['x'], rows['y']))
            np.testing.assert_allclose(seen, lights, atol=1.0)


def hanging(numbers, transforms=None):
    """Frames of a camera that hangs upside down, and where the lights are."""
    lights = tanker_at(roll_deg=180.0) * (1.0, 0.8) + (0.0, 40.0)
    image = Image(draw(lights), 'mono8')
    frames = (Frame((1 + number) * 33_000_000, CAMERA, image) for number in numbers)
    return [replace(frame, static_transforms=transforms) for frame in frames], lights


def seen_by(processor, frames):
    outputs = [dict(processor.process(frame)) for frame in frames][-1]
    rows = view_points(decode_message(ROWS, outputs['markers']()))
    return np.column_stack((rows['x'], rows['y']))


def test_a_mount_that_is_stated_later_takes_the_place_of_that_on_tf_static():
    processor, fresh = tanker(base_frame='base_link'), tanker(camera_mount_xyz=[1.0, 0.0, 0.0])
    processor.static_transforms.add(static('base_link', CAMERA, mounted((180.0, 20.0, 0.0))))
    by_tf = seen_by(processor, hanging(range(6))[0])
    given = {'base_frame': 'base_link', 'camera_mount_xyz': (1.0, 0.0, 0.0)}
    processor.configure(MarkerTrackerParameters.from_mapping(given))
    level = seen_by(processor, hanging(range(6, 12))[0])
    np.testing.assert_allclose(level, seen_by(fresh, hanging(range(6))[0]), atol=0.01)
    assert np.isfinite(by_tf).all()
    assert not np.allclose(level, by_tf)


def test_a_script_follows_the_mount_on_tf_static_as_the_nodes_do():
    transforms = poses.TransformTree()
    transforms.add(static('base_link', CAMERA, mounted((180.0, 20.0, 0.0))))
    frames, lights = hanging(range(6), transforms)
    source = Some(frames=lambda: iter(frames), is_rectified=False, close=lambda: None)
    given = MarkerTrackerParameters(base_frame='base_link')
    *_, last = track(source, parameters=given)
    seen = [(marker.x, marker.y) for marker in last.markers.values()]
    np.testing.assert_allclose(seen, lights, atol=1.0)


def test_a_camera_whose_frame_has_the_axes_of_a_body_is_doubted():
    """Many drivers call the optical frame as robot descriptions do the camera's body."""

    def said_of(frame, there, **given):
        processor = tanker(base_frame='base_link', **given)
        processor.static_transforms.add(static('base_link', frame, there))
        assert 'vision_pose' in fly_tanker(processor, 'camera')[-1]
        return processor.frames_problem

    for tilt in (DOWN_20, (0.0, -20.0, 160.0)):
        body = mounted(tilt)
        body[:3, :3] = body[:3, :3] @ OPTICAL_FROM_BODY
        assert 'camera looks up by /tf_static' in said_of('camera', body)
        # That one says what it is.
        assert said_of('up_optical_frame', body, camera_frame='up_optical_frame') == ''
        assert said_of('camera', mounted(tilt)) == ''
    for down in (60.0, 90.0):
        assert said_of('camera', mounted((0.0, down, 0.0))) == ''


def test_no_attitude_is_used_before_the_mount_is_known():
    processor = runway(base_frame='base_link')
    frame = RUNWAY[0]
    list(processor.process(Frame(frame.stamp_ns, CAMERA, frame.image, RUNWAY_CAMERA, LEVEL)))
    assert "no attitude for this image: the horizon is the image's" in processor.status
    assert f'does not lead from base_link to {CAMERA}' in processor.frames_problem


def test_a_transform_that_tf2_refuses_is_none():
    """An estimator that gets a NaN never comes back from it."""
    processor = tanker(base_frame='base_link')
    for length, x in ((0.0, 0.0), (2.0, 0.0), (math.nan, 0.0), (1.0, math.nan)):
        broken = static('base_link', CAMERA, mounted())
        (transform,) = (each.transform for each in broken.transforms)
        transform.translation.x = x
        for axis in 'xyzw':
            setattr(transform.rotation, axis, length * getattr(transform.rotation, axis))
        processor.static_transforms.add(broken)
    assert 'vision_pose' not in fly_tanker(processor)[-1]
    assert f'does not lead from base_link to {CAMERA}' in processor.frames_problem
    # tf2 knows frames without the slash in front.
    processor.static_transforms.add(static('/base_link', f'/{CAMERA}', mounted()))
    fly_tanker(processor)
    assert processor.frames_problem == ''


@pytest.mark.parametrize('direction', ['camera_to_body', 'body_to_camera'])
def test_without_its_mount_no_camera_is_taken_for_the_vehicle(direction):
    """Until /tf_static had come, an estimator got the camera's pitch as the vehicle's."""
    processor = tanker(base_frame='base_link', publish_tf=direction)
    said = fly_tanker(processor)[-1]
    assert 'vision_pose' not in said
    assert (TF in said) is (direction == 'camera_to_body')
    assert 'no ~/vision_pose of base_link' in processor.frames_problem
    assert f'does not lead from base_link to {CAMERA}' in processor.frames_problem
    # Of a frame without a pose nothing is missing there.
    dark = Image(np.zeros((480, 640), np.uint8), 'mono8')
    list(processor.process(Frame(2 * 10**18, CAMERA, dark)))
    assert processor.frames_problem == ''


def test_the_covariance_of_the_vehicle_has_the_cameras_lever():
    """Against samples, each turned about the target's axes."""
    chance = np.random.default_rng(1)
    rotation = about_z(0.4) @ about_y(0.2) @ about_x(-0.1)
    root = np.diag([0.1, 0.2, 0.5, 0.01, 0.02, 0.03]) @ (np.eye(6) + 0.2)
    camera = poses.Placement(rotation, np.array([9.0, 2.0, 3.0]), root @ root.T)
    mount = poses.mount_of((5.0, -2.0, 1.0), (3.0, 20.0, -8.0))
    given = poses.vehicle_of(camera, mount)
    samples = []
    for sample in chance.multivariate_normal(np.zeros(6), camera.covariance, 20_000):
        turn = np.eye(3) + np.cross(np.eye(3), sample[3:])
        turned = turn @ rotation @ mount.rotation.T
        moved = camera.translation + sample[:3] - turned @ mount.translation
        samples.append([*(moved - given.translation), *sample[3:]])
    measured = np.cov(np.array(samples).T)
    scale = np.sqrt(np.outer(np.diag(measured), np.diag(measured)))
    assert np.abs((measured - given.covariance) / scale).max() < 0.05


def test_the_covariance_over_a_runway_is_of_turns_about_its_axes():
    """Against differences: a camera that looks down rolls about an axis that points down too."""
    angles = np.array((0.2, math.radians(35.0), -0.1))
    root = np.diag([1.0, 0.2, 0.1, 0.01, 0.002, 0.004]) @ (np.eye(6) + 0.2)
    guidance = Guidance(-90.0, 4.0, 30.0, *angles, root @ root.T)
    given = poses.camera_in_runway(guidance)
    jacobian = np.eye(6)
    for axis in range(3):
        step = 1e-6 * np.eye(3)[axis]
        turned = (from_rpy(*(angles + step)) - from_rpy(*(angles - step))) / 2e-6
        cross = turned @ given.rotation.T
        jacobian[3:, 3 + axis] = cross[2, 1], cross[0, 2], cross[1, 0]
    expected = jacobian @ guidance.covariance @ jacobian.T
    np.testing.assert_allclose(given.covariance, expected, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize(
    ('values', 'parent', 'child'),
    [
        ({}, CAMERA, 'tanker_747'),
        ({'publish_tf': True}, CAMERA, 'tanker_747'),
        ({'camera_frame': 'left', 'body_frame': 'tanker_left'}, 'left', 'tanker_left'),
        ({'publish_tf': 'body_to_camera'}, 'tanker_747', CAMERA),
        (
            {'publish_tf': 'body_to_camera', 'base_frame': 'base_link', 'camera_mount_xyz': XYZ},
            'tanker_747',
            'base_link',
        ),
    ],
)
def test_tf_has_a_direction_and_names(values, parent, child):
    plain = fly_tanker(tanker())[-1]
    said = fly_tanker(tanker(**values))[-1]
    found = tf(said[TF])
    assert found[:2] == (parent, child)
    body_in_camera = tf(plain[TF])[2]
    expected = body_in_camera
    if 'publish_tf' in values and values['publish_tf'] is not True:
        expected = np.linalg.inv(body_in_camera)
    if child == 'base_link':
        expected = expected @ np.linalg.inv(mounted((0.0, 0.0, 0.0)))
    np.testing.assert_allclose(found[2], expected, atol=1e-9)


@pytest.mark.parametrize('value', [False, 'off'])
def test_tf_can_be_off(value):
    assert TF not in fly_tanker(tanker(publish_tf=value))[-1]


def test_a_camera_whose_frame_begins_with_a_slash():
    """ROS 1 drivers' names; tf2 takes no such frame."""
    assert tf(fly_tanker(tanker(), f'/{CAMERA}')[-1][TF])[0] == CAMERA
    for parameters in (MarkerTrackerParameters, RunwayDetectorParameters):
        with pytest.raises(ParameterError, match='base_frame: must not begin with a slash'):
            parameters(base_frame='/base_link')


def test_images_without_a_frame_are_said():
    """Nothing was on /tf, and nothing said why."""
    processor = tanker()
    assert fly_tanker(processor, '')[-1].keys() == {'vision_pose'}
    assert processor.frames_problem == 'no /tf: the images have no frame_id; set camera_frame'
    assert TF in fly_tanker(named := tanker(camera_frame=CAMERA), '')[-1]
    assert named.frames_problem == ''


def test_a_static_transform_of_the_users_is_not_overruled():
    """robot_localization's recipe: the runway is in the map. The same parent is no dispute."""
    for parent, problem in (
        ('map', 'no /tf: runway is a child of map on /tf_static'),
        (CAMERA, ''),
    ):
        processor = runway()
        processor.static_transforms.add(static(parent, 'runway', np.eye(4)))
        said = fly(processor, RUNWAY, RUNWAY_CAMERA)
        assert any('vision_pose' in each for each in said)
        assert any(TF in each for each in said) is (parent == CAMERA)
        assert processor.frames_problem.partition(',')[0] == problem


def test_two_cameras_make_one_tree():
    """As launch/two_cameras.launch.py names them."""
    heard, vehicles = [], []
    for side, y in (('left', 0.25), ('right', -0.25)):
        frame = f'{side}_camera_optical_frame'
        mount = mounted((0.0, 0.0, 0.0), (0.5, y, 0.0))
        given = {'camera_frame': frame, 'body_frame': f'tanker_747_{side}'}
        processor = tanker(base_frame='base_link', **given)
        processor.static_transforms.add(static('base_link', frame, mount))
        said = fly_tanker(processor)
        heard += [('base_link', frame, mount), *(tf(each[TF]) for each in said)]
        vehicles.append(place(said[-1]['vision_pose'])[0])
    listener = Listener(*heard)
    assert listener.disputed == set()
    # Both see the same images here, so the bodies are as far apart as the cameras.
    apart = listener.lookup('tanker_747_left', 'tanker_747_right')
    assert np.linalg.norm(apart[:3, 3]) == pytest.approx(0.5)
    for side, vehicle in zip(('left', 'right'), vehicles, strict=True):
        np.testing.assert_allclose(
            listener.lookup(f'tanker_747_{side}', 'base_link'), vehicle, atol=1e-9
        )


def quaternion_product(a, b):
    """Hamilton's, as x, y, z, w."""
    (ax, ay, az, aw), (bx, by, bz, bw) = a, b
    return np.array(
        [
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
            aw * bw - ax * bx - ay * by - az * bz,
        ]
    )


def test_robot_localization_gets_the_vehicle_in_the_map():
    """A pose is multiplied with the transform from its frame to the map, and is base_link's."""
    given = {'base_frame': 'base_link', 'camera_mount_rpy_deg': DOWN_20, 'publish_tf': 'off'}
    said = fly(runway(**given), RUNWAY, RUNWAY_CAMERA)
    runway_in_map = np.eye(4)
    runway_in_map[:3, :3], runway_in_map[:3, 3] = about_z(0.6), (100.0, -40.0, 3.0)
    listener = Listener(('map', 'runway', runway_in_map))
    found = [place(each['vision_pose'])[0] for each in said if 'vision_pose' in each]
    assert len(found) > 3
    for vehicle in found:
        measured = listener.lookup('map', 'runway') @ vehicle
        roll, pitch, yaw = rpy(measured[:3, :3])
        assert math.degrees(pitch) == pytest.approx(0.0, abs=2.5)
        assert math.degrees(roll) == pytest.approx(0.0, abs=2.5)
        assert yaw == pytest.approx(0.6, abs=0.05)
        assert measured[2, 3] == pytest.approx(3.0 + vehicle[2, 3])


HEADINGS = (0.0, 90.0, 215.0)


@pytest.mark.parametrize('heading', HEADINGS)
def test_mavros_and_px4_get_a_level_vehicle_on_the_runways_heading(heading):
    """MAVROS's vision_pose, re-derived: ENU to NED from the left, FLU to FRD from the right.

    Both as products of quaternions; then the angles that go out as VISION_POSITION_ESTIMATE. PX4's
    own message must agree with it.
    """
    ned_enu = quaternion_product([0, 0, math.sqrt(0.5), math.sqrt(0.5)], [1, 0, 0, 0])
    frd_flu = [1.0, 0.0, 0.0, 0.0]
    given = {'base_frame': 'base_link', 'camera_mount_rpy_deg': DOWN_20}
    said = fly(runway(**given), RUNWAY, RUNWAY_CAMERA)
    found = [place(each['vision_pose']) for each in said if 'vision_pose' in each]
    assert len(found) > 3
    for pose, covariance in found:
        enu = east_north_up(pose[:3, 3], pose[:3, :3], covariance, heading)
        x, y, z = enu[0]
        turned = quaternion_product(quaternion_product(ned_enu, quaternion(enu[1])), frd_flu)
        roll, pitch, yaw = rpy(from_quaternion(*turned))
        assert math.degrees(roll) == pytest.approx(0.0, abs=2.5)
        assert math.degrees(pitch) == pytest.approx(0.0, abs=2.5)
        apart = math.degrees(yaw) - heading
        assert (apart + 180) % 360 - 180 == pytest.approx(0.0, abs=2.5)
        assert z == pytest.approx(pose[2, 3])
        # Along the runway and to the left of it, by the compass.
        north, east = math.cos(math.radians(heading)), math.sin(math.radians(heading))
        assert y * north + x * east == pytest.approx(pose[0, 3])
        assert y * east - x * north == pytest.approx(pose[1, 3])
        position, rotation, *variances = north_east_down(*enu)
        np.testing.assert_allclose(position, (y, x, -z))
        np.testing.assert_allclose(rotation, from_quaternion(*turned), atol=1e-9)
        assert variances[0] == pytest.approx(np.diag(enu[2])[[1, 0, 2]])
        assert np.sum(variances[1]) == pytest.approx(np.trace(covariance[3:, 3:]))
