"""A camera that is mounted upside down, as the mount says, finds what an upright one finds."""

import math

import cv2
import numpy as np
import pytest
from support.drawn_ground import drawn_strip

from mvuav_ros.parameters.runway_detector import RunwayDetectorParameters
from mvuav_ros.vision.approach.approach_detector import ApproachDetector
from mvuav_ros.vision.approach.attitude import HorizonLine
from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.frames import Attitude

RUNWAY = {'height': 60, 'width': 30, 'speed': 2, 'ends': (400, 1500)}
UPSIDE_DOWN = (180.0, 0.0, 0.0)
ROW, SLOPE = 100.0, 0.0
LEVEL = Attitude.from_roll_pitch(0.0, math.atan((120 - ROW) / 300))
FRAMES = 30


@pytest.fixture(scope='module')
def flight():
    return [drawn_strip(index, **RUNWAY) for index in range(FRAMES)]


def camera(sign):
    """With its principal point beside the middle, and a lens that bends lines."""
    k = (300, 0, 159.5 + 0.5 * sign, 0, 300, 119.5 + 0.5 * sign, 0, 0, 1)
    return CameraModel(320, 240, k, (-0.02, 0.0, 2e-4 * sign, -1e-4 * sign, 0.0))


def fly(images, mount, sign, known):
    detector = ApproachDetector(
        RunwayDetectorParameters(mode='approach', runway_width=30.0, camera_mount_rpy_deg=mount)
    )
    detector.set_camera(camera(sign))
    for index, image in enumerate(images):
        yield detector.process(image, index * 33_000_000, known), detector.attitude_problem


def turned(images):
    return [cv2.rotate(image, cv2.ROTATE_180) for image in images]


@pytest.mark.parametrize(
    ('upright', 'upside_down'),
    [
        pytest.param(None, None, id='the horizon of the image'),
        pytest.param(LEVEL, LEVEL, id='an attitude'),
        pytest.param(HorizonLine(ROW, 0.0), HorizonLine(239.0 - ROW, math.pi), id='a line'),
    ],
)
def test_what_is_found_is_the_same(flight, upright, upside_down):
    expected = list(fly(flight, (0.0, 0.0, 0.0), 1, upright))
    found = list(fly(turned(flight), UPSIDE_DOWN, -1, upside_down))
    for (one, _), (other, problem) in zip(expected, found, strict=True):
        assert problem == ''
        assert other.status == one.status
        assert other.confidence == pytest.approx(one.confidence, abs=0.05)
        mirrored = np.array((319.0, 239.0)) - np.array(other.corners)
        np.testing.assert_allclose(mirrored, one.corners, atol=2.0)
        np.testing.assert_allclose(mirrored[:, 0], np.array(one.corners)[:, 0], atol=0.6)
        left, right = other.lines[:2]
        assert left.x > right.x, "the pilot's left is the picture's right"
        assert other.guidance.z == pytest.approx(one.guidance.z, rel=0.05)
        assert other.guidance.y == pytest.approx(one.guidance.y, abs=1.0)
        roll = math.remainder(other.guidance.roll - one.guidance.roll, 2 * math.pi)
        assert abs(roll) == pytest.approx(math.pi, abs=0.01)


def test_without_that_mount_nothing_is_found(flight):
    """Otherwise the tests above say nothing."""
    results = [each for each, _ in fly(turned(flight), (0.0, 0.0, 0.0), -1, None)]
    assert max(result.confidence for result in results) < 0.5


def test_an_attitude_that_is_wrong_by_180_degrees_is_none(flight):
    wrong = Attitude.from_roll_pitch(math.pi, 0.0)
    result, problem = list(fly(turned(flight), UPSIDE_DOWN, -1, wrong))[-1]
    assert result.confidence == 0
    assert 'upside down' in result.status
    assert 'camera_mount_rpy_deg' in problem


def test_another_mount_counts_at_once(flight):
    detector = ApproachDetector(RunwayDetectorParameters(mode='approach'))
    for index, image in enumerate(flight[:5]):
        assert detector.process(image, index * 33_000_000).corners is not None
    detector.configure(RunwayDetectorParameters(mode='approach', camera_mount_rpy_deg=UPSIDE_DOWN))
    for index, image in enumerate(turned(flight[5:]), 5):
        result = detector.process(image, index * 33_000_000)
    assert result.confidence > 0.5
