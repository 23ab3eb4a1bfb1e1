"""Filters of a view side by side: the gain form tells what a fit from the same prior tells."""

import math

import numpy as np

from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.markers.lens import Lens
from mvuav_ros.vision.markers.view.filter_bank import FilterBank
from mvuav_ros.vision.markers.view.fit import NamedPlaces, fit
from mvuav_ros.vision.markers.view.weak_perspective import FOCAL, ROLL, ViewState, WeakPerspective
from mvuav_ros.vision.rig import TANKER_747

CAMERA = CameraModel(640, 480, (554.0, 0.0, 319.5, 0.0, 554.0, 239.5, 0.0, 0.0, 1.0))
SHAPE = WeakPerspective.of(TANKER_747, Lens((640, 480), CAMERA))
VIEW = np.array((0.1, math.log(150.0), 320.0, 240.0, 0.1, -0.1, 6.32, 0.0))
SPREAD = np.array((0.02, 0.02, 3.0, 3.0, 0.05, 0.05, 0.01, 1e-4))
RATES = np.array((0.3, 0.1, 1e4, 1e4, 0.04, 0.04, 0.0, 0.0))


def bank(count=1):
    later = FilterBank.of(ViewState(VIEW, np.diag(SPREAD**2)), count, RATES)
    return later.predicted(0.04, 0.01 * SPREAD**2, RATES)


def places(markers, seed=0):
    rng = np.random.default_rng(seed)
    seen = SHAPE.project(VIEW + SPREAD * rng.normal(size=8))[markers]
    return seen + rng.normal(0.0, 0.2, seen.shape)


def test_a_filter_finds_what_a_fit_from_its_prior_finds():
    for markers in ([0, 1, 2, 3, 4], [3, 0, 2], [1, 4]):
        markers = np.array(markers)
        prior = bank()
        seen = NamedPlaces(markers[None], places(markers)[None], 0.2)
        fitted = fit(SHAPE, (prior.parameters, prior.covariance), seen)
        correction = prior.corrected(SHAPE, seen, np.full((1, len(markers)), 0.2**2))
        view = correction.view(0)
        np.testing.assert_allclose(view.parameters, fitted.parameters[0], rtol=1e-6)
        scale = np.sqrt(np.outer(*2 * [np.diag(fitted.covariance[0])]))
        np.testing.assert_allclose(view.covariance / scale, fitted.covariance[0] / scale, atol=1e-6)
        np.testing.assert_allclose(view.surprise, fitted.surprise[0], rtol=1e-5)
        np.testing.assert_allclose(view.misfit, fitted.misfit[0], rtol=1e-5)


def test_rates_follow_the_parameters():
    before = bank()
    moved = SHAPE.project(VIEW + np.array((0.02, 0, 0, 0, 0, 0, 0, 0)))
    seen = NamedPlaces(np.arange(5)[None], moved[None], 0.2)
    after = before.corrected(SHAPE, seen, np.full((1, 5), 0.2**2)).after
    gain = before.covariances[0, 8:, :8] @ np.linalg.inv(before.covariance[0])
    expected = before.rates[0] + gain @ (after.parameters[0] - before.parameters[0])
    np.testing.assert_allclose(after.rates[0], expected, atol=1e-9)
    assert after.rates[0, ROLL] > 0.0


def test_a_marker_is_held_against_the_others_and_not_against_itself():
    prior = bank(2)
    measured = places(np.arange(5))
    measured[2] += (5.0, 0.0)
    variances = np.full((2, 5), 0.2**2)
    variances[1, 2] *= 100.0
    correction = prior.corrected(
        SHAPE, NamedPlaces(np.arange(5)[None], measured[None], 0.2), variances
    )
    rest = np.array([0, 1, 3, 4])
    others = prior.corrected(
        SHAPE, NamedPlaces(rest[None], measured[rest][None], 0.2), variances[:, rest]
    )
    expected, slopes = SHAPE.linearize(others.after.parameters[1])
    spread = slopes[2] @ others.after.covariance[1] @ slopes[2].T + 0.2**2 * np.eye(2)
    away = measured[2] - expected[2]
    square = away @ np.linalg.solve(spread, away)
    np.testing.assert_allclose(correction.surprise[1, 2], square, rtol=0.02)


def test_what_is_known_does_not_become_less_certain():
    before = bank()
    after = before.less_certain(100.0, (FOCAL,))
    sizes = np.sqrt(np.diag(after.covariance[0]) / np.diag(before.covariance[0]))
    assert sizes[FOCAL] == 1.0
    np.testing.assert_allclose(np.delete(sizes, FOCAL), 10.0)
    assert np.linalg.eigvalsh(after.covariances[0]).min() > 0.0
