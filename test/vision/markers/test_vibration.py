"""What a vibration's past tells of its future."""

import numpy as np
import pytest

from mvuav_ros.vision.markers.predictions import VibrationPredictor


def run(innovations):
    """Errors of the predictions of (frames, 2 n) innovations."""
    predictor = VibrationPredictor(innovations.shape[1] // 2)
    errors = []
    for index, innovation in enumerate(innovations):
        predicted = predictor.predict()
        errors.append(innovation - predicted)
        predictor.learn(predictor.lagged, innovation, predicted, index % 4 == 0)
        predictor.remember(innovation)
    return predictor, np.array(errors)


def test_two_harmonics_are_predicted():
    time = np.arange(400) / 30
    wave = np.sin(2 * np.pi * 4.0 * time) + 0.5 * np.sin(2 * np.pi * 8.0 * time + 1.0)
    predictor, errors = run(np.tile(wave[:, None], (1, 10)))
    assert np.abs(errors[200:]).max() < 0.1
    assert predictor.helps


def test_white_noise_is_left_alone():
    noise = np.random.default_rng(1).normal(0.0, 1.0, (400, 10))
    _, errors = run(noise)
    assert np.sqrt(np.mean(errors[100:] ** 2)) == pytest.approx(1.0, abs=0.05)


def test_what_stands_in_for_a_measurement_is_limited():
    predictor = VibrationPredictor(1)
    predictor.level, predictor.left = 1.0, 0.1
    predictor.predicted = np.array([50.0, -0.5])
    np.testing.assert_allclose(predictor.stand_in(), [1.4, -0.35])
