"""Strips within strips, of which a frame says how likely each is the runway."""

import math

import numpy as np
import pytest

from mvuav_ros.vision.approach.track import weigh

RUNWAY = np.array([160.0, 90.0, -0.5, 0.5, 4.0, 24.0])
SHOULDERS = np.array([160.0, 90.0, -0.75, 0.75, 4.0, 24.0])
RUBBER = np.array([160.0, 90.0, -0.2, 0.2, 4.0, 24.0])
STRIPS = np.stack([RUNWAY, SHOULDERS, RUBBER])


def test_the_likeliest_strip_has_the_most():
    strips, shares, _ = weigh(STRIPS[[1, 2, 0]], np.array([1.0, -2.0, 6.0]))
    assert np.array_equal(strips, STRIPS)
    assert shares.sum() == pytest.approx(1.0)
    assert shares[0] > 0.8
    assert shares[1] > shares[2]


def test_of_two_alike_the_wider_counts_more():
    _, shares, _ = weigh(STRIPS, np.zeros(3))
    assert shares == pytest.approx([1.0 / 2.9, 1.5 / 2.9, 0.4 / 2.9])


def test_strips_at_one_place_are_one():
    """The log odds are those of one of them being the runway: what is alike counts once."""
    beside = np.add(RUNWAY, [0.2, 0.1, 0.001, 0.001, 0.0, 0.0])
    strips, _, log_odds = weigh(np.stack([RUNWAY, beside]), np.array([2.0, 2.0]))
    assert np.array_equal(strips, [RUNWAY])
    assert log_odds == pytest.approx(2.0)
    *_, log_odds = weigh(STRIPS[:2], np.array([2.0, 2.0]))
    assert log_odds == pytest.approx(2.0 + math.log(2.0))


def test_what_is_no_strip_has_no_share():
    strips, shares, log_odds = weigh(STRIPS, np.array([-math.inf, 1.0, -math.inf]))
    assert np.array_equal(strips, [SHOULDERS])
    assert (shares.tolist(), log_odds) == ([1.0], 1.0)
