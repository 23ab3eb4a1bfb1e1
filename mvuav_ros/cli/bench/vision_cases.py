"""Time per frame of detectors and simulator, beside what any implementation needs."""

from __future__ import annotations

import importlib
import importlib.util
import itertools
import math
from collections.abc import Callable, Iterable
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.cli.bench.case import Action, Case
from mvuav_ros.cli.bench.scenes import PLACES, circle, lights
from mvuav_ros.parameters.marker_tracker import MODES, MarkerTrackerParameters
from mvuav_ros.parameters.runway_detector import RunwayDetectorParameters
from mvuav_ros.simulation.flight import Flight
from mvuav_ros.simulation.runway_flight import RunwayFlight
from mvuav_ros.simulation.settings import RunwaySettings, TankerSettings
from mvuav_ros.simulation.tanker_flight import TankerFlight
from mvuav_ros.vision.approach.approach_detector import ApproachDetector
from mvuav_ros.vision.approach.evidence import shrink_levels
from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.frames import OPTICAL_FROM_BODY
from mvuav_ros.vision.image import Image
from mvuav_ros.vision.markers.marker_results import MarkerResult, MarkerState, Window
from mvuav_ros.vision.markers.tracker import MarkerTracker
from mvuav_ros.vision.pose import PoseEstimator
from mvuav_ros.vision.rig import TANKER_747
from mvuav_ros.vision.runway.detector import RunwayDetector
from mvuav_ros.vision.runway.edges import automatic_threshold

Frame = NDArray[np.uint8]
Baseline = Callable[[Frame, float], object]
"""Of a frame and the threshold of its edges."""
LIMIT = 0.7 * 255
NO_TANKER = np.array([(100, 100), (200, 150), (320, 300), (400, 120), (520, 330)], float)


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
            _followed('detect', [frame]),
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
        Case(f'{mode}, 1920x1080, {name}', _first_frame(mode, image), limit_ms=50.0)
        for name, image in worst.items()
        for mode in ('detect', 'detect_any', 'track')
    ]


def _crowded_cases() -> list[Case]:
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


def _stream(places: NDArray[np.float64]) -> list[Frame]:
    return [lights(640, 480, places + offset, 3) for offset in circle(6)]


def _followed(
    mode: str, frames: list[Frame], prediction: str = 'kalman'
) -> Callable[[], MarkerResult]:
    tracker = MarkerTracker(MarkerTrackerParameters(mode=mode, prediction=prediction))
    endless, stamps = itertools.cycle(frames), itertools.count(0, 33_333_333)
    return lambda: tracker.process(Image(next(endless), 'mono8'), next(stamps))


def _specks(bright: NDArray[np.bool_]) -> Frame:
    return np.where(bright, 255, 0).astype(np.uint8)


def _flight(width: int, height: int) -> list[Frame]:
    centre = (width / 2, height / 2)
    return [lights(width, height, PLACES + centre + offset) for offset in circle(20)]


def _first_frame(mode: str, image: Frame) -> Action:
    parameters = MarkerTrackerParameters(mode=mode)
    return lambda: MarkerTracker(parameters).process(Image(image, 'mono8'), 0)


def _tracked_frame(
    width: int, height: int, prediction: str = 'acceleration'
) -> tuple[Action, tuple[Window, ...]]:
    run = _followed('track', _flight(width, height), prediction)
    for _ in range(4):
        run()
    result = run()
    assert all(marker.state is MarkerState.DETECTED for marker in result.markers)
    return run, result.windows


def _posed_frame() -> Action:
    camera = CameraModel(640, 480, (554.0, 0.0, 319.5, 0.0, 554.0, 239.5, 0.0, 0.0, 1.0))
    tracker, poses = MarkerTracker(), PoseEstimator(TANKER_747)
    tracker.set_camera(camera)  # As the node does
    behind = TANKER_747.positions @ OPTICAL_FROM_BODY.T + (0.0, 5.0, 100.0)
    frames = []
    for x, y in circle(4.0):
        points = np.add(behind, (x, y, 0.0))
        places = (points @ camera.matrix.T)[:, :2] / points[:, 2:]
        frames.append(Image(lights(640, 480, places), 'mono8'))
    endless, stamps = itertools.cycle(frames), itertools.count(0, 33_333_333)

    def run() -> object:
        stamp_ns = next(stamps)
        markers = tracker.process(next(endless), stamp_ns).markers
        pixels = np.array([(marker.x, marker.y) for marker in markers])
        return poses.estimate(camera, range(len(markers)), pixels, stamp_ns)

    for _ in range(4):
        assert run() is not None
    return run


def _bare_windows(image: Frame, windows: tuple[Window, ...]) -> Action:
    def run() -> None:
        for x0, x1, y0, y1 in windows:
            window = image[y0 : y1 + 1, x0 : x1 + 1]
            cv2.moments(cv2.threshold(window, LIMIT, 255, cv2.THRESH_BINARY)[1])

    return run


_FRAMES = 8
_VERTICAL = np.ones((3, 1), np.uint8)
_KERNEL_SUM_AND_SCALE = 8 * 255


def runway_cases() -> list[Case]:
    """The cases of the runway scheme; those with scikit-image only where it is installed.

    Both sides take the same synthetic frames in turn, with the default resolutions and peaks. The
    baselines get the threshold and the confined channel for nothing, and they correct no lines.
    """
    slice_frames = [_runway(320, 240, seed) for seed in range(_FRAMES)]
    slices = [np.ascontiguousarray(frame[50:130, :, 2]) for frame in slice_frames]
    whole_frames = [_runway(1280, 720, seed) for seed in range(_FRAMES)]
    wholes = [np.ascontiguousarray(frame[:, :, 2]) for frame in whole_frames]
    whole = RunwayDetectorParameters(start_row=0, end_row=0)

    def in_rows(name: str, baseline: Baseline, limit: float) -> Case:
        ours = _in_turn(RunwayDetector().process, slice_frames, itertools.repeat(0))
        theirs = _in_turn(baseline, slices, map(automatic_threshold, slices))
        return Case('runway 320x240 rows 50-130', ours, name, theirs, limit)

    cases = [in_rows('OpenCV', _opencv, 1.5)]
    if importlib.util.find_spec('skimage') is not None:
        cases.append(in_rows('scikit-image', _scikit_image(), 0.2))
    ours = _in_turn(RunwayDetector(whole).process, whole_frames, itertools.repeat(0))
    theirs = _in_turn(_opencv, wholes, map(automatic_threshold, wholes))
    return [*cases, Case('runway 1280x720 whole frame', ours, 'OpenCV', theirs)]


def _in_turn(process: Callable[..., object], *given: Iterable[object]) -> Action:
    """Processes the next of each, and the first ones again after the last."""
    endless = itertools.cycle([*zip(*given, strict=False)])
    return lambda: process(*next(endless))


def _opencv(gray: Frame, threshold: float) -> object:
    x = cv2.Sobel(gray, cv2.CV_32F, 1, 0, borderType=cv2.BORDER_REPLICATE)
    y = cv2.Sobel(gray, cv2.CV_32F, 0, 1, borderType=cv2.BORDER_REPLICATE)
    limit = threshold * _KERNEL_SUM_AND_SCALE
    edges = (cv2.magnitude(x, y) > limit).view(np.uint8)
    opened = cv2.morphologyEx(edges, cv2.MORPH_OPEN, _VERTICAL)
    return cv2.HoughLines(opened, 2, np.pi / 180, 15)


def _scikit_image() -> Baseline:
    # Its functions have no types; as modules of unknown type they need none.
    filters, morphology, transform = (
        importlib.import_module(f'skimage.{name}')
        for name in ('filters', 'morphology', 'transform')
    )
    angles = np.deg2rad(np.arange(-90.0, 90.0))

    def process(gray: Frame, threshold: float) -> object:
        # Its kernels are divided by 4, and its magnitude is the root of both squares' mean.
        edges = filters.sobel(gray / 255) / math.sqrt(2) > threshold
        opened = morphology.opening(edges, _VERTICAL)
        votes, theta, rho = transform.hough_line(opened, angles)
        return transform.hough_line_peaks(votes, theta, rho, 5, 5, 15, 3)

    return process


def _runway(width: int, height: int, seed: int) -> Frame:
    random = np.random.default_rng(seed)
    scale = height / 240
    grass = random.integers(0, 40, (height // 4, width // 4, 3), dtype=np.uint8)
    texture = cv2.resize(grass, (width, height), interpolation=cv2.INTER_CUBIC)
    frame = np.array(texture, np.uint8) + np.array([30, 90, 40], np.uint8)
    horizon = round((35 + random.uniform(-3, 3)) * scale)
    frame[:horizon] = (220, 190, 170)
    apex = width / 2 + random.uniform(-6, 6) * scale, horizon - 10 * scale

    def strip(left: float, right: float, color: tuple[int, int, int]) -> None:
        corners = [apex, (width / 2 + left * scale, height), (width / 2 + right * scale, height)]
        points = np.round(np.array(corners) * 16).astype(np.int32)
        cv2.fillPoly(frame, [points], color, cv2.LINE_AA, 4)

    strip(-64, 64, (100, 100, 100))
    for left, right in ((-64, -56), (-4, 4), (56, 64)):
        strip(left, right, (225, 225, 225))
    # Nothing in the frame is brighter than 225: the sum stays within 8 bits.
    return frame + random.integers(0, 9, frame.shape, dtype=np.uint8)


_APPROACH_FRAMES, _APPROACH_RATES = 40, {(320, 240): 200, (1280, 720): 60}
"""Width and height, px, to frames per second."""
_SIMULATED_FRAMES, _SIMULATED_RATE = 100, 60


def approach_cases() -> list[Case]:
    """One case for each size with a limit; one OpenCV thread is the caller's to set."""
    return [_approach(width, height, rate) for (width, height), rate in _APPROACH_RATES.items()]


def _approach(width: int, height: int, rate: int) -> Case:
    detector = ApproachDetector(RunwayDetectorParameters(mode='approach'))
    flight = RunwayFlight(RunwaySettings(width=width, height=height, frames=_APPROACH_FRAMES))
    frames = [flight.frame(index).image.pixels for index in range(_APPROACH_FRAMES)]
    # There and back, so that nothing jumps.
    frames += reversed(frames)
    return Case(
        f'approach {width}x{height}',
        _in_turn(detector.process, frames, itertools.repeat(0)),
        'OpenCV lines',
        _in_turn(_opencv_lines, frames),
        limit_ms=1e3 / rate,
        note=f'at least {rate} frames/s',
    )


def _opencv_lines(frame: Frame) -> object:
    gray, _ = shrink_levels(cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY))
    edges = cv2.Canny(gray, 60, 150)
    return cv2.HoughLinesP(edges, 1, np.pi / 180, 40, minLineLength=20, maxLineGap=5)


def simulation_cases() -> list[Case]:
    """One case for each kind of flight; one OpenCV thread is the caller's to set."""
    size: dict[str, Any] = {'width': 640, 'height': 480, 'frames': _SIMULATED_FRAMES}
    docking = TankerSettings(motion='docking', encoding='bgr8', **size)
    flights: dict[str, Flight[Any]] = {
        'tanker, mono8': TankerFlight(TankerSettings(**size)),
        'docking, bgr8': TankerFlight(docking),
        'runway, bgr8': RunwayFlight(RunwaySettings(**size)),
    }
    limit: dict[str, Any] = {'limit_ms': 1e3 / _SIMULATED_RATE}
    limit['note'] = f'at least {_SIMULATED_RATE} frames/s'
    return [
        Case(f'simulated 640x480 {name}', _in_turn(flight.frame, range(_SIMULATED_FRAMES)), **limit)
        for name, flight in flights.items()
    ]
