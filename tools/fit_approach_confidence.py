"""Fits mode approach's confidence to what tools/evaluate_approach.py saw, and draws how it holds.

Fitted on the tuning half alone; drawn for both.

    python tools/evaluate_approach.py ../shared/footage --json frames.json
    python tools/fit_approach_confidence.py frames.json [docs/images/approach_reliability.png]
"""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from approach_drone import UAV_RUNWAY
from numpy.typing import NDArray
from scipy.optimize import minimize

from mvuav_ros.vision.approach.probability import Report

OUTPUT = Path('mvuav_ros/vision/approach/probability.json')
BOUNDS = ((None, None), (0.0, None), (0.0, 1.5), (0.0, None), (0.0, None))
"""Of the offset and of the weights of `Report.values`. All flights have clear lines along both
sides, or are near enough for clear steps; without a limit nothing else would be reported."""
PENALTY = 1.0
WRONG_WEIGHT = 1.5
"""Of a wrong report, beside a right one: it does more harm than a missing one. With 2, tuned stills
near by are right in 50 instead of 60 %."""
BINS = np.linspace(0.0, 1.0, 9)


def read(path: Path) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """The rows of the tuning half and of the check half."""
    rows = json.loads(path.read_text())
    return [row for row in rows if not row['check']], [row for row in rows if row['check']]


def judged(row: dict[str, Any]) -> list[tuple[Report, float]]:
    """Reports of a row's frames and their errors in tolerances."""
    return [
        (Report(*frame['report']), frame['error'])
        for frame in row['frames']
        if frame['report'] is not None
        and not (row['name'].startswith('uav') and int(frame['name']) in UAV_RUNWAY)
    ]


def fit(rows: list[dict[str, Any]]) -> list[float]:
    """Weights of the confidence; every row counts as much as any other, a still as one frame."""
    found, counts = [], []
    for row in rows:
        reports = judged(row)
        still = row['name'].startswith('stills')
        found += reports
        counts += [1.0 if still else 100.0 / max(len(reports), 1)] * len(reports)
    values = np.array([report.values() for report, _ in found])
    alone = 1.0 / (1.0 + np.array([report.other_edges for report, _ in found]))
    right = np.array([error <= 1.0 for _, error in found])
    weights = np.array(counts) * np.where(right, 1.0, WRONG_WEIGHT)

    def loss(slopes: NDArray[np.float64]) -> float:
        confidence = alone / (1.0 + np.exp(-values @ slopes[1:] - slopes[0]))
        chance = np.where(right, confidence, 1.0 - confidence)
        penalty = 0.5 * PENALTY * float((slopes[1:] ** 2).sum())
        return penalty - float(weights @ np.log(np.maximum(chance, 1e-12)))

    start = np.zeros(values.shape[1] + 1)
    fitted = minimize(loss, start, method='L-BFGS-B', bounds=BOUNDS).x
    return [float(value) for value in np.round(fitted, 3)]


def draw(halves: dict[str, list[dict[str, Any]]], weights: NDArray[np.float64], path: Path) -> None:
    """Share of right reports over confidence, with the number of frames in each bin."""
    mpl.use('Agg')
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(figsize=(6, 4.5), layout='constrained')
    axes.plot([0, 1], [0, 1], color='grey', linewidth=1)
    for name, rows in halves.items():
        pairs = [pair for row in rows for pair in judged(row)]
        confidence = np.array([report.confidence(weights) for report, _ in pairs])
        right = np.array([error <= 1.0 for _, error in pairs])
        number = np.digitize(confidence, BINS[1:-1])
        used = [index for index in range(BINS.size - 1) if (number == index).sum() >= 10]
        x = [float(confidence[number == index].mean()) for index in used]
        y = [float(right[number == index].mean()) for index in used]
        axes.plot(x, y, marker='o', label=name)
        for at, share, index in zip(x, y, used, strict=True):
            axes.annotate(str((number == index).sum()), (at, share), fontsize=7)
        brier = math.fsum((confidence - right) ** 2) / len(right)
        print(f'{name}: {len(right)} frames, Brier score {brier:.3f}')
    axes.set(xlabel='confidence', ylabel='share of reports that are right', xlim=(0, 1))
    axes.legend()
    figure.savefig(path, dpi=100)


def main() -> None:
    """Fit, write and draw."""
    tuning, check = read(Path(sys.argv[1]))
    found = fit(tuning)
    data = json.loads(OUTPUT.read_text())
    data['confidence'] = found
    OUTPUT.write_text(json.dumps(data) + '\n')
    print(found)
    if len(sys.argv) > 2:
        halves = {'tuning half': tuning, 'check half': check}
        draw(halves, np.array(found), Path(sys.argv[2]))


if __name__ == '__main__':
    main()
