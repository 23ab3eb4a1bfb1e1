"""The weights of competing predictions."""

import numpy as np
import pytest

from mvuav_ros.vision.markers.motion import PredictionMixture


def test_the_better_prediction_takes_over_and_gives_way_again():
    mixture = PredictionMixture((1.0, 1.0))
    rng = np.random.default_rng(1)
    for sizes, best in (((1.0, 2.0), 0), ((2.0, 1.0), 1)):
        for _ in range(120):
            mixture.learn(rng.normal(0.0, 1.0, (2, 10)) * np.array(sizes)[:, None])
        assert mixture.weights[best] > 0.99
    assert mixture.weights.sum() == pytest.approx(1.0)


def test_a_single_wild_frame_decides_nothing():
    """All squares are then those of one frame, which is the evidence of one frame."""
    mixture = PredictionMixture((1.0, 1.0))
    rng = np.random.default_rng(2)
    for _ in range(100):
        mixture.learn(rng.normal(0.0, 1.0, (2, 10)) * np.array([[0.1], [0.2]]))
    assert mixture.weights[0] > 0.99
    mixture.learn(np.array([[12.0] * 10, [10.0] * 10]))
    assert 0.05 < mixture.weights[1] < 0.95


def test_perfect_predictions_change_nothing():
    mixture = PredictionMixture((0.5, 1.0, 0.5))
    for _ in range(5):
        mixture.learn(np.zeros((3, 4)))
    np.testing.assert_allclose(mixture.weights, [0.25, 0.5, 0.25])
