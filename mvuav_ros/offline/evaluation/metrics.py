"""One input's results in numbers: what the GUI counted, and errors where there is truth."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from mvuav_ros.offline.evaluation.comparison import line_errors, marker_errors, roll_errors
from mvuav_ros.offline.evaluation.evaluation_run import EvaluationRun, Rows
from mvuav_ros.offline.evaluation.line_errors import line_numbers
from mvuav_ros.offline.evaluation.numbers import distance_rms, rms
from mvuav_ros.vision.markers.results import MarkerState
from mvuav_ros.vision.runway.results import LineFlag, RunwayLine
from mvuav_ros.vision.runway.statistics import RunwayStatistics


class Metric(NamedTuple):
    """One number; metrics of one group are drawn together, since they have one unit."""

    group: str
    name: str
    unit: str
    value: float

    @property
    def cell(self) -> int | float:
        """The value; counts as whole numbers."""
        whole = not self.unit and self.value.is_integer()
        return int(self.value) if whole else self.value

    @property
    def column(self) -> str:
        """Name and unit."""
        return f'{self.name} [{self.unit}]' if self.unit else self.name


def name_and_unit(column: str) -> tuple[str, str]:
    """What `Metric.column` is made of; the unit is empty where there is none."""
    name, bracket, unit = column.partition(' [')
    return (name, unit.removesuffix(']')) if bracket else (column, '')


def metric_groups(runs: Iterable[Iterable[Metric]]) -> dict[str, list[str]]:
    """Columns by group, without those that have no number at all."""
    groups: dict[str, list[str]] = {}
    for metrics in runs:
        for metric in metrics:
            names = groups.setdefault(metric.group, [])
            if metric.column not in names and not math.isnan(metric.value):
                names.append(metric.column)
    return {group: names for group, names in groups.items() if names}


def metrics_of(run: EvaluationRun) -> list[Metric]:
    """Everything that can be said of an input's results."""
    rejected = math.nan if run.rejected is None else float(run.rejected)
    metrics = [
        Metric('frames', 'frames', '', float(run.frames)),
        Metric('frames', 'frames rejected', '', rejected),
        Metric('time per frame', 'time per frame', 'ms', run.milliseconds),
    ]
    if run.results.markers:
        states = np.concatenate([rows['state'] for rows in run.results.markers.values()])
        for state in (MarkerState.DETECTED, MarkerState.PREDICTED, MarkerState.LOST):
            share = 100.0 * int(np.count_nonzero(states == state)) / max(states.size, 1)
            name = f'markers {state.name.lower()}'
            metrics.append(Metric('markers by state', name, '%', share))
    rolls = np.array([roll for roll in run.results.rpy.values() if math.isfinite(roll)])
    if rolls.size:
        unwrapped = np.degrees(np.unwrap(rolls))
        deviation = float(np.std(unwrapped, ddof=1)) if rolls.size > 1 else math.nan
        metrics += [
            Metric('average roll', 'roll mean', '°', float(np.mean(unwrapped))),
            Metric('deviation of roll', 'roll std', '°', deviation),
        ]
    if run.results.lines:
        metrics += _line_statistics(run.results.lines.values())
    return metrics + _errors(run)


def _line_statistics(frames: Iterable[Rows]) -> list[Metric]:
    """By the node's own statistics, as ``~/statistics`` publishes them."""
    statistics = RunwayStatistics()
    for rows in frames:
        statistics.add([_line(row) for row in rows])
    summary = statistics.summary()
    metrics = [
        Metric('flag counts', 'rho flags', 'frames', float(summary.rho_flags)),
        Metric('flag counts', 'theta flags', 'frames', float(summary.theta_flags)),
        Metric('flag counts', 'combined flags', 'frames', float(summary.corrected)),
    ]
    for number, line in enumerate(summary.lines, 1):
        theta_mean, theta_std = math.degrees(line.theta_mean), math.degrees(line.theta_std)
        metrics += [
            Metric('average rho', f'line {number} rho mean', 'px', line.rho_mean),
            Metric('deviation of rho', f'line {number} rho std', 'px', line.rho_std),
            Metric('average theta', f'line {number} theta mean', '°', theta_mean),
            Metric('deviation of theta', f'line {number} theta std', '°', theta_std),
        ]
    return metrics


def _line(row: np.void) -> RunwayLine:
    flags = int(row['flags'])
    rho = float(row['rho'])
    return RunwayLine(
        peak=None if math.isnan(rho) else 0,
        rho=rho,
        theta=float(row['theta']),
        rho_flag=bool(flags & LineFlag.RHO_ERROR),
        theta_flag=bool(flags & LineFlag.THETA_ERROR),
    )


def _errors(run: EvaluationRun) -> list[Metric]:
    metrics = []
    markers = marker_errors(run)
    if markers is not None:
        for state in (MarkerState.DETECTED, MarkerState.PREDICTED):
            offset = np.where((markers.state == state)[..., None], markers.offset, np.nan)
            name = f'{state.name.lower()} markers, RMS error'
            metrics.append(Metric('error of markers', name, 'px', distance_rms(offset)))
        wrong = float(np.count_nonzero(markers.wrong))
        metrics.append(Metric('wrong names', 'wrong names', '', wrong))
    roll = roll_errors(run)
    if roll is not None:
        error = math.degrees(rms(roll.error))
        metrics.append(Metric('error of roll', 'roll, RMS error', '°', error))
    lines = line_errors(run)
    if lines is not None:
        share, distance, turned = line_numbers(lines.matches, max(sum(lines.visible), 1))
        metrics += [
            Metric('true lines found', 'true lines found', '%', share),
            Metric('error of lines', 'lines, RMS distance', 'px', distance),
            Metric('error of directions', 'lines, RMS direction', '°', turned),
        ]
    return metrics
