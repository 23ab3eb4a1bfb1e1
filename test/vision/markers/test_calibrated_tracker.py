"""Names that do not hang on the calibration, on flights of the independent generator."""

import math

import numpy as np
import pytest
from support.marker_flights import DISTORTION, MarkerFlight, Scene

from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.image import Image
from mvuav_ros.vision.markers.marker_results import MarkerState
from mvuav_ros.vision.markers.tracker import MarkerTracker
from mvuav_ros.vision.rig import TANKER_747


def camera_of(flight, width=640) -> CameraModel:
    return CameraModel(width, 480, tuple(flight.matrix.ravel().tolist()), (*DISTORTION, 0.0))


def flown(flight, camera, tracker=None):
    """Results and truths, after those in which names were sought."""
    tracker = tracker or MarkerTracker(rig=TANKER_747)
    tracker.set_camera(camera)
    frames = list(flight)
    results = [tracker.process(Image(image, 'mono8'), stamp) for stamp, image, _ in frames]
    return results, [truth for _, _, truth in frames]


def named(result):
    return [marker.state is MarkerState.DETECTED for marker in result.markers]


@pytest.mark.parametrize('error', [0.05, 0.15, 0.3])
def test_all_names_and_the_roll_with_a_wrong_calibration(error):
    for seed in (1, 2, 3):
        flight = MarkerFlight(Scene(focal_error=error, frames=16), seed)
        results, truths = flown(flight, camera_of(flight))
        for result, truth in list(zip(results, truths, strict=True))[3:]:
            assert all(named(result))
            places = np.array([(marker.x, marker.y) for marker in result.markers])
            assert np.hypot(*(places - truth.pixels).T).max() < 1.0
            across = truth.pixels[4] - truth.pixels[0]
            assert result.roll == pytest.approx(math.atan2(across[1], across[0]), abs=0.01)


def test_the_doubt_names_both_focal_lengths():
    flight = MarkerFlight(Scene(focal_error=0.15, frames=16), 5)
    results, _ = flown(flight, camera_of(flight))
    told = math.sqrt(flight.matrix[0, 0] * flight.matrix[1, 1])
    start = f'camera_info says a focal length of {told:.0f} px, the lights show '
    assert results[-1].camera_doubt.startswith(start)
    shown = float(results[-1].camera_doubt.removeprefix(start).split()[0])
    assert shown == pytest.approx(610.0, rel=0.02)
    assert all(result.camera_doubt for result in results if any(named(result)))


def test_a_right_calibration_is_not_doubted():
    for seed in (1, 2):
        flight = MarkerFlight(Scene(frames=16), seed)
        results, _ = flown(flight, camera_of(flight))
        assert all(all(named(result)) and not result.camera_doubt for result in results)


def test_a_rig_measured_badly_is_named_at_once_and_no_reason_to_doubt_the_camera():
    for seed in (1, 2, 3):
        flight = MarkerFlight(Scene(rig_error=0.005, frames=16), seed)
        results, _ = flown(flight, camera_of(flight))
        assert all(all(named(result)) and not result.camera_doubt for result in results[3:])


def test_another_calibration_begins_anew():
    flight = MarkerFlight(Scene(focal_error=0.3, frames=8), 1)
    right = MarkerFlight(Scene(frames=8), 1)
    tracker = MarkerTracker(rig=TANKER_747)
    assert flown(flight, camera_of(flight), tracker)[0][-1].camera_doubt
    tracker.reset()
    assert flown(flight, camera_of(flight), tracker)[0][-1].camera_doubt
    tracker.reset()
    assert not any(r.camera_doubt for r in flown(right, camera_of(right), tracker)[0])


def test_a_calibration_of_another_size_is_not_used():
    flight = MarkerFlight(Scene(focal_error=0.3, frames=8), 1)
    results, _ = flown(flight, camera_of(flight, width=320))
    assert all(all(named(result)) and not result.camera_doubt for result in results)


@pytest.mark.parametrize('scale', [3.0, 0.005])
def test_a_calibration_of_other_images_costs_no_names(scale):
    """K of images three times as large, say, which no focal length makes right."""
    flight = MarkerFlight(Scene(frames=60), 2)
    k = flight.matrix.copy()
    k[:2] *= scale
    results, truths = flown(flight, CameraModel(640, 480, k))
    for result, truth in list(zip(results, truths, strict=True))[20:]:
        assert all(named(result))
        places = np.array([(marker.x, marker.y) for marker in result.markers])
        assert np.hypot(*(places - truth.pixels).T).max() < 1.0
        assert result.camera_doubt


def test_other_lights_are_not_named_by_bending_the_camera():
    """Five lights that are no rig's fit no focal length."""
    flight = MarkerFlight(Scene(frames=30), 1)
    tracker = MarkerTracker(rig=TANKER_747)
    tracker.set_camera(camera_of(flight))
    frame = np.full((480, 640), 60, np.uint8)
    for x, y in ((100, 100), (200, 150), (320, 300), (400, 120), (520, 330)):
        frame[y - 3 : y + 4, x - 3 : x + 4] = 255
    for number in range(60):
        result = tracker.process(Image(frame, 'mono8'), number * 33_000_000)
        assert not any(named(result)) and not result.camera_doubt
