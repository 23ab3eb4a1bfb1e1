"""Table 5.5 and Figure 5.11: the RMS of roll at three angles and four vibrations."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mvuav_ros.offline.report import Cell, Column, Figure, Table
from mvuav_ros.offline.report_figures import COLORS, drawing, label, legend_below, plain_log
from mvuav_ros.parameters.marker_tracker import MarkerTrackerParameters
from mvuav_ros.simulation.settings import TankerSettings
from mvuav_ros.simulation.shake import VIBRATIONS
from mvuav_thesis import known
from mvuav_thesis.comparison import METHOD, SHIPPED, Claim, Compared
from mvuav_thesis.marker_runs import FlownMarkers, MarkerTask
from mvuav_thesis.plan import Plan, tracker
from mvuav_thesis.statistics_of_flights import Interval, pooled_rms

THESIS = "the thesis's program"
"""Appendix A; beside it the tracker as shipped."""
MEASUREMENTS_PER_SECOND = 1.0
TYPICAL_NOISE = TankerSettings().noise
NOISES = (0.75, TYPICAL_NOISE, 3.0)
"""Standard deviation of a pixel, grey levels."""
_DIGITS = 4
_PROGRAMS = {THESIS: tracker(mode='detect'), SHIPPED: MarkerTrackerParameters()}
_ROLLS = tuple(map(known.roll_name, known.ROLLS_DEG))


@dataclass(frozen=True)
class RollCell:
    """One cell of the table; all intervals in degrees.

    Attributes:
        roll_deg: of the tanker.
        vibration: number of the setting.
        swings: RMS of measured roll about its mean, by program: what the thesis could measure.
        true_swing: the same of true roll.
        errors: RMS of measured minus true roll, by program.
    """

    roll_deg: float
    vibration: int
    swings: Mapping[str, Interval]
    true_swing: Interval
    errors: Mapping[str, Interval]

    @property
    def swing(self) -> Interval:
        """By the thesis's program."""
        return self.swings[THESIS]


def cells_of(flown: Sequence[FlownMarkers]) -> list[RollCell]:
    """The twelve cells, each from several flights of 60 measurements."""
    cells = []
    for roll in known.ROLLS_DEG:
        for shake in range(len(VIBRATIONS)):
            same = _those(flown, roll, shake)
            swings = {name: _about_mean(same, name) for name in _PROGRAMS}
            errors = {
                name: pooled_rms([np.degrees(f.roll_error(name)) for f in same])
                for name in _PROGRAMS
            }
            cells.append(RollCell(roll, shake, swings, _about_mean(same), errors))
    return cells


def _those(
    flown: Sequence[FlownMarkers], roll: float, shake: int, noise: float = TYPICAL_NOISE
) -> list[FlownMarkers]:
    key = (roll, shake, noise)
    return [f for f in flown if (f.settings.roll_deg, f.settings.shake, f.settings.noise) == key]


def _about_mean(flown: Sequence[FlownMarkers], name: str = '') -> Interval:
    """RMS of the roll by a program about the mean of each flight, degrees; no name: the truth."""
    rolls = [np.degrees(f.runs[name].roll if name else f.roll) for f in flown]
    return pooled_rms([values - np.nanmean(values) for values in rolls])


def roll_tasks(plan: Plan) -> list[MarkerTask]:
    """All flights of all cells."""
    return _tasks(plan, range(len(VIBRATIONS)), plan.repeats)


def noise_tasks(plan: Plan) -> list[MarkerTask]:
    """Flights without motion before cameras of other noise than the simulator's usual one."""
    others = (noise for noise in NOISES if noise != TYPICAL_NOISE)
    return [task for noise in others for task in _tasks(plan, (0,), noise_repeats(plan), noise)]


def noise_repeats(plan: Plan) -> int:
    """Flights of each cell of the table of noise."""
    return min(plan.repeats, 2)


def _tasks(
    plan: Plan, shakes: Sequence[int], repeats: int, noise: float = TYPICAL_NOISE
) -> list[MarkerTask]:
    return [
        MarkerTask(
            TankerSettings(
                motion='still',
                roll_deg=roll,
                shake=shake,
                fps=MEASUREMENTS_PER_SECOND,
                frames=plan.measurements,
                seed=plan.seed_of(1 + repeat),
                noise=noise,
            ),
            _PROGRAMS,
        )
        for roll in known.ROLLS_DEG
        for shake in shakes
        for repeat in range(repeats)
    ]


def roll_tables(cells: Sequence[RollCell], plan: Plan) -> list[Table]:
    """Table 5.5, and what truth adds to it."""
    heading = ' | '.join(['condition', 'by', *(f'{roll} [°] .{_DIGITS}' for roll in _ROLLS)])
    rows: list[tuple[Cell, ...]] = []
    true_rows = []
    for vibration, condition in enumerate(known.CONDITIONS):
        same = [cell for cell in cells if cell.vibration == vibration]
        printed = _printed(condition)
        rows.append((condition, 'thesis', *(cell.text for cell in printed)))
        for name, by in ((THESIS, METHOD), (SHIPPED, SHIPPED)):
            pairs = zip(same, printed, strict=True)
            ours = (Compared.of(cell.swings[name], p.value, by) for cell, p in pairs)
            rows.append((condition, name, *ours))
            errors = (cell.errors[name].text(_DIGITS) for cell in same)
            true_rows.append((condition, name, *errors))
        own = (cell.true_swing.text(_DIGITS) for cell in same)
        rows.append((condition, "the camera's own (truth)", *own))
    swing = Table.of(
        'table_5_5',
        'Table 5.5: RMS error of roll',
        heading,
        rows,
        f'Each cell: {plan.repeats} flights of {plan.measurements} measurements, one a second '
        'as in the thesis, with the 95 % confidence interval of the scatter between flights. '
        f'RMS about the mean of a flight; {THESIS} is Appendix A (whole frames, binary '
        "centroid). The camera's own is the same of the true roll: under vibration nearly all "
        'of a cell is the swing of the camera, and the comparison is one of vibrations.',
        *_growth(cells),
    )
    truth = Table.of(
        'table_5_5_truth',
        'What truth adds to Table 5.5: RMS error of roll against truth',
        heading,
        true_rows,
        'Measured minus true roll of the same frame: the error of the measurement alone, '
        'a constant one included, without the swing of the camera.',
        *(_first_growth(cells, name) for name in (THESIS, SHIPPED)),
    )
    return [swing, truth]


def _printed(condition: str) -> list[known.Known]:
    return [known.cell('table_5_5', condition, roll) for roll in _ROLLS]


def _growth(cells: Sequence[RollCell]) -> Iterator[str]:
    """In how many columns the RMS grows from each vibration to the next."""
    printed = [[cell.value for cell in _printed(condition)] for condition in known.CONDITIONS]
    ours = [
        [cell.swing.value for cell in cells if cell.vibration == vibration]
        for vibration in range(len(known.CONDITIONS))
    ]
    for who, rows in (('The RMS in the thesis', printed), (f'Here, by {THESIS}', ours)):
        growing = np.all(np.diff(rows, axis=0) > 0, axis=0)
        yield f'{who}: grows with the vibration in {np.sum(growing)} of {growing.size} columns.'


def _first_growth(cells: Sequence[RollCell], name: str) -> str:
    """How an error against truth grows from no vibration to vibration 1."""
    calm, shaken = (
        [cell.errors[name].value for cell in cells if cell.vibration == vibration]
        for vibration in (0, 1)
    )
    factors = [b / a for a, b in zip(calm, shaken, strict=True) if a > 0]
    return (
        f'From no motion to vibration 1 the error of {name} changes by factors of '
        f'{min(factors):.2f} to {max(factors):.2f}.'
    )


def noise_table(plan: Plan, flown: Sequence[FlownMarkers]) -> Table:
    """Table 5.5's first row against the noise of the camera, which the thesis does not give."""
    printed = _printed(known.CONDITIONS[0])
    rows: list[tuple[Cell, ...]] = []
    below = []
    for noise in NOISES:
        for name in _PROGRAMS:
            flights = [
                _those(flown, roll, 0, noise)[: noise_repeats(plan)] for roll in known.ROLLS_DEG
            ]
            values = [_about_mean(same, name).value for same in flights]
            rows.append((f'{noise:g}', name, *values))
            count = sum(v < cell.value for v, cell in zip(values, printed, strict=True))
            below.append(f'{name} at {noise:g} in {count}')
    rows.append(('not known', 'thesis', *(cell.text for cell in printed)))
    rolls = (Column(roll, '°', 5) for roll in _ROLLS)
    return Table(
        'table_5_5_noise',
        'Table 5.5 without motion, by the noise of the camera',
        (Column('noise of a pixel [grey levels]'), Column('by'), *rolls),
        tuple(rows),
        (
            'Without motion the RMS of roll is the noise of the pixels at the edges of the lights. '
            'That of the camera in the thesis is not told; the tables above assume 1.5 grey '
            f'levels. Below the thesis, of {len(printed)} columns: {", ".join(below)}.',
        ),
    )


def roll_claims(cells: Sequence[RollCell]) -> list[Claim]:
    """The conclusion on roll."""
    worst = max(cells, key=lambda cell: cell.swing.value)
    return [
        Claim(
            'RMS error of roll under every vibration',
            f'below {known.ROLL_RMS_DEG:g}° (conclusion)',
            f'at most {worst.swing.value:.3f}° ({known.CONDITIONS[worst.vibration].lower()}, '
            f'roll {worst.roll_deg:g}°)',
            worst.swing.value < known.ROLL_RMS_DEG,
        )
    ]


def roll_figure(cells: Sequence[RollCell]) -> Figure:
    """RMS of roll by condition: the thesis's twelve numbers and ours."""
    with drawing(9.6, 4.4) as canvas:
        axes = canvas.figure.subplots()
        places = np.arange(len(known.CONDITIONS))
        for number, roll in enumerate(known.ROLLS_DEG):
            of_roll = [cell.swing for cell in cells if cell.roll_deg == roll]
            color, name = COLORS[number], _ROLLS[number]
            printed = [_printed(condition)[number].value for condition in known.CONDITIONS]
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
    return canvas.as_figure(
        'figure_5_11',
        'Figure 5.11: RMS of roll for the vibrations',
        'RMS of roll about its mean for four conditions and three roll angles',
        'The numbers of Table 5.5, logarithmic; bars: 95 % confidence.',
    )
