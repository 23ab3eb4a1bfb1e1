"""How well a rig's pose and names can be known."""

import numpy as np
import pytest

from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.frames import OPTICAL_FROM_BODY
from mvuav_ros.vision.pose import PoseEstimator
from mvuav_ros.vision.rig import TANKER_747, parse_rig
from mvuav_ros.vision.rig_examination import confusions, pose_error

CAMERA = CameraModel(640, 480, (554.0, 0.0, 319.5, 0.0, 554.0, 239.5, 0.0, 0.0, 1.0))
NOISE = 0.3


def test_the_expected_error_is_the_one_that_is_found():
    distance = 100.0
    points = TANKER_747.positions - TANKER_747.positions.mean(axis=0)
    behind = points @ OPTICAL_FROM_BODY.T + (0.0, 0.0, distance)
    pixels = (behind @ CAMERA.matrix.T)[:, :2] / behind[:, 2:]
    middle = TANKER_747.positions.mean(axis=0)
    rng = np.random.default_rng(1)
    errors, angles = [], []
    for _ in range(300):
        noisy = pixels + rng.normal(0.0, NOISE, pixels.shape)
        pose = PoseEstimator(TANKER_747).estimate(CAMERA, range(5), noisy, 0)
        errors.append(pose.rotation @ middle + pose.translation - (0.0, 0.0, distance))
        angles.append(pose.rpy)
    expected = pose_error(TANKER_747, CAMERA, distance, NOISE)
    found = np.std(errors, axis=0)
    assert found[2] == pytest.approx(expected.along, rel=0.2)
    assert found[:2].max() == pytest.approx(expected.across, rel=0.2)
    roll, pitch, yaw = np.degrees(np.std(angles, axis=0))
    assert roll == pytest.approx(expected.roll, rel=0.2)
    assert max(pitch, yaw) == pytest.approx(expected.tilt, rel=0.2)


def test_size_and_gap_are_those_of_the_image():
    """Of lights 0.2 m apart at most, and 0.04 m at least, seen from 2 m."""
    places = {'a': [0, 0.1, 0], 'b': [0, -0.1, 0], 'c': [0, 0.06, 0], 'd': [0, 0.06, 0.05]}
    middle = np.mean(list(places.values()), axis=0)
    rig = parse_rig({'markers': {name: list(p - middle) for name, p in places.items()}})
    seen = pose_error(rig, CAMERA, 2.0, NOISE)
    assert (seen.span, seen.gap) == pytest.approx((554.0 * 0.1, 554.0 * 0.02))


def test_what_a_lens_does_not_show_has_no_error():
    """From near by, where its model turns back, and has places in the image again."""
    matrix = (300.0, 0.0, 320.0, 0.0, 300.0, 240.0, 0.0, 0.0, 1.0)
    camera = CameraModel(640, 480, matrix, (-0.3, 0.0, 0.0, 0.0, 0.0))
    nearby, farther = (pose_error(TANKER_747, camera, d, NOISE).span for d in (18.0, 60.0))
    assert np.isnan(nearby)
    assert farther > 0.0


def test_errors_grow_with_the_distance():
    near, far = (pose_error(TANKER_747, CAMERA, d, NOISE) for d in (50.0, 200.0))
    assert far.span < near.span
    assert far.along > 10 * near.along
    assert far.roll > 3 * near.roll


def test_the_worst_confusions_come_first():
    found = confusions(TANKER_747, CAMERA, 120.0)
    residuals = [confusion.residual for confusion in found]
    assert residuals == sorted(residuals)
    assert residuals[0] > 1.0
    assert {frozenset(name) for name in found[0].names} <= {
        frozenset(('left_wing', 'left_stabilizer')),
        frozenset(('right_wing', 'right_stabilizer')),
    }


def test_a_rig_that_is_nearly_symmetric_may_be_named_turned():
    angles = np.radians(np.arange(6) * 60.0)
    ring = {name: [0.0, np.cos(a), np.sin(a)] for name, a in zip('abcdef', angles, strict=True)}
    ring['a'][0] = 0.2
    worst = confusions(parse_rig({'markers': ring}), CAMERA, 6.0)[0]
    # No exchange of two or three names leaves so little; all move on around the ring.
    assert sum(map(len, worst.names)) == 6
    assert worst.residual < 2.0


def test_what_is_symmetric_is_confused_without_a_residual():
    square = parse_rig(
        {'markers': {'a': [0, 1, 1], 'b': [0, -1, 1], 'c': [0, -1, -1], 'd': [0, 1, -1]}}
    )
    worst = confusions(square, CAMERA, 6.0)[:3]
    assert worst[-1].residual < 0.01
    quarters = (('a', 'b', 'c', 'd'),), (('a', 'd', 'c', 'b'),)
    assert {confusion.names for confusion in worst} == {*quarters, (('a', 'c'), ('b', 'd'))}
