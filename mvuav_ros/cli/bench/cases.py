"""What ``mvuav bench`` measures in one process, beside what any implementation needs."""

from __future__ import annotations

import importlib
import importlib.util
import itertools
import math
import os
import statistics
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from operator import truediv
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.cli.bench.scenes import PLACES, circle, lights, lights_above_runway
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

Action = Callable[[], object]


@dataclass(frozen=True)
class Case:
    """Something to measure, and what to hold it against; a run is usually one frame.

    The median time may be ``limit_ratio`` times the baseline's, and ``limit_ms``. A note is a
    figure from elsewhere, such as the thesis's own.
    """

    name: str
    run: Action
    baseline_name: str = ''
    baseline: Action | None = None
    limit_ratio: float | None = None
    limit_ms: float | None = None
    note: str = ''


class Measurement(NamedTuple):
    """Medians in ms; ``ratio`` is the median of the ratios pair by pair."""

    case: Case
    median_ms: float
    baseline_ms: float | None
    ratio: float | None

    @property
    def within_limits(self) -> bool:
        """Whether every limit of the case is kept."""
        limit_ratio, limit_ms = self.case.limit_ratio, self.case.limit_ms
        if limit_ratio is not None and (self.ratio is None or self.ratio > limit_ratio):
            return False
        return limit_ms is None or self.median_ms <= limit_ms

    def figures(self) -> dict[str, object]:
        """For a JSON file."""
        return {
            'case': self.case.name,
            'median_ms': self.median_ms,
            'baseline': self.case.baseline_name,
            'baseline_ms': self.baseline_ms,
            'ratio': self.ratio,
            'limit_ratio': self.case.limit_ratio,
            'limit_ms': self.case.limit_ms,
            'within_limits': self.within_limits,
        }


def measure(case: Case, seconds: float = 1.0, max_pairs: int = 3000) -> Measurement:
    """Run a case and its baseline in turn for about ``seconds``, at least five times."""
    for _ in range(3):
        case.run()
        if case.baseline is not None:
            case.baseline()
    end = time.perf_counter() + seconds
    times: list[float] = []
    baselines: list[float] = []
    while len(times) < 5 or (time.perf_counter() < end and len(times) < max_pairs):
        times.append(_time(case.run))
        if case.baseline is not None:
            baselines.append(_time(case.baseline))
    median_ms = statistics.median(times) * 1e3
    if not baselines:
        return Measurement(case, median_ms, None, None)
    ratio = statistics.median(map(truediv, times, baselines))
    return Measurement(case, median_ms, statistics.median(baselines) * 1e3, ratio)


def _time(action: Action) -> float:
    start = time.perf_counter()
    action()
    return time.perf_counter() - start


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


_RATE = 30
_TIMES_REAL_TIME = 15
_TWO_JOBS_GAIN = 1.6
_FLOOR_LIMIT = 1.6
_THRESHOLD = 128
_NODES = ('marker_tracker', 'runway_detector')


def replay_cases(frames: int = _RATE * 15) -> list[Case]:
    """Bags of raw 640x480 and of JPEG 1920x1080; no cases where ROS is not installed.

    Every replay runs in a process that is there already.
    """
    if importlib.util.find_spec('rclpy') is None:
        return []
    from mvuav_ros.offline.tasks import Worker

    folder = TemporaryDirectory(prefix='mvuav_bench_')
    worker = Worker(_replay)

    def replay(*task: object) -> object:
        # The folder lives as long as the cases do.
        assert folder.name
        worker.send(0, task)
        done: Any = worker.receive()
        if done.error is not None:
            raise done.error
        return done.result

    raw, jpeg = Path(folder.name) / 'raw.mcap', Path(folder.name) / 'jpeg.mcap'
    fewer = max(1, frames // 5)
    _write_bag(raw, frames, None)
    _write_bag(jpeg, fewer, (1920, 1080))
    return [
        *_cases_of(f'{frames} frames 640x480', partial(replay, raw), frames),
        *_cases_of(f'{fewer} frames JPEG 1920x1080', partial(replay, jpeg), fewer),
    ]


def _cases_of(name: str, replay: Callable[..., object], frames: int) -> list[Case]:
    cores = sorted(os.sched_getaffinity(0))
    one, floor = partial(replay, _NODES, cores[:1]), partial(replay, (), cores[:1])
    limit_ms = None if 'JPEG' in name else frames / _RATE / _TIMES_REAL_TIME * 1e3
    cases = [Case(f'replay {name}, both nodes, one core', one, limit_ms=limit_ms)]
    for node in _NODES:
        alone = partial(replay, (node,), cores[:1])
        beside = ('read, decode, threshold', floor, _FLOOR_LIMIT)
        cases.append(Case(f'replay {name}, {node}', alone, *beside))
    if len(cores) > 1:
        both = partial(replay, _NODES, cores[:2])
        limit, note = 1 / _TWO_JOBS_GAIN, f'{_TWO_JOBS_GAIN} times the frames/s at the limit'
        title = f'replay {name}, both nodes, --jobs 2'
        cases.append(Case(title, both, '--jobs 1', one, limit, note=note))
    return cases


def _replay(task: tuple[Path, tuple[str, ...], list[int]], _report: object, stop: Any) -> int:
    """Replay a bag with nodes, a thread for each of some cores; without nodes it is the floor."""
    from mvuav_ros.offline.replay.job import ReplayJob, ReplaySettings, attempt

    bag, nodes, cores = task
    os.sched_setaffinity(0, cores)
    if not nodes:
        return _floor(bag)
    settings = ReplaySettings({node: {} for node in nodes})
    job = ReplayJob(str(bag), str(bag.with_suffix('.results.mcap')), settings, True)
    outcome = attempt(job, lambda _: None, stop, len(cores))
    assert outcome.processed == outcome.frames, outcome
    return outcome.processed


def _floor(bag: Path) -> int:
    """What any implementation needs: every frame read, decoded and compared with a threshold."""
    from mvuav_ros.sources.bag import BagImages

    count = 0
    source = BagImages(bag)
    for frame in source.frames():
        cv2.threshold(frame.image.gray(), _THRESHOLD, 255, cv2.THRESH_BINARY)  # type: ignore[union-attr]
        count += 1
    source.close()
    return count


def _write_bag(path: Path, frames: int, jpeg_size: tuple[int, int] | None) -> None:
    from mvuav_ros.messages.cdr import cdr_header
    from mvuav_ros.messages.images import COMPRESSED_IMAGE, IMAGE, serialize_image, serialize_jpeg
    from mvuav_ros.recordings.writing import RecordingWriter

    random = np.random.default_rng(0)
    with RecordingWriter(path) as writer:
        for index in range(frames):
            stamp_ns = 1_700_000_000_000_000_000 + round(index * 1e9 / _RATE)
            header = cdr_header(stamp_ns, 'camera')
            noise = random.integers(0, 9, (480, 640), dtype=np.uint8)
            scene = np.asarray(cv2.add(lights_above_runway(640, 480, index), noise), np.uint8)
            if jpeg_size is None:
                message = serialize_image(Image(scene, 'mono8'), header)
                writer.write('/image_raw', IMAGE, stamp_ns, message)
                continue
            colour = cv2.cvtColor(cv2.resize(scene, jpeg_size), cv2.COLOR_GRAY2BGR)
            message = serialize_jpeg(Image(np.asarray(colour, np.uint8), 'bgr8'), header)
            writer.write('/image_raw/compressed', COMPRESSED_IMAGE, stamp_ns, message)
