"""The fit of the log odds, and the views that it is given."""

import math
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import check_grad

sys.path.append(str(Path(__file__).parents[2] / 'tools'))

import fit_approach
from approach_glimpses import Glimpses, GlimpsesBefore, glimpses, road_views
from fit_approach import Example, Problem, fit

from mvuav_ros.vision.approach.probability import EvidenceWeights


def images_of(count, rng):
    """One candidate of five is right: the one whose two features have one sign."""
    for _ in range(count):
        features = rng.uniform(0.3, 1.0, (5, 2)) * rng.choice([-1.0, 1.0], (5, 1)) * [1.0, -1.0]
        right = np.arange(5) == rng.integers(5)
        features[right, 1] *= -1.0
        yield Example(features, right, 1.0, text=False)


def test_the_fit_learns_what_no_sum_over_features_can_say():
    rng = np.random.default_rng(0)
    nothing = Example(np.zeros((5, 2)), np.zeros(5, bool), 1.0, text=False)
    fitted = fit([*images_of(400, rng), nothing], 1.0, penalty=0.01)
    offset = fitted.pop('offset')
    weights = EvidenceWeights(**{k: np.array(v) for k, v in fitted.items()}, offset=offset)
    left_out = list(images_of(200, rng))
    best = [int(weights.log_odds(image.features).argmax()) for image in left_out]
    found = np.mean([image.right[choice] for image, choice in zip(left_out, best, strict=True)])
    assert found > 0.97


def test_its_gradient_is_that_of_its_loss(monkeypatch):
    monkeypatch.setattr(fit_approach, 'UNITS', 3)
    rng = np.random.default_rng(1)
    images = [*images_of(20, rng), Example(rng.normal(size=(4, 2)), np.zeros(4, bool), 2.0, True)]
    values = np.concatenate([image.features for image in images])
    problem = Problem(values, images, 0.5)
    # In double precision, so that differences are exact enough.
    problem._values = values
    monkeypatch.setattr(np, 'float32', np.float64)
    weights = rng.normal(size=1 + 2 + 2 * 3 + 3 + 3)
    error = check_grad(lambda w: problem._loss(w)[0], lambda w: problem._loss(w)[1], weights)
    assert error < 1e-3


@pytest.mark.parametrize(('kind', 'is_before'), [(Glimpses, False), (GlimpsesBefore, True)])
def test_single_views_are_from_over_or_before_a_near_end(kind, is_before):
    (image, label, slope), *_ = glimpses(range(405, 407), 1, kind)
    height = image.shape[0]
    ends = label.near_left[1], label.near_right[1]
    assert (max(ends) < height - 2) is is_before
    assert abs(slope) < math.radians(60)


def test_a_road_is_seen_from_a_car():
    views = list(road_views(range(920, 922), 2))
    assert len(views) == 4
    assert all(image.shape == (480, 640, 3) for image, _ in views)
