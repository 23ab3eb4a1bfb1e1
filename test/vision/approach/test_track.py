"""One track, on a drawn runway whose edges its colour shows."""

from dataclasses import replace

import numpy as np
import pytest

from mvuav_ros.vision.approach import track as track_module
from mvuav_ros.vision.approach.attitude import Derotation
from mvuav_ros.vision.approach.ground_motion import Registration
from mvuav_ros.vision.approach.search import LevelledImage
from mvuav_ros.vision.approach.sight import Sight
from mvuav_ros.vision.approach.strip_edges import LevelledFrame
from mvuav_ros.vision.approach.track import (
    EdgeKind,
    EdgeKinds,
    RunwayTrack,
    View,
)
from mvuav_ros.vision.approach.tuning import SHOULDERS

LEVEL = Derotation(320, 240, 1, 0.0)
STRIP = np.array([160.0, 60.0, -0.25, 0.25, 20.0, 60.0])
NEAR_ROW = STRIP[1] + STRIP[5]
GRASS, PAVEMENT = (45, 110, 75), (90, 92, 94)
SCATTERED = np.array(
    [
        [157.0, 20.0, -0.16, -0.04, 60.0, 100.0],
        [163.0, -30.0, 0.03, 0.10, 110.0, 150.0],
        [150.0, 70.0, -0.40, -0.15, 10.0, 50.0],
        [158.0, 50.0, -0.18, -0.08, 30.0, 70.0],
    ]
)
"""Strips that have one edge or none in common with the runway, and other vanishing points."""


def view():
    rows, columns = np.mgrid[:240, :320]
    depth = rows - STRIP[1]
    within = (depth > STRIP[4]) & (depth < STRIP[5])
    within &= np.abs(columns - STRIP[0]) < STRIP[3] * depth
    noise = np.random.default_rng(1).normal(0, 2, (240, 320, 1))
    drawn = np.where(within[:, :, None], PAVEMENT, GRASS) + noise
    image = np.clip(np.rint(drawn), 0, 255).astype(np.uint8)
    registration = Registration()
    registration.take(image)
    frame = LevelledFrame(image, LEVEL)
    sight = Sight(STRIP[1], [], (STRIP[1], 2.0))
    return View(frame, LevelledImage(image, LEVEL), sight, registration)


def near_edges(track):
    x, y, left, right = track.strip()[:4]
    return [x + slope * (NEAR_ROW - y) for slope in (left, right)]


def test_colour_holds_the_edges_where_the_strips_scatter(monkeypatch):
    """Their mean is none of them; the edges were followed by colour, which still shows them."""
    seen = view()
    track = RunwayTrack(STRIP, 1.0)
    for _ in range(8):
        track.step(seen, 1)
    assert near_edges(track) == pytest.approx([145, 175], abs=1.0)
    assert track.distinct > 0.9

    def scattered(*_):
        return SCATTERED, np.full(len(SCATTERED), 1 / len(SCATTERED)), 1.0

    monkeypatch.setattr(track_module, 'weigh', scattered)
    for _ in range(3):
        track.step(seen, 1)
    assert near_edges(track) == pytest.approx([145, 175], abs=1.0)
    assert track.shape.vanishing_point == pytest.approx(STRIP[:2], abs=3.0)


def test_the_kind_of_edge_changes_only_over_several_frames():
    """One frame without lines says little; many say that the edges are steps now."""
    kinds = EdgeKinds()
    for _ in range(10):
        kinds.take_in({EdgeKind.LINE: 3.0})
    assert kinds.share(EdgeKind.LINE) > 0.95
    kinds.take_in({EdgeKind.LINE: -2.0, EdgeKind.STEP: 2.0})
    assert kinds.share(EdgeKind.LINE) > 0.6
    for _ in range(10):
        kinds.take_in({EdgeKind.LINE: -2.0, EdgeKind.STEP: 2.0})
    assert kinds.share(EdgeKind.STEP) > 0.9
    assert kinds.likeliest is EdgeKind.STEP


def test_between_weighings_the_edges_are_measured_and_their_kind_stays():
    """Of what is not looked for nothing is learnt."""
    seen = view()
    track = RunwayTrack(STRIP, 1.0)
    for _ in range(8):
        track.step(seen, 1)
    before = [track.kinds.share(kind) for kind in EdgeKind]
    for _ in range(5):
        track.step(seen, 6, shown=True)
    assert [track.kinds.share(kind) for kind in EdgeKind] == before
    assert min(edge.support for edge in track.points) > 0.7
    assert near_edges(track) == pytest.approx([145, 175], abs=1.0)
    track.step(seen, 6, shown=True)
    assert [track.kinds.share(kind) for kind in EdgeKind] != before


def test_edges_that_are_predicted_are_doubted_the_more_the_longer():
    seen = view()
    track = RunwayTrack(STRIP, 1.0)
    for _ in range(8):
        track.step(seen, 1)
    assert all(edge.doubt == (0.0, 0.0) for edge in track.points)
    doubts = []
    for _ in range(4):
        track.shape.predict(0.0, 0.0)
        track.step(seen, 6)
        doubts.append([max(edge.doubt) for edge in track.points])
    assert np.min(doubts) > 1.0
    assert np.min(np.diff(doubts, axis=0)) > 0.0


def test_a_runway_that_is_followed_by_its_edges_alone_and_not_seen_is_weighed_again(monkeypatch):
    """Its log odds rest while its edges are seen; without them the strips decide."""
    seen = view()
    track = RunwayTrack(STRIP, 1.0)
    for _ in range(8):
        track.step(seen, 1)
    monkeypatch.setattr(RunwayTrack, '_lock', lambda self: setattr(self, 'locked', True))
    before = track.log_odds
    track.step(seen, 1)
    assert track.points is not None
    assert track.log_odds == before
    grass = np.full((240, 320, 3), GRASS, np.uint8)
    frame = LevelledFrame(grass, LEVEL)
    nothing = seen._replace(frame=frame, working=LevelledImage(grass, LEVEL))
    for _ in range(10):
        track.step(nothing, 1)
    assert not track.locked
    assert track.log_odds < before - 2.0
    assert track.lost


def test_a_runway_of_which_no_strip_is_seen_is_given_up(monkeypatch):
    """It is reported as predicted for some frames, and not forever."""
    seen = view()
    track = RunwayTrack(STRIP, 1.0)
    for _ in range(8):
        track.step(seen, 1)
    assert track.points is not None
    monkeypatch.setattr(track_module, 'describe_around', lambda *_: None)
    for number in range(RunwayTrack.max_misses + 1):
        assert not track.lost
        track.step(seen, 1)
        assert track.misses == number + 1
    assert track.lost


def test_a_doubt_of_shoulders_fades_where_they_would_be_out_of_the_picture(monkeypatch):
    """Near the ground nothing can end it; it may be of edges that have been given up."""
    monkeypatch.setattr(track_module, 'SHOULDERS', replace(SHOULDERS, min_width=0.0))
    seen, shown = view(), True
    monkeypatch.setattr(track_module, 'shows_shoulders', lambda *_: shown)
    track = RunwayTrack(STRIP, 1.0)
    for _ in range(10):
        track.step(seen, 1)
    assert track.other_edges == 1.0
    before, shown = track.confidence, None
    track.step(seen, 1)
    assert track.other_edges == 1.0
    for _ in range(15):
        track.step(seen, 1)
    assert track.other_edges == 0.0
    assert track.confidence > 1.5 * before


def test_a_runway_whose_edges_have_become_parallel_is_given_up(monkeypatch):
    """Near the ground little of wide edges is in view, and a frame may turn them out."""
    seen = view()
    track = RunwayTrack(STRIP, 1.0)
    track.step(seen, 1)

    def parallel(self, view, strip, *, weighed):
        self.shape.state[:] = (-200.0, 0.5, 500.0, 0.5)

    monkeypatch.setattr(RunwayTrack, '_lock', lambda self: setattr(self, 'locked', True))
    monkeypatch.setattr(RunwayTrack, '_measure', parallel)
    track.step(seen, 1)
    assert track.lost


@pytest.mark.parametrize('height', [30.0, 200.0])
def test_the_length_of_a_runway_is_the_same_from_everywhere(height):
    """1200 m by 40 m, whose near end is 500 m ahead; a focal length of 300 px."""
    focal, width, near, far = 300.0, 40.0, 500.0, 1700.0
    half = 0.5 * width / height
    strip = np.array([160, 60, -half, half, focal * height / far, focal * height / near])
    assert RunwayTrack(strip, 0.0).length(focal) == pytest.approx((far - near) / width)
