"""Rotations between frames."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mvuav_ros.vision.frames import Attitude, from_quaternion, from_rpy, quaternion, rpy


@pytest.mark.parametrize('angles', [(0.0, 0.0, 0.0), (0.3, -0.2, 3.0), (-2.9, 1.5, -0.4)])
def test_the_angles_of_a_rotation_are_those_that_made_it(angles):
    assert rpy(from_rpy(*angles)) == pytest.approx(angles)


def test_positive_are_the_right_wing_down_the_nose_down_and_the_nose_left():
    """REP 103: y is to the left and z up."""
    right_wing = from_rpy(math.radians(30.0), 0.0, 0.0) @ (0.0, -1.0, 0.0)
    assert right_wing[2] == pytest.approx(-0.5)
    nose = from_rpy(0.0, math.radians(30.0), math.radians(60.0)) @ (1.0, 0.0, 0.0)
    assert nose[1:] == pytest.approx((0.75, -0.5))


def test_a_nose_straight_down_has_a_pitch():
    assert rpy(from_rpy(0.0, math.pi / 2, 0.0))[1] == pytest.approx(math.pi / 2)


@pytest.mark.parametrize('pitch', [math.pi / 2, -math.pi / 2])
@pytest.mark.parametrize('yaw', [0.0, 0.8, -2.5])
def test_the_angles_straight_up_and_down_make_the_rotation_again(pitch, yaw):
    rotation = from_quaternion(*quaternion(from_rpy(0.3, pitch, yaw)))
    assert from_rpy(*rpy(rotation)) == pytest.approx(rotation, abs=1e-7)


@pytest.mark.parametrize(
    'turn',
    [(0.2, -0.1, 0.3), (3.1, 0.1, -0.2), (-0.1, 3.0, 0.2), (0.1, 0.2, -3.1), (2.0, 2.1, 1.0)],
)
def test_quaternions_are_those_of_others(turn):
    known = Rotation.from_rotvec(turn)
    x, y, z, w = known.as_quat() * math.copysign(1.0, known.as_quat()[3])
    assert quaternion(known.as_matrix()) == pytest.approx((x, y, z, w))
    assert from_quaternion(2 * x, 2 * y, 2 * z, 2 * w) == pytest.approx(known.as_matrix())


def test_a_quaternion_of_no_length_is_no_rotation():
    assert np.isnan(from_quaternion(0.0, 0.0, 0.0, 0.0)).all()


def test_an_attitude_of_rounded_numbers_is_not_turned_by_their_length():
    exact = Attitude.from_roll_pitch(-0.7, 0.35)
    longer = Attitude(*(1.015 * value for value in (exact.x, exact.y, exact.z, exact.w)))
    assert longer.valid
    assert longer.up == pytest.approx(exact.up)
