"""Figures 5.4 to 5.9, and the error bars of Appendix C."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mvuav_ros.offline.evaluation.metrics import Array
from mvuav_ros.offline.report import Figure
from mvuav_ros.offline.report_figures import (
    COLORS,
    THESIS,
    TRUTH,
    drawing,
    label,
    legend_below,
)
from mvuav_thesis import known
from mvuav_thesis.comparison import SHIPPED
from mvuav_thesis.panels import quartet
from mvuav_thesis.plan import PROGRAM, PROGRAM_OF
from mvuav_thesis.trials import FlownMarkers, Trial, lengths

LEFT_WING = 0
ESTIMATED, ACTUAL = COLORS[1], COLORS[0]
START, END = COLORS[2], THESIS
_TURN_REACH = 9
"""Frames shown before and after the turn."""
_SHORT_NAMES = [name.replace(' ', '\n') for name in known.MARKERS]


def tracking_figures(trials: Sequence[Trial]) -> list[Figure]:
    """All of them; the estimates are those of the program of Appendix C, as in the thesis."""
    return [
        _paths(trials),
        _coordinates(trials),
        _turn(trials[0]),
        _errors(trials),
        _rolls(trials),
        _bars(trials),
        _error_bars(trials),
    ]


def _paths(trials: Sequence[Trial]) -> Figure:
    with quartet(_titles(trials), 7.8, 'x [px]', 'y [px], down') as (canvas, panels):
        for axes, trial in zip(panels, trials, strict=True):
            flight = trial.first
            run = flight.runs[PROGRAM]
            for index in range(len(known.MARKERS)):
                estimated, actual = run.predicted[:, index], run.found[:, index]
                axes.plot(*estimated.T, color=ESTIMATED, lw=1.0, label='estimated')
                axes.plot(*actual.T, color=ACTUAL, lw=0.9, label='actual')
                axes.plot(*_first(actual), 'o', color=START, ms=5, label='start')
                axes.plot(*_first(actual[::-1]), 'o', color=END, ms=5, label='end')
            axes.set_aspect('equal')
            axes.set_xlim(0, flight.settings.width)
            axes.set_ylim(flight.settings.height, 0)
    return canvas.as_figure(
        'figure_5_4',
        'Figure 5.4: estimated against actual position, all trials',
        'paths of five markers in four trials with start and end',
        'Full estimation (program of Appendix C). Axes are the whole frame.',
    )


def _first(places: Array) -> Array:
    seen = places[np.isfinite(places).all(axis=1)]
    return seen[0] if len(seen) else np.full(2, np.nan)


def _coordinates(trials: Sequence[Trial]) -> Figure:
    with drawing(9.6, 5.6) as canvas:
        panels = canvas.figure.subplots(2, 2, sharex=True, squeeze=False)
        for column, trial in enumerate((trials[2], trials[1])):
            run = trial.first.runs[PROGRAM]
            frames = np.arange(1, len(trial.first.time) + 1)
            for row, axis in enumerate('xy'):
                axes = panels[row, column]
                estimated, actual = run.predicted[:, LEFT_WING, row], run.found[:, LEFT_WING, row]
                axes.plot(frames, estimated, color=ESTIMATED, lw=1.2, label='estimated')
                axes.plot(frames, actual, color=ACTUAL, lw=1.0, label='actual')
                title = '' if row else trial.title
                label(axes, title, 'frame' if row else '', '' if column else f'{axis} [px]')
        legend_below(canvas.figure, panels[0, 0])
    return canvas.as_figure(
        'figure_5_5',
        'Figure 5.5: estimated against actual coordinates of the left wing',
        'x and y of the left wing over the frames of trials 3 and 2',
        "The thesis's caption says trial 3, its text trial 2: both are drawn.",
    )


def _turn(trial: Trial) -> Figure:
    run = trial.first.runs[PROGRAM]
    places = run.found[:, LEFT_WING]
    middle = turning_frame(places)
    shown = slice(max(middle - _TURN_REACH, 0), middle + _TURN_REACH + 1)
    with drawing(9.6, 4.4) as canvas:
        axes = canvas.figure.subplots()
        axes.plot(
            *run.predicted[shown, LEFT_WING].T, 'o-', color=ESTIMATED, ms=4, label='estimated'
        )
        axes.plot(*places[shown].T, 'o-', color=ACTUAL, ms=4, label='actual')
        axes.invert_yaxis()
        axes.set_aspect('equal', adjustable='datalim')
        label(axes, '', 'x [px]', 'y [px], down')
        legend_below(canvas.figure, axes)
    return canvas.as_figure(
        'figure_5_6',
        'Figure 5.6: estimated against actual position of the left wing where it turns, trial 1',
        'the path of the left wing around the frame in which it turns',
        f'Frames {shown.start + 1} to {shown.stop}, around the slowest one.',
    )


def turning_frame(places: Array) -> int:
    """The frame between the ends of a path (n, 2) at which it is slowest."""
    steps = np.hypot(*np.diff(places, axis=0).T)
    inner = steps[_TURN_REACH:-_TURN_REACH]
    if not np.isfinite(inner).any():
        return len(places) // 2
    return int(np.nanargmin(inner)) + _TURN_REACH


def _errors(trials: Sequence[Trial]) -> Figure:
    said = []
    with quartet(_titles(trials), 5.8, 'frame', 'error [px]') as (canvas, panels):
        for axes, trial in zip(panels, trials, strict=True):
            distances = lengths(trial.first, PROGRAM)
            frames = np.arange(1, len(distances) + 1)
            for index, name in enumerate(known.MARKERS):
                axes.plot(frames, distances[:, index], color=COLORS[index], lw=0.8, label=name)
            axes.axhline(known.ERROR_PX, color=THESIS, ls='--', lw=1.2, label='2 px')
            seen = distances[np.isfinite(distances)]
            said.append(f'trial {trial.number}: {inside_text(seen)}')
        panels[0].set_ylim(bottom=0)
    return canvas.as_figure(
        'figure_5_7',
        'Figure 5.7: error of the estimated positions, absolute distance',
        'distance between estimated and actual places over the frames of four trials',
        f'Full estimation (program of Appendix C). Below 2 px: {"; ".join(said)}.',
    )


def _rolls(trials: Sequence[Trial]) -> Figure:
    with quartet(_titles(trials), 5.4, 'frame', 'roll [°]', sharey=False) as (canvas, panels):
        for axes, trial in zip(panels, trials, strict=True):
            flight = trial.first
            frames = np.arange(1, len(flight.time) + 1)
            axes.plot(frames, np.degrees(flight.roll), color=TRUTH, lw=2.6, label='truth')
            measured = np.degrees(flight.runs[PROGRAM].roll)
            axes.plot(frames, measured, color=COLORS[5], lw=1.2, label='measured')
    missing = sum(int(np.isnan(t.first.runs[PROGRAM].roll).sum()) for t in trials)
    return canvas.as_figure(
        'figure_5_8',
        'Figure 5.8: roll measured from the wings, all trials',
        'roll over the frames of four trials',
        f'Frames without a roll: {missing}. Truth is the roll between the projected wings.',
    )


def inside_text(errors: Array) -> str:
    """The share of errors (n,) below `known.ERROR_PX`, with its counts."""
    inside, count = np.sum(errors < known.ERROR_PX), len(errors)
    return f'{100 * inside / count:.2f} % ({inside} of {count})' if count else 'none'


def _bars(trials: Sequence[Trial]) -> Figure:
    colors = (*COLORS[:2], *COLORS[:3])
    y = 'RMS of prediction [px]'
    with quartet(_titles(trials), 6.4, '', y, columns=3) as (canvas, panels):
        for axes, trial in zip(panels, trials, strict=True):
            heights = {
                f'{kind}, thesis': [
                    known.cell('table_5_3', f'Trial {trial.number}, {kind}', marker).value
                    for marker in known.MARKERS
                ]
                for kind in known.ESTIMATIONS
            }
            heights |= {
                f'{kind}, here': trial.rms(PROGRAM_OF[kind]).tolist() for kind in known.ESTIMATIONS
            }
            heights[SHIPPED] = trial.rms(SHIPPED).tolist()
            width = 0.84 / len(heights)
            for number, (name, values) in enumerate(heights.items()):
                offset = (number - 0.5 * (len(heights) - 1)) * width
                places = np.arange(len(known.MARKERS)) + offset
                axes.bar(
                    places,
                    values,
                    width,
                    label=name,
                    color=colors[number],
                    alpha=0.35 if number < 2 else None,
                )
            axes.axhline(known.PREDICTION_RMS_PX, color=THESIS, ls='--', lw=1.2, label='1 px')
            axes.grid(axis='x', visible=False)
            axes.set_xticks(range(len(known.MARKERS)), _SHORT_NAMES)
    return canvas.as_figure(
        'figure_5_9',
        'Figure 5.9: RMS of prediction, comparison of methods, all trials',
        'bars of the numbers of Table 5.3',
        'The numbers of Table 5.3; pale: the thesis.',
    )


def _error_bars(trials: Sequence[Trial]) -> Figure:
    with quartet(_titles(trials), 5.6, '', 'error of prediction [px]') as (canvas, panels):
        for axes, trial in zip(panels, trials, strict=True):
            means, deviations = mean_and_deviation(trial.first)
            places = np.arange(len(known.MARKERS))
            axes.bar(places, means, 0.6, color=COLORS[5], label='mean')
            reach = np.array([np.minimum(deviations, means), deviations])
            axes.errorbar(
                places,
                means,
                yerr=reach,
                fmt='none',
                ecolor=TRUTH,
                capsize=4,
                lw=1.2,
                label='standard deviation',
            )
            axes.grid(axis='x', visible=False)
            axes.set_xticks(places, _SHORT_NAMES)
        panels[0].set_ylim(bottom=0)
    return canvas.as_figure(
        'figure_appendix_c',
        'Appendix C: mean and standard deviation of the error by marker',
        'bars of the mean error of each marker with its standard deviation',
        "The program's two bar charts in one, for full estimation. The thesis's three whole "
        'frames, whose estimate is their place, are left out.',
    )


def mean_and_deviation(flight: FlownMarkers) -> tuple[list[float], list[float]]:
    """Of the error of full estimation, by marker, px; the deviation as MATLAB's ``std``."""
    distances = lengths(flight, PROGRAM)
    deviations = np.nanstd(distances, axis=0, ddof=1)
    return np.nanmean(distances, axis=0).tolist(), deviations.tolist()


def _titles(trials: Sequence[Trial]) -> list[str]:
    return [trial.title for trial in trials]
