"""A camera that is mounted upside down, as the mount says, names what an upright one names."""

import math

import numpy as np
import pytest
from support.marker_flights import HEIGHT, WIDTH, MarkerFlight, Scene, told
from support.marker_scenes import draw, tanker_at

from mvuav_ros.parameters.marker_tracker import MarkerTrackerParameters
from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.image import Image
from mvuav_ros.vision.markers.marker_results import MarkerState
from mvuav_ros.vision.markers.tracker import MarkerTracker

UPRIGHT, UPSIDE_DOWN = (0.0, 0.0, 0.0), (180.0, 0.0, 0.0)
RUDDER = 2


def names(mount, *, turned):
    """Of 8 flights without their rudder's light, which look nearly alike both ways.

    Names that are wrong, and those that are right, over the markers in sight.
    """
    wrong = right = seen = 0
    for seed in range(700, 708):
        flight = MarkerFlight(Scene(roll=0.2, frames=24), seed)
        flight.dark[:, RUDDER] = True
        rig, camera = told(flight)
        if turned:
            fx, _, cx, _, fy, cy, *_ = camera.k
            k = (fx, 0.0, WIDTH - 1 - cx, 0.0, fy, HEIGHT - 1 - cy, 0.0, 0.0, 1.0)
            k1, k2, p1, p2, k3 = camera.d
            camera = CameraModel(WIDTH, HEIGHT, k, (k1, k2, -p1, -p2, k3))
        tracker = MarkerTracker(MarkerTrackerParameters(camera_mount_rpy_deg=mount), rig)
        tracker.set_camera(camera)
        for stamp_ns, pixels, truth in flight:
            image = np.ascontiguousarray(pixels[::-1, ::-1] if turned else pixels)
            result = tracker.process(Image(image, 'mono8'), stamp_ns)
            for marker, place in zip(result.markers, truth.pixels.tolist(), strict=True):
                if marker.state is MarkerState.DETECTED:
                    x, y = place
                    there = (WIDTH - 1 - x, HEIGHT - 1 - y) if turned else (x, y)
                    away = math.dist((marker.x, marker.y), there)
                    wrong, right = wrong + (away > 4.0), right + (away <= 4.0)
            seen += int(truth.whole.sum())
    return wrong, right / seen


def test_a_body_without_its_rudder_has_the_right_names():
    assert names(UPSIDE_DOWN, turned=True) == pytest.approx(names(UPRIGHT, turned=False))
    wrong, right = names(UPSIDE_DOWN, turned=True)
    assert wrong == 0
    assert right > 0.6


def test_without_that_mount_its_names_are_exchanged():
    """Otherwise the test above says nothing."""
    assert names(UPRIGHT, turned=True)[0] > 0


@pytest.mark.parametrize('mount', [UPRIGHT, UPSIDE_DOWN])
def test_five_lights_that_are_not_the_rigs_are_named_by_their_distances(mount):
    """Without a calibration, as the thesis names them; the body is level before either camera."""
    places = tanker_at(roll_deg=-mount[0]) * (1.0, 0.8) + (0.0, 40.0)
    tracker = MarkerTracker(MarkerTrackerParameters(camera_mount_rpy_deg=mount))
    for number in range(6):
        result = tracker.process(Image(draw(places), 'mono8'), number * 33_000_000)
    for marker, place in zip(result.markers, places, strict=True):
        assert (marker.x, marker.y) == pytest.approx(tuple(place), abs=1.0)


def test_another_mount_counts_at_once():
    tracker = MarkerTracker()
    tracker.process(Image(draw(tanker_at()), 'mono8'), 0)
    tracker.configure(MarkerTrackerParameters(camera_mount_rpy_deg=UPSIDE_DOWN))
    result = tracker.process(Image(draw(tanker_at(roll_deg=180.0)), 'mono8'), 33_000_000)
    assert [marker.state for marker in result.markers] == [MarkerState.DETECTED] * 5
    assert abs(result.roll) == pytest.approx(math.pi, abs=0.01)
