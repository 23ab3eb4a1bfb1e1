"""The Kalman filter of constant acceleration."""

import numpy as np
import pytest

from mvuav_ros.vision.markers.predictions import KalmanFilter


def test_it_follows_an_acceleration_exactly():
    kalman = KalmanFilter(1)
    kalman.set_step(0.1)
    time = np.arange(80) * 0.1
    path = np.stack((5.0 + 3.0 * time + 2.0 * time**2, 100.0 - time), axis=-1)
    kalman.start(np.ones(2, bool), path[0])
    for seen, place in enumerate(path[1:], 1):
        kalman.advance(0.1)
        gains = kalman.gains(np.array([seen]), np.array([0]))
        kalman.state += np.repeat(gains, 2, axis=1) * (place - kalman.state[0])
    np.testing.assert_allclose(kalman.state[1], [3.0 + 4.0 * time[-1], -1.0], atol=1e-3)
    np.testing.assert_allclose(kalman.state[2], [4.0, 0.0], atol=1e-2)


def test_the_gain_grows_with_a_gap_and_settles_without():
    kalman = KalmanFilter(3)
    kalman.set_step(1 / 30)
    gains = kalman.gains(np.array([100, 100, 100]), np.array([0, 3, 1000]))
    np.testing.assert_allclose(gains[:, :1], kalman.settled)
    assert gains[0, 0] < gains[0, 1] < gains[0, 2] <= 1.0
    first = kalman.gains(np.array([0]), np.array([0]))
    assert first.ravel() == pytest.approx([1.0, 0.0, 0.0])
