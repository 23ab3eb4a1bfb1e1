"""Figures 5.4 to 5.9."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mvuav_ros.offline.evaluation.marker_runs import FlownMarkers
from mvuav_ros.offline.evaluation.numbers import distance_rms
from mvuav_ros.offline.report.model import Figure
from mvuav_ros.offline.report.style import (
    COLORS,
    GRID,
    THESIS,
    TRUTH,
    drawing,
    label,
    legend_below,
    plain_log,
)
from mvuav_ros.offline.thesis import known
from mvuav_ros.offline.thesis.plan import RUNS, SHIPPED, THESIS_RUN, words
from mvuav_ros.vision.markers.results import TANKER_LABELS

MARKER_NAMES = tuple(words(label.name.lower()) for label in TANKER_LABELS)
_WING = len(MARKER_NAMES) - 1


def tracking_figures(steady: Sequence[FlownMarkers]) -> list[Figure]:
    """All of them, of the four trials without vibration."""
    rolling = [f for f in steady if 'roll' in f.settings.motion]
    return [
        _paths(steady),
        _positions(steady),
        _errors(steady, 'velocity', 'figure_5_6', '5.6'),
        _errors(steady, 'acceleration', 'figure_5_7', '5.7'),
        _rolls(rolling),
        _bars(steady),
    ]


def _paths(steady: Sequence[FlownMarkers]) -> Figure:
    with drawing(9.6, 7.6) as canvas:
        panels = canvas.figure.subplots(2, 2, sharex=True, sharey=True)
        for axes, flight in zip(panels.flat, steady, strict=True):
            found = flight.runs[THESIS_RUN].found
            for index, name in enumerate(MARKER_NAMES):
                color = COLORS[index]
                true = flight.places[:, index]
                axes.plot(true[:, 0], true[:, 1], color=color, lw=0.9, alpha=0.75)
                axes.plot(
                    found[:, index, 0], found[:, index, 1], '.', color=color, ms=3.2, label=name
                )
            axes.set_aspect('equal')
            axes.set_xlim(0, flight.settings.width)
            axes.set_ylim(flight.settings.height, 0)
            label(axes, words(flight.settings.motion))
        for axes in panels[-1]:
            axes.set_xlabel('x [px]')
        for axes in panels[:, 0]:
            axes.set_ylabel('y [px], down')
        legend_below(canvas.figure, panels.flat[0])
    return Figure(
        'figure_5_4',
        'Figure 5.4: estimated against actual position, on the frame',
        canvas.png,
        'paths of five markers in four trials',
        ('Dots: found; lines: truth. Axes are the whole frame.',),
    )


def _positions(steady: Sequence[FlownMarkers]) -> Figure:
    with drawing(9.6, 6.4) as canvas:
        panels = canvas.figure.subplots(2, len(steady), sharex=True)
        for column, flight in enumerate(steady):
            run = flight.runs[THESIS_RUN]
            for row, axis in enumerate('xy'):
                axes = panels[row, column]
                axes.plot(
                    flight.time, flight.places[:, _WING, row], color=TRUTH, lw=2.6, label='truth'
                )
                axes.plot(
                    flight.time, run.found[:, _WING, row], color=COLORS[5], lw=1.2, label='found'
                )
                axes.plot(
                    flight.time,
                    run.predicted[:, _WING, row],
                    '--',
                    color=COLORS[1],
                    lw=1.0,
                    label='predicted (velocity)',
                )
                title = words(flight.settings.motion) if row == 0 else ''
                label(axes, title, 'time [s]' if row else '', f'{axis} [px]' if not column else '')
        legend_below(canvas.figure, panels[0, 0])
    return Figure(
        'figure_5_5',
        'Figure 5.5: estimated against actual position over time, right wing',
        canvas.png,
        'x and y of the right wing over time in four trials',
        (
            'At this scale the three curves of each panel coincide; Figures 5.6 and 5.7 show the '
            'differences.',
        ),
    )


def _errors(steady: Sequence[FlownMarkers], method: str, key: str, number: str) -> Figure:
    with drawing(9.6, 5.4) as canvas:
        panels = canvas.figure.subplots(2, 2, sharex=True, sharey=True)
        for axes, flight in zip(panels.flat, steady, strict=True):
            error = flight.runs[method].prediction_error
            lengths = np.hypot(error[..., 0], error[..., 1])
            for index, name in enumerate(MARKER_NAMES):
                axes.plot(flight.time, lengths[:, index], color=COLORS[index], lw=0.7, label=name)
            against = flight.predicted_error(method)
            true = np.sqrt(np.mean(np.sum(against**2, axis=2), axis=1))
            axes.plot(flight.time, true, color=TRUTH, lw=1.6, label='against truth, rms of five')
            axes.axhline(
                known.PREDICTION_RMS_PX,
                color=THESIS,
                ls='--',
                lw=1.2,
                label="thesis's bound of the RMS",
            )
            pooled = distance_rms(error)
            label(axes, f'{words(flight.settings.motion)}: RMS {pooled:.3f} px')
        for axes in panels[-1]:
            axes.set_xlabel('time [s]')
        for axes in panels[:, 0]:
            axes.set_ylabel('error [px]')
        panels.flat[0].set_ylim(bottom=0)
        legend_below(canvas.figure, panels.flat[0], columns=4)
    return Figure(
        key,
        f'Figure {number}: error of prediction over time, {method}',
        canvas.png,
        f'distance between predicted and found markers over time, {method}',
        ('Thin: predicted minus found, by marker. Black: predicted minus truth.',),
    )


def _rolls(rolling: Sequence[FlownMarkers]) -> Figure:
    with drawing(9.6, 5.2) as canvas:
        panels = canvas.figure.subplots(
            2, len(rolling), sharex=True, sharey='row', height_ratios=(2, 1)
        )
        for column, flight in enumerate(rolling):
            upper, lower = panels[:, column]
            upper.plot(flight.time, np.degrees(flight.roll), color=TRUTH, lw=2.6, label='truth')
            upper.plot(
                flight.time,
                np.degrees(flight.runs[THESIS_RUN].roll),
                color=COLORS[5],
                lw=1.2,
                label='estimated',
            )
            label(upper, words(flight.settings.motion), '', '' if column else 'roll [°]')
            for name, color in ((THESIS_RUN, COLORS[1]), (SHIPPED, COLORS[2])):
                error = np.degrees(flight.roll_error(name))
                by = SHIPPED if name == SHIPPED else "the thesis's programs"
                lower.plot(flight.time, error, color=color, lw=0.8, label=f'error, {by}')
            lower.axhline(0.0, color=GRID, lw=1.0)
            label(lower, '', 'time [s]', '' if column else 'error [°]')
        legend_below(canvas.figure, panels[0, 0], panels[1, 0], columns=4)
    return Figure(
        'figure_5_8',
        'Figure 5.8: roll, estimated against actual, and its error',
        canvas.png,
        'roll and its error over time',
        (
            'Roll from the wings alone, as the thesis has it; truth is the roll between the '
            'projected wings.',
        ),
    )


def _bars(steady: Sequence[FlownMarkers]) -> Figure:
    with drawing(9.6, 5.8) as canvas:
        panels = canvas.figure.subplots(2, 2, sharex=True, sharey=True)
        width = 0.84 / len(RUNS)
        for axes, flight in zip(panels.flat, steady, strict=True):
            for number, method in enumerate(RUNS):
                error = flight.runs[method].prediction_error
                heights = [distance_rms(error[:, index]) for index in range(len(MARKER_NAMES))]
                offset = (number - 0.5 * (len(RUNS) - 1)) * width
                axes.bar(
                    np.arange(len(MARKER_NAMES)) + offset,
                    heights,
                    width,
                    color=COLORS[number],
                    label=words(method),
                )
            axes.axhline(
                known.PREDICTION_RMS_PX,
                color=THESIS,
                ls='--',
                lw=1.2,
                label='thesis: below 1 px in all trials',
            )
            plain_log(axes)
            axes.grid(axis='x', visible=False)
            axes.set_xticks(
                range(len(MARKER_NAMES)), [name.replace(' ', '\n') for name in MARKER_NAMES]
            )
            label(axes, words(flight.settings.motion))
        for axes in panels[:, 0]:
            axes.set_ylabel('RMS of prediction [px]')
        least = min(
            distance_rms(flight.runs[name].prediction_error) for flight in steady for name in RUNS
        )
        panels.flat[0].set_ylim(bottom=0.4 * max(least, 0.01))
        legend_below(canvas.figure, panels.flat[0], columns=4)
    return Figure(
        'figure_5_9',
        'Figure 5.9: RMS of prediction by marker, method and trial',
        canvas.png,
        'bars of the numbers of Table 5.3',
        (
            'The numbers of Table 5.3; logarithmic, because keeping the last position ("none") is '
            'so much worse.',
        ),
    )
