"""A recording's results against its truth, as a report."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from mvuav_ros.offline.evaluation import metrics
from mvuav_ros.offline.evaluation.evaluation_run import EvaluationRun
from mvuav_ros.offline.report import Cell, Figure, Report, Section, Table
from mvuav_ros.offline.report_figures import COLORS, TRUTH, drawing, label, legend_below, line_of
from mvuav_ros.vision.markers.marker_results import MarkerState


def bag_report(run: EvaluationRun, settings: Mapping[str, Cell]) -> Report:
    """Every error that results and truth allow; settings are shown besides version and input."""
    numbers = Table.of(
        'metrics',
        'All numbers',
        'what | value .4 | unit',
        [(m.name, m.cell, m.unit) for m in metrics.metrics_of(run) if not math.isnan(m.value)],
        'Statistics as the runway GUI has them, and errors where there is truth.',
    )
    sections = [Section('Overview', (), (numbers,))]
    if (markers := metrics.marker_errors(run)) is not None:
        sections.append(Section('Markers', (), (_marker_table(markers), _marker_figure(markers))))
    if (roll := metrics.roll_errors(run)) is not None:
        sections.append(Section('Roll', (), (_roll_table(roll), roll_figure(roll))))
    elif run.results.rpy:
        sections.append(Section('Roll', ('The truth holds no roll for these frames.',)))
    if (pose := metrics.pose_errors(run)) is not None:
        sections.append(Section('Pose', (), (_pose_table(pose),)))
    if (lines := metrics.line_errors(run)) is not None:
        sections.append(Section('Runway lines', (), (_line_table(lines),)))
    return Report(
        f'Results against truth: {run.name}',
        tuple(f'Not all is in it: {error}' for error in run.errors),
        {'input': run.name, **settings},
        tuple(sections),
    )


def _marker_table(errors: metrics.MarkerErrors) -> Table:
    rows: list[tuple[Cell, ...]] = []
    for index, name in enumerate([*errors.names, f'all {len(errors.names)}']):
        one = slice(index, index + 1) if index < len(errors.names) else slice(None)
        state, offset = errors.state[:, one], errors.offset[:, one]
        found, predicted = (
            np.where((state == kind)[..., None], offset, np.nan) for kind in _ORDER[:2]
        )
        rows.append(
            (
                name,
                100.0 * float(np.mean(errors.visible[:, one])),
                *(100.0 * float(np.mean(state == kind)) for kind in _ORDER),
                int(np.count_nonzero(errors.wrong[:, one])),
                metrics.rms(found[..., 0]),
                metrics.rms(found[..., 1]),
                metrics.distance_rms(found),
                metrics.distance_rms(predicted),
            )
        )
    return Table.of(
        'markers',
        f'Markers in {len(errors.time)} frames',
        'marker | visible [%] .1 | detected [%] .1 | predicted [%] .1 | lost [%] .1 '
        '| wrong names [frames] | detected, x RMS [px] | detected, y RMS [px] '
        '| detected, RMS [px] | predicted, RMS [px]',
        rows,
        'Errors are places minus true places; RMS without an axis is of the distance. A name '
        f'is wrong where a marker lies within {metrics.NEAR:g} px of another light and not of its '
        'own.',
    )


_ORDER = (MarkerState.DETECTED, MarkerState.PREDICTED, MarkerState.LOST)


def _marker_figure(errors: metrics.MarkerErrors) -> Figure:
    distance = np.hypot(errors.offset[..., 0], errors.offset[..., 1])
    with drawing(9.6, 4.0) as canvas:
        axes = canvas.figure.subplots()
        for index, name in enumerate(errors.names):
            state, values = errors.state[:, index], distance[:, index]
            detected = np.where(state == MarkerState.DETECTED, values, np.nan)
            predicted = state == MarkerState.PREDICTED
            look = line_of(index)
            axes.plot(errors.time, detected, **look, label=name)
            axes.plot(errors.time[predicted], values[predicted], 'x', color=look['color'], ms=5)
        axes.plot([], [], 'x', color=TRUTH, label='predicted')
        axes.set_ylim(bottom=0)
        label(axes, '', 'time [s]', 'distance from truth [px]')
        legend_below(canvas.figure, axes)
    return Figure('markers_over_time', 'Distance of the markers from truth', canvas.png)


def _roll_table(errors: metrics.RollErrors) -> Table:
    known = errors.error[np.isfinite(errors.error)]
    row = (
        len(errors.time),
        100.0 * known.size / len(errors.time),
        math.degrees(float(np.mean(known))) if known.size else math.nan,
        math.degrees(metrics.rms(known)),
        math.degrees(_greatest(known)),
    )
    return Table.of(
        'roll',
        'Roll',
        'frames | measured [%] .1 | mean error [°] .4 | RMS error [°] .4 | greatest error [°] .4',
        [row],
    )


def _greatest(values: metrics.Array) -> float:
    return float(max(np.abs(values[np.isfinite(values)]), default=math.nan))


def roll_figure(errors: metrics.RollErrors) -> Figure:
    """Roll and true roll over time, and the error below."""
    with drawing(9.6, 4.6) as canvas:
        upper, lower = canvas.figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
        upper.plot(errors.time, np.degrees(errors.true), color=TRUTH, lw=2.6, label='truth')
        upper.plot(errors.time, np.degrees(errors.measured), color=COLORS[5], label='measured')
        lower.plot(errors.time, np.degrees(errors.error), color=COLORS[1], label='error')
        label(upper, '', '', 'roll [°]')
        label(lower, '', 'time [s]', 'error [°]')
        legend_below(canvas.figure, upper, lower)
    return Figure('roll_over_time', 'Roll and its error', canvas.png)


def _pose_table(errors: metrics.PoseErrors) -> Table:
    known = np.isfinite(errors.place)
    row: list[Cell] = [len(known), 100.0 * float(known.mean())]
    for values in (1000.0 * errors.place, 100.0 * errors.share, np.degrees(errors.turn)):
        row += [metrics.rms(values), _greatest(values)]
    return Table.of(
        'pose',
        'Pose',
        'frames | poses [%] .1 | RMS error [mm] .2 | greatest [mm] .2 | RMS error/distance [%] .3 '
        '| greatest [%] .3 | attitude, RMS error [°] .3 | greatest [°] .3',
        [tuple(row)],
    )


def _line_table(errors: metrics.LineErrors) -> Table:
    return Table.of(
        'lines',
        f'Runway lines in {errors.frames} frames',
        'line | visible [frames] | found [%] .1 | distance, RMS [px] .2 | direction, RMS [°] .2',
        [
            (role.name.lower().replace('_', ' '), errors.visible[index], *errors.numbers(index))
            for index, role in enumerate(metrics.ALONG)
        ],
        f'{errors.found} lines were reported. One is found when it passes within '
        f'{metrics.DISTANCE_LIMIT:g} px of the middle of the true segment and within '
        f'{math.degrees(metrics.THETA_LIMIT):g}° of its direction.',
    )
