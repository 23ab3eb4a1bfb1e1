"""Lights given to the markers at whose expected places they lie, and bodies that replace names."""

import copy
import math

import numpy as np
import pytest

from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.markers.fault_detection import FaultDetector
from mvuav_ros.vision.markers.lamps import Lamps
from mvuav_ros.vision.markers.lights import Detection, Lens, Light
from mvuav_ros.vision.markers.marker_memory import FIRST_ODDS, Expectation, KnownMarker
from mvuav_ros.vision.markers.naming import UNLIKELY_COST, Clutter, Search, assign
from mvuav_ros.vision.markers.rig_view import ViewState, WeakPerspective
from mvuav_ros.vision.markers.view_filter import ViewFilter
from mvuav_ros.vision.rig import TANKER_747

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
    assert named(0.0, UNLIKELY_COST) == set()
    far = {**EXPECTED, 1: Expectation(85.0, 100.0, 5.0)}
    assert set(assign(far, [LIGHT], lambda marker, light: (0.0, UNLIKELY_COST)[marker])) == {0}


def test_a_light_that_looks_like_no_marker_has_no_name():
    assert named(UNLIKELY_COST, math.inf) == set()


@pytest.mark.parametrize(('odds', 'kept'), [(8.0, True), (FIRST_ODDS, False)])
def test_four_lights_of_a_ghost_do_not_replace_three_names_that_lasted(odds, kept):
    """A flare shows the lights once more; two names were new, and are gone in the same frame."""
    camera = CameraModel(640, 480, (554.0, 0.0, 319.5, 0.0, 554.0, 239.5, 0.0, 0.0, 1.0))
    shape = WeakPerspective.of(TANKER_747, Lens((640, 480), camera))
    view = np.array((0.1, math.log(80.0), 260.0, 240.0, 0.05, -0.05, 6.317, 0.0))
    spread = np.array((0.01, 0.01, 1.0, 1.0, 0.01, 0.01, 0.003, 1e-4))
    faults = FaultDetector(ViewFilter(shape, ViewState(view, np.diag(spread**2)), 0.0))
    places = shape.project(view)
    for frame in range(1, 30):
        faults.views.predict(frame / 30)
        faults.commit(dict(enumerate(places.tolist())))
    faults.views.predict(1.0)
    own = {marker: lit(*places[marker]) for marker in (0, 1, 3)}
    ghost = [lit(*place) for place in 0.88 * places[[0, 1, 3, 4]] + (107.0, -6.0)]
    consensus = faults.weigh({marker: light[:2] for marker, light in own.items()})
    search = Search(faults, [KnownMarker(40.0, 1.0, 3.6, odds=odds)] * 5, consensus, own)
    search.name([*own.values(), *ghost], Clutter(), Lamps(), copy.copy(faults.views))
    assert (search.found == own) is kept


def lit(x, y):
    return Light(x, y, Detection(x, y, 40, 1.0))
