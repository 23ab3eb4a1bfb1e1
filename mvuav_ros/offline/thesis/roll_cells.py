"""Table 5.5: the RMS of roll at three angles and four vibrations, 60 measurements each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mvuav_ros.offline.evaluation.marker_runs import FlownMarkers, MarkerTask
from mvuav_ros.offline.evaluation.numbers import Interval, pooled_rms
from mvuav_ros.offline.report.comparison import METHOD, SHIPPED, Compared
from mvuav_ros.offline.report.model import Cell, Claim, Column, Table
from mvuav_ros.offline.thesis import known
from mvuav_ros.offline.thesis.plan import Plan, tracker
from mvuav_ros.offline.thesis.statements import growth_text, monotonic_text, noise_text
from mvuav_ros.parameters.marker_tracker import MarkerTrackerParameters
from mvuav_ros.simulation.settings import TankerSettings
from mvuav_ros.simulation.shake import VIBRATIONS

THESIS = "the thesis's program"
"""Appendix A; beside it the tracker as shipped."""
MEASUREMENTS_PER_SECOND = 1.0
USUAL_NOISE = TankerSettings().noise
NOISES = (0.75, USUAL_NOISE, 3.0)
"""Standard deviation of a pixel, grey levels."""
_DIGITS = 4


_PROGRAMS = {THESIS: tracker(mode='detect'), SHIPPED: MarkerTrackerParameters()}


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
    return [
        _cell(roll, shake, _those(flown, roll, shake))
        for roll in known.ROLLS_DEG
        for shake in range(len(VIBRATIONS))
    ]


def _those(
    flown: Sequence[FlownMarkers], roll: float, shake: int, noise: float = USUAL_NOISE
) -> list[FlownMarkers]:
    key = (roll, shake, noise)
    return [f for f in flown if (f.settings.roll_deg, f.settings.shake, f.settings.noise) == key]


def roll_tasks(plan: Plan) -> list[MarkerTask]:
    """All flights of all cells."""
    return [
        MarkerTask(
            TankerSettings(
                motion='still',
                roll_deg=roll,
                shake=shake,
                fps=MEASUREMENTS_PER_SECOND,
                frames=plan.measurements,
                seed=plan.seed_of(1 + repeat),
            ),
            _PROGRAMS,
        )
        for roll in known.ROLLS_DEG
        for shake in range(len(VIBRATIONS))
        for repeat in range(plan.repeats)
    ]


def _cell(roll_deg: float, vibration: int, flown: Sequence[FlownMarkers]) -> RollCell:
    return RollCell(
        roll_deg,
        vibration,
        {name: _about_mean(flown, name) for name in _PROGRAMS},
        _about_mean(flown),
        {n: pooled_rms([np.degrees(f.roll_error(n)) for f in flown]) for n in _PROGRAMS},
    )


def _about_mean(flown: Sequence[FlownMarkers], name: str = '') -> Interval:
    """RMS of the roll by a program about the mean of each flight, degrees; no name: the truth."""
    rolls = [np.degrees(f.runs[name].roll if name else f.roll) for f in flown]
    return pooled_rms([values - np.nanmean(values) for values in rolls])


def roll_tables(cells: Sequence[RollCell], plan: Plan) -> list[Table]:
    """Table 5.5, and what truth adds to it."""
    columns = (
        Column('condition'),
        Column('by'),
        *(Column(known.roll_name(roll), '°', _DIGITS) for roll in known.ROLLS_DEG),
    )
    rows: list[tuple[Cell, ...]] = []
    for vibration, condition in enumerate(known.CONDITIONS):
        same = [cell for cell in cells if cell.vibration == vibration]
        printed = [known.cell('table_5_5', condition, known.roll_name(c.roll_deg)) for c in same]
        rows.append((condition, 'thesis', *(cell.text for cell in printed)))
        for name, by in ((THESIS, METHOD), (SHIPPED, SHIPPED)):
            ours = [
                Compared.of(cell.swings[name], p.value, by)
                for cell, p in zip(same, printed, strict=True)
            ]
            rows.append((condition, name, *ours))
        own = [cell.true_swing.text(_DIGITS) for cell in same]
        rows.append((condition, "the camera's own (truth)", *own))
    swing = Table(
        'table_5_5',
        'Table 5.5: RMS error of roll',
        columns,
        tuple(rows),
        (
            f'Each cell: {plan.repeats} flights of {plan.measurements} measurements, one a second '
            'as in the thesis, with the 95 % confidence interval of the scatter between flights. '
            f'RMS about the mean of a flight; {THESIS} is Appendix A (whole frames, binary '
            "centroid). The camera's own is the same of the true roll: under vibration nearly all "
            'of a cell is the swing of the camera, and the comparison is one of vibrations.',
            *_growth(cells),
        ),
    )
    return [swing, _truth_table(cells, columns)]


def _growth(cells: Sequence[RollCell]) -> tuple[str, str]:
    printed = [
        [known.cell('table_5_5', condition, known.roll_name(r)).value for r in known.ROLLS_DEG]
        for condition in known.CONDITIONS
    ]
    ours = [
        [cell.swing.value for cell in cells if cell.vibration == vibration]
        for vibration in range(len(known.CONDITIONS))
    ]
    return (
        monotonic_text(printed, 'The RMS in the thesis'),
        monotonic_text(ours, f'Here, by {THESIS}'),
    )


def _truth_table(cells: Sequence[RollCell], columns: tuple[Column, ...]) -> Table:
    rows: list[tuple[Cell, ...]] = []
    for vibration, condition in enumerate(known.CONDITIONS):
        same = [cell for cell in cells if cell.vibration == vibration]
        rows += [
            (condition, name, *(cell.errors[name].text(_DIGITS) for cell in same))
            for name in (THESIS, SHIPPED)
        ]
    return Table(
        'table_5_5_truth',
        'What truth adds to Table 5.5: RMS error of roll against truth',
        columns,
        tuple(rows),
        (
            'Measured minus true roll of the same frame: the error of the measurement alone, '
            'a constant one included, without the swing of the camera.',
            *(growth_text(first_growth(cells, name), name) for name in (THESIS, SHIPPED)),
        ),
    )


def first_growth(cells: Sequence[RollCell], name: str) -> list[tuple[float, float]]:
    """Errors without motion and at vibration 1, for each roll."""
    by_place = {(cell.roll_deg, cell.vibration): cell.errors[name].value for cell in cells}
    return [(by_place[roll, 0], by_place[roll, 1]) for roll in known.ROLLS_DEG]


def noise_tasks(plan: Plan) -> list[MarkerTask]:
    """Flights without motion before cameras of other noise than the simulator's usual one."""
    return [
        MarkerTask(
            TankerSettings(
                motion='still',
                roll_deg=roll,
                fps=MEASUREMENTS_PER_SECOND,
                frames=plan.measurements,
                seed=plan.seed_of(1 + repeat),
                noise=noise,
            ),
            _PROGRAMS,
        )
        for noise in NOISES
        if noise != USUAL_NOISE
        for roll in known.ROLLS_DEG
        for repeat in range(noise_repeats(plan))
    ]


def noise_repeats(plan: Plan) -> int:
    """Flights of each cell of the table of noise."""
    return min(plan.repeats, 2)


def noise_table(plan: Plan, flown: Sequence[FlownMarkers]) -> Table:
    """Table 5.5's first row against the noise of the camera, which the thesis does not tell."""
    repeats = noise_repeats(plan)
    rows: list[tuple[Cell, ...]] = []
    for noise in NOISES:
        for name in _PROGRAMS:
            cells = [
                _about_mean(_those(flown, roll, 0, noise)[:repeats], name)
                for roll in known.ROLLS_DEG
            ]
            rows.append((f'{noise:g}', name, *(cell.value for cell in cells)))
    printed = [
        known.cell('table_5_5', known.CONDITIONS[0], known.roll_name(roll))
        for roll in known.ROLLS_DEG
    ]
    rows.append(('not known', 'thesis', *(cell.text for cell in printed)))
    return Table(
        'table_5_5_noise',
        'Table 5.5 without motion, by the noise of the camera',
        (
            Column('noise of a pixel [grey levels]'),
            Column('by'),
            *(Column(known.roll_name(roll), '°', 5) for roll in known.ROLLS_DEG),
        ),
        tuple(rows),
        (
            'Without motion the RMS of roll is the noise of the pixels at the edges of the lights. '
            'That of the camera in the thesis is not told; the tables above assume 1.5 grey '
            f'levels. {noise_text(rows)}',
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
