"""Marker detection and tracking beside bare OpenCV, and the worst frames."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.cli.bench.case import Action, Case
from mvuav_ros.parameters.marker_tracker import MODES, MarkerTrackerParameters
from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.frames import OPTICAL_FROM_BODY
from mvuav_ros.vision.image import Image
from mvuav_ros.vision.markers.results import MarkerResult, MarkerState, Window
from mvuav_ros.vision.markers.tracker import MarkerTracker
from mvuav_ros.vision.pose import PoseEstimator
from mvuav_ros.vision.rig import TANKER_747

LIMIT = 0.7 * 255
# Left wing, left stabilizer, rudder, right stabilizer, right wing; px from the tanker's centre.
PLACES = np.array([(-150, 0), (-60, -20), (0, -60), (60, -20), (150, 0)])
NO_TANKER = np.array([(100, 100), (200, 150), (320, 300), (400, 120), (520, 330)], float)
FRAMES = 60


def marker_cases() -> list[Case]:
    """Full frames, tracked frames, and frames without markers that must not stall the stream."""
    return [*_usual_cases(), *_worst_cases(), *_crowded_cases()]


def _usual_cases() -> list[Case]:
    frame = _flight(640, 480)[0]
    tracked, windows = _tracked_frame(640, 480)
    kalman, _ = _tracked_frame(640, 480, prediction='kalman')
    larger, _ = _tracked_frame(1920, 1080)

    def beside_tracking(
        name: str, run: Action, baseline: str, ratio: float | None, ms: float | None = None
    ) -> Case:
        return Case(name, run, baseline, _tracked_frame(640, 480)[0], ratio, ms)

    thesis = "track, the thesis's way"
    return [
        Case(
            'detect, 640x480 mono8, whole frame',
            _whole_frame('detect', frame),
            'threshold + findNonZero',
            lambda: cv2.findNonZero(cv2.threshold(frame, LIMIT, 255, cv2.THRESH_BINARY)[1]),
            limit_ratio=3.0,
            note='thesis: 85 ms',
        ),
        beside_tracking('track with the names kept (kalman), 640x480 mono8', kalman, thesis, 2.0),
        beside_tracking('the same and the pose, 640x480 mono8', _posed_frame(), thesis, None, 0.5),
        Case(
            'track, 640x480 mono8, five windows',
            tracked,
            '5 x threshold + moments',
            _bare_windows(frame, windows),
            limit_ratio=3.0,
            note='thesis: 30 ms',
        ),
        beside_tracking('track, 1920x1080 mono8, five windows', larger, 'the same at 640x480', 1.2),
    ]


def _worst_cases() -> list[Case]:
    noise = np.random.default_rng(0).random((1080, 1920))
    worst = {
        'all white': np.full((1080, 1920), 255, np.uint8),
        'half salt and pepper': _specks(noise < 0.5),
        '4 % salt and pepper': _specks(noise < 0.04),
        '0.1 % salt and pepper': _specks(noise < 0.001),
    }
    return [
        Case(f'{mode}, 1920x1080, {name}', _whole_frame(mode, image), limit_ms=50.0)
        for name, image in worst.items()
        for mode in ('detect', 'detect_any', 'track')
    ]


def _crowded_cases() -> list[Case]:
    """Streams of 640x480 in which there is more, or something else, than the five markers."""
    noise = np.random.default_rng(1)
    scenes = {
        '5 lights that are no tanker': _stream(NO_TANKER),
        **{f'{count} lights': _stream(_scattered(count)) for count in (12, 100, 300)},
        '4 % salt and pepper': [_specks(noise.random((480, 640)) < 0.04) for _ in range(10)],
    }
    return [
        Case(f'{mode}, 640x480, {name}', _followed(mode, frames), limit_ms=5.0)
        for name, frames in scenes.items()
        for mode in MODES
    ]


def _scattered(count: int) -> NDArray[np.float64]:
    """Places on a grid, each moved a little, (count, 2) px."""
    rows = math.ceil(math.sqrt(0.75 * count))
    columns = math.ceil(count / rows)
    step = 600 / columns, 440 / rows
    number = np.arange(count)
    grid = np.stack((number % columns, number // columns), axis=-1) * step
    shift = np.random.default_rng(count).uniform(-0.2, 0.2, (count, 2)) * step
    return np.asarray(grid + shift + (25.0, 25.0))


def _stream(places: NDArray[np.float64]) -> list[NDArray[np.uint8]]:
    """Lights on a small circle; the last frame joins the first."""
    return [_lights(640, 480, places + offset, 3) for offset in _circle(6)]


def _followed(
    mode: str, frames: list[NDArray[np.uint8]], prediction: str = 'kalman'
) -> Callable[[], MarkerResult]:
    """A call that processes the next frame, again and again."""
    tracker = MarkerTracker(MarkerTrackerParameters(mode=mode, prediction=prediction))
    endless, stamps = itertools.cycle(frames), itertools.count(0, 33_333_333)
    return lambda: tracker.process(Image(next(endless), 'mono8'), next(stamps))


def _specks(bright: NDArray[np.bool_]) -> NDArray[np.uint8]:
    return np.where(bright, 255, 0).astype(np.uint8)


def _flight(width: int, height: int) -> list[NDArray[np.uint8]]:
    """A tanker on a small circle; the last frame joins the first."""
    centre = (width / 2, height / 2)
    return [_lights(width, height, PLACES + centre + offset) for offset in _circle(20)]


def _circle(radius: float) -> NDArray[np.float64]:
    """(`FRAMES`, 2) px."""
    angles = np.arange(FRAMES) * 2 * np.pi / FRAMES
    return np.asarray(radius * np.stack((np.cos(angles), np.sin(angles)), axis=-1))


def _lights(
    width: int, height: int, places: NDArray[np.float64], radius: int = 4
) -> NDArray[np.uint8]:
    image = np.full((height, width), 40, np.uint8)
    for x, y in places:
        cv2.circle(image, (round(x * 16), round(y * 16)), radius * 16, 255, -1, cv2.LINE_8, 4)
    return image


def _whole_frame(mode: str, image: NDArray[np.uint8]) -> Action:
    parameters = MarkerTrackerParameters(mode=mode)
    return lambda: MarkerTracker(parameters).process(Image(image, 'mono8'), 0)


def _tracked_frame(
    width: int, height: int, prediction: str = 'acceleration'
) -> tuple[Action, tuple[Window, ...]]:
    """A call that tracks the next frame, and the windows of the one that came first."""
    run = _followed('track', _flight(width, height), prediction)
    for _ in range(4):
        run()
    result = run()
    assert all(marker.state is MarkerState.DETECTED for marker in result.markers)
    return run, result.windows


def _posed_frame() -> Action:
    """A call that tracks the tanker of the built-in rig and estimates its pose."""
    camera = CameraModel(640, 480, (554.0, 0.0, 319.5, 0.0, 554.0, 239.5, 0.0, 0.0, 1.0))
    tracker, poses = MarkerTracker(), PoseEstimator(TANKER_747)
    behind = TANKER_747.positions @ OPTICAL_FROM_BODY.T + (0.0, 5.0, 100.0)
    frames = []
    for x, y in _circle(4.0):
        points = np.add(behind, (x, y, 0.0))
        places = (points @ camera.matrix.T)[:, :2] / points[:, 2:]
        frames.append(Image(_lights(640, 480, places), 'mono8'))
    endless, stamps = itertools.cycle(frames), itertools.count(0, 33_333_333)

    def run() -> object:
        stamp_ns = next(stamps)
        markers = tracker.process(next(endless), stamp_ns).markers
        pixels = np.array([(marker.x, marker.y) for marker in markers])
        return poses.estimate(camera, range(len(markers)), pixels, stamp_ns)

    for _ in range(4):
        assert run() is not None
    return run


def _bare_windows(image: NDArray[np.uint8], windows: tuple[Window, ...]) -> Action:
    def run() -> None:
        for x0, x1, y0, y1 in windows:
            window = image[y0 : y1 + 1, x0 : x1 + 1]
            cv2.moments(cv2.threshold(window, LIMIT, 255, cv2.THRESH_BINARY)[1])

    return run
