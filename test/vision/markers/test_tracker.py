"""The marker programs behind one call: in what of a colour image lights are looked for."""

import copy
import pickle

import cv2
import numpy as np
import pytest

from mvuav_ros.parameters.marker_tracker import MODES, MarkerTrackerParameters
from mvuav_ros.vision.image import Image
from mvuav_ros.vision.markers.marker_results import MarkerState
from mvuav_ros.vision.markers.tracker import MarkerTracker

PLACES = ((100, 240), (230, 225), (320, 120), (410, 225), (540, 240))
RED, WHITE = (0, 0, 255), (255, 255, 255)


def lights(color, shift=0, background=30, places=PLACES):
    """Five lights of one colour, blue first."""
    image = np.full((480, 640, 3), background, np.uint8)
    for x, y in places:
        cv2.circle(image, (x + shift, y), 5, color, -1, cv2.LINE_AA)
    return image


def detected(result):
    return sum(marker.state is MarkerState.DETECTED for marker in result.markers)


@pytest.mark.parametrize('mode', MODES)
@pytest.mark.parametrize('color', [RED, (0, 255, 0), (255, 0, 0), (0, 140, 255), WHITE])
def test_five_lights_of_any_colour_are_found_with_the_defaults(mode, color):
    tracker = MarkerTracker(MarkerTrackerParameters(mode=mode))
    for frame in range(6):
        result = tracker.process(Image(lights(color, 2 * frame), 'bgr8'), frame * 33_000_000)
        assert detected(result) == 5


@pytest.mark.parametrize('color', [RED, WHITE])
def test_lights_of_any_colour_that_several_frames_must_agree_on_are_found(color):
    """Five that are named as in the thesis: red ones had a new tracker in every frame."""
    tracker = MarkerTracker()
    places = ((294, 198), (529, 246), (276, 213), (409, 272), (143, 330))
    found = [
        detected(tracker.process(Image(lights(color, k, places=places), 'bgr8'), k * 33_000_000))
        for k in range(5)
    ]
    assert found == [0, 0, 5, 5, 5]


def test_intensity_alone_does_not_see_pure_red():
    tracker = MarkerTracker(MarkerTrackerParameters(channel='intensity'))
    assert detected(tracker.process(Image(lights(RED), 'bgr8'), 0)) == 0


def test_one_colour_leaves_the_others_out():
    both = lights(RED)
    both[200:206, 20:26] = (0, 255, 0)
    for channel, count in (('red', 5), ('green', 1)):
        parameters = MarkerTrackerParameters(mode='detect_any', channel=channel)
        assert detected(MarkerTracker(parameters).process(Image(both, 'bgr8'), 0)) == count


def test_auto_is_intensity_where_that_finds_the_lights():
    """A bright blue background pulls at lights in the brightest channel."""
    image = lights(WHITE)
    image[..., 0] = np.maximum(image[..., 0], np.linspace(60, 170, 640).astype(np.uint8))
    results = {
        channel: MarkerTracker(MarkerTrackerParameters(channel=channel)).process(
            Image(image, 'bgr8'), 0
        )
        for channel in ('auto', 'intensity', 'brightest')
    }
    assert detected(results['auto']) == detected(results['brightest']) == 5
    # As text: velocities are NaN, which equals nothing.
    assert repr(results['auto'].markers) == repr(results['intensity'].markers)
    assert repr(results['auto'].markers) != repr(results['brightest'].markers)


def test_the_channel_stays_when_markers_are_lost_and_is_forgotten_by_reset():
    tracker = MarkerTracker()
    tracker.process(Image(lights(RED), 'bgr8'), 0)
    dark = Image(np.zeros((480, 640, 3), np.uint8), 'bgr8')
    for frame in range(1, 40):
        assert detected(tracker.process(dark, frame * 33_000_000)) == 0
    # White lights are bright in every channel, red ones in the brightest alone.
    assert detected(tracker.process(Image(lights(RED), 'bgr8'), 41 * 33_000_000)) == 5
    tracker.reset()
    assert detected(tracker.process(Image(lights(WHITE), 'bgr8'), 0)) == 5


@pytest.mark.parametrize('prediction', ['kalman', 'acceleration_program'])
def test_grey_images_have_no_channel(prediction):
    gray = cv2.cvtColor(lights(WHITE), cv2.COLOR_BGR2GRAY)
    results = []
    for channel in ('auto', 'intensity', 'brightest', 'blue'):
        parameters = MarkerTrackerParameters(channel=channel, prediction=prediction)
        tracker = MarkerTracker(parameters)
        results.append(
            [repr(tracker.process(Image(gray, 'mono8'), i * 33_000_000)) for i in range(6)]
        )
    assert results.count(results[0]) == len(results)


@pytest.mark.parametrize('mode', MODES)
def test_where_all_is_too_dark_the_status_says_so(mode):
    """As of a camera of 12 bits, whose images do not use the upper four of 16."""
    lights = np.zeros((240, 320), np.uint16)
    for x, y in ((40, 120), (120, 90), (160, 60), (200, 90), (280, 120)):
        cv2.circle(lights, (x, y), 4, 4095, -1)
    tracker = MarkerTracker(MarkerTrackerParameters(mode=mode))
    words = '; no pixel is above the threshold; the brightest is 0.062'
    assert tracker.process(lights, 0).status.endswith(words)
    assert 'threshold' not in tracker.process(16 * lights, 33_000_000).status


def test_what_is_not_looked_at_makes_no_dark_frame_bright():
    """Opacity, and colours beside the channel in use."""
    black = np.zeros((240, 320, 4), np.uint8)
    black[..., 3] = 255
    green = np.zeros((240, 320, 3), np.uint8)
    green[..., 1] = 255
    for image, channel in ((Image(black, 'bgra8'), 'intensity'), (Image(green, 'bgr8'), 'red')):
        tracker = MarkerTracker(MarkerTrackerParameters(channel=channel))
        assert tracker.process(image, 0).status.endswith('the brightest is 0')


@pytest.mark.parametrize('mode', MODES)
@pytest.mark.parametrize('handed_over', [copy.deepcopy, lambda t: pickle.loads(pickle.dumps(t))])
def test_a_tracker_that_is_handed_to_another_process_goes_on_as_it_would_have(mode, handed_over):
    tracker = MarkerTracker(MarkerTrackerParameters(mode=mode))
    for frame in range(8):
        tracker.process(Image(lights(WHITE, 2 * frame), 'bgr8'), frame * 33_000_000)
    other = handed_over(tracker)
    for frame in range(8, 12):
        image, stamp_ns = Image(lights(WHITE, 2 * frame), 'bgr8'), frame * 33_000_000
        assert repr(other.process(image, stamp_ns)) == repr(tracker.process(image, stamp_ns))
