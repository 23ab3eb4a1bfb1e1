"""Flies hundreds of flights of lights with one or two versions of the package: one table.

    python tools/compare_markers.py [--flights 300] [--seeds 20000 21000] [--against CHECKOUT]
        [--only PART_OF_A_GROUP] [--name NAME] [--json FILE] [--csv FILE]

The groups are the scenes of `mvuav_thesis.integrity_runs`, with their calibration
and five of them without, and those of `test/support/marker_flights.py`, whose motion, projection
and drawing are not the package's. Every group flies the seeds from the first one on. With another
checkout, or a file that --json wrote, its figures stand in the line above. Each flight is flown by
one version, then by the other, so that a busy machine slows both; times are processor time.

Seeds 20000 to 29999 are for choosing constants; 30000 and on are kept back: fly those when a change
is done, and change nothing after them but back. `test/data/marker_flights.json` has figures of both
halves, of the version that its name in the file says.

| column | meaning |
|---|---|
| wrong | marker-frames with a name more than 4 px from the marker; the longest run |
| missed | whole markers' frames without a name, from the first frame with all markers whole |
| waits | times of more than 3 frames with three whole markers or more and not all named; longest |
| start | frames to all names: mean, most |
| recovery | frames from a marker's return to its name: 95th percentile, most |
| roll | frames with both wings whole in which the roll is told, within a degree |
| pose | poses told over frames with three whole markers (more than 100 %: with markers in part \
hidden); its worst errors; median of the flights' mean NEES (6 is ideal) |
| ms | median of frames in which nothing happens, mean of the others, worst of those |
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import json
import math
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
TUNING = 20000, 21000
COLUMNS = ['wrong; run', 'missed', 'waits; most', 'start', 'recovery', 'roll', 'pose', 'worst pose']
COLUMNS += ['NEES', 'ms']


class Version:
    """A process that flies with the package of one checkout."""

    def __init__(self, checkout: Path, without: str = '') -> None:
        paths = os.pathsep.join((str(checkout), str(ROOT / 'test')))
        self._process = subprocess.Popen(
            [sys.executable, __file__, '--worker', *(['--without', without] if without else [])],
            cwd=checkout,
            env={**os.environ, 'PYTHONPATH': paths},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        self.groups: list[str] = self._answer()

    def fly(self, group: str, seed: int) -> dict[str, Any]:
        """One flight's figures (see `FlightScore.figures`)."""
        assert self._process.stdin is not None
        print(json.dumps([group, seed]), file=self._process.stdin, flush=True)
        figures: dict[str, Any] = self._answer()
        return figures

    def _answer(self) -> Any:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            raise SystemExit('a version has failed; its message is above')
        return json.loads(line)

    def close(self) -> None:
        """Let it end."""
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._process.wait()


def work(without: str) -> None:
    """Fly what the standard input names, with whatever package is imported."""
    if without:
        from marker_mechanisms import switch_off

        switch_off(without)
    answers = os.fdopen(os.dup(1), 'w')
    os.dup2(2, 1)
    import cv2
    from support.marker_flights import SCENES

    cv2.setNumThreads(1)
    package = _package_groups()
    print(json.dumps([*package, *SCENES]), file=answers, flush=True)
    for line in sys.stdin:
        group, seed = json.loads(line)
        figures = _fly_package(*package[group], seed) if group in package else _fly(group, seed)
        print(json.dumps(figures), file=answers, flush=True)


def _package_groups() -> dict[str, tuple[str, bool]]:
    """Scenes of the package by their groups, and whether they are calibrated."""
    from mvuav_thesis.integrity_runs import SCENES

    names = list(SCENES)
    groups = {f'package: {name}': (name, True) for name in names}
    for name in names:
        if name.startswith(('calm', 'a light', 'rolling, shaking', 'all dark, back', 'eight')):
            groups[f'package, no calibration: {name}'] = (name, False)
    return groups


def _fly_package(name: str, calibrated: bool, seed: int) -> dict[str, Any]:
    from mvuav_ros.vision.rig import TANKER_747
    from mvuav_thesis.integrity_runs import SCENES
    from mvuav_thesis.light_flights import LightFlight, random_rig

    scene, count = SCENES[name]
    rig = TANKER_747 if count == len(TANKER_747.names) else random_rig(count, seed)
    flight = LightFlight(scene, seed, rig)
    bare = not scene.thefts and not scene.glares
    frames = (
        (stamp_ns, image, truth, truth.whole, bare and bool(truth.visible.all()))
        for stamp_ns, image, truth in flight
    )
    return _follow(rig, flight.camera if calibrated else None, frames)


def _fly(group: str, seed: int) -> dict[str, Any]:
    from support.marker_flights import SCENES, MarkerFlight, told

    flight = MarkerFlight(SCENES[group], seed)
    frames = (
        (stamp_ns, image, truth, truth.whole, not len(truth.others))
        for stamp_ns, image, truth in flight
    )
    return _follow(*told(flight), frames)


def _follow(rig: Any, camera: Any, frames: Iterator[Any]) -> dict[str, Any]:
    """Track as the node does: names, then the pose by those detected."""
    import numpy as np
    from support.marker_scores import FlightScore

    from mvuav_ros.vision.image import Image
    from mvuav_ros.vision.markers.marker_results import MarkerState
    from mvuav_ros.vision.markers.tracker import MarkerTracker
    from mvuav_ros.vision.pose import PoseEstimator

    tracker, poses, score = MarkerTracker(rig=rig), PoseEstimator(rig), FlightScore()
    tracker.set_camera(camera)
    wings = [i for i, name in enumerate(rig.names) if name in ('left_wing', 'right_wing')]
    for stamp_ns, image, truth, whole, calm in frames:
        begin = time.process_time()
        result = tracker.process(Image(image, 'mono8'), stamp_ns)
        cpu_ms = 1e3 * (time.process_time() - begin)
        named = np.array([m.state is MarkerState.DETECTED for m in result.markers])
        places = np.array([(marker.x, marker.y) for marker in result.markers])
        score.add(named, places, truth.pixels, whole, calm, cpu_ms)
        # A version before the confidence has none.
        sure = np.array([getattr(marker, 'confidence', np.nan) for marker in result.markers])
        score.add_confidences(named, places, truth.pixels, sure)
        if len(wings) == 2 and whole[wings].all():
            score.add_roll(result.roll, *truth.pixels[wings])
        # A version that finds the calibration wrong says so, and its node tells no pose.
        if camera is None or getattr(result, 'camera_doubt', ''):
            continue
        labels = np.flatnonzero(named)
        pose = poses.estimate(camera, labels.tolist(), places[labels], stamp_ns)
        if pose is not None:
            told = pose.rotation, pose.translation, pose.covariance
            score.add_pose(told, (truth.rotation, truth.translation))
    return score.figures()


def cells(row: dict[str, Any]) -> list[str]:
    """A group's figures as `COLUMNS`."""

    def shown(*values: float | None) -> str:
        return ', '.join('-' if value is None else f'{value:g}' for value in values)

    posed = row['worst_moved_percent'], row['worst_turned_deg']
    return [
        shown(row['wrong'], row['longest_wrong']),
        shown(row['missed_percent']) + ' %',
        shown(row['waits'], row['longest_wait']),
        shown(row['start_mean'], row['start_max']),
        shown(row['recovery_p95'], row['recovery_max']),
        shown(row['roll_percent']) + ' %',
        shown(row['pose_percent']) + ' %',
        '{:g} %, {:g}°'.format(*posed),
        shown(row['nees']),
        shown(row['usual_ms'], row['search_ms'], row['worst_ms']),
    ]


def print_table(tables: dict[str, dict[str, dict[str, Any]]], groups: Sequence[str]) -> None:
    """One line for each group and version, in Markdown."""
    print('| group | flights, frames | version |', ' | '.join(COLUMNS), '|')
    print('|---|---|---|' + '---|' * len(COLUMNS))
    for group in groups:
        for version, rows in tables.items():
            if group in rows:
                row = rows[group]
                flown = f'{row["flights"]}, {row["frames"]}'
                print(f'| {group} | {flown} | {version} |', ' | '.join(cells(row)), '|')


def main() -> None:
    """Parse, fly, print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--flights', type=int, default=300, help='of all groups together')
    parser.add_argument('--seeds', type=int, nargs=2, default=list(TUNING), metavar=('A', 'B'))
    parser.add_argument('--against', type=Path, help='another checkout, or a file of --json')
    parser.add_argument('--kept', help='which figures of that file; else those of the same seeds')
    parser.add_argument('--name', default='this', help='of this version in the table and the file')
    parser.add_argument('--only', default='', help='groups whose names contain this')
    parser.add_argument('--json', type=Path, help="add each group's figures to it")
    parser.add_argument('--csv', type=Path, help="write each flight's figures")
    parser.add_argument('--without', default='', help=argparse.SUPPRESS)
    parser.add_argument('--worker', action='store_true', help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.worker:
        work(asked.without)
        return
    checkouts = {asked.name: ROOT}
    tables: dict[str, dict[str, dict[str, Any]]] = {}
    if asked.against is not None and asked.against.is_file():
        kept = json.loads(asked.against.read_text())
        same = (name for name, one in kept.items() if one['seeds'] == asked.seeds)
        chosen = asked.kept or next(same, '')
        if chosen not in kept:
            raise SystemExit(f'{asked.against} has figures of {", ".join(kept)}; name one: --kept')
        rows = kept[chosen]['groups']
        whole = not asked.only and kept[chosen]['flights'] == asked.flights
        tables[f'{chosen} (kept)'] = {name: rows[name] for name in rows if name != 'all' or whole}
    elif asked.against is not None:
        checkouts = {'against': asked.against.resolve(), **checkouts}
    flown = fly_all(checkouts, asked.flights, asked.seeds, asked.only)
    tables.update({name: rows for name, (rows, _) in flown.items()})
    groups = list(flown[asked.name][0])
    print_table(tables, groups)
    if asked.json is not None:
        kept = json.loads(asked.json.read_text()) if asked.json.exists() else {}
        for name, (rows, _) in flown.items():
            kept[name] = {'flights': asked.flights, 'seeds': asked.seeds, 'groups': rows}
        asked.json.write_text(_one_line_each(kept))
    if asked.csv is not None:
        with asked.csv.open('w', newline='') as file:
            writer = csv.writer(file)
            lines = [line for _, (_, lines) in flown.items() for line in lines]
            writer.writerow(lines[0])
            writer.writerows(line.values() for line in lines)


def _one_line_each(kept: dict[str, Any]) -> str:
    """JSON with a line for each group."""
    versions = []
    for name, one in kept.items():
        rows = [f'{json.dumps(group)}: {json.dumps(row)}' for group, row in one['groups'].items()]
        head = {key: value for key, value in one.items() if key != 'groups'}
        start = f'{json.dumps(name)}: {json.dumps(head)[:-1]}, "groups": '
        versions.append(start + '{\n  ' + ',\n  '.join(rows) + '\n}}')
    return '{' + ',\n'.join(versions) + '}\n'


def fly_all(
    checkouts: dict[str, Path], flights: int, seeds: Sequence[int], only: str
) -> dict[str, tuple[dict[str, dict[str, Any]], list[dict[str, Any]]]]:
    """For each version its groups' summaries, and every flight's figures."""
    sys.path.append(str(ROOT / 'test'))
    from support.marker_scores import summary

    with contextlib.ExitStack() as stack:
        versions = {name: Version(path) for name, path in checkouts.items()}
        for version in versions.values():
            stack.callback(version.close)
        everything = list(versions.values())[-1].groups
        each = max(math.ceil(flights / len(everything)), 1)
        if each > seeds[1] - seeds[0]:
            raise SystemExit(f'{each} flights of each group need as many seeds')
        groups = [group for group in everything if only in group]
        told: dict[str, dict[str, list[dict[str, Any]]]] = {name: {} for name in versions}
        lines: dict[str, list[dict[str, Any]]] = {name: [] for name in versions}
        for number, group in enumerate(groups, 1):
            print(f'{number} of {len(groups)}: {group}', file=sys.stderr)
            for seed in range(seeds[0], seeds[0] + each):
                for name, version in versions.items():
                    if group in version.groups:
                        figures = version.fly(group, seed)
                        told[name].setdefault(group, []).append(figures)
                        lines[name].append(
                            {'version': name, 'group': group, 'seed': seed, **figures}
                        )
        result = {}
        for name, by_group in told.items():
            rows = {group: summary(figures) for group, figures in by_group.items()}
            rows['all'] = summary([one for figures in by_group.values() for one in figures])
            result[name] = rows, lines[name]
        return result


if __name__ == '__main__':
    main()
