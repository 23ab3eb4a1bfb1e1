"""Results against truth, frame by frame."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mvuav_ros.offline.evaluation.evaluation_run import EvaluationRun, Rows
from mvuav_ros.offline.evaluation.line_errors import ALONG, LineErrors, TrueLine
from mvuav_ros.offline.evaluation.numbers import Array, angle_difference
from mvuav_ros.vision.markers.results import MarkerState
from mvuav_ros.vision.runway.normal_form import NormalForm

NEAR = 5.0
"""px; a marker within this of another light's true place, and not of its own, is a wrong name."""


@dataclass(frozen=True, eq=False)
class MarkerErrors:
    """Of the frames that have results and truth.

    Attributes:
        names: of the k markers.
        time: (n,) s since the first of them.
        offset: (n, k, 2) px, place minus true place; NaN for a lost marker.
        state: (n, k), `MarkerState`.
        visible: (n, k), whether the light could be seen.
        wrong: (n, k), whether a detected marker carries another's name.
    """

    names: tuple[str, ...]
    time: Array
    offset: Array
    state: Array
    visible: Array
    wrong: Array


@dataclass(frozen=True, eq=False)
class RollErrors:
    """Time (s), measured and true roll (rad), and their difference; NaN where not measured.

    Frames without a true roll are left out.
    """

    time: Array
    measured: Array
    true: Array

    @property
    def error(self) -> Array:
        """Measured minus true, rad."""
        return angle_difference(self.measured, self.true)


def marker_errors(run: EvaluationRun) -> MarkerErrors | None:
    """Markers against truth; None where one of them is missing, or the markers have no names."""
    results, truth = run.results.markers, run.truth.markers
    stamps = [
        stamp
        for stamp in sorted(results.keys() & truth.keys())
        if np.array_equal(results[stamp]['label'], truth[stamp]['label'])
    ]
    if not stamps:
        return None
    found = np.array([_places(results[stamp]) for stamp in stamps])
    true = np.array([_places(truth[stamp]) for stamp in stamps])
    state = np.array([results[stamp]['state'] for stamp in stamps])
    seen = np.array([truth[stamp]['state'] for stamp in stamps]) == MarkerState.DETECTED
    labels = range(found.shape[1])
    names = (run.names.get(label, f'marker {label}').replace('_', ' ') for label in labels)
    wrong = _wrong_names(found, true, state)
    return MarkerErrors(tuple(names), _seconds(stamps), found - true, state, seen, wrong)


def _wrong_names(found: Array, true: Array, state: Array) -> Array:
    apart = np.hypot(*np.moveaxis(found[:, :, None] - true[:, None], -1, 0))
    own = np.diagonal(apart, axis1=1, axis2=2)
    nearest = np.where(np.isnan(apart), np.inf, apart).min(axis=2)
    return np.asarray((state == MarkerState.DETECTED) & ~(own <= NEAR) & (nearest <= NEAR))


def roll_errors(run: EvaluationRun) -> RollErrors | None:
    """Roll against truth; None where one of them is missing."""
    results, truth = run.results.rpy, run.truth.rpy
    stamps = sorted(s for s in results.keys() & truth.keys() if math.isfinite(truth[s]))
    if not stamps:
        return None
    return RollErrors(
        _seconds(stamps),
        np.array([results[stamp] for stamp in stamps]),
        np.array([truth[stamp] for stamp in stamps]),
    )


def line_errors(run: EvaluationRun) -> LineErrors | None:
    """Lines against truth; None where one of them is missing."""
    results, truth = run.results.lines, run.truth.lines
    stamps = sorted(results.keys() & truth.keys())
    if not stamps:
        return None
    errors = LineErrors()
    for stamp in stamps:
        lines = [NormalForm(float(row['rho']), float(row['theta'])) for row in results[stamp]]
        errors.add(lines, _true_lines(truth[stamp]))
    return errors


def _true_lines(rows: Rows) -> list[TrueLine]:
    """The first rows of ``/truth/lines``, which are those of `ALONG`."""
    return [
        TrueLine(
            NormalForm(float(row['rho']), float(row['theta'])),
            (0.5 * float(row['x'] + row['x2']), 0.5 * float(row['y'] + row['y2'])),
        )
        for row in rows[: len(ALONG)]
    ]


def _places(rows: Rows) -> Array:
    return np.stack([rows['x'], rows['y']], axis=1).astype(float)


def _seconds(stamps: Sequence[int]) -> Array:
    return np.array([(stamp - stamps[0]) * 1e-9 for stamp in stamps])
