"""Real footage: every frame gives its rows and its images, whatever is on it."""

import math

import cv2
import pytest

from mvuav_ros.parameters.runway_detector import RunwayDetectorParameters
from mvuav_ros.vision.runway.debug_images import draw_hough, draw_overlay
from mvuav_ros.vision.runway.detector import RunwayDetector

CLIPS = {
    'runway/approach_run1': 101,
    'runway/approach_run3': 501,
    'runway/uav_a4_over_threshold_640x480.mp4': 1001,
    'road/udacity_solidWhiteRight.mp4': 221,
    'road/forest_road_white_edges.mp4': 1231,
}


def frames_of(path):
    if path.is_dir():
        for name in sorted(path.glob('*.jpg')):
            yield cv2.imread(str(name))
        return
    video = cv2.VideoCapture(str(path))
    while True:
        grabbed, frame = video.read()
        if not grabbed:
            return
        yield frame


@pytest.mark.parametrize('clip', CLIPS)
def test_footage_runs_clean_to_the_end(footage, clip):
    pipeline = RunwayDetector(RunwayDetectorParameters())
    for number, frame in enumerate(frames_of(footage / clip)):
        result = pipeline.process(frame, number)
        assert len(result.lines) == 3
        for line in result.lines:
            numbers = (line.rho, line.theta, line.votes, line.rho_raw, line.theta_raw)
            assert all(math.isnan(value) != line.found for value in numbers)
        if number % 50 == 0:
            assert draw_overlay(result).shape == frame.shape
            assert draw_hough(result).any()
    assert number + 1 == CLIPS[clip]
