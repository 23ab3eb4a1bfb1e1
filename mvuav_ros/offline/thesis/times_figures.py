"""Figures 5.1 to 5.3."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from mvuav_ros.offline.evaluation.numbers import Array
from mvuav_ros.offline.report.model import Figure
from mvuav_ros.offline.report.style import (
    THESIS,
    TRUTH,
    drawing,
    label,
    legend_below,
    line_of,
    plain_log,
    quartet,
)
from mvuav_ros.offline.thesis import known

_SHOWN_AT_START = 10


class Loss(NamedTuple):
    """The flight of the loss variant: time (s), lights to be seen, and those found by method."""

    time: Array
    lit: Array
    found: Mapping[str, Array]


def method_figure(trials: Mapping[int, Mapping[str, Array]]) -> Figure:
    """Time of every frame by method, a panel for each trial."""
    titles = [f'Trial {trial}' for trial in trials]
    with quartet(titles, 6.4, 'frame', 'time per frame [ms]', columns=4) as (canvas, panels):
        for axes, times in zip(panels, trials.values(), strict=True):
            for number, (name, ms) in enumerate(times.items()):
                axes.plot(np.arange(1, len(ms) + 1), ms, lw=1.0, label=name, **line_of(number))
            for dashes, program in zip(('--', '-.', ':'), known.PROGRAMS, strict=True):
                printed = known.cell('figures', f'Figure 5.1: {program}', 'number').value
                axes.axhline(
                    1e3 * printed, color=THESIS, ls=dashes, lw=1.0, label=f'{program}, thesis'
                )
            plain_log(axes)
    return Figure(
        'figure_5_1',
        'Figure 5.1: time per frame by method, all trials',
        canvas.png,
        'time of each frame for each method in four trials, logarithmic',
        ("Red: the thesis's averages.",),
    )


def transient_figure(times: Mapping[str, Array]) -> Figure:
    """The first frames of trial 4."""
    with drawing(9.6, 3.9) as canvas:
        axes = canvas.figure.subplots()
        frames = np.arange(1, _SHOWN_AT_START + 1)
        for number, (name, ms) in enumerate(times.items()):
            shown = ms[: len(frames)]
            axes.plot(frames[: len(shown)], shown, marker='o', ms=4, label=name, **line_of(number))
        plain_log(axes)
        axes.set_xticks(frames)
        label(axes, '', 'frame', 'time per frame [ms]')
        legend_below(canvas.figure, axes, columns=5)
    return Figure(
        'figure_5_2',
        'Figure 5.2: the transient at the start, trial 4',
        canvas.png,
        'time of the first ten frames by method',
        ('The first three frames are searched whole: an acceleration needs three positions.',),
    )


def loss_figure(times: Mapping[str, Array], loss: Loss) -> Figure:
    """Lights found, and time per frame, while lights go out and come back."""
    with drawing(9.6, 5.4) as canvas:
        upper, lower = canvas.figure.subplots(2, 1, sharex=True)
        upper.step(loss.time, loss.lit, where='mid', color=TRUTH, lw=3.0, label='lights to be seen')
        for number, (name, ms) in enumerate(times.items()):
            line = line_of(number)
            upper.step(loss.time, loss.found[name], where='mid', lw=1.2, label=name, **line)
            lower.plot(loss.time, ms, lw=1.2, label=name, **line)
        plain_log(lower)
        label(upper, '', '', 'lights found')
        label(lower, '', 'time [s]', 'time per frame [ms]')
        legend_below(canvas.figure, upper, columns=5)
    return Figure(
        'figure_5_3',
        'Figure 5.3: time per frame of the loss variant and the others',
        canvas.png,
        'lights found and time per frame while lights are out',
        (
            'One light is out from 2 s, two from 2.5 to 3 s, all from 6 to 6.6 s. Detection with '
            'names needs all five; any number of markers takes what is there, without names.',
        ),
    )
