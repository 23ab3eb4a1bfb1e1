"""A body found again that was out of sight."""

import math
from itertools import combinations

import numpy as np
import pytest
from support.marker_flights import SCENES, MarkerFlight, track_flight

from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.markers.hypotheses import Prior, body_hypotheses, log_odds_of
from mvuav_ros.vision.markers.lights import Detection, Lens, Light
from mvuav_ros.vision.markers.marker_memory import MIN_ODDS
from mvuav_ros.vision.markers.naming import JOLT, reacquire
from mvuav_ros.vision.markers.rig_view import ViewState, WeakPerspective
from mvuav_ros.vision.markers.view_filter import ViewFilter
from mvuav_ros.vision.rig import TANKER_747, MarkerRig
from mvuav_thesis.light_flights import random_rig


def light(x, y):
    return Light(x, y, Detection(x, y, 40, 1.0))


CAMERA = CameraModel(640, 480, (554.0, 0.0, 319.5, 0.0, 554.0, 239.5, 0.0, 0.0, 1.0))
SHAPE = WeakPerspective.of(TANKER_747, Lens((640, 480), CAMERA))
VIEW = np.array((0.1, math.log(200.0), 320.0, 240.0, 0.1, -0.1, 6.317, 0.0))
SPREAD = np.array((0.2, 0.05, 40.0, 40.0, 0.05, 0.05, 0.003, 1e-4))
SPOTS = [light(x, y) for x, y in SHAPE.project(VIEW).tolist()]


def prior_after(elapsed):
    """What a filter has of the view a while after it was known this well, and a jolt."""
    views = ViewFilter(SHAPE, ViewState(VIEW, np.diag(SPREAD**2)), 0.0)
    views.predict(elapsed)
    return Prior.of(views, JOLT)


def find(spots, fewest=4, elapsed=0.1):
    again = reacquire(SHAPE, prior_after(elapsed), spots, lambda marker, spot: 0.0, fewest=fewest)
    return dict(again.lights) if again else {}


def test_lights_of_a_body_are_named():
    assert find(SPOTS[::-1]) == dict(enumerate(SPOTS))


def test_a_body_that_has_jumped_is_found():
    moved = [spot._replace(x=spot.x + 150.0, y=spot.y - 60.0) for spot in SPOTS]
    assert find(moved) == dict(enumerate(moved))


def test_fewer_lights_than_it_takes_have_no_names():
    for count in range(3):
        assert find(SPOTS[:count], 3) == {}
    assert find(SPOTS[:3]) == {}


def test_a_rig_of_fewer_markers_than_it_takes_is_not_found():
    """Two markers among clutter, of which three lights must be found, raised ValueError."""
    rig = MarkerRig('two', TANKER_747.markers[:2], (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    shape = WeakPerspective.of(rig, Lens((640, 480), CAMERA))
    assert body_hypotheses(shape, SPOTS, prior_after(0.1), fewest=3) == []


def test_three_lights_are_enough_where_they_are_all_that_there_is():
    assert find(SPOTS[:3], 3) == dict(enumerate(SPOTS[:3]))


def known_for(elapsed):
    """What a filter has of a view so many s after it was known well, without a jolt."""
    views = ViewFilter(SHAPE, ViewState(VIEW, np.diag((0.1 * SPREAD) ** 2)), 0.0)
    views.predict(elapsed)
    return Prior.of(views)


@pytest.mark.parametrize('two', combinations(range(5), 2))
def test_two_lights_have_names_only_while_the_view_is_known(two):
    spots = [SPOTS[marker] for marker in two]
    again = reacquire(SHAPE, known_for(0.05), spots, lambda marker, spot: 0.0)
    assert again.lights == dict(zip(two, spots, strict=True))
    assert min(again.odds.values()) > MIN_ODDS
    later = reacquire(SHAPE, known_for(5.0), spots, lambda marker, spot: 0.0)
    assert later is None or min(later.odds.values()) < MIN_ODDS


def test_four_markers_in_one_plane_may_be_seen_from_its_other_side():
    """After long the body may be upside down, and only the rudder tells."""
    level = VIEW.copy()
    level[4:6] = 0.0
    spots = [light(x, y) for x, y in SHAPE.project(level).tolist()]
    wide = Prior(level, np.array((1.5, 0.2, 60.0, 60.0, 0.6, 0.5, 0.003, 1e-4)), 0.5)
    four = [spot for marker, spot in enumerate(spots) if marker != 2]

    def named(lights, prior):
        again = reacquire(SHAPE, prior, lights, lambda marker, spot: 0.0)
        return None if again is None else dict(again.lights)

    assert named(spots, wide) == dict(enumerate(spots))
    known = Prior(level, wide.deviations * (0.1, *[1.0] * 7), 0.5)
    assert named(four, known) == {marker: spots[marker] for marker in (0, 1, 3, 4)}
    aside = level.copy()
    aside[0] += 0.5 * math.pi
    turned = Prior(aside, wide.deviations, 0.5)
    assert named(four, turned) is None


@pytest.mark.parametrize('turns', [0, 1])
def test_a_body_whose_roll_is_lost_is_about_upright(turns):
    """One that was seen upside down a moment ago is not."""

    def rolled(roll, deviation):
        view, spread = VIEW.copy(), SPREAD.copy()
        view[0], spread[0] = roll + 2.0 * math.pi * turns, deviation
        prior = Prior.of(ViewFilter(SHAPE, ViewState(view, np.diag(spread**2)), 0.0))
        return prior.mean[0] - 2.0 * math.pi * turns, prior.deviations[0]

    roll, deviation = rolled(2.5, 1.2)
    assert 0.5 < roll < 1.5
    assert 0.5 < deviation < 0.9
    assert rolled(3.0, 0.05) == pytest.approx((3.0, 0.05), rel=0.01)


def test_four_lights_that_come_back_after_seconds_are_not_taken_for_a_body_upside_down():
    """Its roll was 57 degrees, and -59 +- 67 expected: there were 140 wrong names."""
    wrong, counts = track_flight(MarkerFlight(SCENES['everything at once'], 27942))
    assert wrong == 0
    assert np.sum(counts, axis=0)[0] > 300


@pytest.mark.parametrize('changed', [(0.5, 0.0), (-0.4, 0.3), (0.3, -0.3)])
def test_two_lights_of_a_body_that_has_turned_and_come_nearer(changed):
    """Rolled by rad, and its size in the image changed by a factor's logarithm."""
    view, prior = VIEW.copy(), known_for(0.05)
    view[:2] += changed
    deviations = prior.deviations.copy()
    deviations[:2] = 0.3
    prior = Prior(prior.mean, deviations, prior.noise)
    spots = [light(x, y) for x, y in SHAPE.project(view).tolist()]
    best = body_hypotheses(SHAPE, [spots[0], spots[4]], prior, 2)[0]
    assert best.assignment == ((0, 0), (4, 1))
    assert best.view.parameters[:2] == pytest.approx(view[:2], abs=0.02)


def test_lights_that_cannot_be_the_body_have_no_names():
    shrunk = [spot._replace(x=320 + 0.2 * (spot.x - 320), y=400.0) for spot in SPOTS[:3]]
    assert find(shrunk, 3) == {}


def test_views_that_the_prior_allows_are_not_ruled_out():
    """Other lights about, two deviations away: what is cheap to see of pairs and threes is safe."""
    rng = np.random.default_rng(5)
    prior = prior_after(0.5)
    for _ in range(60):
        view = VIEW.copy()
        away = rng.normal(size=6)
        view[:6] += 2.0 * prior.deviations[:6] * away / np.linalg.norm(away)
        spots = [light(x, y) for x, y in SHAPE.project(view).tolist()]
        best = body_hypotheses(SHAPE, spots + OTHERS, prior, 5)[0]
        assert best.assignment == tuple((marker, marker) for marker in range(5))


OTHERS = [light(60.0, 420.0), light(600.0, 430.0), light(330.0, 40.0), light(500.0, 90.0)]


@pytest.mark.parametrize('hidden', range(5))
def test_a_body_with_a_hidden_marker_stands_out_among_other_lights(hidden):
    """Its view was known a second ago; whichever marker is hidden, the evidence is for the rest."""
    prior = prior_after(1.0)
    shown = [spot for marker, spot in enumerate(SPOTS) if marker != hidden]
    spots = [OTHERS[0], *shown, *OTHERS[1:]]
    best, *others = body_hypotheses(SHAPE, spots, prior, 4)
    named = {marker: spots[number] for marker, number in best.assignment}
    assert named == {marker: spot for marker, spot in enumerate(SPOTS) if marker != hidden}
    assert best.evidence > 0.0
    assert all(guess.evidence < best.evidence for guess in others)


def test_a_marker_that_is_another_light_leaves_no_evidence_for_a_body():
    """Three right lights and one that lies 8 px from the fourth marker."""
    prior = prior_after(1.0)
    beside = SPOTS[3]._replace(x=SPOTS[3].x + 8.0)
    hypotheses = body_hypotheses(SHAPE, [*SPOTS[:3], beside, *OTHERS], prior, 4)
    assert all(guess.evidence < -8.0 for guess in hypotheses)


def test_the_less_is_known_of_the_view_the_less_evidence_there_is():
    priors = [prior_after(elapsed) for elapsed in (0.1, 1.0, 5.0)]
    evidence = [
        body_hypotheses(SHAPE, SPOTS[:4] + OTHERS, prior, 4)[0].evidence for prior in priors
    ]
    assert evidence[0] > evidence[1] > evidence[2]


@pytest.mark.parametrize(
    ('markers', 'hidden', 'left'), [(5, 0, 1), (5, 1, 2), (5, 2, 1), (8, 2, 2)]
)
def test_some_triangles_are_left_whichever_markers_are_hidden(markers, hidden, left):
    shape = WeakPerspective.of(random_rig(markers, 4), Lens((640, 480), CAMERA))
    triangles = shape.triangles(hidden)
    for out in combinations(range(markers), hidden):
        assert sum(not set(three) & set(out) for three in triangles) >= left
    assert len(triangles) < math.comb(markers, 3) or hidden == markers - 3


def test_each_name_of_a_way_has_its_own_odds():
    """One light is 20 px beside its marker: the others are surer than that one."""
    prior = prior_after(0.1)
    beside = SPOTS[3]._replace(x=SPOTS[3].x + 20.0)
    hypotheses = body_hypotheses(SHAPE, [*SPOTS[:3], beside, *OTHERS], prior, 3)
    best = max(hypotheses, key=lambda one: one.evidence if len(one.assignment) == 3 else -math.inf)
    odds = log_odds_of(best, hypotheses)
    assert odds.keys() == {marker for marker, _ in best.assignment}
    whole = body_hypotheses(SHAPE, [*SPOTS, *OTHERS], prior, 3)
    assert min(log_odds_of(whole[0], whole).values()) > max(odds.values())


def test_without_one_of_its_markers_a_way_has_the_evidence_of_the_others():
    """By the chain rule, against a fit of the others alone."""
    prior = prior_after(0.1)
    (whole,) = (one for one in body_hypotheses(SHAPE, SPOTS, prior, 5) if len(one.assignment) == 5)
    assert whole.without.keys() == set(range(5))
    # The more lights there are, the more ways of giving four of them to the markers.
    ways = math.log(math.perm(4, 4) / math.perm(5, 4))
    for out in range(5):
        rest = body_hypotheses(SHAPE, SPOTS[:out] + SPOTS[out + 1 :], prior, 4)[0]
        assert whole.without[out] == pytest.approx(rest.evidence + ways, abs=0.3)


def test_the_rarer_strange_lights_are_the_more_a_body_stands_out():
    prior = prior_after(0.1)
    few, many = (body_hypotheses(SHAPE, SPOTS, prior, 5, clutter)[0] for clutter in (1e-6, 1e-5))
    assert few.evidence - many.evidence == pytest.approx(5 * math.log(10.0))
