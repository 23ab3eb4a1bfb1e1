"""Markers that are named by the rig alone, where their motion was not foreseen."""

import math

import numpy as np
import pytest

from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.markers.assignment import RECOVERY, Recovery
from mvuav_ros.vision.markers.centroid import Detection
from mvuav_ros.vision.markers.lights import Lens
from mvuav_ros.vision.markers.rig_view import PITCH, YAW, ViewState, WeakPerspective
from mvuav_ros.vision.markers.view_filter import ViewFilter
from mvuav_ros.vision.rig import TANKER_747

CAMERA = CameraModel(640, 480, (554.0, 0.0, 319.5, 0.0, 554.0, 239.5, 0.0, 0.0, 1.0))
SHAPE = WeakPerspective.of(TANKER_747, Lens((640, 480), CAMERA))
EXPECTED = np.array((0.1, math.log(200.0), 320.0, 240.0, 0.1, -0.1, 6.317, 0.0))
SPREAD = np.array((0.01, 0.01, 1.0, 1.0, 0.01, 0.01, 0.003, 1e-4))


@pytest.fixture
def spots():
    """Of a body that has pitched and yawed by far more than was expected."""
    view = EXPECTED.copy()
    view[[PITCH, YAW]] += (0.25, -0.15)
    return [Detection(x, y, 40, 1.0) for x, y in SHAPE.project(view).tolist()]


@pytest.fixture
def views():
    return ViewFilter(SHAPE, ViewState(EXPECTED, np.diag(SPREAD**2)), 0.0)


def recover(views, found, spots, frames):
    recovery = Recovery()
    for _ in range(frames):
        named = recovery.name(views, found, spots, lambda marker, spot: True)
    return named


def test_three_lights_that_fit_are_named_at_once(views, spots):
    named = recover(views, {0: spots[0], 4: spots[4]}, spots[1:4], 1)
    assert named == dict(enumerate(spots))


def test_two_lights_that_fit_are_named_when_they_have_fitted_twice(views, spots):
    found = {0: spots[0], 4: spots[4]}
    assert recover(views, found, [spots[3], spots[1]], RECOVERY.confirmed - 1) == found
    named = recover(views, found, [spots[3], spots[1]], RECOVERY.confirmed)
    assert named == {0: spots[0], 1: spots[1], 3: spots[3], 4: spots[4]}


def test_a_single_light_may_be_another_one(views, spots):
    found = {0: spots[0], 1: spots[1], 4: spots[4]}
    assert recover(views, found, spots[2:3], 5) == found


def test_lights_that_do_not_fit_get_no_name_and_the_view_stays(views, spots):
    found = {0: spots[0], 4: spots[4]}
    strangers = [spots[1]._replace(y=spots[1].y + 30.0), spots[3]._replace(x=spots[3].x + 40.0)]
    before = views.belief
    assert recover(views, found, strangers, 5) == found
    assert views.belief is before
