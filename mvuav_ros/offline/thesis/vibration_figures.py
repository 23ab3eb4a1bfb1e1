"""Figures 5.10 and 5.11, and roll against vibration."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from matplotlib.axes import Axes

from mvuav_ros.offline.evaluation.numbers import Interval, Spectrum
from mvuav_ros.offline.report.model import Figure
from mvuav_ros.offline.report.style import COLORS, SOFT, drawing, label, legend_below

if TYPE_CHECKING:
    from mvuav_ros.offline.thesis.roll_cells import RollCell


class Curve(NamedTuple):
    """One vibration's spectrum: measured, true if it is worth drawing, and what was set (Hz)."""

    name: str
    measured: Spectrum
    true: Spectrum | None
    frequencies: tuple[float, ...]


def spectrum_figure(
    key: str, title: str, unit: str, curves: Sequence[Curve], notes: tuple[str, ...]
) -> Figure:
    """Densities over frequency; triangles at the frequencies that were set."""
    with drawing(9.6, 4.2) as canvas:
        axes = canvas.figure.subplots()
        for color, curve in zip(COLORS, curves, strict=False):
            # The first bin holds what is left of the mean.
            axes.semilogy(
                curve.measured.frequency[1:],
                curve.measured.density[1:],
                color=color,
                label=curve.name,
            )
            if curve.true is not None:
                axes.semilogy(
                    curve.true.frequency[1:], curve.true.density[1:], ':', color=color, lw=1.0
                )
            top = [float(np.interp(f, *curve.measured)) for f in curve.frequencies]
            axes.plot(curve.frequencies, [3.0 * t for t in top], 'v', color=color, ms=6)
        axes.plot([], [], 'v', color=SOFT, label='frequency set')
        axes.plot([], [], ':', color=SOFT, label='truth')
        floor = min(float(np.median(curve.measured.density[1:])) for curve in curves)
        axes.set_ylim(bottom=0.02 * floor)
        axes.set_xlim(0, float(curves[0].measured.frequency[-1]))
        label(axes, '', 'frequency [Hz]', unit)
        legend_below(canvas.figure, axes)
    return Figure(key, title, canvas.png, f'{title}: one curve for each vibration', notes)


def roll_figure(cells: Sequence[RollCell]) -> Figure:
    """Measured swing and error over the vibration in px, with intervals."""
    with drawing(9.6, 4.0) as canvas:
        left, right = canvas.figure.subplots(1, 2)
        for number, roll in enumerate(sorted({cell.roll_deg for cell in cells})):
            of_roll = [cell for cell in cells if cell.roll_deg == roll]
            pointing = [cell.pointing for cell in of_roll]
            color, name = COLORS[number], f'roll {roll:g}°'
            _bars(left, pointing, [cell.swing for cell in of_roll], color, name)
            first = [next(iter(cell.error.values())) for cell in of_roll]
            _bars(right, pointing, first, color, name)
        x = "vibration, RMS of the markers' movement [px per axis]"
        label(left, 'About the mean', x, 'RMS of roll [°]')
        label(right, 'Against truth', x, 'RMS error of roll [°]')
        for axes in (left, right):
            axes.set_ylim(bottom=0)
        legend_below(canvas.figure, left)
    return Figure(
        'figure_roll_vibration',
        'Roll against vibration, the cells of Table 5.5',
        canvas.png,
        'RMS of roll about its mean and against truth over vibration',
        (
            'Bars: 95 % confidence. About the mean the camera itself is measured; the error '
            'against truth is what the measurement adds.',
        ),
    )


def _bars(axes: Axes, x: list[float], values: list[Interval], color: str, name: str) -> None:
    below = [max(v.value - v.low, 0.0) for v in values]
    above = [max(v.high - v.value, 0.0) for v in values]
    axes.errorbar(
        x,
        [v.value for v in values],
        yerr=np.nan_to_num(np.array([below, above])),
        fmt='o-',
        color=color,
        ms=4,
        capsize=3,
        lw=1.0,
        label=name,
    )
