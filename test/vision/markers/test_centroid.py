"""Sub-pixel centroids against truth, beside the thesis's."""

import math

import cv2
import numpy as np
import pytest
from support.reference import load_trial

from mvuav_ros.parameters.marker_tracker import MarkerTrackerParameters
from mvuav_ros.simulation.settings import TankerSettings
from mvuav_ros.simulation.tanker_flight import TankerFlight
from mvuav_ros.vision.image import Image
from mvuav_ros.vision.markers.lights import CentroidMeter
from mvuav_ros.vision.markers.marker_results import NO_WINDOW, Window
from mvuav_ros.vision.markers.tracker import MarkerTracker


def rms(values, axis=None):
    return np.sqrt(np.mean(np.square(values), axis=axis))


def errors(frames, truth, centroid, **parameters):
    """Centroids minus truth, px, and the roll's, degrees; tracked at 15 frames/s."""
    pipeline = MarkerTracker(MarkerTrackerParameters(centroid=centroid, **parameters))
    places, rolls = [], []
    for index, frame in enumerate(frames):
        result = pipeline.process(Image(frame, 'mono8'), round(index / 15 * 1e9))
        places.append([(m.x, m.y) for m in result.markers])
        rolls.append(result.roll)
    left, right = truth[:, 0], truth[:, 4]
    true_rolls = np.arctan2(right[:, 1] - left[:, 1], right[:, 0] - left[:, 0])
    return np.array(places) - truth, np.degrees(np.array(rolls) - true_rolls)


@pytest.mark.parametrize('trial', ['trial1', 'trial3'])
@pytest.mark.parametrize(
    'parameters', [{}, {'mode': 'detect'}, {'prediction': 'velocity'}], ids=lambda p: str(p)
)
def test_reference_frames(trial, parameters):
    data = load_trial(trial)
    frames = data['frames']
    truth = data['truth_xy0'][: len(frames)]
    weighted, weighted_roll = errors(frames, truth, 'weighted', **parameters)
    binary, binary_roll = errors(frames, truth, 'binary', **parameters)
    assert rms(binary, (0, 1)) == pytest.approx(0.085, abs=0.01)
    assert rms(binary_roll) == pytest.approx(0.017, abs=0.006)
    assert max(rms(weighted, (0, 1))) <= 0.020
    assert rms(weighted_roll) <= 0.005


@pytest.mark.parametrize('motion', ['translation', 'roll', 'docking'])
def test_simulated_frames(motion):
    flight = TankerFlight(TankerSettings(motion=motion, frames=60, fps=5.0, seed=5, exposure=0.0))
    found = []
    for index in flight.indices:
        frame = flight.frame(index)
        meter = CentroidMeter(frame.image, 0.7, weighted=True)
        for marker in frame.truth.markers:
            if marker.whole and 25 < marker.x < 614 and 25 < marker.y < 454:
                x, y = round(marker.x), round(marker.y)
                spot = meter.measure(Window(x - 10, x + 10, y - 10, y + 10))
                found.append((spot.x - marker.x, spot.y - marker.y))
    assert len(found) > 200
    assert max(rms(found, 0)) <= 0.03


def light(x, y, size=21, dark=40.0, scale=255, step=0.0):
    """A soft saturated light; the background is ``step`` brighter right of the middle."""
    columns, rows = np.meshgrid(np.arange(size), np.arange(size))
    background = np.where(columns > x, dark + step, dark)
    cover = np.clip(4.5 - np.hypot(columns - x, rows - y) + 0.5, 0.0, 1.0)
    image = cv2.GaussianBlur(background + cover * (255.0 - background), (0, 0), 1.1)
    return np.round(image * scale / 255).astype(np.uint16 if scale > 255 else np.uint8)


def centroid(image, weighted=True, encoding='mono8'):
    height, width = image.shape
    meter = CentroidMeter(Image(image, encoding), 0.7, weighted)
    return meter.measure(Window(0, width - 1, 0, height - 1))


@pytest.mark.parametrize('shift', [0.0, 0.2, 0.5, 0.8])
@pytest.mark.parametrize(('scale', 'encoding'), [(255, 'mono8'), (65535, 'mono16')])
def test_any_place_within_a_pixel(shift, scale, encoding):
    spot = centroid(light(15.0 + shift, 15.0, 31, scale=scale), encoding=encoding)
    assert spot.x == pytest.approx(15.0 + shift, abs=0.03)
    assert spot.y == pytest.approx(15.0, abs=0.03)


def test_a_brighter_background_on_one_side_pulls_little():
    image = light(20.0, 20.0, 41, step=12.0)
    meter = CentroidMeter(Image(image, 'mono8'), 0.7, weighted=True)
    ((spot, pull),) = meter.measure_all([Window(10, 30, 10, 30)], [None])
    weights = image[10:31, 10:31].astype(float) - 40.0
    naive = (weights * np.arange(10, 31)).sum() / weights.sum()
    assert pull[0] > 0.01
    assert abs(spot.x - 20.0) < 0.1 * abs(naive - 20.0)
    assert abs(spot.x - 20.0) < 0.7 * abs(spot.x + pull[0] - 20.0)


def test_another_light_in_the_ring_is_no_background():
    alone = light(20.0, 20.0, 41)
    beside = np.maximum(alone, light(31.0, 20.0, 41))
    window = Window(14, 26, 14, 26)
    near = CentroidMeter(Image(beside, 'mono8'), 0.7, weighted=True).measure(window)
    far = CentroidMeter(Image(alone, 'mono8'), 0.7, weighted=True).measure(window)
    assert near.x == pytest.approx(far.x, abs=0.02)


def test_spread_tells_a_disc_from_two():
    disc = light(15.0, 15.0, 31)
    pair = np.maximum(light(12.0, 15.0, 31), light(18.0, 15.0, 31))
    assert centroid(pair).spread > 1.15 * centroid(disc).spread


def test_nothing_bright_is_no_light():
    assert centroid(np.full((21, 21), 178, np.uint8)) is None
    assert centroid(np.full((21, 21), 178, np.uint8), weighted=False) is None


def test_auto_is_the_thesiss_way_for_the_thesiss_predictions():
    def weighted(**values):
        return MarkerTrackerParameters(**values).weighted

    assert weighted()
    assert weighted(mode='track_any')
    for prediction in ('none', 'velocity', 'acceleration', 'acceleration_program'):
        assert not weighted(prediction=prediction)
        assert weighted(prediction=prediction, centroid='weighted')
    assert not weighted(mode='detect')
    assert not weighted(mode='detect_any')
    assert not weighted(centroid='binary')


def test_radius_of_a_spot():
    assert centroid(light(15.0, 15.0, 31)).radius == pytest.approx(3.8, abs=0.2)
    assert math.isfinite(centroid(light(15.0, 15.0, 31)).spread)


def test_windows_of_any_size_are_measured_as_each_alone():
    """Also those that the frame's edge cuts, or that show nothing."""
    image = Image(np.vstack((light(30.0, 30.0, 60), light(3.0, 45.0, 60))), 'mono8')
    meter = CentroidMeter(image, 0.7, weighted=True)
    bounds = [(20, 40, 20, 40), (0, 12, 92, 119), NO_WINDOW, (40, 59, 0, 9), (25, 36, 24, 35)]
    windows = [Window(*each) for each in bounds]
    pulls = [None, None, None, None, (0.01, 0.02)]
    found = meter.measure_all(windows, pulls)
    assert found[2:4] == [None, None]
    for index in (0, 1):
        alone = meter.measure(windows[index])
        assert found[index][0] == pytest.approx(alone, abs=1e-4)
    spot, pull = found[4]
    bare = meter.measure_all(windows[4:], [(0.0, 0.0)])[0][0]
    assert pull == (0.01, 0.02)
    assert (spot.x, spot.y) == pytest.approx((bare.x - 0.01, bare.y - 0.02), abs=1e-4)
