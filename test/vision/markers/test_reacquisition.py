"""A body found again that was out of sight."""

import math

import numpy as np
import pytest

from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.markers.centroid import Detection
from mvuav_ros.vision.markers.lights import Lens, Light
from mvuav_ros.vision.markers.naming import reacquire
from mvuav_ros.vision.markers.rig_view import ViewState, WeakPerspective
from mvuav_ros.vision.markers.view_filter import ViewFilter
from mvuav_ros.vision.rig import TANKER_747


def light(x, y):
    return Light(x, y, Detection(x, y, 40, 1.0))


CAMERA = CameraModel(640, 480, (554.0, 0.0, 319.5, 0.0, 554.0, 239.5, 0.0, 0.0, 1.0))
SHAPE = WeakPerspective.of(TANKER_747, Lens((640, 480), CAMERA))
VIEW = np.array((0.1, math.log(200.0), 320.0, 240.0, 0.1, -0.1, 6.317, 0.0))
SPREAD = np.array((0.2, 0.05, 40.0, 40.0, 0.05, 0.05, 0.003, 1e-4))
SPOTS = [light(x, y) for x, y in SHAPE.project(VIEW).tolist()]


@pytest.fixture
def views():
    return ViewFilter(SHAPE, ViewState(VIEW, np.diag(SPREAD**2)), 0.0)


def find(views, spots, fewest=3):
    return reacquire(views, spots, lambda marker, spot: True, fewest)


def test_lights_of_a_body_are_named(views):
    assert find(views, SPOTS[::-1]) == dict(enumerate(SPOTS))


def test_fewer_lights_than_it_takes_contradict_nothing(views):
    assert find(views, SPOTS[:1]) == {}
    assert find(views, SPOTS[:2]) == {}


def test_three_of_more_lights_are_too_few(views):
    """Three of them nearly always look like three of the markers."""
    assert find(views, SPOTS[:3]) == dict(enumerate(SPOTS[:3]))
    others = [light(60.0, 420.0), light(600.0, 430.0)]
    assert not find(views, [*SPOTS[:3], *others])


def test_lights_that_cannot_be_the_body_contradict_the_view(views):
    shrunk = [spot._replace(x=320 + 0.2 * (spot.x - 320), y=400.0) for spot in SPOTS[:3]]
    assert find(views, shrunk) is None
