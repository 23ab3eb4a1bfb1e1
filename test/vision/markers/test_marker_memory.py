"""What is remembered of markers: how probable their names are."""

import numpy as np
import pytest
from scipy.stats import multivariate_t

from mvuav_ros.vision.markers.fault_detection import Evidence
from mvuav_ros.vision.markers.lights import Detection, Light
from mvuav_ros.vision.markers.marker_memory import (
    FIRST_ODDS,
    Expectation,
    Jumps,
    KnownMarker,
    MarkerMemory,
)

BESIDE = 36.0  # px², of another light's place


def densities(deviation, away=0.0):
    """Of a place known so well, px, with a light so far from there."""
    return tuple(
        multivariate_t(shape=variance * np.eye(2), df=4).logpdf((away, 0.0))
        for variance in (deviation**2, deviation**2 + BESIDE)
    )


def returned(deviation, others, away=0.0):
    marker = KnownMarker(30.0, 1.0, 3.0, unseen=5)
    marker.give(*densities(deviation, away), others=others, followed=False)
    return marker.confidence


def test_a_name_that_is_given_back_is_as_sure_as_its_place():
    sure = [returned(deviation, others=True) for deviation in (0.3, 1.0, 3.0, 10.0)]
    assert sure == sorted(sure, reverse=True)
    assert sure[0] > 0.97
    assert sure[-1] < 0.75
    assert returned(1.0, others=True, away=6.0) < returned(1.0, others=True) - 0.2


def test_without_other_lights_even_a_place_that_is_hardly_known_will_do():
    assert returned(30.0, others=False) > 0.9 > returned(30.0, others=True)


def test_a_doubt_stays_when_a_light_is_named_again_by_its_place():
    marker = KnownMarker(30.0, 1.0, 3.0)
    marker.odds = -1.0
    marker.give(*densities(0.3), others=True, followed=True)
    assert marker.odds == -1.0
    marker.odds = 9.0
    marker.give(*densities(30.0), others=True, followed=True)
    assert 2.0 < marker.odds < 3.0
    marker.give(*densities(30.0), others=True, followed=False)
    assert marker.odds < 2.0, 'nothing of the body was where it was expected'


@pytest.mark.parametrize(('away', 'jumped'), [(0.175, None), (0.25, 2), (3.0, 2)])
def test_a_light_jumps_farther_than_its_background_can_pull_it(away, jumped):
    jumps = Jumps()
    still = dict.fromkeys(range(5), (0.0, 0.0))
    for _ in range(100):
        assert jumps.update(still) is None
    assert jumps.update({**still, 2: (away, 0.0)}) == jumped


def memory_of(count, **options):
    spots = [Detection(100.0 * i + 50.0, 100.0, 30, 1.0) for i in range(count)]
    lights = {i: Light(spot.x, spot.y, spot) for i, spot in enumerate(spots)}
    return MarkerMemory(0.0, lights, count, **options), spots


def after_a_return(count, later):
    """Marker 0 was away among other lights; later so many are seen, at places known to 5 px."""
    memory, spots = memory_of(count)
    place = Expectation(50.0, 100.0, 5.0)
    seen = {i: spots[i] for i in (1, 2)}
    memory.predict(0.03)
    memory.remember(0.03, seen, {i: place for i in range(count) if i not in seen})
    for step, number in enumerate((3, later), 2):
        seen = {i: spots[i] for i in range(number)}
        evidence = Evidence({i: densities(5.0) for i in seen}, 0.25 if number > 3 else 0.0)
        rest = {i: place for i in range(number, count)}
        memory.predict(0.03 * step)
        memory.weigh(seen, evidence, {0} if step == 2 else (), others=True)
        memory.remember(0.03 * step, seen, rest)
        yield 0 in memory.doubtful


def test_what_three_lights_leave_in_doubt_a_fourth_decides():
    assert list(after_a_return(5, 3)) == [True, True]
    assert list(after_a_return(5, 4)) == [True, False]


def test_names_of_a_body_found_again_are_as_sure_as_their_posterior():
    memory, _spots = memory_of(5)
    memory.predict(0.03)
    memory.remember(0.03, {}, dict.fromkeys(range(5), Expectation(50.0, 100.0, 5.0)))
    near = Evidence({i: densities(5.0) for i in range(3)}, 0.0)
    memory.weigh(range(3), near, range(3), True, {0: 4.0, 1: 0.5, 2: 30.0})
    assert memory.markers[0].odds == 4.0
    assert memory.doubtful == {1}
    assert memory.markers[2].odds == FIRST_ODDS, 'a single frame does not make it surer'


def test_a_name_is_not_made_surer_by_being_found_again():
    """The lights of following frames are the same, right or wrong."""
    memory, _spots = memory_of(5)
    memory.markers[1].odds = 0.5
    memory.predict(0.03)
    memory.weigh(range(3), Evidence({i: (-3.0, -3.0) for i in range(3)}, 0.0), {0}, True, {1: 4.0})
    assert memory.markers[1].odds < 1.0


def test_another_light_makes_names_surer_that_are_found_again_with_it():
    memory, _spots = memory_of(5)
    memory.markers[1].odds = 0.5
    memory.predict(0.03)
    alike = Evidence({i: (-3.0, -3.0) for i in range(3)}, 0.0)
    memory.weigh(range(3), alike, {0}, False, {0: 3.0, 1: 4.0})
    assert memory.markers[0].odds == 3.0
    assert memory.markers[1].odds == 4.0
    memory.weigh(range(3), alike, (), False, {0: 4.0, 1: 5.0})
    assert memory.markers[1].odds < 4.0, 'in the next frame the lights are the same'


@pytest.mark.parametrize('redundant', [True, False])
def test_what_is_found_again_is_trusted_where_a_wrong_light_could_show(redundant):
    for trust in (lambda memory: memory.trust({0}), MarkerMemory.start_afresh):
        memory, _spots = memory_of(5, is_redundant=redundant)
        memory.markers[0].untrusted = 9
        trust(memory)
        assert memory.untrusted == (set() if redundant else {0})


@pytest.mark.parametrize(('away', 'is_told'), [(0.0, True), (1.0, True), (12.0, False)])
def test_a_lone_light_that_stays_when_the_others_go_may_be_another(away, is_told):
    """As where all lights go out at once and another one stands within a window."""
    lights = {i: Light(100.0 * i, 100.0, Detection(100.0 * i, 100.0, 30, 1.0)) for i in range(5)}
    memory = MarkerMemory(0.0, lights, 5)
    calm = Evidence({i: densities(2.0) for i in range(5)}, 0.5)
    for _ in range(4):
        memory.weigh(range(5), calm, others=True)
    memory.weigh({4}, Evidence({4: densities(2.0, away)}, 0.0), others=True)
    assert (4 not in memory.doubtful) is is_told
