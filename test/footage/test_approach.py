"""Real approaches and roads: what is found, and what is not made up."""

from itertools import islice

import cv2
import numpy as np
import pytest

from mvuav_ros.offline.evaluation.corners import (
    LabelledRun,
    Tolerance,
    read_corners,
    read_horizon,
    run_detector,
)
from mvuav_ros.parameters.runway_detector import RunwayDetectorParameters
from mvuav_ros.vision.approach.approach_detector import ApproachDetector
from mvuav_ros.vision.runway.detector import RunwayDetector
from mvuav_ros.vision.runway.results import LineRole

APPROACH = RunwayDetectorParameters(mode='approach')
UAV = 'runway/uav_a4_over_threshold_640x480.mp4'
# The forest road goes on like that for 1,231 frames.
ROADS = {'road/udacity_solidWhiteRight.mp4': 221, 'road/forest_road_white_edges.mp4': 450}


def frames_of(path):
    video = cv2.VideoCapture(str(path))
    while True:
        grabbed, frame = video.read()
        if not grabbed:
            return
        yield frame


def results(path, parameters, most=None):
    pipeline = ApproachDetector(parameters)
    frames = islice(frames_of(path), most)
    return [pipeline.process(frame, index) for index, frame in enumerate(frames)]


def reported(path, parameters, most=None):
    return np.array([result.corners is not None for result in results(path, parameters, most)])


def labelled(footage, run, *, horizon, gray=False, part=slice(None)):
    """A run, with the horizon as attitude would give it or without."""
    labels = footage / 'runway' / run / 'corners.csv'
    frames = read_corners(labels)[part]
    lines = read_horizon(labels.parent / 'horizon.csv', frames) if horizon else None
    allowed = Tolerance(4.0, 0.08) if run == 'approach_run5' else Tolerance()
    return LabelledRun(labels.parent, frames, APPROACH, lines, gray, allowed)


def judged(*arguments, **options):
    return run_detector(labelled(*arguments, **options), lambda: None)


def test_the_flight_it_was_tuned_on(footage):
    score = judged(footage, 'approach_run1', horizon=True)
    assert score.shares['both_found'] >= 0.90
    assert score.shares['wrong'] <= 0.02
    assert score.first_report <= 25


@pytest.mark.parametrize(
    ('horizon', 'gray'),
    [(True, False), (True, True), (False, False), (False, True)],
)
def test_a_flight_that_nothing_was_tuned_on(footage, horizon, gray):
    """Dusk, in colour and turned grey."""
    score = judged(footage, 'approach_run2', horizon=horizon, gray=gray)
    assert score.shares['both_found'] >= (0.80 if horizon else 0.60)
    assert score.shares['wrong'] <= 0.02
    assert score.first_report <= 25


@pytest.mark.parametrize(('horizon', 'least'), [(True, 0.80), (False, 0.60)])
def test_a_grey_camera_at_another_airport(footage, horizon, least):
    score = judged(footage, 'approach_run5', horizon=horizon)
    assert score.shares['both_found'] >= least
    assert score.shares['wrong'] <= 0.02


@pytest.mark.parametrize('start', [60, 150, 240])
def test_a_flight_may_begin_anywhere(footage, start):
    """Nothing is known but what the first 24 frames showed."""
    part = slice(start, start + 60)
    assert judged(footage, 'approach_run3', horizon=False, part=part).shares['both_found'] >= 0.90


@pytest.mark.parametrize(
    'change',
    [
        pytest.param(lambda image: image[:, ::-1], id='mirrored'),
        pytest.param(lambda image: cv2.convertScaleAbs(image, alpha=0.5, beta=60), id='faint'),
        pytest.param(lambda image: cv2.convertScaleAbs(image, alpha=0.5), id='dark'),
    ],
)
def test_other_light_and_the_other_side(footage, change):
    """The runway still is reported in nine frames of ten, and where it is."""
    pipeline = ApproachDetector(APPROACH)
    labels = footage / 'runway' / 'approach_run3' / 'corners.csv'
    found = []
    for index, frame in enumerate(read_corners(labels)[100:250]):
        image = cv2.imread(str(labels.parent / frame.file))
        result = pipeline.process(np.ascontiguousarray(change(image)), index)
        middle = 0.5 * (frame.near_left[0] + frame.near_right[0])
        if change(image)[0, 0].tolist() == image[0, -1].tolist():
            middle = image.shape[1] - 1 - middle
        corners = result.corners
        found.append(
            corners is not None and abs(0.5 * (corners[0][0] + corners[1][0]) - middle) < 4
        )
    assert np.mean(found[25:]) >= 0.90


def test_no_runway_where_none_is(footage):
    seen = reported(footage / UAV, APPROACH)
    # The runway comes into view before frame 200 and leaves before 450.
    without = np.concatenate([seen[:200], seen[451:]])
    assert without.mean() <= 0.05


@pytest.mark.parametrize('road', ROADS)
def test_a_road_is_seldom_taken_for_a_runway(footage, road):
    assert reported(footage / road, APPROACH, ROADS[road]).mean() <= 0.01


@pytest.mark.parametrize('road', ROADS)
def test_road_edges_are_steady(footage, road):
    """Flags per line and frame: at most half of the thesis's scheme on the whole frame."""
    parameters = RunwayDetectorParameters(mode='approach', target='road')
    road_lines = [
        line
        for result in results(footage / road, parameters, ROADS[road])
        for line in result.lines
        if line.found and line.role in (LineRole.LEFT_EDGE, LineRole.RIGHT_EDGE)
    ]
    assert len(road_lines) > 2 * 0.8 * ROADS[road]
    thesis = RunwayDetector(RunwayDetectorParameters(start_row=0, end_row=0))
    thesis_lines = [
        line
        for index, frame in enumerate(islice(frames_of(footage / road), ROADS[road]))
        for line in thesis.process(frame, index).lines
        if line.found
    ]
    thesis_rate = np.mean([line.corrected for line in thesis_lines])
    assert np.mean([line.corrected for line in road_lines]) <= 0.5 * thesis_rate


def test_the_white_line_is_the_right_edge_of_the_lane(footage):
    """Its place at row 500 of 540, found by its own colour in the right half of the image."""
    road = footage / 'road/udacity_solidWhiteRight.mp4'
    pipeline = ApproachDetector(RunwayDetectorParameters(mode='approach', target='road'))
    errors = []
    for index, frame in enumerate(frames_of(road)):
        result = pipeline.process(frame, index)
        right = result.lines[LineRole.RIGHT_EDGE - 1]
        if index < 25 or not right.found:
            continue
        white = np.flatnonzero(frame[500, 480:].min(axis=1) > 200) + 480
        if white.size:
            column = (right.rho - 500 * np.sin(right.theta)) / np.cos(right.theta)
            errors.append(abs(column - white.mean()))
    assert len(errors) > 150
    assert np.percentile(errors, 90) < 15
