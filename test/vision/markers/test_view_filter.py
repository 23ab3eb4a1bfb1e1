"""The view's Kalman filter over time."""

import math

import numpy as np
import pytest

from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.markers import view_filter
from mvuav_ros.vision.markers.lights import Lens
from mvuav_ros.vision.markers.rig_view import COUNT, FOCAL, ViewState, WeakPerspective, X
from mvuav_ros.vision.markers.view_filter import ViewFilter
from mvuav_ros.vision.rig import TANKER_747

CAMERA = CameraModel(640, 480, (554.0, 0.0, 319.5, 0.0, 554.0, 239.5, 0.0, 0.0, 1.0))
VIEW = np.array((0.1, math.log(150.0), 320.0, 240.0, 0.1, -0.1, 6.32, 0.0))
SPREAD = np.array((0.02, 0.02, 3.0, 3.0, 0.05, 0.05, 0.01, 1e-4))
SHAPE = WeakPerspective.of(TANKER_747, Lens((640, 480), CAMERA))


SETTLED = 120  # Frames until the covariance has settled


def fly(camera=CAMERA, frames=240, push=None):
    """A calm flight, in which a push may move all lights by 6 px: views, gains, deviations."""
    shape = WeakPerspective.of(TANKER_747, Lens((640, 480), camera))
    views = ViewFilter(shape, ViewState(VIEW, np.diag(SPREAD**2)), 0.0)
    rng, seen, gains, deviations = np.random.default_rng(0), [], [], []
    for frame in range(1, frames):
        wave = 0.02 * math.sin(0.05 * frame)
        view = VIEW + np.array((wave, 0.5 * wave, frame, 0.0, wave, -wave, 0.0, 0.0))
        view[X] += 6.0 if push is not None and frame >= push else 0.0
        places = shape.project(view) + rng.normal(0.0, 0.1, (5, 2))
        views.predict(frame / 30)
        correction = views.correct(dict(enumerate(map(tuple, places.tolist()))))
        views.commit(correction)
        seen.append(views.means[0, :COUNT].copy())
        deviations.append(np.sqrt(np.diag(views.view.covariance)))
        gains.append(correction.gain)
    return np.array(seen), gains, np.array(deviations)


@pytest.mark.parametrize('camera', [CAMERA, None], ids=['calibrated', 'not calibrated'])
def test_a_gain_that_is_kept_gives_the_same_view(camera, monkeypatch):
    kept, gains, deviations = fly(camera)
    assert len({id(gain) for gain in gains[SETTLED:]}) < 0.3 * len(gains[SETTLED:])
    monkeypatch.setattr(view_filter, 'MAX_KEPT', 0)
    renewed, gains, _ = fly(camera)
    assert len({id(gain) for gain in gains}) == len(gains)
    apart = (kept - renewed)[SETTLED:] / deviations[SETTLED:]
    assert np.sqrt(np.mean(apart[:, : FOCAL - (camera is None)] ** 2)) < 0.3


def test_a_push_is_met_with_a_new_gain():
    _, gains, _ = fly(push=SETTLED + 20)
    newest = SETTLED + 19
    assert gains[newest] is not gains[newest - 1]
    settled = [gains[index] is not gains[index - 1] for index in range(SETTLED, newest)]
    assert sum(settled) < 0.5 * len(settled)


def test_no_variance_gets_negative():
    """Again and again a view of which nearly nothing is known any more is told exactly."""
    views = ViewFilter(SHAPE, ViewState(VIEW, np.diag(SPREAD**2)), 0.0)
    seen = dict(enumerate(SHAPE.project(VIEW).tolist()))
    for frame in range(1, 60):
        views.predict(float(frame))
        views.commit(views.correct({m: seen[m] for m in list(seen)[: 2 + frame % 4]}))
        (covariance,) = views.belief.covariance
        sizes = np.sqrt(np.diag(covariance))
        assert (sizes > 0.0).all()
        assert np.linalg.eigvalsh(covariance / np.outer(sizes, sizes))[0] > -1e-9
