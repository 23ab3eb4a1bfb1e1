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
from collections.abc import Callable, Iterator
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from approach_drone import UAV_RUNWAY, model_airfield, uav
from approach_flights import (
    BANKS,
    CHECK_SEEDS,
    FLIGHTS,
    HIGHER,
    HIGHER_SEEDS,
    LOOKING_DOWN,
    LOOKING_DOWN_GREY,
    OVERFLOWN,
    STEEP,
    STEEP_CHECK,
    TUNED_SEEDS,
    higher,
    looking_down,
    overflown,
    simulated,
)
from approach_mechanisms import WITHOUT, switch_off
from approach_rows import HEADER, Frame, Row, Timed, judged
from approach_variants import PLAIN, VARIANTS, Variant
from approach_views import (
    BAD_CAMERAS,
    FAINT,
    TEXTS,
    Shot,
    View,
    as_it_is,
    cropped,
    following,
    hazy,
    in_sky_or_text,
    magnified,
    painted_over,
    taken_by,
    with_text,
    without_runway,
)
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
CUTS: dict[str, list[tuple[str, View, slice]]] = {
    'approach_run2': [
        ('cut 1 px below', following(1.0), slice(None)),
        ('cut at 88', cropped(88), slice(None)),
        ('cut at 88, twice', cropped(88, 2), slice(None)),
    ],
    'approach_run3': [
        ('cut 2 px below', following(2.0), slice(200, None)),
        ('cut 14 px below', following(14.0), slice(320, None)),
        ('cut at 84', cropped(84), slice(270, None)),
        ('cut at 84, twice', cropped(84, 2), slice(270, 480)),
        ('cut at 95, thrice', cropped(95, 3), slice(370, 490)),
    ],
    'approach_run5': [
        ('cut 4 px below', following(4.0), slice(200, None)),
        ('cut at 130', cropped(130), slice(250, None)),
        ('cut at 136, twice', cropped(136, 2), slice(250, None)),
    ],
}
"""Of each flight: name, what is seen of a frame, and which frames; no horizon is in view."""
MAGNIFIED = {'approach_run3': (3, 4), 'approach_run5': (4,)}
"""By how much, so that the near end is out of view: as from over the runway."""
CLIPS = {
    'road/udacity_solidWhiteRight.mp4': 221,
    'road/straight_rural_road_720p50.mp4': 1295,
    'road/forest_road_white_edges.mp4': 1231,
    'runway/uav_a4_over_threshold_640x480.mp4': 1001,
}
CHECK_CLIPS = ('road/udacity_solidWhiteRight.mp4', 'runway/uav_a4_over_threshold_640x480.mp4')
STILL_FRAMES = 30
OVERLAP = 0.3


class Job(NamedTuple):
    """Rows of one kind of footage, made when they are asked for."""

    group: str
    name: str
    check: bool
    make: Callable[[], list[Row]]


def run_jobs(footage: Path, options: argparse.Namespace) -> Iterator[Job]:
    """The labelled flights: as they are, without a horizon in view, and with text."""
    part = slice(options.start, options.stop, options.step)
    for run in RUNS:
        for gray in (True,) if run == 'approach_run5' else (False, True):
            for horizon in (True, False):
                kind = ('grey' if gray else 'colour') + (' horizon' if horizon else ' image')

                def job(
                    group: str,
                    name: str,
                    part: slice = part,
                    run: str = run,
                    gray: bool = gray,
                    horizon: bool = horizon,
                    **how: Any,
                ) -> Job:
                    make = partial(
                        labelled_run,
                        name,
                        footage / 'runway' / run,
                        RUNS[run],
                        gray=gray,
                        horizon=horizon,
                        part=part,
                        **how,
                    )
                    return Job(group, name, run == 'approach_run2', lambda: [make()])

                for variant in VARIANTS if options.variants else (PLAIN,):
                    name = f'{run[-4:]} {kind}'
                    name += '' if variant is PLAIN else f', {variant.name}'
                    yield job('runs', name, variant=variant)
                for cut, view, rows in CUTS[run]:
                    yield job('no horizon', f'{run[-4:]} {kind} {cut}', rows, view=view)
                for zoom in MAGNIFIED.get(run, ()):
                    rows = slice(360, None, options.step)
                    name = f'{run[-4:]} {kind}, {zoom} times'
                    yield job('over the runway', name, rows, view=magnified(zoom))
                for half in (20, 40, 80):
                    yield job('haze', f'{run[-4:]} {kind} haze {half}', view=hazy(half))
                changed: dict[str, dict[str, Callable[[View], View]]] = {}
                if horizon == (run == 'approach_run3' and gray):
                    for light, view in FAINT.items():
                        yield job('low contrast', f'{run[-4:]} {kind} {light}', view=view)
                    changed['text'] = {style: partial(with_text, style) for style in TEXTS}
                if not horizon:
                    changed['bad cameras'] = {
                        camera: partial(taken_by, **how) for camera, how in BAD_CAMERAS.items()
                    }
                for group, views in changed.items():
                    for change, view_of in views.items():
                        name, rows = f'{run[-4:]} {kind} {change}', slice(None, 240, options.step)
                        yield job(group, name, view=view_of(as_it_is))
                        bare = view_of(without_runway)
                        yield job(group, f'{name}, no runway', rows, view=bare, absent=True)


def labelled_run(
    name: str,
    folder: Path,
    allowed: Tolerance,
    *,
    gray: bool,
    horizon: bool,
    part: slice,
    variant: Variant = PLAIN,
    view: View = as_it_is,
    absent: bool = False,
) -> Row:
    """A run with corners labelled by hand; every report is wrong where the runway is absent."""
    labels: list[LabelledFrame] = read_corners(folder / 'corners.csv')
    lines = read_horizon(folder / 'horizon.csv', labels)
    row, detector = Row(name), Timed()
    flag = cv2.IMREAD_GRAYSCALE if gray else cv2.IMREAD_COLOR
    frames = list(zip(labels, lines, strict=True))[part][variant.skip :]
    for index, (label, line) in enumerate(frames):
        image = cv2.imread(str(folder / label.file), flag)
        width = image.shape[1]
        changed = variant.label(label, width), variant.horizon(line, width)
        shot = view(Shot(variant.image(image, index), *changed), index)
        result = detector.process(shot.image, shot.horizon if horizon else None)
        if shot.label is None:
            continue
        within = Tolerance(shot.zoom * allowed.least, allowed.share)
        error = score_frame(shot.label, result.lines, within).error
        frame = judged(label.file, detector, result, math.inf if absent else error)
        frame.outside = frame.corners is not None and in_sky_or_text(frame.corners, shot)
        row.frames.append(frame)
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


def clip(name: str, path: Path, gray: bool, step: int, text: str) -> Row:
    """A clip without a runway; every report is wrong, except of the UAV's runway."""
    uav = 'uav' in path.name
    row = Row(name, warm_up=0)
    detector = Timed()
    view = with_text(text) if text else as_it_is
    video = cv2.VideoCapture(str(path))
    for index in range(CLIPS[f'{path.parent.name}/{path.name}']):
        if not video.grab():
            break
        if index % step:
            continue
        _, image = video.retrieve()
        if image.shape[1] >= 960:
            # As large as a flight's frames, so that it takes no longer to read.
            image = cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
        if gray:
            image = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
        error = 0.0 if uav and index in UAV_RUNWAY else math.inf
        shot = view(Shot(image), index)
        frame = judged(str(index), detector, detector.process(shot.image), error)
        frame.outside = frame.corners is not None and in_sky_or_text(frame.corners, shot)
        row.frames.append(frame)
    return detector.put(row)


def stills(folder: Path, check: bool, frames: int, text: str, *, absent: bool = False) -> list[Row]:
    """Stills of one half of the videos, each shown several times; near and far group apart.

    Text that is drawn changes with time, the rest does not. Where runways are absent, they are
    painted over, and every report is wrong.
    """
    view = with_text(text) if text else as_it_is
    boxes: dict[str, list[list[float]]] = {}
    with (folder / 'boxes.csv').open(newline='') as file:
        for line in csv.DictReader(file):
            box = [float(line[key]) for key in ('x_min', 'y_min', 'x_max', 'y_max')]
            boxes.setdefault(line['file'], []).append(box)
    half = 'check' if check else 'tuning'
    name = f'stills {half} {text}{", no runway" if absent else ""} '.replace('  ', ' ')
    rows = {group: Row(name + group, warm_up=0) for group in ('far', 'near')}
    for name in sorted(boxes):
        if bool(int(name.split('-')[1]) // 2 % 2) != check:
            continue
        image, detector = cv2.imread(str(folder / name)), Timed()
        if absent:
            image = painted_over(image, [np.reshape(box, (2, 2)) for box in boxes[name]])
        shots = [view(Shot(image), number) for number in range(frames)]
        result = [detector.process(shot.image) for shot in shots][-1]
        best = 0.0
        if result.corners is not None and not absent:
            points = np.array(result.corners)
            best = max(overlap(points, box) for box in boxes[name])
        row = rows['near' if name.startswith('1') else 'far']
        frame = judged(name, detector, result, OVERLAP / max(best, 1e-3))
        frame.outside = frame.corners is not None and in_sky_or_text(frame.corners, shots[-1])
        row.frames.append(frame)
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


def jobs(options: argparse.Namespace) -> Iterator[Job]:
    """All rows, in groups of footage of one kind."""
    footage, step = options.footage, options.step
    yield from run_jobs(footage, options)
    for path in CLIPS:
        check = path in CHECK_CLIPS
        for gray in (False, True):
            for text in ('', *TEXTS):
                group = ('fields' if 'uav' in path else 'roads') + (' with text' if text else '')
                name = f'{Path(path).stem[:24]} {"grey" if gray else "colour"} {text}'
                make = partial(clip, name, footage / path, gray, options.clip_step, text)
                yield Job(group, name, check, lambda make=make: [make()])
    folder = footage / 'runway' / 'cockpit_stills'
    for check in (False, True):
        for text in ('', 'status lines', 'boxes'):
            name = f'stills {"check" if check else "tuning"} {text}'.rstrip()
            make_all = partial(stills, folder, check, options.still_frames, text)
            yield Job('stills with text' if text else 'stills', name, check, make_all)
            if text:
                make_all = partial(make_all, absent=True)
                yield Job('stills with text', f'{name}, no runway', check, make_all)
    folder = footage / 'runway' / 'model_airfield'
    clip_path = footage / 'runway' / 'uav_a4_over_threshold_640x480.mp4'
    for gray in (False, True):
        yield Job('drones', 'UAV', True, lambda gray=gray: [uav(clip_path, gray=gray)])
        drone = partial(model_airfield, folder, options.still_frames, gray=gray)
        yield Job('drones', 'model airfield', True, lambda drone=drone: [drone()])
    for flight in (*FLIGHTS, *BANKS):
        name = f'simulated {flight}'
        one = partial(simulated, flight, step, options.cache)
        yield Job('simulated', name, flight not in FLIGHTS, lambda one=one: [one()])
    for flight in STEEP:
        name = f'simulated {flight}'
        one = partial(simulated, flight, step, options.cache)
        yield Job('no horizon', name, flight in STEEP_CHECK, lambda one=one: [one()])
    looks = (*LOOKING_DOWN, *LOOKING_DOWN_GREY)
    flown = [('looking down', looking_down, flight) for flight in looks]
    flown += [('over the runway', overflown, flight) for flight in OVERFLOWN]
    for given in ('', ', attitude'):
        for check, seeds in zip((False, True), HIGHER_SEEDS, strict=True):
            several = partial(higher, HIGHER + given, seeds, step, options.cache)
            yield Job('higher', HIGHER + given, check, lambda several=several: [several()])
    for kind, fly, flight in flown:
        for check, seeds in ((False, TUNED_SEEDS), (True, CHECK_SEEDS)):
            for given in ('', ', attitude'):
                several = partial(fly, flight + given, seeds, step, options.cache)
                name = f'{kind}, {flight}{given}'
                yield Job(kind, name, check, lambda several=several: [several()])


def summary(rows: list[Row]) -> Iterator[str]:
    """Means of each group's halves."""
    yield f'{"mean of rows":42s} {HEADER[43:]}'
    for group in dict.fromkeys(row.kind for row in rows):
        for check in (False, True):
            part = [row for row in rows if row.kind == group and row.check == check]
            if part:
                shares = np.array([(*row.shares(), row.outside) for row in part]).mean(axis=0)
                counted = sum(len(row.frames) - row.warm_up for row in part)
                times = [(row.first_ms, row.later_ms, row.opencv_ms) for row in part]
                first, later, opencv = np.mean(times, axis=0)
                yield (
                    f'{group:42s} {"check" if check else "tuned":5s} {counted:5d} '
                    + ' '.join(f'{share:6.1f}' for share in shares)
                    + f' {"":6s} {first:7.0f} {later:6.1f} {opencv:6.1f}'
                )


def beside(rows: list[Row], other: Path) -> Iterator[str]:
    """Right, wrong, in sky or text, first report and CPU of an earlier run and of this one."""
    titles = ('right', 'wrong', 'sky', 'first', 'ms')
    yield f'{"":42s} half  ' + ' '.join(f'{title:>15s}' for title in titles)
    old = {entry['name']: entry for entry in json.loads(other.read_text())}
    for row in rows:
        before = old.get(row.name)
        if before is None:
            continue
        frames = [Frame(**frame) for frame in before['frames']]
        was = Row(**{**before, 'frames': frames})
        cells = [
            (was.shares()[1], row.shares()[1]),
            (was.shares()[2], row.shares()[2]),
            (was.outside, row.outside),
            (was.first or math.nan, row.first or math.nan),
            (was.later_ms, row.later_ms),
        ]
        half = 'check' if row.check else 'tuned'
        text = ' '.join(f'{one:6.1f} > {two:6.1f}' for one, two in cells)
        yield f'{row.name:42s} {half} {text}'


def main() -> None:
    """Print the table, and write every frame where that was asked for."""
    parser = argparse.ArgumentParser()
    parser.add_argument('footage', type=Path)
    parser.add_argument('--only', nargs='*', default=[''], help='parts of names')
    parser.add_argument('--skip', nargs='*', default=[], help='parts of names that are left out')
    parser.add_argument('--kinds', nargs='*', help='groups: runs, text, no horizon, roads, ...')
    parser.add_argument('--step', type=int, default=1, help='of the flights')
    parser.add_argument('--start', type=int, help='first frame of the flights')
    parser.add_argument('--stop', type=int, help='frame after the last one')
    parser.add_argument('--variants', action='store_true', help='of the flights, too')
    parser.add_argument('--clip-step', type=int, default=2, help='of the clips')
    parser.add_argument('--still-frames', type=int, default=STILL_FRAMES)
    parser.add_argument('--cache', type=Path, help='for simulated frames')
    parser.add_argument('--json', type=Path, help='for every frame')
    parser.add_argument('--beside', type=Path, help='JSON of another checkout, to compare with')
    parser.add_argument('--without', choices=WITHOUT, help='a mechanism that is switched off')
    parser.add_argument('--noise', type=int, default=0, help='seed of noise of one grey level')
    options = parser.parse_args()
    Timed.noise = options.noise
    if options.without is not None:
        switch_off(options.without)
    cv2.setNumThreads(1)
    print(HEADER, flush=True)
    rows = []
    groups: dict[str, list[Row]] = {}
    for job in jobs(options):
        wanted = options.kinds is None or job.group in options.kinds
        wanted = wanted and not any(part in job.name for part in options.skip)
        if wanted and any(part in job.name for part in options.only):
            for row in job.make():
                row.kind, row.check = job.group, job.check
                rows.append(row)
                groups.setdefault(job.name.split(',')[0], []).append(row)
                print(row.line(), flush=True)
                if options.json is not None:
                    options.json.write_text(json.dumps([asdict(each) for each in rows]))
    if options.variants:
        for name, group in groups.items():
            print(f'{name:20s} {scatter(group)}')
    for line in summary(rows):
        print(line)
    if options.beside is not None:
        for line in beside(rows, options.beside):
            print(line)


if __name__ == '__main__':
    main()
