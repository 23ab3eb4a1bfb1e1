"""Lights given to the markers at whose expected places they lie."""

import math

from mvuav_ros.vision.markers.centroid import Detection
from mvuav_ros.vision.markers.lights import Light
from mvuav_ros.vision.markers.marker_memory import Expectation
from mvuav_ros.vision.markers.naming import UNLIKE, assign

LIGHT = Light(100.0, 100.0, Detection(100.0, 100.0, 40, 1.0))
EXPECTED = {0: Expectation(102.0, 100.0, 5.0), 1: Expectation(98.0, 100.0, 5.0)}


def named(*unlikeness):
    """Markers that get the only light, which looks more or less unlike each of them."""
    return set(assign(EXPECTED, [LIGHT], lambda marker, light: unlikeness[marker]))


def test_a_light_that_may_be_two_markers_has_no_name():
    assert named(0.0, 0.0) == set()


def test_a_light_that_may_be_one_marker_alone_is_that_one():
    assert named(0.0, math.inf) == {0}
    assert named(math.inf, 0.0) == {1}


def test_a_marker_of_another_size_leaves_a_name_in_doubt():
    """The frame may cut it: it is unlikely to be the light, but not out of the question."""
    assert named(0.0, UNLIKE) == set()
    far = {**EXPECTED, 1: Expectation(85.0, 100.0, 5.0)}
    assert set(assign(far, [LIGHT], lambda marker, light: (0.0, UNLIKE)[marker])) == {0}


def test_a_light_that_looks_like_no_marker_has_no_name():
    assert named(UNLIKE, math.inf) == set()
