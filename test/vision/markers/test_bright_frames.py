"""Frames in which more is bright than the markers: ground, specks, or nearly everything."""

import cv2
import numpy as np
import pytest
from support.marker_flights import SCENES, MarkerFlight, Scene, track_flight

from mvuav_ros import Image, MarkerTracker
from mvuav_ros.parameters.marker_tracker import MarkerTrackerParameters
from mvuav_ros.vision.markers.lights import MAX_BLOBS, Blobs

PARAMETERS = MarkerTrackerParameters(prediction='kalman')


@pytest.mark.parametrize('seed', [3, 8])
def test_markers_before_bright_ground_have_their_names(seed):
    """A fifth of each frame is as bright as they are, and some pass before it."""
    wrong, counts = track_flight(MarkerFlight(SCENES['bright ground'], seed))
    names, whole = np.sum(counts, axis=0)
    assert wrong == 0
    assert names >= 0.97 * whole > 500


def test_markers_among_thousands_of_specks_have_their_names():
    """One pixel in a hundred is bright, another one in each frame, while markers go dark."""

    def specked(pixels, number):
        noise = np.random.default_rng(number).random(pixels.shape)
        return np.where(noise < 0.01, np.uint8(255), pixels)

    wrong, counts = track_flight(MarkerFlight(Scene(losses=4, roll=0.3), 4), specked)
    names, whole = np.sum(counts, axis=0)
    assert wrong == 0
    assert names >= 0.97 * whole > 500


def test_of_too_many_pieces_the_largest_may_be_lights():
    mask = np.zeros((480, 640), np.uint8)
    mask[20::8, 20::8] = 255
    places = [(100, 100), (301, 200), (500, 401)]
    for place in places:
        cv2.circle(mask, place, 6, 255, -1)
    blobs = Blobs(mask, PARAMETERS)
    assert len(blobs.stats) > 2 * MAX_BLOBS
    chosen = blobs.may_be_lights()
    assert len(chosen) == MAX_BLOBS
    assert np.count_nonzero(blobs.stats[chosen][:, 4] > 1) == len(places)
    lights = blobs.measure(blobs.may_be_lights(least=5.0))
    assert [(round(light.x), round(light.y)) for light in lights] == places


def test_a_piece_larger_than_all_lights_of_a_frame_may_be_is_not_one_of_them():
    """Half of the frame is white, and would be measured as a whole."""
    frame = np.zeros((480, 640), np.uint8)
    frame[240:] = 255
    cv2.circle(frame, (100, 100), 60, 255, -1)
    [(x, y, *_)] = Blobs(frame, PARAMETERS).measure()
    assert (x, y) == pytest.approx((100, 100), abs=0.01)


@pytest.mark.parametrize(('rows', 'percent'), [(240, 50), (480, 100)])
def test_where_nothing_is_found_the_status_says_how_much_is_bright(rows, percent):
    frame = np.zeros((480, 640), np.uint8)
    frame[:rows] = 255
    status = MarkerTracker(PARAMETERS).process(Image(frame, 'mono8'), 0).status
    assert f'{percent} % of the frame is above the threshold' in status


def test_any_lights_are_followed_beside_bright_ground():
    """It is no light, and those on the dark part of the frame have their numbers."""
    tracker = MarkerTracker(MarkerTrackerParameters(mode='track_any'))
    first = np.array([(100, 60), (250, 90), (400, 70), (520, 110)])
    for step in range(20):
        places = first + step * np.array([2, 1])
        frame = np.zeros((480, 640), np.uint8)
        frame[240:] = 255
        for place in places.tolist():
            cv2.circle(frame, place, 4, 255, -1)
        result = tracker.process(Image(frame, 'mono8'), step * 33_000_000)
        assert result.ids == (1, 2, 3, 4)
        seen = [(marker.x, marker.y) for marker in result.markers]
        assert np.sort(seen, axis=0) == pytest.approx(np.sort(places, axis=0))
    status = tracker.process(Image(np.full((480, 640), 255, np.uint8), 'mono8'), 10**9).status
    assert '100 % of the frame is above the threshold' in status
