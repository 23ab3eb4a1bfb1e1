"""Which of the strips followed is shown, and where others are searched."""

import math

import numpy as np
import pytest

from mvuav_ros.vision.approach.attitude import Derotation, turn_strips
from mvuav_ros.vision.approach.search import fan_jobs
from mvuav_ros.vision.approach.strip_tracker import RunwayTracker
from mvuav_ros.vision.approach.track import EdgeKind, RunwayTrack
from mvuav_ros.vision.approach.tuning import SEARCH

LEVEL = Derotation(320, 240, 1, 0.0)
BANKED = Derotation(320, 240, 1, math.radians(33.0))
STRIP = np.array([152.0, -14.0, -1.2, 1.6, 16.0, 100.0])
"""Seen from near by; its edges meet above the picture."""


def following(log_odds):
    """A tracker that has followed the strip in one frame."""
    tracker = RunwayTracker()
    tracker.best = RunwayTrack(STRIP, log_odds)
    tracker.best.age = 10
    tracker.tracks = [tracker.best]
    return tracker


def test_what_lies_above_a_horizon_is_likelier_something_else():
    tracker = following(0.5)
    known, rank = tracker.confidence, tracker.best.rank
    tracker.best.above_horizon = True
    assert tracker.confidence < known
    assert tracker.best.rank < rank


def test_a_strip_in_the_sky_does_not_replace_a_runway_that_looks_less_like_one():
    tracker = following(-1.3)
    followed, cloud = tracker.best, RunwayTrack(STRIP, 0.0)
    cloud.above_horizon = True
    tracker.tracks.append(cloud)
    tracker._choose()
    assert tracker.best is followed
    cloud.above_horizon = False
    tracker._choose()
    assert tracker.best is cloud


def test_what_is_followed_by_plain_edges_is_not_left_for_a_strip_that_is_nowhere_for_sure():
    tracker = following(3.7)
    followed, other = tracker.best, RunwayTrack(STRIP, 5.0)
    followed.distinct, other.distinct, other.agreement = 1.0, 1.0, 0.04
    tracker.tracks.append(other)
    tracker._choose()
    assert tracker.best is followed
    other.agreement = 0.95
    tracker._choose()
    assert tracker.best is other, 'though it was found later'


@pytest.mark.parametrize(
    ('log_odds', 'lines', 'agreement', 'alone'),
    [
        pytest.param(0.8, 0.0, 1.0, False, id='doubtful'),
        pytest.param(0.8, 1.0, 1.0, True, id='lines speak for it'),
        pytest.param(3.0, 0.0, 0.1, False, id='likely, but where is doubtful'),
        pytest.param(3.0, 0.0, 0.95, True, id='likely, and there'),
    ],
)
def test_a_likely_report_is_followed_by_its_edges_alone(log_odds, lines, agreement, alone):
    track = RunwayTrack(STRIP, log_odds)
    track.age, track.moved, track.distinct, track.agreement = 30, 30, lines, agreement
    for _ in range(30):
        track.kinds.take_in({EdgeKind.STEP: 6.0})
    track._lock()
    assert track.locked == alone


def test_a_strip_on_its_side_is_none():
    assert np.isnan(turn_strips(STRIP[None], LEVEL, BANKED)).all()
    (there,) = turn_strips(STRIP[None], LEVEL, Derotation(320, 240, 1, 0.1))
    (back,) = turn_strips(there[None], Derotation(320, 240, 1, 0.1), LEVEL)
    assert back[:4] == pytest.approx(STRIP[:4])


@pytest.mark.parametrize('level', range(4))
def test_the_search_begins_where_the_compared_part_of_a_strip_does(level):
    """However far above the picture vanishing points are looked for."""
    for first in (-96.0, -80.0):
        for depth, rows in fan_jobs(first, 7.0, level):
            top = 0.5 - SEARCH.last_first_row * depth
            assert rows[0] == pytest.approx(max(first, top))
            assert max(rows) >= 7.0 - 0.2 * depth
