"""Rigs from simulated flights, against the rigs that flew."""

import cv2
import numpy as np
import pytest
from scipy.stats import chi2

from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.frames import OPTICAL_FROM_BODY
from mvuav_ros.vision.rig_calibration import RigCalibrationError, calibrate_rig

CAMERA = CameraModel(640, 480, (600, 0, 319.5, 0, 600, 239.5, 0, 0, 1), (-0.2, 0.05, 0, 0, 0))
FISHEYE = CameraModel(
    640, 480, (330, 0, 319.5, 0, 330, 239.5, 0, 0, 1), (-0.02, 0.005, 0, 0), 'equidistant'
)


class Case:
    """A random rig before a camera, seen with noise from random sides, some lights missing."""

    def __init__(
        self, seed, lights=None, frames=100, tilt=30.0, wrong=0.0, rough=0.005, camera=CAMERA
    ):
        rng = np.random.default_rng(seed)
        count = lights or int(rng.integers(4, 13))
        apart = np.zeros((count, count))
        while apart.min() < 0.12:
            self.true = rng.uniform(-0.5, 0.5, (count, 3)) * (0.6, 1.0, 0.7)
            apart = np.linalg.norm(self.true[:, None] - self.true, axis=2)
            self.span = float(apart.max())
            self.ends = np.unravel_index(apart.argmax(), apart.shape)
            np.fill_diagonal(apart, 9.0)
        self.camera = camera
        self.pixels = np.full((frames, count, 2), np.nan)
        for own in self.pixels:
            turn = cv2.Rodrigues(np.radians(rng.uniform(-tilt, tilt, 3)))[0] @ OPTICAL_FROM_BODY
            depth = rng.uniform(1.6, 3.0) * self.span if tilt else 2.0 * self.span
            beside = rng.uniform(-0.2, 0.2, 2) * depth if tilt else np.zeros(2)
            place = np.append(beside, depth) - turn @ self.true.mean(axis=0)
            pixels = camera.project(self.true, cv2.Rodrigues(turn)[0], place)
            pixels = pixels + rng.normal(0, 0.3, pixels.shape)
            seen = np.flatnonzero(rng.random(count) > 0.05)
            names = seen.copy()
            if rng.random() < wrong:
                names[[0, -1]] = names[[-1, 0]]
            own[names] = pixels[seen]
        self.rough = self.true + rng.normal(0, rough, self.true.shape)

    def distance(self):
        return int(self.ends[0]), int(self.ends[1]), self.span

    def calibrate(self, measured=True):
        distance = self.distance() if measured else None
        return calibrate_rig(self.rough, self.camera, self.pixels, distance)

    def error(self, found):
        """(n, 3), m, in the best common frame; and its chi-square over the 99 % bound."""
        apart = found.positions - found.positions.mean(axis=0)
        wanted = self.true - self.true.mean(axis=0)
        u, _, vt = np.linalg.svd(wanted.T @ apart)
        turn = u * (1, 1, np.linalg.det(u @ vt)) @ vt
        error = apart @ turn.T - wanted
        mixed = np.kron(np.eye(len(apart)), turn)
        covariance = mixed @ found.covariance @ mixed.T
        moves = [np.tile(axis, len(wanted)) for axis in np.eye(3)]
        moves += [np.cross(axis, wanted).ravel() for axis in np.eye(3)]
        basis = np.linalg.qr(np.column_stack(moves), mode='complete')[0][:, 6:]
        variances, axes = np.linalg.eigh(basis.T @ covariance @ basis)
        known = variances > 1e-9 * variances.max()
        parts = (axes.T @ basis.T @ error.ravel())[known]
        bound = chi2.ppf(0.99, known.sum())
        return error, float((parts**2 / variances[known]).sum()) / bound


@pytest.mark.parametrize(('seed', 'lights'), [(1, 4), (2, 5), (3, 7), (4, 12)])
def test_lights_are_found_to_a_thousandth_of_the_span(seed, lights):
    case = Case(seed, lights)
    found = case.calibrate()
    error, inside = case.error(found)
    assert np.sqrt((error**2).sum(axis=1).mean()) < 0.001 * case.span
    assert inside < 1.0
    assert found.noise == pytest.approx(0.3, rel=0.1)
    first, second, metres = case.distance()
    assert np.linalg.norm(found.positions[first] - found.positions[second]) == pytest.approx(metres)
    # In the frame of the rough rig.
    assert found.positions.mean(axis=0) == pytest.approx(case.rough.mean(axis=0))


def test_wrong_names_are_left_out():
    case = Case(5, 7, wrong=0.2)
    found = case.calibrate()
    error, inside = case.error(found)
    assert np.sqrt((error**2).sum(axis=1).mean()) < 0.001 * case.span
    assert inside < 1.0
    assert found.used[np.isfinite(case.pixels[..., 0])].mean() > 0.85


def test_a_rig_that_is_wrong_by_six_centimetres_comes_back():
    case = Case(3, 5, rough=0.06)
    error, _ = case.error(case.calibrate())
    assert np.sqrt((error**2).sum(axis=1).mean()) < 0.001 * case.span


def test_a_fisheye_camera():
    case = Case(8, 6, camera=FISHEYE)
    error, inside = case.error(case.calibrate())
    assert np.sqrt((error**2).sum(axis=1).mean()) < 0.002 * case.span
    assert inside < 1.0


def test_without_a_distance_the_scale_is_the_rough_rigs_and_as_uncertain():
    case = Case(6, 8)
    found = case.calibrate(measured=False)
    inside = case.error(found)[1]
    assert inside < 1.0
    size = [np.linalg.norm(p - p.mean(axis=0)) for p in (found.positions, case.true)]
    assert 0 < abs(size[0] / size[1] - 1.0) < 4 * found.scale_deviation < 0.02


@pytest.mark.parametrize('seed', range(4))
def test_a_rough_rig_that_is_wrong_by_three_percent_gives_a_rough_scale_alone(seed):
    case = Case(seed, 6, rough=0.03)
    found = case.calibrate(measured=False)
    assert case.error(found)[1] < 1.0
    size = [np.linalg.norm(p - p.mean(axis=0)) for p in (found.positions, case.true)]
    assert 0.004 < found.scale_deviation < 0.06
    assert abs(size[0] / size[1] - 1.0) < 4 * found.scale_deviation
    # It is in the covariance, of which a distance leaves a small part.
    assert case.calibrate().deviations.max() < 0.25 * found.deviations.max()


def test_a_motion_that_does_not_tell_the_shape_is_refused():
    with pytest.raises(RigCalibrationError, match=r'does not determine the shape: .* has to turn'):
        Case(1, 5, tilt=0.0).calibrate()
    with pytest.raises(RigCalibrationError, match='does not determine the shape'):
        Case(1, 5, frames=12, tilt=2.0).calibrate()


def test_too_few_lights_or_images_are_refused():
    with pytest.raises(RigCalibrationError, match='3 lights are too few'):
        Case(1, 3).calibrate()
    with pytest.raises(RigCalibrationError, match='10 are needed, and 100 are good'):
        Case(1, 5, frames=8).calibrate()
    unseen = Case(1, 5)
    unseen.pixels[:] = np.nan
    with pytest.raises(RigCalibrationError, match='no pose fits the lights in any image'):
        unseen.calibrate()


def test_a_light_that_is_never_seen_is_named():
    case = Case(2, 6)
    case.pixels[:, 2] = np.nan
    with pytest.raises(RigCalibrationError, match='light 2 is seen in 0 images'):
        case.calibrate()


def test_names_that_are_exchanged_in_all_images_are_refused():
    case = Case(7, 6)
    case.pixels = case.pixels[:, [1, 0, 2, 3, 4, 5]]
    with pytest.raises(RigCalibrationError, match='names are exchanged'):
        case.calibrate()
