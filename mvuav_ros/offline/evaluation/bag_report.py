"""A recording's results against its truth, as a report."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

import mvuav_ros
from mvuav_ros.offline.evaluation.comparison import (
    NEAR,
    LineErrors,
    MarkerErrors,
    RollErrors,
    line_errors,
    marker_errors,
    roll_errors,
)
from mvuav_ros.offline.evaluation.evaluation_run import EvaluationRun
from mvuav_ros.offline.evaluation.line_errors import DISTANCE_LIMIT, THETA_LIMIT
from mvuav_ros.offline.evaluation.metrics import metrics_of
from mvuav_ros.offline.evaluation.numbers import distance_rms, rms
from mvuav_ros.offline.report.model import Cell, Column, Figure, Report, Section, Table
from mvuav_ros.offline.report.style import COLORS, TRUTH, drawing, label, legend_below, line_of
from mvuav_ros.vision.markers.results import MarkerState


def bag_report(run: EvaluationRun, settings: Mapping[str, Cell]) -> Report:
    """Every error that results and truth allow.

    Args:
        run: one input.
        settings: shown besides version and input.
    """
    sections = [_everything(run)]
    markers = marker_errors(run)
    if markers is not None:
        sections.append(Section('Markers', (), (_marker_table(markers), _marker_figure(markers))))
    roll = roll_errors(run)
    if roll is not None:
        sections.append(Section('Roll', (), (_roll_table(roll), _roll_figure(roll))))
    elif run.results.rpy:
        sections.append(Section('Roll', ('The truth holds no roll for these frames.',), ()))
    lines = line_errors(run)
    if lines is not None:
        sections.append(Section('Runway lines', (), (_line_table(lines),)))
    return Report(
        f'Results against truth: {run.name}',
        tuple(f'Could not be read: {error}' for error in run.errors),
        {'version': f'mvuav_ros {mvuav_ros.__version__}', 'input': run.name, **settings},
        (),
        tuple(sections),
    )


def _everything(run: EvaluationRun) -> Section:
    metrics = [metric for metric in metrics_of(run) if not math.isnan(metric.value)]
    table = Table(
        'metrics',
        'All numbers',
        (Column('what'), Column('value', '', 4), Column('unit')),
        tuple((metric.name, metric.cell, metric.unit) for metric in metrics),
        ('Statistics as the runway GUI has them, and errors where there is truth.',),
    )
    return Section('Overview', (), (table,))


def _marker_table(errors: MarkerErrors) -> Table:
    rows: list[tuple[Cell, ...]] = []
    for index, name in enumerate([*errors.names, f'all {len(errors.names)}']):
        one = slice(index, index + 1) if index < len(errors.names) else slice(None)
        state, offset = errors.state[:, one], errors.offset[:, one]
        counts = [100.0 * float(np.mean(state == kind)) for kind in _ORDER]
        found, predicted = (
            np.where((state == kind)[..., None], offset, np.nan) for kind in _ORDER[:2]
        )
        rows.append(
            (
                name,
                100.0 * float(np.mean(errors.visible[:, one])),
                *counts,
                int(np.count_nonzero(errors.wrong[:, one])),
                rms(found[..., 0]),
                rms(found[..., 1]),
                distance_rms(found),
                distance_rms(predicted),
            )
        )
    return Table(
        'markers',
        f'Markers in {len(errors.time)} frames',
        (
            Column('marker'),
            Column('visible', '%', 1),
            Column('detected', '%', 1),
            Column('predicted', '%', 1),
            Column('lost', '%', 1),
            Column('wrong names', 'frames'),
            Column('detected, x RMS', 'px'),
            Column('detected, y RMS', 'px'),
            Column('detected, RMS', 'px'),
            Column('predicted, RMS', 'px'),
        ),
        tuple(rows),
        (
            'Errors are places minus true places; RMS without an axis is of the distance. A name '
            f'is wrong where a marker lies within {NEAR:g} px of another light and not of its own.',
        ),
    )


_ORDER = (MarkerState.DETECTED, MarkerState.PREDICTED, MarkerState.LOST)


def _marker_figure(errors: MarkerErrors) -> Figure:
    distance = np.hypot(errors.offset[..., 0], errors.offset[..., 1])
    with drawing(9.6, 4.0) as canvas:
        axes = canvas.figure.subplots()
        for index, name in enumerate(errors.names):
            detected = errors.state[:, index] == MarkerState.DETECTED
            predicted = errors.state[:, index] == MarkerState.PREDICTED
            values = distance[:, index]
            axes.plot(errors.time, np.where(detected, values, np.nan), **line_of(index), label=name)
            color = line_of(index)['color']
            axes.plot(errors.time[predicted], values[predicted], 'x', color=color, ms=5)
        axes.plot([], [], 'x', color=TRUTH, label='predicted')
        axes.set_ylim(bottom=0)
        label(axes, '', 'time [s]', 'distance from truth [px]')
        legend_below(canvas.figure, axes)
    return Figure('markers_over_time', 'Distance of the markers from truth', canvas.png)


def _roll_table(errors: RollErrors) -> Table:
    known = np.isfinite(errors.error)
    worst = float(np.max(np.abs(errors.error[known]))) if known.any() else math.nan
    row = (
        len(errors.time),
        100.0 * float(np.mean(known)),
        math.degrees(float(np.mean(errors.error[known]))) if known.any() else math.nan,
        math.degrees(rms(errors.error)),
        math.degrees(worst),
    )
    return Table(
        'roll',
        'Roll',
        (
            Column('frames'),
            Column('measured', '%', 1),
            Column('mean error', '°', 4),
            Column('RMS error', '°', 4),
            Column('greatest error', '°', 4),
        ),
        (row,),
    )


def _roll_figure(errors: RollErrors) -> Figure:
    with drawing(9.6, 4.6) as canvas:
        upper, lower = canvas.figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
        upper.plot(errors.time, np.degrees(errors.true), color=TRUTH, lw=2.6, label='truth')
        upper.plot(errors.time, np.degrees(errors.measured), color=COLORS[5], label='measured')
        lower.plot(errors.time, np.degrees(errors.error), color=COLORS[1], label='error')
        label(upper, '', '', 'roll [°]')
        label(lower, '', 'time [s]', 'error [°]')
        legend_below(canvas.figure, upper, lower)
    return Figure('roll_over_time', 'Roll and its error', canvas.png)


def _line_table(errors: LineErrors) -> Table:
    rows: list[tuple[Cell, ...]] = []
    for index, name in enumerate(errors.names):
        matches = errors.of(index)
        visible = errors.visible[index]
        rows.append(
            (
                name,
                visible,
                100.0 * len(matches) / visible if visible else math.nan,
                rms(np.array([match.distance for match in matches])),
                math.degrees(rms(np.array([match.dtheta for match in matches]))),
            )
        )
    return Table(
        'lines',
        f'Runway lines in {errors.frames} frames',
        (
            Column('line'),
            Column('visible', 'frames'),
            Column('found', '%', 1),
            Column('distance, RMS', 'px', 2),
            Column('direction, RMS', '°', 2),
        ),
        tuple(rows),
        (
            f'{errors.found} lines were reported. One is found when it passes within '
            f'{DISTANCE_LIMIT:g} px of the middle of the true segment and within '
            f'{math.degrees(THETA_LIMIT):g}° of its direction.',
        ),
    )
