"""Our numbers beside published ones, with confidence intervals over flights."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from itertools import islice, takewhile
from typing import Literal, NamedTuple

import numpy as np
from scipy import special

from mvuav_ros.offline.evaluation.metrics import Array
from mvuav_ros.offline.report import Cell, JudgedCell, Section, Table, is_number


class Interval(NamedTuple):
    """A value with the ends of its 95 % confidence interval; NaN ends where it has none."""

    value: float
    low: float
    high: float

    def text(self, digits: int) -> str:
        """As a cell of a table: value and interval, each with so many digits after the point."""
        value = f'{self.value:.{digits}f}'
        if math.isnan(self.low):
            return value
        return f'{value} [{self.low:.{digits}f}, {self.high:.{digits}f}]'


def pooled_rms(repeats: Sequence[Array]) -> Interval:
    """RMS over all repeats, with the interval that their scatter allows.

    Measurements of one flight hang together (they share its vibration's phases), so that only
    whole flights are taken as independent: the interval is Student's t of their mean squares.
    NaN does not count.
    """
    squares = np.array([float(np.nanmean(r**2)) for r in repeats if np.isfinite(r).any()])
    if squares.size == 0:
        return Interval(math.nan, math.nan, math.nan)
    mean = float(squares.mean())
    if squares.size == 1:
        return Interval(math.sqrt(mean), math.nan, math.nan)
    error = float(squares.std(ddof=1)) / math.sqrt(squares.size)
    reach = float(special.stdtrit(squares.size - 1, 0.975)) * error
    return Interval(
        math.sqrt(mean), math.sqrt(max(mean - reach, 0.0)), math.sqrt(max(mean + reach, 0.0))
    )


class Spectrum(NamedTuple):
    """Power spectral density: frequencies (Hz) and density (unit² per Hz)."""

    frequency: Array
    density: Array

    def peaks(self, most: int, min_share: float = 0.002) -> list[float]:
        """The frequencies (Hz) of the strongest maxima in rising order.

        Below ``min_share`` of the strongest one's density a maximum is noise.
        """
        inner = self.density[1:-1]
        top = (inner >= self.density[:-2]) & (inner > self.density[2:])
        top &= inner > min_share * float(self.density.max(initial=0.0))
        places = np.flatnonzero(top) + 1
        strongest = places[np.argsort(self.density[places])[::-1][:most]]
        return sorted(float(self.frequency[place]) for place in strongest)

    def amplitude(self, frequency: float, reach: float) -> float:
        """Amplitude of the sine at a frequency: from the power within ``reach`` (Hz) of it."""
        near = np.abs(self.frequency - frequency) <= reach
        step = float(self.frequency[1] - self.frequency[0])
        return math.sqrt(2.0 * float(self.density[near].sum()) * step)


def spectrum(values: Array, rate: float, seconds: float = 10.0) -> Spectrum:
    """Welch's power spectral density of a signal (n,) without NaN, as deviation from its mean.

    The rate is samples per second; the length of a segment (s) is the inverse of the resolution.
    """
    from scipy import signal

    length = min(len(values), round(seconds * rate))
    frequency, density = signal.welch(values, rate, nperseg=length, detrend='constant')
    return Spectrum(np.asarray(frequency), np.asarray(density))


EQUAL_SHARE = 0.01
"""Numbers that differ by at most this part of the published one are equal."""
METHOD, SHIPPED = 'the same method', 'as shipped'
"""By what a number was made: what the thesis itself ran, or our defaults."""


class Verdict(Enum):
    """What a comparison says of our number."""

    BETTER = 'better'
    EQUAL = 'equal'
    WORSE = 'worse'


_MARKS: dict[Verdict, Literal['good', 'bad', 'neutral']] = {
    Verdict.BETTER: 'good',
    Verdict.EQUAL: 'neutral',
    Verdict.WORSE: 'bad',
}


@dataclass(frozen=True)
class Compared(JudgedCell):
    """Our number beside a published one, the lower being the better.

    Attributes:
        value: ours.
        published: theirs.
        by: `METHOD` or `SHIPPED`.
        low: lower end of the 95 % confidence interval of ours; NaN where it has none.
        high: its upper end.
        is_bound: the published number says only what theirs is below.
        digits: after the point; the column's if None.
        tolerance: for a condition that is to be met: equal within it, worse otherwise.
    """

    value: float
    published: float
    by: str = METHOD
    low: float = math.nan
    high: float = math.nan
    is_bound: bool = False
    tolerance: float = math.nan
    digits: int | None = None

    @classmethod
    def of(cls, interval: Interval, published: float, by: str = METHOD) -> Compared:
        """A value with its confidence interval."""
        return cls(interval.value, published, by, interval.low, interval.high)

    @property
    def verdict(self) -> Verdict:
        """Equal within the interval or within `EQUAL_SHARE`; below a bound as well."""
        if self.is_bound:
            return Verdict.EQUAL if self.value < self.published else Verdict.WORSE
        if not math.isnan(self.tolerance):
            met = abs(self.value - self.published) <= self.tolerance
            return Verdict.EQUAL if met else Verdict.WORSE
        near = abs(self.value - self.published) <= EQUAL_SHARE * abs(self.published)
        if near or self.low <= self.published <= self.high:
            return Verdict.EQUAL
        return Verdict.BETTER if self.value < self.published else Verdict.WORSE

    @property
    def ratio(self) -> float:
        """Ours over theirs."""
        return self.value / self.published if self.published else math.inf

    @property
    def mark(self) -> Literal['good', 'bad', 'neutral']:
        """The verdict's colour."""
        return _MARKS[self.verdict]

    def parts(self, digits: int) -> tuple[str, str, str]:
        """Value, interval if it has one, and verdict."""
        shown = digits if self.digits is None else self.digits
        number, _, interval = Interval(self.value, self.low, self.high).text(shown).partition(' ')
        return number, interval, self.verdict.value


@dataclass(frozen=True)
class ComparedCell:
    """A comparison and its place: table, words of the row, name of the column."""

    table: str
    row: str
    column: str
    compared: Compared

    def record(self) -> dict[str, str | float | None]:
        """As JSON and CSV know it."""
        c = self.compared
        return {
            'table': self.table,
            'row': self.row,
            'column': self.column,
            'by': c.by,
            'thesis': c.published,
            'ours': c.value,
            'low': None if math.isnan(c.low) else c.low,
            'high': None if math.isnan(c.high) else c.high,
            'verdict': c.verdict.value,
        }


@dataclass(frozen=True)
class Claim:
    """A statement, the thesis's number for it and ours; ``holds`` is None if it cannot be known."""

    statement: str
    thesis: str
    ours: str
    holds: bool | None

    @property
    def verdict(self) -> str:
        """In words."""
        return {True: '✓ holds', False: '✗ does not hold', None: '? undecided'}[self.holds]


class ClaimVerdict(JudgedCell):
    """Whether a claim holds, as a cell."""

    def __init__(self, claim: Claim) -> None:
        self.value: str = claim.verdict
        self._holds = claim.holds

    @property
    def mark(self) -> Literal['good', 'bad', 'neutral']:
        """The verdict's colour."""
        return 'neutral' if self._holds is None else 'good' if self._holds else 'bad'

    def parts(self, digits: int) -> tuple[str, str, str]:
        """The verdict alone."""
        return '', '', self.value


def compared_cells(table: Table) -> list[ComparedCell]:
    """Every cell of a table that is held against the thesis, in order."""
    return [
        ComparedCell(table.title.partition(':')[0], _row_name(row), column.name, cell)
        for row in table.rows
        for column, cell in zip(table.columns, row, strict=True)
        if isinstance(cell, Compared)
    ]


def _row_name(row: tuple[Cell, ...]) -> str:
    """The words with which a row begins, at most three."""
    words = takewhile(lambda cell: isinstance(cell, str) and not is_number(cell), row)
    return ', '.join(map(str, islice(words, 3)))


def summary(cells: Sequence[ComparedCell], claims: Sequence[Claim]) -> Section:
    """How many cells have each verdict, the worse ones by name, and the claims."""
    counts, tables = [], []
    for by in (METHOD, SHIPPED):
        chosen = [cell for cell in cells if cell.compared.by == by]
        verdicts = [cell.compared.verdict for cell in chosen]
        count = ', '.join(f'{verdicts.count(verdict)} {verdict.value}' for verdict in Verdict)
        counts.append(f'{by.capitalize()}: of {len(chosen)} cells beside the thesis {count}.')
        worse = [cell for cell in chosen if cell.compared.verdict is Verdict.WORSE]
        rows = [
            (c.table, c.row, c.column, c.compared.value, c.compared.published, c.compared.ratio)
            for c in sorted(worse, key=lambda c: -c.compared.ratio)
        ]
        if rows:
            key, title = f'worse_{by.split()[-1]}', f'{by.capitalize()}: worse than the thesis'
            heading = 'table | row | column | here .4 | thesis .4 | times .2'
            tables.append(Table.of(key, title, heading, rows, 'The worst first.'))
    order = (False, None, True)
    tables.append(
        Table.of(
            'claims',
            "The thesis's conclusions, and ours",
            'statement | thesis, or limit | here | verdict',
            [
                (c.statement, c.thesis, c.ours, ClaimVerdict(c))
                for c in sorted(claims, key=lambda c: order.index(c.holds))
            ],
        )
    )
    return Section('Summary', tuple(counts), tuple(tables))
