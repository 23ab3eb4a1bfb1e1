"""Holds mode approach against all kinds of footage at once: one row for each flight or clip.

Not part of the package: it needs the footage, which is not given away. The simulated flights need
none.

    python tools/evaluate_approach.py ../shared/footage [--only NAME] [--step 2] [--json FILE]
"""

from __future__ import annotations

import argparse
import csv
import json
import math
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.offline.evaluation.corners import (
    WARM_UP,
    LabelledFrame,
    Tolerance,
    read_corners,
    read_horizon,
    score_frame,
)
from mvuav_ros.parameters.runway_detector import RunwayDetectorParameters
from mvuav_ros.simulation.runway import RunwayFlight
from mvuav_ros.simulation.settings import RunwaySettings
from mvuav_ros.vision.approach.attitude import HorizonLine
from mvuav_ros.vision.approach.detector import ApproachDetector
from mvuav_ros.vision.approach.finders import RunwayFinder
from mvuav_ros.vision.approach.results import ApproachResult
from mvuav_ros.vision.approach.runway.probability import Report
from mvuav_ros.vision.camera import CameraModel

Pixels = NDArray[Any]
RUNS = {
    'approach_run2': Tolerance(),
    'approach_run3': Tolerance(),
    'approach_run5': Tolerance(4.0, 0.08),
}
CLIPS = {
    'road/udacity_solidWhiteRight.mp4': (0, 221),
    'road/straight_rural_road_720p50.mp4': (0, 1295),
    'road/forest_road_white_edges.mp4': (0, 1231),
    'runway/uav_a4_over_threshold_640x480.mp4': (0, 1001),
}
UAV_RUNWAY = range(200, 451)
"""Frames of the UAV clip in which its runway may be seen."""
FLIGHTS: dict[str, dict[str, Any]] = {
    'approach': {},
    'from the right': {'seed': 3, 'lateral_offset': -12.0},
    'low pass': {'seed': 5, 'motion': 'low_pass'},
    'from afar': {'seed': 9, 'start_distance': 900.0, 'camera_pitch_deg': 5.0},
}
FLIGHT_FRAMES = 275
STILL_FRAMES = 30
MIN_CONFIDENCE = 0.5
OVERLAP = 0.3


@dataclass
class Frame:
    """One judged frame: what was reported, with which error."""

    name: str
    confidence: float
    reported: bool
    error: float
    corners: list[tuple[float, float]] | None = None
    report: Report | None = None


@dataclass
class Row:
    """One flight, clip or set of stills."""

    name: str
    frames: list[Frame] = field(default_factory=list)
    warm_up: int = WARM_UP
    first_ms: float = 0.0
    later_ms: float = 0.0

    def line(self) -> str:
        """Shares of the counted frames, the first report, and milliseconds of CPU."""
        counted = self.frames[self.warm_up :]
        count = max(len(counted), 1)
        reported = sum(frame.reported for frame in counted)
        right = sum(frame.reported and frame.error <= 1.0 for frame in counted)
        first = next((n for n, frame in enumerate(self.frames, 1) if frame.reported), None)
        return (
            f'{self.name:42s} {len(counted):5d} {100 * reported / count:6.1f} '
            f'{100 * right / count:6.1f} {100 * (reported - right) / count:6.1f} '
            f'{first or "-":>6} {self.first_ms:7.0f} {self.later_ms:6.1f}'
        )


HEADER = (
    f'{"":42s} {"count":>5} {"report":>6} {"right":>6} {"wrong":>6} {"first":>6} {"ms 1st":>7} ms'
)


class Timed:
    """A detector whose CPU time is counted."""

    def __init__(self, width: float = 0.0) -> None:
        # Everything is reported, so that it is known how wrong the doubtful is.
        parameters = RunwayDetectorParameters(
            mode='approach', runway_width=width, min_confidence=0.0
        )
        self.detector = ApproachDetector(parameters)
        self.spent: list[float] = []

    def process(self, image: Pixels, horizon: HorizonLine | None = None) -> ApproachResult:
        """The next frame, at 25 frames/s."""
        begin = time.process_time()
        result = self.detector.process(image, len(self.spent) * 40_000_000, horizon)
        self.spent.append(1e3 * (time.process_time() - begin))
        return result

    def put(self, row: Row) -> Row:
        """The times into a row."""
        row.first_ms = self.spent[0] if self.spent else 0.0
        row.later_ms = float(np.mean(self.spent[1:])) if len(self.spent) > 1 else 0.0
        return row


def judged(name: str, detector: Timed, result: ApproachResult, error: float) -> Frame:
    """A frame of a row; reported is what has a confidence of `MIN_CONFIDENCE`."""
    corners = None if result.corners is None else [(float(x), float(y)) for x, y in result.corners]
    reported = corners is not None and result.confidence >= MIN_CONFIDENCE
    finder = detector.detector._finder
    report = finder.report if isinstance(finder, RunwayFinder) else None
    return Frame(name, float(result.confidence), reported, min(error, 1e6), corners, report)


def run_rows(footage: Path, part: slice) -> Iterator[tuple[str, Callable[[], Row]]]:
    """The labelled flights, in colour and grey, with and without a horizon."""
    for run, allowed in RUNS.items():
        for gray in (True,) if run == 'approach_run5' else (False, True):
            for horizon in (True, False):
                kind = ('grey' if gray else 'colour') + (' horizon' if horizon else ' image')
                name = f'{run[-4:]} {kind}'
                make = partial(
                    labelled_run,
                    name,
                    footage / 'runway' / run,
                    allowed,
                    gray=gray,
                    horizon=horizon,
                    part=part,
                )
                yield name, make


def labelled_run(
    name: str, folder: Path, allowed: Tolerance, *, gray: bool, horizon: bool, part: slice
) -> Row:
    """A run with corners labelled by hand."""
    labels: list[LabelledFrame] = read_corners(folder / 'corners.csv')
    lines = read_horizon(folder / 'horizon.csv', labels) if horizon else [None] * len(labels)
    row, detector = Row(name), Timed()
    for label, line in list(zip(labels, lines, strict=True))[part]:
        flag = cv2.IMREAD_GRAYSCALE if gray else cv2.IMREAD_COLOR
        result = detector.process(cv2.imread(str(folder / label.file), flag), line)
        score = score_frame(label, result.lines, allowed)
        row.frames.append(judged(label.file, detector, result, score.error))
    return detector.put(row)


def clip(path: Path, gray: bool, step: int) -> Row:
    """A clip without a runway; every report is wrong, except of the UAV's runway."""
    uav = 'uav' in path.name
    row = Row(f'{path.stem[:24]} {"grey" if gray else "colour"}', warm_up=0)
    detector = Timed()
    video = cv2.VideoCapture(str(path))
    first, last = CLIPS[f'{path.parent.name}/{path.name}']
    for index in range(last):
        grabbed, image = video.read()
        if not grabbed:
            break
        if index < first or index % step:
            continue
        if gray:
            image = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
        error = 0.0 if uav and index in UAV_RUNWAY else math.inf
        result = detector.process(image)
        row.frames.append(judged(str(index), detector, result, error))
    return detector.put(row)


def stills(folder: Path, check: bool, frames: int) -> list[Row]:
    """Stills of one half of the videos, each shown several times; near and far group apart."""
    boxes: dict[str, list[list[float]]] = {}
    with (folder / 'boxes.csv').open(newline='') as file:
        for line in csv.DictReader(file):
            box = [float(line[key]) for key in ('x_min', 'y_min', 'x_max', 'y_max')]
            boxes.setdefault(line['file'], []).append(box)
    half = 'check' if check else 'tuning'
    rows = {group: Row(f'stills {half} {group}', warm_up=0) for group in ('far', 'near')}
    for name in sorted(boxes):
        if bool(int(name.split('-')[1]) // 2 % 2) != check:
            continue
        image, detector = cv2.imread(str(folder / name)), Timed()
        result = [detector.process(image) for _ in range(frames)][-1]
        best = 0.0
        if result.corners is not None:
            points = np.array(result.corners)
            best = max(overlap(points, box) for box in boxes[name])
        row = rows['near' if name.startswith('1') else 'far']
        row.frames.append(judged(name, detector, result, OVERLAP / max(best, 1e-3)))
        row.first_ms += detector.spent[0]
        row.later_ms += float(np.mean(detector.spent[1:])) if frames > 1 else 0.0
    for row in rows.values():
        row.first_ms /= max(len(row.frames), 1)
        row.later_ms /= max(len(row.frames), 1)
    return list(rows.values())


def overlap(corners: NDArray[np.float64], box: list[float]) -> float:
    """Intersection over union of the corners' bounding box and another one."""
    first, last = corners.min(axis=0), corners.max(axis=0)
    inner = np.maximum(np.minimum(last, box[2:]) - np.maximum(first, box[:2]), 0)
    shared = float(np.prod(inner))
    area = (box[2] - box[0]) * (box[3] - box[1])
    return shared / (float(np.prod(last - first)) + area - shared)


def simulated(name: str, step: int, cache: Path | None) -> Row:
    """A simulated flight down to 20 m before the runway; within 3 px of the true ends."""
    flight = RunwayFlight(RunwaySettings(frames=1000, **FLIGHTS[name]))
    settings = flight.settings
    row, detector = Row(f'simulated {name}'), Timed(settings.runway_width)
    camera = flight.camera
    detector.detector.set_camera(
        CameraModel(camera.width, camera.height, tuple(camera.matrix.ravel()))
    )
    last = int((settings.start_distance - 20) / settings.speed * settings.fps)
    errors = []
    for index in range(last - FLIGHT_FRAMES, last, step):
        truth = flight.truth_at(flight.seen_at(index))
        result = detector.process(drawn(flight, name, index, cache))
        worst = 0.0
        for line in result.lines[:2]:
            true = truth.lines[line.role - 1]
            for x, y in ((true.x1, true.y1), (true.x2, true.y2)):
                away = abs(x * math.cos(line.theta) + y * math.sin(line.theta) - line.rho)
                worst = max(worst, away / 3.0 if line.found else math.inf)
        row.frames.append(judged(str(index), detector, result, worst))
        guidance = result.guidance
        if guidance is not None and guidance.known:
            pose = truth.pose
            errors.append(
                (
                    100 * (guidance.z / pose.position[2] - 1),
                    guidance.y - pose.position[1],
                    math.degrees(guidance.yaw - pose.yaw),
                    math.dist(result.vanishing_point, truth.vanishing_point),
                )
            )
    if errors:
        height, aside, yaw, place = np.sqrt((np.array(errors) ** 2).mean(axis=0))
        row.name += f' z{height:.1f}% y{aside:.2f} {yaw:.2f}° vp{place:.1f}'
    return detector.put(row)


def drawn(flight: RunwayFlight, name: str, index: int, cache: Path | None) -> Pixels:
    """A frame of a simulated flight, kept as PNG where that was asked for."""
    if cache is None:
        return flight.frame(index).image.pixels
    path = cache / name.replace(' ', '_') / f'{index}.png'
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(path), flight.frame(index).image.pixels)
    return cv2.imread(str(path))


def jobs(options: argparse.Namespace) -> Iterator[tuple[str, Callable[[], list[Row]]]]:
    """All rows by name."""
    footage, step = options.footage, options.step
    part = slice(options.start, options.stop, step)
    for name, make in run_rows(footage, part):
        yield name, lambda make=make: [make()]
    for path in CLIPS:
        for gray in (False, True):
            name = f'{Path(path).stem} {"grey" if gray else "colour"}'
            yield name, lambda path=path, gray=gray: [clip(footage / path, gray, options.clip_step)]
    folder = footage / 'runway' / 'cockpit_stills'
    for check in (False, True):
        name = f'stills {"check" if check else "tuning"}'
        yield name, lambda check=check: stills(folder, check, options.still_frames)
    for name in FLIGHTS:
        yield f'simulated {name}', lambda name=name: [simulated(name, step, options.cache)]


def main() -> None:
    """Print the table, and write every frame where that was asked for."""
    parser = argparse.ArgumentParser()
    parser.add_argument('footage', type=Path)
    parser.add_argument('--only', nargs='*', default=[''], help='parts of names')
    parser.add_argument('--step', type=int, default=1, help='of the flights')
    parser.add_argument('--start', type=int, help='first frame of the flights')
    parser.add_argument('--stop', type=int, help='frame after the last one')
    parser.add_argument('--clip-step', type=int, default=1, help='of the clips')
    parser.add_argument('--still-frames', type=int, default=STILL_FRAMES)
    parser.add_argument('--cache', type=Path, help='for simulated frames')
    parser.add_argument('--json', type=Path, help='for every frame')
    options = parser.parse_args()
    cv2.setNumThreads(1)
    print(HEADER, flush=True)
    rows = []
    for name, make in jobs(options):
        if any(part in name for part in options.only):
            for row in make():
                rows.append(row)
                print(row.line(), flush=True)
    if options.json is not None:
        options.json.write_text(json.dumps([asdict(row) for row in rows]))


if __name__ == '__main__':
    main()
