"""Real scenes without a tanker: none must be reported."""

import cv2
import numpy as np
import pytest

from mvuav_ros.parameters.marker_tracker import MarkerTrackerParameters
from mvuav_ros.vision.image import Image
from mvuav_ros.vision.markers.marker_results import MarkerState
from mvuav_ros.vision.markers.tracker import MarkerTracker

STILLS = (
    'CargoStraightDark24in.jpg',
    'LoadingStraightDark36in.jpg',
    'dride_outdoor_night_floodlights.png',
)
VIDEOS = (
    'road/udacity_solidWhiteRight.mp4',
    'road/forest_road_white_edges.mp4',
    'runway/uav_a4_over_threshold_640x480.mp4',
)


def reports(result):
    return any(marker.state is not MarkerState.LOST for marker in result.markers)


@pytest.mark.parametrize('threshold', [0.5, 0.7, 0.9])
@pytest.mark.parametrize('name', STILLS)
def test_no_tanker_among_distractors(footage, name, threshold):
    image = cv2.imread(str(footage / 'led' / 'distractors' / name))
    pipeline = MarkerTracker(MarkerTrackerParameters(threshold=threshold))
    for index in range(6):
        result = pipeline.process(Image(image, 'bgr8'), index * 33_000_000)
        assert not reports(result)
        assert result.status


@pytest.mark.parametrize('name', VIDEOS)
def test_no_tanker_in_videos(footage, name):
    capture = cv2.VideoCapture(str(footage / name))
    pipeline = MarkerTracker()
    index = 0
    while True:
        grabbed, image = capture.read()
        if not grabbed:
            break
        result = pipeline.process(Image(image, 'bgr8'), index * 33_000_000)
        assert not reports(result), index
        index += 1
    assert index > 200


@pytest.mark.parametrize(
    ('video', 'fps', 'count', 'frames'),
    [
        ('ir3_stereo_left_640x480_50fps.avi', 50, 3, 2509),
        ('ir5_fisheye_752x480.avi', 20, 5, 402),
    ],
)
def test_real_leds_keep_their_numbers_throughout(footage, video, fps, count, frames):
    capture = cv2.VideoCapture(str(footage / 'led' / video))
    pipeline = MarkerTracker(MarkerTrackerParameters(mode='track_any'))
    before = {}
    for index in range(frames):
        grabbed, image = capture.read()
        assert grabbed
        result = pipeline.process(Image(image, 'bgr8'), index * 1_000_000_000 // fps)
        assert sorted(result.ids) == list(range(1, count + 1)), index
        now = {i: (m.x, m.y) for i, m in zip(result.ids, result.markers, strict=True)}
        detected = all(m.state is MarkerState.DETECTED for m in result.markers)
        if detected and before:
            # A switch would be a jump to where another light was.
            for number, place in now.items():
                distances = {i: np.hypot(*np.subtract(place, p)) for i, p in before.items()}
                assert min(distances, key=distances.get) == number, index
        before = now if detected else {}
