"""Names that the other markers contradict, and how lively a view's motion is."""

import math
from dataclasses import replace

import numpy as np

from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.markers import view_filter
from mvuav_ros.vision.markers.fault_detection import FaultDetector
from mvuav_ros.vision.markers.lights import Lens
from mvuav_ros.vision.markers.rig_view import PITCH, ViewState, WeakPerspective
from mvuav_ros.vision.markers.view_filter import ViewFilter
from mvuav_ros.vision.rig import TANKER_747

CAMERA = CameraModel(640, 480, (554.0, 0.0, 319.5, 0.0, 554.0, 239.5, 0.0, 0.0, 1.0))
SHAPE = WeakPerspective.of(TANKER_747, Lens((640, 480), CAMERA))
SPREAD = np.array((0.01, 0.01, 1.0, 1.0, 0.01, 0.01, 0.01, 1e-4))


def view_at(frame, wave=0.02):
    """A calm flight."""
    turn = wave * math.sin(0.05 * frame)
    return np.array((0.1 + turn, math.log(150.0), 320.0 + frame, 240.0, turn, -turn, 6.32, 0.0))


def follow(frames, wave=0.02, moved=None):
    """Fly calmly; from then on ``moved`` shifts the right wing's light by so many px a frame."""
    detector = FaultDetector(ViewFilter(SHAPE, ViewState(view_at(0), np.diag(SPREAD**2)), 0.0))
    for frame in range(1, frames):
        detector.views.predict(frame / 30)
        found = dict(enumerate(map(tuple, SHAPE.project(view_at(frame, wave)).tolist())))
        assert detector.weigh(found).kept == (0, 1, 2, 3, 4)
        detector.commit(found)
    for number in range(20):
        if moved is None:
            break
        frame = frames + number
        detector.views.predict(frame / 30)
        found = dict(enumerate(map(tuple, SHAPE.project(view_at(frame, wave)).tolist())))
        found[4] = found[4][0] + number * moved, found[4][1]
        consensus = detector.weigh(found)
        if consensus.dropped or consensus.suspects:
            return consensus, number
        detector.commit(found)
    return detector, frames


def test_a_light_that_wanders_off_loses_its_name_before_four_pixels():
    for moved in (0.3, 0.5, 1.0, 3.0):
        consensus, frames = follow(60, moved=moved)
        assert 4 in (*consensus.dropped, *consensus.suspects)
        assert 4 not in consensus.kept
        assert frames * moved < 4.0


def four_lights_of_which_one_drifts(frames=100):
    """By the frames until it loses its name: a light that drifts 0.3 px a frame, with the view."""
    rig = replace(TANKER_747, name='four', markers=TANKER_747.markers[:4])
    shape = WeakPerspective.of(rig, Lens((640, 480), CAMERA))
    detector = FaultDetector(ViewFilter(shape, ViewState(view_at(0), np.diag(SPREAD**2)), 0.0))
    for frame in range(1, 60 + frames):
        detector.views.predict(frame / 30)
        found = dict(enumerate(map(tuple, shape.project(view_at(frame)).tolist())))
        found[3] = found[3][0], found[3][1] + 0.3 * max(frame - 60, 0)
        consensus = detector.weigh(found)
        if 3 not in consensus.kept:
            return frame - 60, detector
        assert consensus.kept == (0, 1, 2, 3)
        detector.commit(found)
    return frames, detector


def test_a_drifting_light_of_four_is_seen_by_the_filter_that_ignores_it(monkeypatch):
    frames, detector = four_lights_of_which_one_drifts()
    assert detector.views.has_bank
    monkeypatch.setattr(view_filter, 'BENDING', (0, -1))
    frames_bent, detector = four_lights_of_which_one_drifts()
    assert not detector.views.has_bank
    assert frames < frames_bent


def test_a_body_with_enough_lights_needs_one_filter():
    views = ViewFilter(SHAPE, ViewState(view_at(0), np.diag(SPREAD**2)), 0.0)
    assert not views.has_bank


def test_a_calm_flight_is_expected_to_go_on_calmly():
    spreads = []
    for wave in (0.0, 0.4):
        detector, frames = follow(60, wave)
        detector.views.predict(frames / 30)
        spreads.append(math.sqrt(detector.views.belief.covariance[0, PITCH, PITCH]))
    assert spreads[0] < 0.7 * spreads[1]


def test_three_lights_cannot_check_each_other():
    detector, frames = follow(60)
    detector.views.predict(frames / 30)
    every = dict(enumerate(map(tuple, SHAPE.project(view_at(frames)).tolist())))
    three = {marker: every[marker] for marker in (0, 2, 4)}
    assert detector.evidence(three).redundancy == 0.0
    detector.views.predict((frames + 1) / 30)
    evidence = detector.evidence(every)
    assert 0.0 < evidence.redundancy < 1.0
    assert evidence.places.keys() == every.keys()
    assert detector.evidence({}).places == {}


def test_nothing_is_ever_too_uncertain_to_be_computed():
    detector, frames = follow(20)
    for frame in range(400):
        detector.views.predict(float(frames + frame))
        found = {0: (100.0, 100.0), 4: (300.0, 120.0)}
        detector.weigh(found)
    assert np.isfinite(detector.views.look(found).parameters).all()
    assert np.isfinite(detector.views.belief.covariance).all()


def test_names_in_doubt_do_not_move_the_view():
    """Where too few are in sight to check each other, a light beside the marker would bend it."""
    moved = {}
    for doubtful in (set(), {0}):
        detector, frames = follow(60)
        detector.views.predict(frames / 30)
        places = SHAPE.project(view_at(frames)).tolist()
        beside = {0: (places[0][0] + 2.0, places[0][1]), 2: tuple(places[2]), 4: tuple(places[4])}
        before = detector.views.view.parameters
        detector.doubtful = doubtful
        detector.commit(beside)
        moved[bool(doubtful)] = float(np.abs(detector.views.view.parameters - before)[2:4].max())
    assert moved[True] < 0.2 * moved[False]


def test_names_in_doubt_take_part_where_there_are_enough_to_check_them():
    detector, frames = follow(60)
    detector.views.predict(frames / 30)
    every = dict(enumerate(map(tuple, SHAPE.project(view_at(frames)).tolist())))
    usual = detector.evidence(every).places[0]
    detector.doubtful = {0}
    assert detector.evidence(every).places[0] == usual
