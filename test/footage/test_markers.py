"""Real scenes without a tanker: none must be reported."""

import cv2
import pytest

from mvuav_ros.parameters.marker_tracker import MarkerTrackerParameters
from mvuav_ros.vision.image import Image
from mvuav_ros.vision.markers.results import MarkerState
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
