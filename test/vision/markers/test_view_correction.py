"""What lights make of views: the most probable one, and each marker against all others."""

import math

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.stats import multivariate_t

from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.markers.lights import Lens
from mvuav_ros.vision.markers.rig_view import (
    COUNT,
    ROLL,
    WeakPerspective,
)
from mvuav_ros.vision.markers.view_correction import BESIDE, Belief, Correction, NamedPlaces
from mvuav_ros.vision.rig import TANKER_747

CAMERA = CameraModel(640, 480, (554.0, 0.0, 319.5, 0.0, 554.0, 239.5, 0.0, 0.0, 1.0))
SHAPE = WeakPerspective.of(TANKER_747, Lens((640, 480), CAMERA))
VIEW = np.array((0.1, math.log(150.0), 320.0, 240.0, 0.1, -0.1, 6.32, 0.0))
SPREAD = np.array((0.02, 0.02, 3.0, 3.0, 0.05, 0.05, 0.01, 1e-4))
NOISE = 0.2


def prior():
    """A view and its rates, correlated as after a step of the filter."""
    step = np.eye(2 * COUNT)
    step[:COUNT, COUNT:] = 0.04 * np.eye(COUNT)
    rates = np.array((0.3, 0.1, 1e4, 1e4, 0.04, 0.04, 1e-9, 1e-9))
    covariance = step @ np.diag(np.concatenate((SPREAD**2, rates))) @ step.T
    return Belief(np.concatenate((VIEW, np.zeros(COUNT)))[None], covariance[None])


def places(markers, seed=0):
    rng = np.random.default_rng(seed)
    seen = SHAPE.project(VIEW + SPREAD * rng.normal(size=COUNT))[markers]
    return dict(zip(markers, (seen + rng.normal(0.0, 0.2, seen.shape)).tolist(), strict=True))


def corrected(found, before=None, variances=None):
    return Correction.of(SHAPE, before or prior(), NamedPlaces.of(found), NOISE**2, variances)


@pytest.mark.parametrize('markers', [[0, 1, 2, 3, 4], [4, 3, 2, 1, 0], [3, 0, 2], [1, 4]])
def test_a_correction_is_the_most_probable_view(markers):
    """As another optimizer finds it from the same prior, with the inverse Hessian as covariance."""
    found, (mean, covariance) = places(markers), prior()
    root = np.linalg.inv(np.linalg.cholesky(covariance[0, :COUNT, :COUNT]))

    def residuals(view):
        apart = SHAPE.project(view)[markers] - np.array(list(found.values()))
        return np.concatenate((apart.ravel() / NOISE, root @ (view - mean[0, :COUNT])))

    best = least_squares(residuals, VIEW, x_scale=SPREAD, xtol=1e-12, ftol=1e-12, gtol=1e-12)
    correction = corrected(found)
    view = correction.view()
    np.testing.assert_allclose((view.parameters - best.x) / SPREAD, 0.0, atol=1e-3)
    expected = np.linalg.inv(best.jac.T @ best.jac)
    scale = np.sqrt(np.outer(*2 * [np.diag(expected)]))
    np.testing.assert_allclose(view.covariance / scale, expected / scale, atol=0.01)
    np.testing.assert_allclose(correction.cost, 2.0 * best.cost, rtol=1e-3)
    expected = NOISE * np.linalg.norm(best.fun[: 2 * len(markers)]) / math.sqrt(len(markers))
    np.testing.assert_allclose(view.rms_residual, expected, rtol=1e-2)


def test_several_ways_of_naming_are_fitted_at_once():
    ways = [places([0, 1, 2]), places([4, 3, 1]), places([2, 0, 4])]
    each = zip(*map(NamedPlaces.of, ways), strict=True)
    named = NamedPlaces(*map(np.concatenate, each))
    together = Correction.of(SHAPE, prior(), named, NOISE**2)
    for row, way in enumerate(ways):
        alone = corrected(way)
        np.testing.assert_allclose(
            together.after.mean[row], alone.after.mean[0], rtol=1e-6, atol=1e-6
        )
        np.testing.assert_allclose(together.cost[row], alone.cost[0], rtol=1e-4)
        assert together.nis_by(row)[1] == pytest.approx(alone.nis[1], rel=1e-3)


def test_filters_of_one_rig_correct_each_by_itself():
    """Each has its own prior, and its own variances of the lights."""
    found, (mean, covariance) = places([0, 1, 2, 3, 4]), prior()
    shift = np.concatenate((0.5 * SPREAD, np.zeros(COUNT)))
    before = Belief(np.concatenate((mean, mean + shift)), np.concatenate((covariance,) * 2))
    variances = np.full((2, 10), NOISE**2)
    variances[1, 6:8] *= 100.0
    both = corrected(found, before, variances)
    for row in range(2):
        one = Belief(*(part[row : row + 1] for part in before))
        alone = corrected(found, one, variances[row : row + 1])
        np.testing.assert_allclose(both.after.mean[row], alone.after.mean[0], rtol=1e-6, atol=1e-6)
        np.testing.assert_allclose(both.nis_by(row), alone.nis, rtol=1e-4)
        np.testing.assert_allclose(both.rms_residual(row), alone.rms_residual(), rtol=1e-4)


def test_rates_follow_the_parameters():
    moved = SHAPE.project(VIEW + np.array((0.02, 0, 0, 0, 0, 0, 0, 0)))
    before = prior()
    after = corrected(dict(enumerate(moved.tolist())), before).after
    (covariance,), (mean,) = before.covariance, before.mean
    gain = covariance[COUNT:, :COUNT] @ np.linalg.inv(covariance[:COUNT, :COUNT])
    expected = mean[COUNT:] + gain @ (after.mean[0, :COUNT] - mean[:COUNT])
    np.testing.assert_allclose(after.mean[0, COUNT:], expected, atol=1e-9)
    assert after.mean[0, COUNT + ROLL] > 0.0


@pytest.mark.parametrize('ignored', [False, True])
def test_a_marker_is_held_against_the_others_and_not_against_itself(ignored):
    """In closed form as by a second filter without it, also where it has less weight."""
    found = places([0, 1, 2, 3, 4])
    found[2] = (found[2][0] + 1.0, found[2][1])
    variances = np.full((1, 10), NOISE**2)
    variances[0, 4:6] *= 100.0 if ignored else 1.0
    correction = corrected(found, variances=variances)
    others = corrected({m: place for m, place in found.items() if m != 2}).after
    ((expected,), (slopes,)) = SHAPE.linearize(others.mean[:, :COUNT])
    spread = slopes[:, 4:6].T @ others.covariance[0, :COUNT, :COUNT] @ slopes[:, 4:6]
    away = found[2] - expected[4:6]
    spread += NOISE**2 * np.eye(2)
    square = away @ np.linalg.solve(spread, away)
    np.testing.assert_allclose(correction.nis[2], square, rtol=0.02)
    expected = [
        multivariate_t(shape=spread + beside**2 * np.eye(2), df=4).logpdf(away)
        for beside in (0.0, BESIDE)
    ]
    np.testing.assert_allclose(correction.log_likelihoods()[2], expected, atol=0.05)


def test_a_place_speaks_for_a_name_or_against_it():
    found = places([0, 1, 2, 3, 4])
    right = corrected(found).log_likelihoods()
    assert min(own - other for own, other in right.values()) > 0.0
    found[2] = (found[2][0] + 5.0, found[2][1] + 5.0)
    own, other = corrected(found).log_likelihoods()[2]
    assert own - other < -5.0
