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

from mvuav_ros.vision.approach.probability import ConfidenceWeights, Report

OUTPUT = Path('mvuav_ros/vision/approach/probability.json')
KINDS = ('runs', 'no horizon', 'text', 'roads', 'roads with text', 'fields', 'fields with text')
KINDS += ('stills', 'stills with text')
"""Of the rows that are fitted; of these, those of simulated flights are left out as well."""
NEARBY = 4.0
"""Tolerances: a report that near is of the runway itself."""
RUNWAY_BOUNDS = ((None, None), (0.0, 1.0), (0.0, 2.5), (0.0, 1.5), (0.0, 1.5))
"""Of the offset and of the weights of `Report.of_the_runway`: log odds that were themselves fitted
count at most as such; few flights cannot tell how much attitude is worth."""
PLACE_BOUNDS = ((None, None), (1.5, 2.0))
"""Likewise of `Report.of_the_place`. Nearly all frames of the runs have clear lines, which say
where the edges are; what agreement is worth without them is from the version before."""
PENALTY = 1.0
WRONG_WEIGHT = 1.5
"""Of a report of what is no runway, beside a report of one: it does more harm than a missing one.
With 1 twice as many tuned stills are wrong, with 2 fewer flights without a horizon are right."""
BINS = np.linspace(0.0, 1.0, 9)


def read(path: Path) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """The rows of the tuning half and of the check half."""
    rows = [
        row
        for row in json.loads(path.read_text())
        if row['kind'] in KINDS and 'simulated' not in row['name']
    ]
    return [row for row in rows if not row['check']], [row for row in rows if row['check']]


def judged(row: dict[str, Any]) -> list[tuple[Report, float]]:
    """Reports of a row's frames and their errors in tolerances."""
    return [
        (Report(*frame['report']), frame['error'])
        for frame in row['frames']
        if frame['report'] is not None
        and not (row['name'].startswith('uav') and int(frame['name']) in UAV_RUNWAY)
    ]


def fit(rows: list[dict[str, Any]]) -> dict[str, list[float]]:
    """Weights of both functions; every row counts as much as any other, a still as one frame."""
    values, places, near, right, weights = [], [], [], [], []
    for row in rows:
        found = judged(row)
        still = row['name'].startswith('stills')
        for report, error in found:
            values.append(report.of_the_runway())
            near.append(error <= (1.0 if still else NEARBY))
            weights.append(1.0 if still else 100.0 / len(found))
            if not still and error <= NEARBY:
                places.append(report.of_the_place())
                right.append(error <= 1.0)
    counted = np.array(weights) * np.where(near, 1.0, WRONG_WEIGHT)
    runway = logistic(np.array(values), np.array(near, float), counted, RUNWAY_BOUNDS)
    ones = np.full(len(right), 100.0 * len(rows) / max(len(right), 1))
    place = logistic(np.array(places), np.array(right, float), ones, PLACE_BOUNDS)
    return {'runway': np.round(runway, 3).tolist(), 'place': np.round(place, 3).tolist()}


def logistic(
    values: NDArray[np.float64],
    right: NDArray[np.float64],
    weights: NDArray[np.float64],
    bounds: tuple[tuple[float | None, float | None], ...],
) -> NDArray[np.float64]:
    """Offset and weights of a logistic regression within bounds."""

    def loss(slopes: NDArray[np.float64]) -> float:
        odds = values @ slopes[1:] + slopes[0]
        likelihood = weights * (np.logaddexp(0.0, odds) - right * odds)
        return float(likelihood.sum() + 0.5 * PENALTY * (slopes[1:] ** 2).sum())

    start = np.zeros(values.shape[1] + 1)
    result: NDArray[np.float64] = minimize(loss, start, method='L-BFGS-B', bounds=bounds).x
    return result


def draw(halves: dict[str, list[dict[str, Any]]], weights: ConfidenceWeights, path: Path) -> None:
    """Share of right reports over confidence, with the number of frames in each bin."""
    mpl.use('Agg')
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(figsize=(6, 4.5), layout='constrained')
    axes.plot([0, 1], [0, 1], color='grey', linewidth=1)
    for name, rows in halves.items():
        pairs = [pair for row in rows for pair in judged(row)]
        confidence = np.array([weights.confidence(report) for report, _ in pairs])
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
    OUTPUT.write_text(json.dumps(data, indent=1) + '\n')
    print(found)
    if len(sys.argv) > 2:
        weights = ConfidenceWeights(np.array(found['runway']), np.array(found['place']))
        draw({'tuning half': tuning, 'check half': check}, weights, Path(sys.argv[2]))


if __name__ == '__main__':
    main()
