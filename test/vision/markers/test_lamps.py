"""Lights on the body that are no markers: learnt in flight, and never taken for markers."""

import math

import numpy as np
import pytest
from support.marker_flights import SCENES, MarkerFlight, Scene, track_flight

from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.markers.lamps import MIN_SEEN, Lamps
from mvuav_ros.vision.markers.lights import Detection, Frame, Lens, Light
from mvuav_ros.vision.markers.rig_view import PITCH, ROLL, ViewState, WeakPerspective, X, Y
from mvuav_ros.vision.markers.view_correction import Belief
from mvuav_ros.vision.rig import TANKER_747

CAMERA = CameraModel(640, 480, (554.0, 0.0, 319.5, 0.0, 554.0, 239.5, 0.0, 0.0, 1.0))
SHAPE = WeakPerspective.of(TANKER_747, Lens((640, 480), CAMERA))
VIEW = np.array((0.1, math.log(200.0), 320.0, 240.0, 0.1, -0.1, 6.317, 0.0))
KNOWN = np.diag(np.square((1e-3, 1e-3, 0.2, 0.2, 3e-3, 3e-3, 1e-3, 1e-4)))
LAMPS = np.array([(0.3, 0.15, -0.3), (-0.4, 0.2, 0.2), (0.1, -0.25, 0.35), (-0.2, -0.15, 0.0)])
"""Units of the body's size: right, down, ahead."""


def lit(places):
    return [Light(x, y, Detection(x, y, 40, 1.0)) for x, y in places]


def seen_from(view, points=LAMPS):
    return WeakPerspective(points, SHAPE.lens).project(view)


def views(frames, travel=60.0):
    """A body that flies across the image, rolls and nods."""
    for t in np.linspace(0.0, 1.0, frames):
        view = VIEW.copy()
        view[[X, Y]] += travel * t, 0.5 * travel * t
        view[ROLL] += 0.15 * math.sin(6.0 * t)
        view[PITCH] += 0.1 * math.sin(9.0 * t)
        yield view


def learnt(flight, lights_in=seen_from):
    """What was learnt in a flight, its frames measured to 0.2 px."""
    lamps, rng = Lamps(), np.random.default_rng(4)
    for view in flight:
        places = lights_in(view) + rng.normal(0.0, 0.2, (len(LAMPS), 2))
        state, markers = ViewState(view, KNOWN), SHAPE.project(view)
        lamps.learn(SHAPE, state, lit(places), markers, is_whole=True)
    return lamps


def test_lamps_are_known_after_some_frames_in_which_they_went_with_the_body():
    assert not learnt(views(MIN_SEEN - 1)).are_known
    lamps = learnt(views(MIN_SEEN + 5))
    assert lamps.are_known
    elsewhere = VIEW + np.array((0.2, 0.0, -90.0, 50.0, 0.0, 0.0, 0.0, 0.0))
    places = seen_from(elsewhere)
    found = lamps.find(SHAPE, ViewState(elsewhere, KNOWN), lit([(50.0, 60.0), *places]))
    assert sorted(light[:2] for light in found.values()) == sorted(map(tuple, places.tolist()))


def test_lights_that_stand_still_while_the_body_moves_are_none():
    still = seen_from(VIEW)
    assert not learnt(views(60), lambda view: still).are_known


def test_lights_beside_a_body_that_has_not_moved_may_be_far_away():
    assert not learnt([VIEW] * 60).are_known


def test_the_depth_of_a_lamp_shows_as_the_body_turns():
    """By what a lamp half a metre ahead of the others would be elsewhere, another light is."""
    lamps = learnt(views(40))
    tilted = VIEW.copy()
    tilted[PITCH] += 0.3
    places, flat = seen_from(tilted), seen_from(tilted, LAMPS * (1.0, 1.0, 0.0))
    assert np.hypot(*(places - flat).T).max() > 15.0
    found = lamps.find(SHAPE, ViewState(tilted, KNOWN), lit([*flat[:3], *places]))
    assert sorted(light[:2] for light in found.values()) == sorted(map(tuple, places.tolist()))


def test_lamps_that_are_too_few_say_nothing():
    lamps = learnt(views(40))
    assert lamps.find(SHAPE, ViewState(VIEW, KNOWN), lit(seen_from(VIEW)[:2])) == {}


def test_a_lamp_that_a_marker_hides_is_not_missed():
    lamps = learnt(views(40))
    for view in views(60):
        hidden = seen_from(view)[:1] + 2.0
        state, lights = ViewState(view, KNOWN), lit(seen_from(view)[1:])
        lamps.learn(
            SHAPE, state, lights, np.concatenate((SHAPE.project(view), hidden)), is_whole=True
        )
    assert len(lamps.find(SHAPE, ViewState(VIEW, KNOWN), lit(seen_from(VIEW)))) == 4


def test_a_lamp_that_went_out_is_forgotten():
    lamps = learnt(views(40))
    for view in views(60):
        lights = lit(seen_from(view)[1:])
        lamps.learn(SHAPE, ViewState(view, KNOWN), lights, SHAPE.project(view), is_whole=True)
    assert len(lamps.find(SHAPE, ViewState(VIEW, KNOWN), lit(seen_from(VIEW)))) == 3


def test_a_lamp_that_went_out_at_the_side_of_a_bent_image_is_forgotten():
    """It would be left of an image without distortion."""
    matrix = (400.0, 0.0, 319.5, 0.0, 400.0, 239.5, 0.0, 0.0, 1.0)
    lens = Lens((640, 480), CameraModel(640, 480, matrix, (-0.25, 0.05, 0.0, 0.0)))
    shape, points = WeakPerspective.of(TANKER_747, lens), WeakPerspective(LAMPS, lens)
    moved = np.array((0.0, 0.0, -300.0, 0.0, 0.0, 0.0, -0.326, 0.0))
    flight = [view + moved for view in views(60, 15.0)]
    lamps = Lamps()
    for left in (0, 1):
        for view in flight:
            places, state = points.project(view), ViewState(view, KNOWN)
            lit_ones, markers = lit(np.delete(places, [1][:left], axis=0)), shape.project(view)
            assert (lens.to_image(places) > 0.0).all()
            lamps.learn(shape, state, lit_ones, markers, is_whole=True)
    state, lights = ViewState(flight[0], KNOWN), lit(points.project(flight[0]))
    assert len(lamps.find(shape, state, lights)) == 3


def test_lamps_show_how_the_body_is_seen():
    lamps, prior = (
        learnt(views(40)),
        np.diag(np.square((0.05, 0.02, 15, 15, 0.02, 0.02, 1e-3, 1e-4))),
    )
    before = Belief(
        (VIEW + np.array((0.03, 0.01, 8.0, -6.0, 0.0, 0.0, 0.0, 0.0)))[None], prior[None]
    )
    lights = lit(seen_from(VIEW))
    found = lamps.find(SHAPE, ViewState(before.mean[0], prior), lights)
    assert len(found) == 4
    after = lamps.correction(SHAPE, before, found).view().parameters
    assert np.hypot(*(SHAPE.project(after) - SHAPE.project(VIEW)).T).max() < 3.0
    away = np.hypot(*(SHAPE.project(before.mean[0]) - SHAPE.project(VIEW)).T)
    assert away.min() > 5.0


def test_lamps_that_contradict_each_other_show_nothing():
    lamps = learnt(views(40))
    lights = lit(seen_from(VIEW))
    lights[0] = lights[0]._replace(x=lights[0].x + 25.0)
    before = Belief(VIEW[None], KNOWN[None])
    assert lamps.correction(SHAPE, before, dict(enumerate(lights))) is None


def test_lamps_speak_for_the_view_that_shows_them_where_they_are():
    lamps, lights = learnt(views(40)), lit(seen_from(VIEW))
    elsewhere = VIEW + np.array((0.0, 0.0, 60.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    named = np.full((2, 1, 2), -99.0)
    right, wrong = lamps.log_odds(SHAPE, lights, np.array((VIEW, elsewhere)), named)
    assert right > 12.0
    # They may be others by now, which happens in one flight in a hundred.
    assert wrong == pytest.approx(math.log(0.01), abs=0.1)
    assert Lamps().log_odds(SHAPE, lights, VIEW[None], named[:1]) == 0.0


@pytest.mark.parametrize('seed', [5, 9])
def test_lamps_do_not_take_the_names_of_markers_that_go_dark(seed):
    """Without what is known of the lamps 38 and 12 names are wrong."""
    wrong, _ = track_flight(MarkerFlight(SCENES['lamps on the body'], seed))
    assert wrong == 0


def test_a_body_whose_markers_are_dark_for_long_is_neither_found_nor_lost():
    """Its lamps are no body, and the markers have their names again at once."""
    flight = MarkerFlight(Scene(lamps=7, roll=0.3, tilt=0.12, frames=540), 3)
    flight.dark[60:480] = True
    wrong, counts = track_flight(flight)
    assert wrong == 0
    assert not any(names for names, _ in counts[60:480])
    assert all(names >= whole for names, whole in counts[483:])


@pytest.mark.parametrize(('lamps', 'most'), [(0, 4), (3, 62)])
def test_all_lights_are_looked_at_in_few_usual_frames(lamps, most, monkeypatch):
    """In one of sixty; in one of three while a light may yet turn out to be a lamp."""
    looks = []
    lights = Frame.lights
    monkeypatch.setattr(Frame, 'lights', lambda *frame: looks.append(1) or lights(*frame))
    flight = MarkerFlight(Scene(lamps=lamps), 3)
    assert track_flight(flight) == (0, [(5, 5)] * 180)
    assert 3 <= len(looks) <= most


def test_what_is_too_bright_to_be_searched_costs_no_names():
    """A usual frame is looked at for lamps, and most of it is white."""

    def brightened(pixels, number):
        if number < 10:
            return pixels
        pixels = pixels.copy()
        pixels[:110] = pixels[300:] = 255
        return pixels

    assert track_flight(MarkerFlight(Scene(lamps=0), 3), brightened) == (0, [(5, 5)] * 180)
