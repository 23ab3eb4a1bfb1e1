"""Detections given to known lights."""

import numpy as np
from scipy.optimize import linear_sum_assignment

from mvuav_ros.vision.markers.multi_object import (
    IMPOSSIBLE,
    assign,
    choices,
    common_shift,
    nearest_other,
)


def test_the_sum_of_costs_is_least():
    for seed in range(20):
        rng = np.random.default_rng(seed)
        predicted, seen = rng.uniform(0, 60, (6, 2)), rng.uniform(0, 60, (8, 2))
        apart, number = choices(predicted, seen, 1000.0)
        cost = apart**2
        cost[apart > 20.0] = IMPOSSIBLE
        given = assign(cost, number)
        full = np.hypot(*(predicted[:, None] - seen).transpose(2, 0, 1)) ** 2
        full[full > 400.0] = IMPOSSIBLE
        rows, columns = linear_sum_assignment(full)
        expected = np.full(6, -1)
        valid = full[rows, columns] < IMPOSSIBLE
        expected[rows[valid]] = columns[valid]
        np.testing.assert_array_equal(given, expected)


def test_a_light_too_far_off_gets_nothing():
    apart, number = choices(np.zeros((1, 2)), np.array([(80.0, 0.0)]), 60.0)
    cost = np.where(apart > 60.0, IMPOSSIBLE, apart)
    assert assign(cost, number).tolist() == [-1]


def test_a_jump_of_most_lights_is_found():
    rng = np.random.default_rng(3)
    places = rng.uniform(50, 400, (30, 2))
    jump = np.array((70.0, -55.0)) + rng.normal(0, 1.0, (30, 2))
    seen = np.vstack((places + jump, [(10.0, 10.0)]))
    nearest = choices(places, seen, 60.0)[0][:, 0]
    shift = common_shift(places, seen, nearest, 180.0, 5.0)
    np.testing.assert_allclose(shift, (70.0, -55.0), atol=1.0)
    still = choices(places, places, 60.0)[0][:, 0]
    assert common_shift(places, places, still, 180.0, 5.0) is None


def test_the_nearest_other():
    places = np.array([(0.0, 0.0), (3.0, 4.0), (100.0, 0.0)])
    np.testing.assert_allclose(nearest_other(places)[:2], 5.0)
    assert nearest_other(places[:1]).tolist() == [IMPOSSIBLE]
