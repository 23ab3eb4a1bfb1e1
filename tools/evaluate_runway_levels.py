"""Coverage of the levels of mode approach's guidance: simulated flights and labelled runs.

Simulated flights have the truth. For labelled runs, which have no calibration, a camera of
nominal focal length stands in, and the error is the difference between the guidance from the
reported edges and that from the labels' edges, both by the same flat-ground formula; the labels
are whole pixels. Each row: how often the error is within the deviations that a Gaussian leaves
with 50, 90, 95 and 99 %; the same with the deviations inflated by the one factor that makes 95 %
of the OTHER flights' errors right; then, for a risk per frame, the share of frames with levels
and how many of these were exceeded. With seeds, the same of random simulated flights.

Usage: evaluate_runway_levels.py [FOOTAGE] [--seeds A B] (FOOTAGE: the folder with
runway/approach_run*/corners.csv; B is not flown).
"""

from __future__ import annotations

import argparse
import math
import random
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from mvuav_ros.offline.evaluation.corners import LabelledFrame, read_corners
from mvuav_ros.parameters.runway_detector import RunwayDetectorParameters
from mvuav_ros.simulation.runway_flight import RunwayFlight
from mvuav_ros.simulation.settings import RunwaySettings
from mvuav_ros.vision.approach.approach_detector import ApproachDetector
from mvuav_ros.vision.approach.approach_results import ApproachResult
from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.frames import OPTICAL_FROM_BODY, Attitude, quaternion
from mvuav_ros.vision.integrity import runway_levels

Array = NDArray[np.float64]
WIDTH = 30.0
"""m, of the runways."""
SIMULATED: dict[str, dict[str, Any]] = {
    'approach': {},
    'from the right': {'seed': 103, 'lateral_offset': -12.0},
    'low pass': {'seed': 105, 'motion': 'low_pass'},
    'shaken': {'seed': 114, 'shake': 2},
    'S-turn': {'seed': 116, 'motion': 's_turn'},
    'noise, defocus': {'seed': 117, 'noise': 6.0, 'blur': 1.5},
}
RUNS = ('approach_run2', 'approach_run3', 'approach_run5')
STEP, WARM_UP = 3, 25
NOMINAL = np.array((0.5, 0.9, 0.95, 0.99))
RISKS = (0.02, 0.05, 0.2)
LABELLED_CAMERA = CameraModel(320, 240, k=(400, 0, 159.5, 0, 400, 119.5, 0, 0, 1))


def detector(camera: CameraModel, width: float = WIDTH) -> ApproachDetector:
    """Mode approach with guidance."""
    made = ApproachDetector(RunwayDetectorParameters(mode='approach', runway_width=width))
    made.set_camera(camera)
    return made


def random_settings(seed: int) -> tuple[dict[str, Any], bool]:
    """Settings of a flight drawn at random, and whether there is attitude."""
    draw = random.Random(seed * 7919)
    given: dict[str, Any] = {
        'frames': 110,
        'seed': seed,
        'motion': draw.choice(['approach', 'approach', 'low_pass', 's_turn']),
        'fps': draw.choice([15, 30]),
        'start_distance': draw.choice([2000, 1200, 700, 400, 200, 0, -150]),
        'lateral_offset': draw.choice([0, 5, -10, 25, -40]),
        'runway_width': draw.choice([10, 15, 23, 30, 45, 60]),
        'runway_length': draw.choice([600, 1200, 2500]),
        'visibility': draw.choice([3000, 9000, 30000]),
        'camera_pitch_deg': draw.choice([0, 4, 8, 8, 14, 20, 30]),
        'shake': draw.choice([0, 1, 2]),
        'noise': draw.choice([1, 2, 4]),
        'gain_steps': draw.choice([0, 0, 0.1]),
        'width': draw.choice([320, 640, 640]),
        'speed': draw.choice([25, 40, 60]),
    }
    given['height'] = given['width'] * 3 // 4
    return given, draw.random() < 0.5


def simulated(
    given: dict[str, Any], step: int = STEP, has_attitude: bool = False
) -> Iterator[tuple[ApproachResult, Array]]:
    """Results with the error of offset, height and heading."""
    flight = RunwayFlight(RunwaySettings(**{'frames': 240, 'seed': 101, **given}))
    camera = flight.camera
    model = CameraModel(camera.width, camera.height, tuple(camera.matrix.ravel()))
    made = detector(model, flight.settings.runway_width)
    for index, frame in enumerate(flight):
        if index % step:
            continue
        attitude = None
        if has_attitude:
            attitude = Attitude(*quaternion(frame.truth.pose.rotation @ OPTICAL_FROM_BODY))
        result = made.process(frame.image.bgr(), frame.stamp_ns, attitude)
        guidance, pose = result.guidance, flight.frame(index).truth.pose
        if index >= WARM_UP and guidance is not None and guidance.known:
            # Without their images thousands of results fit into memory.
            yield (
                replace(result, image=np.empty((0, 0), np.uint8)),
                np.array(
                    (
                        guidance.y - pose.position[1],
                        guidance.z - pose.position[2],
                        guidance.yaw - pose.yaw,
                    )
                ),
            )


def labelled(folder: Path) -> Iterator[tuple[ApproachResult, Array]]:
    """The same on a real flight."""
    made = detector(LABELLED_CAMERA)
    for index, frame in enumerate(read_corners(folder / 'corners.csv')):
        pixels = np.asarray(cv2.imread(str(folder / frame.file)), np.uint8)
        result = made.process(pixels, round(index * 1e9 / 25))
        guidance = result.guidance
        if index < WARM_UP or guidance is None or not guidance.known:
            continue
        left, right = result.lines[:2]
        rows = np.array((frame.far_left[1], frame.near_left[1]))
        seen = [(row, *(_column(line, row) for line in (left, right))) for row in rows]
        yield result, flat(seen, guidance.roll) - flat(_label_rows(frame, rows), guidance.roll)


def _column(line: object, row: float) -> float:
    theta, rho = line.theta, line.rho  # type: ignore[attr-defined]
    return (rho - row * math.sin(theta)) / math.cos(theta)


def _label_rows(frame: LabelledFrame, rows: Array) -> list[tuple[float, float, float]]:
    def at(near: tuple[float, float], far: tuple[float, float], row: float) -> float:
        return far[0] + (near[0] - far[0]) * (row - far[1]) / (near[1] - far[1])

    return [
        (
            row,
            at(frame.near_left, frame.far_left, row),
            at(frame.near_right, frame.far_right, row),
        )
        for row in rows
    ]


def flat(rows: list[tuple[float, float, float]], roll: float) -> Array:
    """Offset and height (m) and heading (rad) from two edges over flat ground, pitch neglected."""
    focal, (x0, y0) = LABELLED_CAMERA.k[0], (LABELLED_CAMERA.k[2], LABELLED_CAMERA.k[5])
    turn = np.array(((math.cos(roll), -math.sin(roll)), (math.sin(roll), math.cos(roll))))
    edges = [
        np.array([(row_columns[side] - x0, row_columns[0] - y0) for row_columns in rows]) @ turn.T
        for side in (1, 2)
    ]
    slopes = [(far[0] - near[0]) / (far[1] - near[1]) for far, near in edges]
    (x_left, y_left), (x_right, y_right) = edges[0][1], edges[1][1]
    gap = (x_right - slopes[1] * y_right) - (x_left - slopes[0] * y_left)
    row = gap / (slopes[0] - slopes[1])
    column = x_left + slopes[0] * (row - y_left)
    height = WIDTH / (slopes[1] - slopes[0])
    return np.array((0.5 * (slopes[0] + slopes[1]) * height, height, math.atan2(column, focal)))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('footage', type=Path, nargs='?')
    parser.add_argument('--seeds', type=int, nargs=2, default=(0, 0), metavar=('A', 'B'))
    asked = parser.parse_args()
    for_random = [random_settings(seed) for seed in range(*asked.seeds)]
    drawn = [list(simulated(given, 1, has_attitude)) for given, has_attitude in for_random]
    for name, has_attitude in (('without attitude', False), ('with attitude', True)):
        some = [
            found
            for found, (_, has) in zip(drawn, for_random, strict=True)
            if found and has is has_attitude
        ]
        every = [frame for found in some for frame in found]
        if every:
            print(f'{len(some)} random flights {name} | {len(every)} frames | {levels(every)}')
    flights = {name: list(simulated(given)) for name, given in SIMULATED.items()}
    if asked.footage is not None:
        folder = asked.footage / 'runway'
        flights |= {name: list(labelled(folder / name)) for name in RUNS}
    errors = {name: normalized(found) for name, found in flights.items()}
    print('flight | frames | coverage at 50 90 95 99 % | inflated | risk: available, exceeded')
    factors = -ndtri((1.0 - NOMINAL) / 2.0)
    for name, found in flights.items():
        if not found:
            print(f'{name} | 0')
            continue
        kind = [other for other in flights if (other in RUNS) == (name in RUNS)]
        rest = np.concatenate([errors[other] for other in kind if other != name])
        inflation = np.quantile(np.abs(rest), 0.95) / factors[2]
        plain, inflated = (
            ' '.join(f'{100 * np.mean(np.abs(errors[name]) <= scale * k):.0f}' for k in factors)
            for scale in (1.0, inflation)
        )
        print(f'{name} | {len(found)} | {plain} | {inflated} (x {inflation:.1f}) | {levels(found)}')


def normalized(found: list[tuple[ApproachResult, Array]]) -> Array:
    """(n, 3), errors in deviations."""
    rows = [
        error / np.sqrt(np.diag(result.guidance.covariance)[[1, 2, 5]])  # type: ignore[union-attr]
        for result, error in found
    ]
    return np.array(rows).reshape(-1, 3)


def levels(found: list[tuple[ApproachResult, Array]]) -> str:
    """For each risk the share of frames with levels, and in how many of these they failed."""
    words = []
    for risk in RISKS:
        available = exceeded = 0
        for result, error in found:
            assert result.guidance is not None
            level = runway_levels(result.guidance.covariance, result.confidence, risk)
            if not level.reason:
                available += 1
                bounds = np.array((level.offset, level.height, level.heading))
                exceeded += bool((np.abs(error) > bounds).any())
        words.append(f'{risk:g}: {100 * available / len(found):.0f} %, {exceeded}')
    return '; '.join(words)


if __name__ == '__main__':
    main()
