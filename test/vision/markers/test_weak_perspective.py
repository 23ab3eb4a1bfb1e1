"""Views of a rig: projection, its derivatives, and the fit."""

import gc
import math
import weakref

import numpy as np
import pytest

from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.markers.lights import Lens
from mvuav_ros.vision.markers.rig_view import COUNT, WeakPerspective
from mvuav_ros.vision.markers.view_correction import Belief, Correction, NamedPlaces
from mvuav_ros.vision.rig import TANKER_747

CAMERA = CameraModel(640, 480, (554.0, 0.0, 319.5, 0.0, 554.0, 239.5, 0.0, 0.0, 1.0))
VIEW = np.array((0.3, math.log(150.0), 300.0, 260.0, 0.2, -0.3, 6.3, 0.0))


@pytest.fixture(params=[CAMERA, None], ids=['calibrated', 'not calibrated'])
def shape(request):
    return WeakPerspective.of(TANKER_747, Lens((640, 480), request.param))


def fit(shape, mean, variances, places, noise):
    """A view by all markers' places, from a prior."""
    before = Belief(mean[None], np.diag(variances)[None])
    named = NamedPlaces.of(dict(enumerate(places)))
    return Correction.of(shape, before, named, noise**2)


def test_slopes_are_the_places_differences(shape):
    rng = np.random.default_rng(0)
    barrel = 0.0 if shape.lens.focal else -0.1
    views = VIEW + rng.normal(0.0, 0.05, (6, COUNT))
    views[:, -1] = barrel
    step = 1e-6
    _, slopes = shape.linearize(views)
    for parameter in range(COUNT if barrel else COUNT - 1):
        shift = np.zeros(COUNT)
        shift[parameter] = step
        apart = shape.project(views + shift) - shape.project(views - shift)
        differences = apart.reshape(len(views), -1) / (2 * step)
        np.testing.assert_allclose(slopes[:, parameter], differences, atol=1e-3)


def test_a_body_that_is_not_its_rig_is_shown_where_it_is(shape):
    beside = shape.project(VIEW) + np.random.default_rng(1).normal(0.0, 5.0, (5, 2))
    fitted = fit(shape, VIEW, np.full(COUNT, 1e-8), beside, 1.0).view()
    other = shape.with_offsets(fitted, beside)
    np.testing.assert_allclose(other.project(fitted.parameters), beside, atol=1e-6)
    turned = fitted.parameters + np.array((0.2, *np.zeros(7)))
    moved = other.project(turned) - shape.project(turned)
    lengths = np.hypot(*moved.T), np.hypot(*(beside - shape.project(fitted.parameters)).T)
    np.testing.assert_allclose(*lengths, rtol=1e-6)


def test_the_fit_finds_the_view_and_the_light_that_does_not_fit(shape):
    places = shape.project(VIEW)
    away = np.array((0.05, 0.05, 20.0, 20.0, 0.05, 0.05, 0.01, 0.0))
    spread = np.array((1, 1, 1e4, 1e4, 0.2, 0.2, 0.01, 1e-8))
    right = fit(shape, VIEW + away, spread, places, 0.2)
    assert right.rms_residual() < 0.1
    np.testing.assert_allclose(right.after.mean[0, :4], VIEW[:4], atol=0.2)
    places[2] += (12.0, 5.0)
    wrong = fit(shape, VIEW + away, spread, places, 0.2)
    assert np.argmax(wrong.nis) == 2
    assert max(wrong.nis) > 100 > max(right.nis)


def test_a_shape_that_is_no_longer_used_is_forgotten():
    """Each start of a tracker has one; its triangles were kept for good, a kilobyte each."""
    shape = WeakPerspective.of(TANKER_747, Lens((640, 480)))
    assert shape.triangles(1) is shape.triangles(1)
    left = weakref.ref(shape)
    del shape
    gc.collect()
    assert left() is None
