"""The thesis's predictions of many markers at once are those of one."""

import math

import numpy as np
import pytest

from mvuav_ros.vision.markers.motion import METHODS, MotionPredictor
from mvuav_ros.vision.markers.thesis_tracker import Motion

STEPS = {'even': np.full(12, 1 / 15), 'uneven': np.linspace(0.02, 0.09, 12)}


@pytest.mark.parametrize('steps', STEPS)
def test_it_predicts_what_motion_predicts(steps):
    rng = np.random.default_rng(1)
    times = np.cumsum(STEPS[steps])
    places = rng.uniform(0, 400, (12, 2, 2))
    one = [Motion(), Motion()]
    many = MotionPredictor(2)
    for index, (time, now) in enumerate(zip(times.tolist(), places, strict=True)):
        many.predict(time)
        if index >= 3:
            expected = [[m.predict(time, method) for m in one] for method in METHODS]
            rows = many.competing[: len(METHODS)]
            np.testing.assert_allclose(rows, np.reshape(expected, (4, 4)), atol=1e-9)
        for motion, place in zip(one, now, strict=True):
            motion.add(time, *place)
        many.update(now.ravel())


def test_a_marker_out_of_sight_goes_straight_on_and_returns_with_the_velocity_between():
    many = MotionPredictor(1)
    places = [(0.0, 10.0), (2.0, 10.0), (math.nan,) * 2, (math.nan,) * 2, (11.0, 10.0)]
    rows = []
    for time, place in enumerate([*places, (0.0, 0.0)]):
        many.predict(float(time))
        rows.append(many.competing[: len(METHODS)])
        many.update(place)
    np.testing.assert_allclose(rows[4][:, 0], [2.0, 8.0, 8.0, 8.0])
    np.testing.assert_allclose(rows[5][:, 0], [11.0, 14.0, 14.0, 14.0])
    np.testing.assert_allclose(rows[5][:, 1], 10.0)
