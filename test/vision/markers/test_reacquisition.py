"""A body found again that was out of sight."""

import math
from itertools import combinations

import numpy as np
import pytest

from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.markers.centroid import Detection
from mvuav_ros.vision.markers.initialization import MIN_EVIDENCE, Prior, guess_body
from mvuav_ros.vision.markers.lights import Lens, Light
from mvuav_ros.vision.markers.naming import reacquire
from mvuav_ros.vision.markers.rig_view import ViewState, WeakPerspective
from mvuav_ros.vision.markers.view_filter import ViewFilter
from mvuav_ros.vision.rig import TANKER_747
from mvuav_thesis.light_flights import random_rig


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


def find(views, spots):
    return reacquire(views, spots, lambda marker, spot: True)


def test_lights_of_a_body_are_named(views):
    assert find(views, SPOTS[::-1]) == dict(enumerate(SPOTS))


def test_fewer_lights_than_it_takes_have_no_names(views):
    for count in range(3):
        assert find(views, SPOTS[:count]) == {}


def test_three_of_more_lights_are_too_few(views):
    """Three of them nearly always look like three of the markers."""
    assert find(views, SPOTS[:3]) == dict(enumerate(SPOTS[:3]))
    others = [light(60.0, 420.0), light(600.0, 430.0)]
    assert not find(views, [*SPOTS[:3], *others])


def test_lights_that_cannot_be_the_body_have_no_names(views):
    shrunk = [spot._replace(x=320 + 0.2 * (spot.x - 320), y=400.0) for spot in SPOTS[:3]]
    assert find(views, shrunk) == {}


OTHERS = [light(60.0, 420.0), light(600.0, 430.0), light(330.0, 40.0), light(500.0, 90.0)]


@pytest.mark.parametrize('hidden', range(5))
def test_a_body_with_a_hidden_marker_stands_out_among_other_lights(hidden):
    """Its view was known a second ago; whichever marker is hidden, the evidence is for the rest."""
    prior = Prior.since(SHAPE, ViewState(VIEW, np.diag(SPREAD**2)), 1.0, 0.001)
    shown = [spot for marker, spot in enumerate(SPOTS) if marker != hidden]
    spots = [OTHERS[0], *shown, *OTHERS[1:]]
    best, *others = guess_body(SHAPE, spots, prior, 4)
    named = {marker: spots[number] for marker, number in best.way}
    assert named == {marker: spot for marker, spot in enumerate(SPOTS) if marker != hidden}
    assert best.evidence > MIN_EVIDENCE
    assert all(guess.evidence < best.evidence for guess in others)


def test_a_marker_that_is_another_light_leaves_no_evidence_for_a_body():
    """Three right lights and one that lies 8 px from the fourth marker."""
    prior = Prior.since(SHAPE, ViewState(VIEW, np.diag(SPREAD**2)), 1.0, 0.001)
    beside = SPOTS[3]._replace(x=SPOTS[3].x + 8.0)
    guesses = guess_body(SHAPE, [*SPOTS[:3], beside, *OTHERS], prior, 4)
    assert all(guess.evidence < MIN_EVIDENCE for guess in guesses)


def test_the_less_is_known_of_the_view_the_less_evidence_there_is():
    view = ViewState(VIEW, np.diag(SPREAD**2))
    priors = [Prior.since(SHAPE, view, elapsed, 0.001) for elapsed in (0.1, 1.0, 5.0)]
    evidence = [guess_body(SHAPE, SPOTS[:4] + OTHERS, prior, 4)[0].evidence for prior in priors]
    assert evidence[0] > evidence[1] > evidence[2]


@pytest.mark.parametrize(('markers', 'hidden'), [(5, 0), (5, 1), (5, 2), (8, 2)])
def test_some_triangle_is_left_whichever_markers_are_hidden(markers, hidden):
    shape = WeakPerspective.of(random_rig(markers, 4), Lens((640, 480), CAMERA))
    triangles = shape.triangles(hidden)
    for out in combinations(range(markers), hidden):
        assert any(not set(three) & set(out) for three in triangles)
    assert len(triangles) < math.comb(markers, 3) or hidden == markers - 3
