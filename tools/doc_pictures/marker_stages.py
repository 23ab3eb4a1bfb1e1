"""The marker pipeline on one frame, and what its parameters do."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from doc_pictures.style import image_row, save
from mvuav_ros import MarkerTracker
from mvuav_ros.parameters.marker_tracker import MarkerTrackerParameters
from mvuav_ros.sources.opening import make_flight
from mvuav_ros.vision.image import Image
from mvuav_ros.vision.markers.drawing import draw_markers, draw_pose
from mvuav_ros.vision.markers.lights import Blobs
from mvuav_ros.vision.markers.marker_results import MarkerResult
from mvuav_ros.vision.point_operations import threshold
from mvuav_ros.vision.pose import PoseEstimator

_FLIGHT = {'frames': 16, 'fps': 15, 'motion': 'roll_translation', 'background': 'sky', 'glares': 2}
_CROP = slice(0, 450)


def marker_pipeline(path: Path) -> None:
    """Frame, threshold, blobs, names, windows of the next frame, pose."""
    flight = make_flight('tanker', {**_FLIGHT, 'encoding': 'bgr8'})
    camera = flight.camera
    tracker = MarkerTracker()
    tracker.set_camera(camera)
    estimator = PoseEstimator(tracker.rig)
    results = [(frame.image, tracker.process(frame.image, frame.stamp_ns)) for frame in flight]
    image, result = results[-1]
    gray = cv2.cvtColor(image.bgr(), cv2.COLOR_BGR2GRAY)
    parameters = MarkerTrackerParameters()
    mask = threshold(gray, parameters.threshold)
    blobs = image.bgr().copy()
    for x, y, width, height, _ in Blobs(gray, parameters).stats.tolist():
        corners = (x - 5, y - 5), (x + width + 4, y + height + 4)
        cv2.rectangle(blobs, *corners, (0, 220, 255), 2)
    start, first = next(each for each in results if np.isfinite(each[1].roll))
    named = draw_markers(start, _without_windows(first))
    seen = [marker for marker in result.markers if marker.state.name == 'DETECTED']
    pixels = np.array([(marker.x, marker.y) for marker in seen])
    pose = estimator.estimate(camera, [int(m.label) for m in seen], pixels, 0)
    posed = draw_markers(image, _without_windows(result))
    if pose is not None:
        draw_pose(posed, pose, camera, tracker.rig)
    images = [image.bgr(), mask, blobs, named, draw_markers(image, result), posed]
    titles = [
        '1  frame (two reflections)',
        '2  above threshold',
        '3  blobs: gated by size, shape',
        '4  names: the rig fits five of seven',
        '5  later frames: search windows only',
        '6  pose: the axes of the body',
    ]
    save(image_row([each[_CROP] for each in images], titles), path)


def lamps(path: Path) -> None:
    """A body whose markers are dark for a time, and whose lamps are not."""
    # The flights that try the tracker, which are the tests'.
    sys.path.append(str(Path(__file__).resolve().parents[2] / 'test'))
    from support.marker_flights import SCENES, MarkerFlight, told

    flight = MarkerFlight(SCENES['lamps on the body'], 5)
    rig, camera = told(flight)
    tracker = MarkerTracker(rig=rig)
    tracker.set_camera(camera)
    drawn = []
    for stamp_ns, pixels, _ in flight:
        image = Image(pixels, 'mono8')
        drawn.append(draw_markers(image, tracker.process(image, stamp_ns)))
    crop = slice(90, 310), slice(130, 570)
    titles = ['five markers and five lamps', 'two seconds later: the markers are dark']
    save(image_row([drawn[number][crop] for number in (40, 100)], titles), path)


def marker_parameters(path: Path, name: str) -> None:
    """Too low, right, too high."""
    if name == 'threshold':
        _thresholds(path)
    else:
        _radii(path)


def _thresholds(path: Path) -> None:
    given = {**_FLIGHT, 'frames': 1, 'encoding': 'bgr8', 'glares': 0}
    dimmed = cv2.convertScaleAbs(next(iter(make_flight('tanker', given))).image.bgr(), alpha=0.62)
    gray = cv2.cvtColor(dimmed, cv2.COLOR_BGR2GRAY)
    images, titles = [dimmed[_CROP]], ['dim lights']
    for value, word in ((0.25, 'too low'), (0.45, 'right'), (0.605, 'too high')):
        mask = threshold(gray, value)
        count = cv2.connectedComponents(mask)[0] - 1
        images.append(mask[_CROP])
        area = int(np.count_nonzero(mask)) / max(count, 1)
        titles.append(f'threshold {value}: {word}, {count} blobs of {area:.0f} px')
    save(image_row(images, titles), path)


def _radii(path: Path) -> None:
    images, titles = [], []
    flight = list(
        make_flight('tanker', {**_FLIGHT, 'motion': 'erratic', 'frames': 24, 'glares': 0})
    )
    for radius, word in ((3, 'too small'), (12, 'right'), (45, 'too large')):
        parameters = MarkerTrackerParameters(search_radius=radius, prediction='none')
        tracker = MarkerTracker(parameters)
        found = []
        for frame in flight:
            result = tracker.process(frame.image, frame.stamp_ns)
            found.append(sum(marker.state.name == 'DETECTED' for marker in result.markers))
            if len(found) == 9:
                images.append(draw_markers(frame.image, result)[_CROP])
        titles.append(f'search_radius {radius}: {word}, {np.mean(found):.1f} of 5 found')
    save(image_row(images, titles), path)


def _without_windows(result: MarkerResult) -> MarkerResult:
    return replace(result, windows=())
