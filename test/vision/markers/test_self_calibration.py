"""The focal length that lights show, held against the truth of independent flights."""

import math

import numpy as np
import pytest
from support.marker_flights import DISTORTION, SCENES, MarkerFlight, Scene

from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.markers.calibrated_tracker import SelfCalibration
from mvuav_ros.vision.rig import MarkerRig

TRUE_FOCAL = 612.0


def camera_of(flight) -> CameraModel:
    return CameraModel(640, 480, tuple(flight.matrix.ravel().tolist()), (*DISTORTION, 0.0))


def checked(flight, frames=range(0, 60, 12), noise=0.05, change=lambda labels, pixels: None):
    """The estimate by some frames of a flight; what changes their lights may do so."""
    check = SelfCalibration(flight.rig, camera_of(flight))
    rng = np.random.default_rng(1)
    for frame in frames:
        truth = flight.truth(frame)
        labels = np.flatnonzero(truth.whole)
        pixels = truth.pixels[labels] + rng.normal(0.0, noise, (len(labels), 2))
        change(labels, pixels)
        check.add(labels.tolist(), pixels)
    return check.estimate()


@pytest.mark.parametrize('seed', range(4))
@pytest.mark.parametrize('error', [0.05, 0.15, 0.3])
def test_a_wrong_focal_length_is_found_and_named(error, seed):
    flight = MarkerFlight(Scene(focal_error=error), seed)
    estimate = checked(flight)
    assert estimate.fits and estimate.contradicts
    focal = estimate.of_camera(camera_of(flight)).k[0]
    assert focal == pytest.approx(TRUE_FOCAL, rel=0.01)
    # The deviation is honest.
    assert abs(estimate.shift - math.log(TRUE_FOCAL / flight.matrix[0, 0])) < 3 * estimate.deviation


def test_a_body_whose_origin_is_behind_the_camera_is_checked_as_well():
    flight = MarkerFlight(Scene(focal_error=0.3), 7)
    truth = flight.truth(0)
    labels = np.flatnonzero(truth.whole)
    estimates = []
    for ahead in (0.0, 200.0):
        check = SelfCalibration(np.add(flight.rig, (ahead, 0.0, 0.0)), camera_of(flight))
        assert check.add(labels.tolist(), truth.pixels[labels])
        estimates.append(check.estimate().shift)
    assert estimates[0] == pytest.approx(estimates[1], abs=1e-4)


def test_one_frame_is_enough_for_a_gross_error():
    estimate = checked(MarkerFlight(Scene(focal_error=0.3), 7), frames=[0])
    assert estimate.contradicts and estimate.deviation < 0.05


@pytest.mark.parametrize('name', ['usual', 'crossing', 'four lights', 'eight lights'])
def test_a_right_calibration_is_not_contradicted(name):
    for seed in range(4):
        estimate = checked(MarkerFlight(SCENES[name], seed))
        assert not estimate.contradicts


def test_a_rig_measured_badly_is_learnt_and_seldom_taken_for_a_wrong_calibration():
    """Some such rigs look just as the right one does through another lens."""
    taken = 0
    for seed in range(16):
        flight = MarkerFlight(Scene(rig_error=0.005), seed)
        estimate = checked(flight)
        assert estimate.fits
        taken += estimate.contradicts
        places = map(tuple, flight.rig.tolist())
        rig = MarkerRig('body', tuple(zip(flight.names, places, strict=True)), *[(0, 0, 0)] * 2)
        again = SelfCalibration(
            estimate.of_rig(rig).positions, estimate.of_camera(camera_of(flight))
        )
        again.add(range(5), flight.truth(90).pixels)
        assert again.estimate().reduced_chi2 < 2.0
    assert taken <= 2


def test_a_wrong_name_fits_no_focal_length():
    flight = MarkerFlight(Scene(), 3)

    def exchange(labels, pixels):
        pixels[[1, 2]] = pixels[[2, 1]]

    estimate = checked(flight, change=exchange)
    assert not estimate.fits and not estimate.contradicts


def test_too_few_lights_tell_nothing():
    check = SelfCalibration(MarkerFlight(Scene(), 3).rig, camera_of(MarkerFlight(Scene(), 3)))
    check.add([0, 1, 2], np.array([(10.0, 10.0), (50.0, 10.0), (30.0, 40.0)]))
    assert len(check) == 0 and check.estimate() is None
    # Nor do lights that are all in one place.
    check.add(range(5), np.full((5, 2), 100.0))
    assert check.estimate() is None or not check.estimate().contradicts


def test_the_newest_frames_are_kept():
    flight = MarkerFlight(Scene(), 3)
    check = SelfCalibration(flight.rig, camera_of(flight))
    for frame in range(0, 60, 3):
        check.add(range(5), flight.truth(frame).pixels)
    assert len(check) == 12


def test_a_light_that_is_another_one_for_a_moment_teaches_nothing():
    flight = MarkerFlight(Scene(), 3)
    check = SelfCalibration(flight.rig, camera_of(flight))
    for frame in range(0, 24, 6):
        assert check.add(range(5), flight.truth(frame).pixels)
    shift = check.estimate().shift
    for frame in range(24, 60, 6):
        pixels = flight.truth(frame).pixels.copy()
        pixels[0] += (2.0, 0.0)
        assert not check.add(range(5), pixels)
    assert check.estimate().shift == shift
    assert check.add(range(5), flight.truth(60).pixels)


def test_a_fisheye_and_rectified_images():
    flight = MarkerFlight(Scene(), 3)
    ways = flight.rotations, flight.translations
    places = [flight.rig @ r.T + t for r, t in zip(*ways, strict=True)]
    k, p = (600, 0, 330, 0, 600, 235, 0, 0, 1), (600, 0, 330, 0, 0, 600, 235, 0, 0, 0, 1, 0)
    fisheye = CameraModel(640, 480, k, (0.05, -0.01, 0.002, 0.0), 'equidistant')
    for true in (fisheye, CameraModel(640, 480, k, (-0.2,) + (0.0,) * 4, p=p).rectified()):
        told = true.binned(1, 1)
        for name in ('k', 'p'):
            wrong = [1.2 * v if v == 600 else v for v in getattr(true, name)]
            object.__setattr__(told, name, tuple(wrong))
        check = SelfCalibration(flight.rig, told)
        for frame in range(0, 60, 12):
            check.add(range(5), true.project(places[frame]))
        assert check.estimate().contradicts
        assert check.estimate().of_camera(told).matrix[0, 0] == pytest.approx(600.0, rel=0.01)
