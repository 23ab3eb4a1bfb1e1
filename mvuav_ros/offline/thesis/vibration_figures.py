"""Figures 5.10 and 5.11."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from mvuav_ros.offline.report.model import Figure
from mvuav_ros.offline.report.style import (
    COLORS,
    drawing,
    label,
    legend_below,
    plain_log,
    quartet,
)
from mvuav_ros.offline.thesis import known

if TYPE_CHECKING:
    from mvuav_ros.offline.thesis.roll_cells import RollCell
    from mvuav_ros.offline.thesis.vibration import Measured

_AXIS_NAMES = ('pitch', 'yaw', 'roll')


def spectrum_figure(measured: Sequence[Measured]) -> Figure:
    """Densities over frequency for each condition; triangles at Table 5.4's frequencies."""
    titles = [condition.name for condition in measured]
    with quartet(titles, 6.0, 'frequency [Hz]', 'density [°²/Hz]') as (canvas, panels):
        for axes, condition in zip(panels, measured, strict=True):
            axes.set_yscale('log')
            for number, name, curve in zip((1, 2, 0), _AXIS_NAMES, condition.spectra, strict=True):
                # The three swing with the same frequencies: the strongest is drawn below.
                axes.plot(
                    curve.frequency[1:],
                    np.maximum(curve.density[1:], _FLOOR),
                    color=COLORS[number],
                    lw=(3.0, 1.6, 0.8)[number],
                    zorder=2 + number,
                    label=name,
                )
            if not condition.listed_hz:
                axes.text(0.5, 0.5, 'nothing moves', transform=axes.transAxes, ha='center')
            roll = condition.spectra[-1]
            tops = [4.0 * float(np.interp(hz, *roll)) for hz in condition.listed_hz]
            axes.plot(condition.listed_hz, tops, 'v', color=COLORS[6], ms=5, label='Table 5.4')
        panels[0].set_ylim(bottom=_FLOOR)
        panels[0].set_xlim(0, _SHOWN_HZ)
    return Figure(
        'figure_5_10',
        'Figure 5.10: power spectral density of the vibrations',
        canvas.png,
        'spectral density of pitch, yaw and roll for four conditions',
        (
            "Welch's method on the camera's attitude. The thesis shows accelerations on three "
            'axes of an inertial sensor.',
        ),
    )


_FLOOR = 1e-8
_SHOWN_HZ = 75.0
"""Table 5.4 ends at 66.58 Hz."""


def roll_figure(cells: Sequence[RollCell]) -> Figure:
    """RMS of roll by condition: the thesis's twelve numbers and ours."""
    with drawing(9.6, 4.4) as canvas:
        axes = canvas.figure.subplots()
        places = np.arange(len(known.CONDITIONS))
        for number, roll in enumerate(known.ROLLS_DEG):
            of_roll = [cell.swing for cell in cells if cell.roll_deg == roll]
            color, name = COLORS[number], known.roll_name(roll)
            printed = [
                known.cell('table_5_5', condition, name).value for condition in known.CONDITIONS
            ]
            below = [max(v.value - v.low, 0.0) for v in of_roll]
            above = [max(v.high - v.value, 0.0) for v in of_roll]
            axes.errorbar(
                places + 0.06 * (number - 1),
                [v.value for v in of_roll],
                yerr=np.nan_to_num(np.array([below, above])),
                fmt='o-',
                color=color,
                ms=4,
                capsize=3,
                label=f'{name}, here',
            )
            axes.plot(places, printed, 's--', color=color, ms=4, alpha=0.6, label=f'{name}, thesis')
        plain_log(axes)
        axes.set_xticks(places, known.CONDITIONS)
        label(axes, '', '', 'RMS of roll [°]')
        legend_below(canvas.figure, axes, columns=3)
    return Figure(
        'figure_5_11',
        'Figure 5.11: RMS of roll for the vibrations',
        canvas.png,
        'RMS of roll about its mean for four conditions and three roll angles',
        ('The numbers of Table 5.5, logarithmic; bars: 95 % confidence.',),
    )
