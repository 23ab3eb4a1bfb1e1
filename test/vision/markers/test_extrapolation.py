"""The thesis's predictions of many markers at once are those of one."""

import math

import numpy as np
import pytest

from mvuav_ros.vision.markers.predictions import METHODS, Extrapolation
from mvuav_ros.vision.markers.thesis_tracker import Motion

STEPS = {'even': np.full(12, 1 / 15), 'uneven': np.linspace(0.02, 0.09, 12)}


@pytest.mark.parametrize('steps', STEPS)
def test_it_predicts_what_motion_predicts(steps):
    rng = np.random.default_rng(1)
    times = np.cumsum(STEPS[steps])
    places = rng.uniform(0, 400, (12, 2, 2))
    one = [Motion(), Motion()]
    many = Extrapolation(2)
    rows = np.zeros((4, 4))
    for index, (time, now) in enumerate(zip(times.tolist(), places, strict=True)):
        if index >= 3:
            many.predict(time, rows)
            expected = [[m.predict(time, method) for m in one] for method in METHODS]
            np.testing.assert_allclose(rows, np.reshape(expected, (4, 4)), atol=1e-9)
        for motion, place in zip(one, now, strict=True):
            motion.add(time, *place)
        new = np.full(4, index == 0)
        many.update_some(time, now.ravel(), new, np.full(4, index == 1))


def test_a_marker_out_of_sight_goes_straight_on_and_returns_with_the_velocity_between():
    many = Extrapolation(1)
    rows = np.zeros((4, 2))
    nowhere, none, both = np.full(2, math.nan), np.zeros(2, bool), np.ones(2, bool)
    many.update_some(0.0, np.array([0.0, 10.0]), both, none)
    many.update_some(1.0, np.array([2.0, 10.0]), none, both)
    for time in (2.0, 3.0):
        many.predict(time, rows)
        many.update_some(time, nowhere, none, none)
    many.predict(4.0, rows)
    np.testing.assert_allclose(rows[:, 0], [2.0, 8.0, 8.0, 8.0])
    many.update_some(4.0, np.array([11.0, 10.0]), none, both)
    many.predict(5.0, rows)
    np.testing.assert_allclose(rows[:, 0], [11.0, 14.0, 14.0, 14.0])
    np.testing.assert_allclose(rows[:, 1], 10.0)
