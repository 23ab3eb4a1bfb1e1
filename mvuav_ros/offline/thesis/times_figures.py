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
)
from mvuav_ros.offline.thesis import known

_SHOWN_AT_START = 12


class Loss(NamedTuple):
    """The flight of the loss variant: time (s), lights to be seen, and those found by method."""

    time: Array
    lit: Array
    found: Mapping[str, Array]


def method_figure(times: Mapping[str, Array]) -> Figure:
    """Time of every frame, by method."""
    with drawing(9.6, 4.6) as canvas:
        axes = canvas.figure.subplots()
        for number, (name, ms) in enumerate(times.items()):
            axes.plot(np.arange(1, len(ms) + 1), ms, lw=1.2, label=name, **line_of(number))
        axes.axhline(known.FULL_FRAME_MS, color=THESIS, ls='--', label='thesis, whole frame: 85 ms')
        axes.axhline(known.TRACKED_MS, color=THESIS, ls=':', label='thesis, tracked: 30 ms')
        plain_log(axes)
        axes.set_ylim(top=2 * known.FULL_FRAME_MS)
        axes.set_xlim(1, max(len(ms) for ms in times.values()))
        label(axes, '', 'frame', 'time per frame [ms]')
        legend_below(canvas.figure, axes, columns=4)
    return Figure(
        'figure_5_1',
        'Figure 5.1: time per frame by method',
        canvas.png,
        'time of each frame for each mode and method of prediction, logarithmic',
        ('Frames that track start like whole ones: see Figure 5.2.',),
    )


def transient_figure(times: Mapping[str, Array]) -> Figure:
    """The first frames of tracking."""
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
        'Figure 5.2: the transient at the start of tracking',
        canvas.png,
        'time of the first twelve frames, high in the first three',
        (
            'The first three frames are searched whole, since an acceleration needs three '
            "positions. The thesis's steps: 85 ms, then 30 ms.",
        ),
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
        'Figure 5.3: the loss variant',
        canvas.png,
        'lights found and time per frame while lights are out',
        (
            'One light out from 0.6 s, two from 0.8 to 1.0 s, all from 1.6 to 1.8 s. Detection '
            "with names needs all five; without names (detect_any, Appendix B's purpose) it finds "
            "what is there. The thesis's program takes five or six lights only; its times are not "
            'available to us.',
        ),
    )
