"""How far the surroundings of a strip have moved."""

import math

import cv2
import numpy as np
import pytest

from mvuav_ros.vision.approach.attitude import Derotation
from mvuav_ros.vision.approach.ground_motion import Registration

STRIP = np.array([160.0, 90.0, -0.4, 0.4, 4.0, 40.0])


@pytest.fixture(scope='module')
def texture():
    rng = np.random.default_rng(4)
    coarse = rng.integers(40, 200, (60, 80), np.uint8)
    return cv2.resize(coarse, (320, 240), interpolation=cv2.INTER_CUBIC)


def moved(image, right, down):
    matrix = np.array([[1.0, 0.0, right], [0.0, 1.0, down]])
    return cv2.warpAffine(image, matrix, (320, 240), borderMode=cv2.BORDER_REPLICATE)


@pytest.mark.parametrize('shift', [(0.0, 0.0), (3.0, -2.0), (-1.5, 4.25), (-17.0, 8.5)])
def test_a_turn_of_the_camera_is_measured(texture, shift):
    registration = Registration()
    registration.take(texture)
    registration.take(moved(texture, *shift))
    found = registration.shift(STRIP, Derotation(320, 240, 1, 0.0))
    assert found == pytest.approx(shift, abs=0.2)


def test_a_part_alone_may_move_less_far(texture):
    """As where a picture is torn: what is around the strip has come from elsewhere."""
    torn = texture.copy()
    torn[70:170, 60:260] = moved(texture, 14.0, 0.0)[70:170, 60:260]
    registration = Registration()
    registration.take(texture)
    registration.take(torn)
    right, _ = registration.shift(STRIP, Derotation(320, 240, 1, 0.0))
    assert abs(right) < 6.0


def test_the_memory_of_an_image_may_be_used_for_the_next(texture):
    registration, buffer = Registration(), texture.copy()
    registration.take(buffer)
    buffer[:] = moved(texture, 3.0, -2.0)
    registration.take(buffer)
    found = registration.shift(STRIP, Derotation(320, 240, 1, 0.0))
    assert found == pytest.approx((3.0, -2.0), abs=0.2)


def test_the_shift_is_given_on_the_levelled_image(texture):
    registration = Registration()
    registration.take(texture)
    registration.take(moved(texture, 4.0, 0.0))
    slope = math.radians(30.0)
    found = registration.shift(STRIP, Derotation(320, 240, 1, slope))
    expected = (4.0 * math.cos(slope), -4.0 * math.sin(slope))
    assert found == pytest.approx(expected, abs=0.2)


def test_what_shows_something_else_tells_nothing(texture):
    registration = Registration()
    level = Derotation(320, 240, 1, 0.0)
    registration.take(texture)
    assert registration.shift(STRIP, level) == (0.0, 0.0)
    registration.take(np.random.default_rng(9).integers(0, 255, (240, 320), np.uint8))
    assert registration.shift(STRIP, level) == (0.0, 0.0)
