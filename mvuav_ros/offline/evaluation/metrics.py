"""Results against truth: errors frame by frame, and one input in numbers."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.offline.evaluation.evaluation_run import EvaluationRun, Rows
from mvuav_ros.vision.markers.marker_results import MarkerState
from mvuav_ros.vision.runway.normal_form import NormalForm
from mvuav_ros.vision.runway.results import LineFlag, LineRole, RunwayLine
from mvuav_ros.vision.runway.statistics import RunwayStatistics

Array = NDArray[np.floating[Any]]


def rms(values: Array) -> float:
    """Root mean square of the numbers that are not NaN; NaN if there are none."""
    known = values[np.isfinite(values)]
    return math.sqrt(float(np.mean(known**2))) if known.size else math.nan


def distance_rms(errors: Array) -> float:
    """Root mean square of the lengths of vectors (..., 2); those with NaN do not count."""
    return rms(np.hypot(errors[..., 0], errors[..., 1]))


def angle_difference(a: Array, b: Array | float) -> Array:
    """A minus b, rad, in [-pi, pi)."""
    return np.asarray((a - b + math.pi) % (2 * math.pi) - math.pi)


ALONG = (LineRole.LEFT_EDGE, LineRole.RIGHT_EDGE, LineRole.CENTRELINE)
"""The lines that a runway's detector looks for; a runway's ends run across."""
DISTANCE_LIMIT = 5.0
"""px; a line that passes farther off is another one."""
THETA_LIMIT = math.radians(3.0)


class TrueLine(NamedTuple):
    """A true line, and the point of it at which distances are taken, px."""

    line: NormalForm
    point: tuple[float, float]


class LineMatch(NamedTuple):
    """A line found with the true one that it is: indices, distance (px), difference (rad)."""

    found: int
    true: int
    distance: float
    dtheta: float


def match_lines(found: Sequence[NormalForm], true: Sequence[TrueLine]) -> list[LineMatch]:
    """Pair lines that are close at the true line's point and in direction, the closest first.

    Lines with NaN match nothing; each line occurs in one pair at most.
    """
    pairs = []
    for number, line in enumerate(found):
        for index, (truth, (x, y)) in enumerate(true):
            distance = x * math.cos(line.theta) + y * math.sin(line.theta) - line.rho
            # The same line may be written with theta turned by half a circle.
            dtheta = (line.theta - truth.theta + math.pi / 2) % math.pi - math.pi / 2
            if abs(distance) <= DISTANCE_LIMIT and abs(dtheta) <= THETA_LIMIT:
                pairs.append(LineMatch(number, index, distance, dtheta))
    matched: list[LineMatch] = []
    for pair in sorted(pairs, key=lambda p: abs(p.distance)):
        if all(pair.found != m.found and pair.true != m.true for m in matched):
            matched.append(pair)
    return matched


@dataclass(eq=False)
class LineErrors:
    """Lines found on some frames against the true ones of a runway."""

    frames: int = 0  # seen
    found: int = 0  # lines found in all frames
    visible: list[int] = field(default_factory=lambda: [0] * len(ALONG))  # frames with each
    matches: list[LineMatch] = field(default_factory=list)

    def add(self, found: Sequence[NormalForm], true: Sequence[TrueLine]) -> list[LineMatch]:
        """Match a frame's lines to those of `ALONG`, which are NaN where the frame has none."""
        in_view = [math.isfinite(line.line.rho) for line in true]
        self.frames += 1
        self.found += sum(math.isfinite(line.rho) for line in found)
        self.visible = [n + seen for n, seen in zip(self.visible, in_view, strict=True)]
        matches = match_lines(found, true)
        self.matches += matches
        return matches

    def numbers(self, *which: int) -> tuple[float, float, float]:
        """Of true lines, by their indices in `ALONG`; of all without.

        Percent of the frames that show a line in which it was found; RMS of its error, px and °.
        """
        which = which or tuple(range(len(ALONG)))
        own = [match for match in self.matches if match.true in which]
        visible = sum(self.visible[index] for index in which)
        return (
            100.0 * len(own) / visible if visible else math.nan,
            rms(np.array([match.distance for match in own])),
            math.degrees(rms(np.array([match.dtheta for match in own]))),
        )


NEAR = 5.0
"""px; a marker within this of another light's true place, and not of its own, is a wrong name."""


@dataclass(frozen=True, eq=False)
class MarkerErrors:
    """Of the n frames that have results and truth, and their k markers."""

    names: tuple[str, ...]
    time: Array  # (n,) s since the first of them
    offset: Array  # (n, k, 2) px, place minus true place; NaN for a lost marker
    state: Array  # (n, k), `MarkerState`
    visible: Array  # (n, k), whether the light could be seen
    wrong: Array  # (n, k), whether a detected marker carries another's name


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


@dataclass(frozen=True, eq=False)
class PoseErrors:
    """By frame, (n,) each; NaN without a pose."""

    place: Array  # m
    share: Array  # of the true distance
    turn: Array  # rad


def marker_errors(run: EvaluationRun) -> MarkerErrors | None:
    """Markers against truth; None where one of them is missing, or the markers have no names."""
    results, truth = run.results.markers, run.truth.markers
    stamps = sorted(results.keys() & truth.keys())
    labels = next((truth[stamp]['label'] for stamp in stamps if len(truth[stamp])), np.array(()))
    stamps = [
        stamp
        for stamp in stamps
        if all(np.array_equal(rows[stamp]['label'], labels) for rows in (results, truth))
    ]
    if not labels.size or not stamps:
        return None
    found = np.array([_places(results[stamp]) for stamp in stamps])
    true = np.array([_places(truth[stamp]) for stamp in stamps])
    state = np.array([results[stamp]['state'] for stamp in stamps])
    seen = np.array([truth[stamp]['state'] for stamp in stamps]) == MarkerState.DETECTED
    numbers = range(found.shape[1])
    names = (run.names.get(label, f'marker {label}').replace('_', ' ') for label in numbers)
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


def pose_errors(run: EvaluationRun) -> PoseErrors | None:
    """Poses against truth; None where one of them is missing, or in another frame."""
    results, truth = run.results.poses, run.truth.poses
    stamps = sorted(s for s in results.keys() & truth.keys() if results[s][0] == truth[s][0])
    if not stamps:
        return None
    found, true = (np.array([poses[stamp][1] for stamp in stamps]) for poses in (results, truth))
    place, distance = (np.linalg.norm(p[:, :3], axis=1) for p in (found - true, true))
    with np.errstate(invalid='ignore', divide='ignore'):
        lengths = np.linalg.norm(found[:, 3:], axis=1) * np.linalg.norm(true[:, 3:], axis=1)
        # Opposite quaternions are the same attitude; one of zeros is none.
        half = np.arccos(np.minimum(np.abs((found * true)[:, 3:].sum(axis=1)) / lengths, 1.0))
        return PoseErrors(place, place / distance, 2.0 * half)


def line_errors(run: EvaluationRun) -> LineErrors | None:
    """Lines against truth; None where one of them is missing."""
    results, truth = run.results.lines, run.truth.lines
    stamps = sorted(results.keys() & truth.keys())
    if not stamps:
        return None
    errors = LineErrors()
    for stamp in stamps:
        errors.add([_form(row) for row in results[stamp]], _true_lines(truth[stamp]))
    return errors


def is_compared(run: EvaluationRun) -> bool:
    """Whether any of its results are of what its truth is of."""
    errors_of = (marker_errors, roll_errors, pose_errors, line_errors)
    return any(errors(run) is not None for errors in errors_of)


_NOWHERE = NormalForm(math.nan, math.nan)


def _form(row: np.void) -> NormalForm:
    """A row's line; `_NOWHERE` where it has none, or a damaged message says something else."""
    rho, theta = float(row['rho']), float(row['theta'])
    return NormalForm(rho, theta) if math.isfinite(rho) and math.isfinite(theta) else _NOWHERE


def _true_lines(rows: Rows) -> list[TrueLine]:
    """The first rows of ``/truth/lines``, which are those of `ALONG`; what is not there is NaN."""
    lines = [
        TrueLine(_form(row), (0.5 * float(row['x'] + row['x2']), 0.5 * float(row['y'] + row['y2'])))
        for row in rows[: len(ALONG)]
    ]
    nowhere = TrueLine(_NOWHERE, (math.nan, math.nan))
    return [*lines, *[nowhere] * (len(ALONG) - len(lines))]


def _places(rows: Rows) -> Array:
    return np.stack([rows['x'], rows['y']], axis=1).astype(float)


def _seconds(stamps: Sequence[int]) -> Array:
    return np.array([(stamp - stamps[0]) * 1e-9 for stamp in stamps])


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
        # About where they point together: a roll that goes through 180° is no leap.
        middle = float(np.angle(np.exp(1j * rolls).sum()))
        apart = angle_difference(rolls, middle)
        mean = math.degrees(math.remainder(middle + float(apart.mean()), math.tau))
        deviation = math.degrees(np.std(apart, ddof=1)) if rolls.size > 1 else math.nan
        metrics += [
            Metric('average roll', 'roll mean', '°', mean),
            Metric('deviation of roll', 'roll std', '°', deviation),
        ]
    if run.results.lines:
        metrics += _line_statistics(run.results.lines.values())
    return metrics + _errors(run)


def _line_statistics(frames: Iterable[Rows]) -> list[Metric]:
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
    form = _form(row)
    return RunwayLine(
        peak=None if form is _NOWHERE else 0,
        rho=form.rho,
        theta=form.theta,
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
    pose = pose_errors(run)
    if pose is not None:
        metrics += [
            Metric('poses', 'poses', '%', 100.0 * float(np.isfinite(pose.place).mean())),
            Metric('error of pose', 'pose, RMS error', 'mm', 1000.0 * rms(pose.place)),
            Metric('relative error', 'pose, RMS error/distance', '%', 100.0 * rms(pose.share)),
            Metric('error of attitude', 'attitude, RMS error', '°', math.degrees(rms(pose.turn))),
        ]
    lines = line_errors(run)
    if lines is not None:
        share, distance, turned = lines.numbers()
        metrics += [
            Metric('true lines found', 'true lines found', '%', share),
            Metric('error of lines', 'lines, RMS distance', 'px', distance),
            Metric('error of directions', 'lines, RMS direction', '°', turned),
        ]
    return metrics
