"""What a vibration's past tells of its future."""

import numpy as np
import pytest

from mvuav_ros.vision.markers.motion import LAGS, Vibration


def run(innovations):
    """Errors of the predictions of (frames, 2 n) innovations."""
    vibration = Vibration()
    lagged = np.zeros((LAGS, innovations.shape[1]))
    errors = []
    for index, innovation in enumerate(innovations):
        predicted = vibration.coefficients.dot(lagged)
        errors.append(innovation - predicted)
        history = np.vstack((innovation, lagged))
        vibration.learn(history, index % 4 == 0)
        lagged = history[:-1]
    return vibration, np.array(errors)


def test_two_harmonics_are_predicted():
    time = np.arange(400) / 30
    wave = np.sin(2 * np.pi * 4.0 * time) + 0.5 * np.sin(2 * np.pi * 8.0 * time + 1.0)
    vibration, errors = run(np.tile(wave[:, None], (1, 10)))
    assert np.abs(errors[200:]).max() < 0.1
    assert vibration.helps


def test_white_noise_is_left_alone():
    noise = np.random.default_rng(1).normal(0.0, 1.0, (400, 10))
    _, errors = run(noise)
    assert np.sqrt(np.mean(errors[100:] ** 2)) == pytest.approx(1.0, abs=0.05)


def test_what_stands_in_for_a_measurement_is_limited():
    vibration = Vibration()
    vibration.level, vibration.left = 1.0, 0.1
    np.testing.assert_allclose(vibration.stand_in(np.array([50.0, -0.5])), [1.4, -0.35])
