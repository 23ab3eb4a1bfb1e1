"""Strips that keep their places in the runway, and are weighed over many frames."""

import numpy as np
import pytest

from mvuav_ros.vision.approach.track import Hypotheses

RUNWAY = np.array([160.0, 90.0, -0.5, 0.5, 4.0, 24.0])
SHOULDERS = np.array([160.0, 90.0, -0.75, 0.75, 4.0, 24.0])
RUBBER = np.array([160.0, 90.0, -0.2, 0.2, 4.0, 24.0])
STRIPS = np.stack([RUNWAY, SHOULDERS, RUBBER])


def weighed(hypotheses, frame, odds, strips=STRIPS):
    """Take in a frame in which exactly the known strips are seen, or the given ones at first."""
    expected = hypotheses.strips(frame)
    measured = expected if len(expected) else strips
    found = hypotheses.weigh(measured, np.array(odds, float), 1.0, frame)
    hypotheses.settle(found.strips, frame)
    return found


def test_one_frame_does_not_change_what_many_said():
    hypotheses = Hypotheses()
    for _ in range(20):
        steady = weighed(hypotheses, RUNWAY, [4.0, 1.0, -2.0])
    after = weighed(hypotheses, RUNWAY, [1.0, 4.0, -2.0])
    assert np.allclose(steady.strips[0], RUNWAY, atol=1e-6)
    assert np.allclose(after.strips[0], RUNWAY, atol=1e-6)
    for _ in range(60):
        after = weighed(hypotheses, RUNWAY, [1.0, 4.0, -2.0][: len(after.shares)])
    assert after.shares.sum() == pytest.approx(1.0)


def test_places_are_those_of_the_ground():
    """Lower, to the side and turned: the edges keep their shares of the runway's width."""
    hypotheses = Hypotheses()
    weighed(hypotheses, RUNWAY, [4.0, 1.0, -2.0])
    nearer = np.array([120.0, 70.0, -0.8, 1.6, 6.0, 40.0])
    middle, half = 0.4, 1.2
    expected = sorted((middle - share * half, middle + share * half) for share in (1.0, 1.5, 0.4))
    found = hypotheses.strips(nearer)
    assert np.allclose(found[:, :2], nearer[:2], atol=1e-6)
    assert np.allclose(sorted(map(tuple, found[:, 2:4])), expected, atol=1e-6)


def test_a_strip_that_is_gone_loses():
    hypotheses = Hypotheses()
    weighed(hypotheses, RUNWAY, [4.0, 3.5, -2.0])
    first = None
    for _ in range(15):
        measured = hypotheses.strips(RUNWAY)
        gone = np.abs(measured[:, 2] - RUNWAY[2]) < 0.01
        odds = np.where(gone, -np.inf, 3.5)
        found = hypotheses.weigh(measured, odds, 1.0, RUNWAY)
        hypotheses.settle(found.strips, RUNWAY)
        first = found.strips[0]
    assert np.allclose(first[2:4], SHOULDERS[2:4], atol=1e-6)
