"""Rotations between frames."""

import math

import pytest

from mvuav_ros.vision.frames import from_rpy, rpy


@pytest.mark.parametrize('angles', [(0.0, 0.0, 0.0), (0.3, -0.2, 3.0), (-2.9, 1.5, -0.4)])
def test_the_angles_of_a_rotation_are_those_that_made_it(angles):
    assert rpy(from_rpy(*angles)) == pytest.approx(angles)


def test_a_nose_straight_down_has_a_pitch():
    assert rpy(from_rpy(0.0, math.pi / 2, 0.0))[1] == pytest.approx(math.pi / 2)
