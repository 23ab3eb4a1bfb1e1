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
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from approach_flights import BANKS, FLIGHTS, simulated
from approach_rows import HEADER, Row, Timed, judged
from approach_variants import PLAIN, VARIANTS, Variant
from numpy.typing import NDArray

from mvuav_ros.offline.evaluation.corners import (
    LabelledFrame,
    Tolerance,
    read_corners,
    read_horizon,
    score_frame,
)

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
STILL_FRAMES = 30
OVERLAP = 0.3


def run_rows(
    footage: Path, part: slice, variants: Sequence[Variant]
) -> Iterator[tuple[str, Callable[[], Row]]]:
    """The labelled flights, in colour and grey, with and without a horizon."""
    for run, allowed in RUNS.items():
        for gray in (True,) if run == 'approach_run5' else (False, True):
            for horizon in (True, False):
                kind = ('grey' if gray else 'colour') + (' horizon' if horizon else ' image')
                for variant in variants:
                    name = f'{run[-4:]} {kind}'
                    make = partial(
                        labelled_run,
                        name if variant is PLAIN else f'{name}, {variant.name}',
                        footage / 'runway' / run,
                        allowed,
                        gray=gray,
                        horizon=horizon,
                        part=part,
                        variant=variant,
                    )
                    yield name, make


def labelled_run(
    name: str,
    folder: Path,
    allowed: Tolerance,
    *,
    gray: bool,
    horizon: bool,
    part: slice,
    variant: Variant,
) -> Row:
    """A run with corners labelled by hand."""
    labels: list[LabelledFrame] = read_corners(folder / 'corners.csv')
    lines = read_horizon(folder / 'horizon.csv', labels) if horizon else [None] * len(labels)
    row, detector = Row(name), Timed()
    flag = cv2.IMREAD_GRAYSCALE if gray else cv2.IMREAD_COLOR
    frames = list(zip(labels, lines, strict=True))[part][variant.skip :]
    for index, (label, line) in enumerate(frames):
        image = cv2.imread(str(folder / label.file), flag)
        width = image.shape[1]
        seen = variant.horizon(line, width)
        result = detector.process(variant.image(image, index), seen)
        score = score_frame(variant.label(label, width), result.lines, allowed)
        row.frames.append(judged(label.file, detector, result, score.error))
    return detector.put(row)


def scatter(rows: list[Row]) -> str:
    """Mean and worst of a flight's variants: shares of right and of wrong, and first reports."""
    shares = np.array([row.shares()[1:] for row in rows])
    firsts = [row.first or len(row.frames) + 1 for row in rows]
    (right, wrong), least, most = shares.mean(axis=0), shares[:, 0].min(), shares[:, 1].max()
    return (
        f'{len(rows)} variants: right {right:.1f} (least {least:.1f}), wrong {wrong:.1f} '
        f'(most {most:.1f}), first report {max(firsts)} at the latest'
    )


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


def jobs(options: argparse.Namespace) -> Iterator[tuple[str, Callable[[], list[Row]]]]:
    """All rows by name."""
    footage, step = options.footage, options.step
    part = slice(options.start, options.stop, step)
    for name, make in run_rows(footage, part, VARIANTS if options.variants else (PLAIN,)):
        yield name, lambda make=make: [make()]
    for path in CLIPS:
        for gray in (False, True):
            name = f'{Path(path).stem} {"grey" if gray else "colour"}'
            yield name, lambda path=path, gray=gray: [clip(footage / path, gray, options.clip_step)]
    folder = footage / 'runway' / 'cockpit_stills'
    for check in (False, True):
        name = f'stills {"check" if check else "tuning"}'
        yield name, lambda check=check: stills(folder, check, options.still_frames)
    for name in (*FLIGHTS, *BANKS):
        yield f'simulated {name}', lambda name=name: [simulated(name, step, options.cache)]


def main() -> None:
    """Print the table, and write every frame where that was asked for."""
    parser = argparse.ArgumentParser()
    parser.add_argument('footage', type=Path)
    parser.add_argument('--only', nargs='*', default=[''], help='parts of names')
    parser.add_argument('--step', type=int, default=1, help='of the flights')
    parser.add_argument('--start', type=int, help='first frame of the flights')
    parser.add_argument('--stop', type=int, help='frame after the last one')
    parser.add_argument('--variants', action='store_true', help='of the flights, too')
    parser.add_argument('--clip-step', type=int, default=1, help='of the clips')
    parser.add_argument('--still-frames', type=int, default=STILL_FRAMES)
    parser.add_argument('--cache', type=Path, help='for simulated frames')
    parser.add_argument('--json', type=Path, help='for every frame')
    options = parser.parse_args()
    cv2.setNumThreads(1)
    print(HEADER, flush=True)
    rows = []
    groups: dict[str, list[Row]] = {}
    for name, make in jobs(options):
        if any(part in name for part in options.only):
            for row in make():
                rows.append(row)
                groups.setdefault(name, []).append(row)
                print(row.line(), flush=True)
    if options.variants:
        for name, group in groups.items():
            print(f'{name:20s} {scatter(group)}')
    if options.json is not None:
        options.json.write_text(json.dumps([asdict(row) for row in rows]))


if __name__ == '__main__':
    main()
