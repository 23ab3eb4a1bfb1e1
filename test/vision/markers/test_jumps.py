"""Lights that jump against the others."""

import numpy as np

from mvuav_ros.vision.markers.marker_memory import MAX_JUMP, Jumps

RNG = np.random.default_rng(5)


def steady(count=5, scatter=0.06):
    """How far lights lie from where their motion takes them, shaken together."""
    shaken = RNG.normal(0.0, 3.0, 2)
    return {m: tuple(shaken + RNG.normal(0.0, scatter, 2)) for m in range(count)}


def watched(frames=200):
    jumps = Jumps()
    for _ in range(frames):
        jumps.update(steady())
    return jumps


def test_what_shakes_all_lights_alike_is_no_jump():
    jumps = watched()
    found = 0
    for _ in range(1000):
        jumps.update(steady())
        found += bool(jumps.evidence)
    assert found <= 5


def test_a_light_that_jumps_alone_is_found_and_forgotten():
    jumps = watched()
    away = steady()
    away[3] = away[3][0] + 0.8, away[3][1]
    jumps.update(away)
    assert set(jumps.evidence) == {3}
    assert 20.0 < jumps.evidence[3] <= MAX_JUMP
    for _ in range(60):
        jumps.update(steady())
    assert 3 not in jumps.evidence


def test_where_two_jump_the_motion_was_not_foreseen():
    jumps = watched()
    away = steady()
    for marker, x in ((1, 0.9), (3, -0.8)):
        away[marker] = away[marker][0] + x, away[marker][1]
    jumps.update(away)
    assert jumps.evidence == {}


def test_two_lights_do_not_tell_which_has_jumped():
    jumps = watched()
    jumps.update({0: (0.0, 0.0), 1: (50.0, 0.0)})
    assert jumps.evidence == {}
