"""The thesis's numbers: chapter 5's tables, Fig. 4.30, and the figures that its text names.

The one place where they stand. Cells are written as the thesis prints them; the report prints them
beside ours, and nothing measured by us comes from here.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True)
class Known:
    """One printed cell.

    Attributes:
        table: its table or figure.
        row: of the table.
        column: of the table.
        text: as printed.
    """

    table: str
    row: str
    column: str
    text: str

    @property
    def value(self) -> float:
        """The number; NaN where there is none, the bound where the cell gives only a bound."""
        try:
            return float(self.text.replace(',', '').lstrip('<'))
        except ValueError:
            return math.nan

    @property
    def is_bound(self) -> bool:
        """Whether the cell says only what the number is below."""
        return self.text.startswith('<')


MARKERS = ('Left Wing', 'Left Stabilizer', 'Rudder', 'Right Stabilizer', 'Right Wing')
VELOCITY, FULL = 'Velocity Only', 'Full Estimation'
ESTIMATIONS = (VELOCITY, FULL)
"""Table 5.3's methods; full estimation is the program of Appendix C."""
PROGRAMS = ('No Estimation', VELOCITY, FULL)
"""Table 5.2's methods."""
ROLLS_DEG = (0.0, 20.0, 50.0)


def roll_name(roll_deg: float) -> str:
    """A column of Table 5.5."""
    return f'Φ = {roll_deg:g}°'


def _grid(table: str, columns: Iterable[str], rows: dict[str, str]) -> list[Known]:
    names = list(columns)
    return [
        Known(table, row, column, text)
        for row, cells in rows.items()
        for column, text in zip(names, cells.split('; '), strict=True)
    ]


def _rows(cells: Iterable[Known]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(cell.row for cell in cells))


TABLE_5_2 = _grid(
    'table_5_2',
    (f'{program}, {what}' for program in PROGRAMS for what in ('time', 'executions')),
    {
        'Reading the AVI': '5.516; 1; 6.109; 1; 6.828; 1',
        'Pre-processing': '4.422; 150; 4.779; 150; 5.34; 150',
        'Image Scanning': '44.955; 46,080,000; 0.92; 921,600; 0.89; 921,600',
        'Scanning for Estimation': 'N/A; N/A; 0.49; 324,135; 0.51; 324,135',
        'Centroid Calculation': '0.4; 15,328; 0.15; 24,870; 0.22; 24,870',
        'Marker Definition': '0.2; 150; <0.01; 3; <0.01; 3',
        'Other Lines and Overhead': '0.867; N/A; 4.376; N/A; 1.79; N/A',
        'Total Time': '56.36; 1; 17.094; 1; 15.828; 1',
    },
)
"""Times in s for 150 frames, under MATLAB's profiler."""
STAGES = _rows(TABLE_5_2)
TABLE_5_3 = _grid(
    'table_5_3',
    MARKERS,
    {
        f'Trial 1, {VELOCITY}': '0.8306; 0.4556; 0.3829; 0.378; 0.5478',
        f'Trial 1, {FULL}': '0.7341; 0.4500; 0.4725; 0.4414; 0.5621',
        f'Trial 2, {VELOCITY}': '0.6145; 0.6570; 0.6486; 0.6243; 0.5398',
        f'Trial 2, {FULL}': '0.6479; 0.7684; 0.7643; 0.7363; 0.5759',
        f'Trial 3, {VELOCITY}': '0.4310; 0.4082; 0.3546; 0.4519; 0.3590',
        f'Trial 3, {FULL}': '0.4987; 0.3901; 0.3546; 0.5299; 0.3804',
        f'Trial 4, {VELOCITY}': '0.4937; 0.5285; 0.5434; 0.4916; 0.4762',
        f'Trial 4, {FULL}': '0.4887; 0.5776; 0.5969; 0.5404; 0.4660',
    },
)
"""RMS of predicted minus found, px."""
TABLE_5_4 = _grid(
    'table_5_4',
    ('Primary Frequency', 'Amplitude', 'Harmonics'),
    {
        'No Motion': '39.4; 2.77E-06; N/A',
        'Vibration 1': '11.06; 0.005248; 22.12, 33.11, 66.58',
        'Vibration 2': '14.21; 0.01204; 28.42, 64.01',
        'Vibration 3': '16.63; 0.01378; 8.31, 24.98, 33.22, 41.78, 49.88, 58.26, 66.54',
    },
)
"""Hz, "dB/Hertz", Hz."""
CONDITIONS = _rows(TABLE_5_4)
TABLE_5_5 = _grid(
    'table_5_5',
    map(roll_name, ROLLS_DEG),
    {
        'No Motion': '0.004941; 0.003679; 0.01315',
        'Vibration 1': '0.1063; 0.056434; 0.089607',
        'Vibration 2': '0.1971; 0.2035; 0.19598',
        'Vibration 3': '0.4215; 0.2693; 0.3303',
    },
)
"""RMS of roll, degrees."""
TABLE_5_7 = _grid(
    'table_5_7',
    ('time', 'executions'),
    {
        'Model Initialize': '0.3906; 1',
        'Reading the AVI': '1.6562; 150',
        'Pre-processing': '3.4374; 150',
        'Hough Transform': '2.4218; 150',
        'Rho/Theta Correction': '0.09375; 150',
        'Image Regeneration': '0.3125; 150',
        'Other Lines and Overhead': '0.2658; N/A',
        'Total Time': '7.9062; 1',
    },
)
"""Times in s for 150 frames."""
RUNWAY_STAGES = _rows(TABLE_5_7)
FIGURE_4_30 = _grid(
    'figure_4_30',
    ('number',),
    {
        'Rho flag, frames of 150': '54',
        'Theta flag, frames of 150': '55',
        'Main flag, frames of 150': '62',
        'Rho 1, mean': '170.7045',
        'Rho 1, standard deviation': '26.0799',
        'Rho 2, mean': '145.8508',
        'Rho 2, standard deviation': '51.637',
        'Rho 3, mean': '149.4568',
        'Rho 3, standard deviation': '36.8584',
        'Theta 1, mean': '-0.0075631',
        'Theta 1, standard deviation': '0.10365',
        'Theta 2, mean': '0.10577',
        'Theta 2, standard deviation': '0.20568',
        'Theta 3, mean': '0.11286',
        'Theta 3, standard deviation': '0.27034',
    },
)
"""Rho in px, theta in rad."""
FIGURES = _grid(
    'figures',
    ('number',),
    {
        'Figure 5.1: No Estimation': '0.085',
        'Figure 5.1: Velocity Only': '0.05',
        'Figure 5.1: Full Estimation': '0.03',
        'Figure 5.2: first frames over the average': '3',
        'Figure 5.3: any number of markers': '0.07',
    },
)
"""Seconds per frame, and a ratio, as the text about the figures gives them."""

ALL = (*TABLE_5_2, *TABLE_5_3, *TABLE_5_4, *TABLE_5_5, *TABLE_5_7, *FIGURE_4_30, *FIGURES)
_BY_PLACE = {(cell.table, cell.row, cell.column): cell for cell in ALL}

TRIAL_SECONDS, TRIAL_FPS = 10.0, 15.0
"""The marker videos."""
RUNWAY_SECONDS, RUNWAY_FPS = 5.0, 30.0
"""The runway videos."""
MEASUREMENTS = 60
"""Of roll in each cell of Table 5.5, one a second."""
PREDICTION_RMS_PX = 1.0
"""The RMS of prediction is below this in all trials (section 5.1.2, conclusion)."""
ERROR_PX = 2.0
"""The error of prediction is below this in almost every instance (about Figure 5.7)."""
ROLL_RMS_DEG = 1.0
"""The RMS error of roll is below this under every vibration (conclusion)."""
TRACKING_HZ = 30.0
"""Full estimation is faster than this (abstract, conclusion)."""
RUNWAY_HZ = 20.0
"""The runway scheme reaches about this (abstract, section 5.2.1)."""
WINDOW_SHARE_ABSTRACT = 0.0016
"""The five search windows' share of the frame by the abstract: 5 x 10 x 10 of 640 x 480 px."""
RUNWAY_SHARES = {'Pre-processing': 43.0, 'Hough Transform': 30.0, 'Reading the AVI': 21.0}
"""Percent of Table 5.7's total, as the text about it gives them."""


def cell(table: str, row: str, column: str) -> Known:
    """One printed cell.

    Raises:
        KeyError: the thesis has no such cell.
    """
    return _BY_PLACE[table, row, column]
