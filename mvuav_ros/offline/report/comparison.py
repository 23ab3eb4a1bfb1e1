"""Numbers held against published ones: better, equal or worse."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

from mvuav_ros.offline.evaluation.numbers import Interval

EQUAL_SHARE = 0.01
"""Numbers that differ by at most this part of the published one are equal."""
METHOD, SHIPPED = 'the same method', 'as shipped'
"""By what a number was made: what the thesis itself ran, or our defaults."""


class Verdict(Enum):
    """What a comparison says of our number."""

    BETTER = 'better'
    EQUAL = 'equal'
    WORSE = 'worse'


@dataclass(frozen=True)
class Compared:
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

    def text(self, digits: int) -> str:
        """Value, interval if it has one, and verdict."""
        shown = digits if self.digits is None else self.digits
        value = Interval(self.value, self.low, self.high).text(shown)
        return f'{value} {self.verdict.value}'


@dataclass(frozen=True)
class ComparedCell:
    """A comparison and its place: table, words of the row, name of the column."""

    table: str
    row: str
    column: str
    compared: Compared

    @property
    def text(self) -> str:
        """One line of a list of worse cells."""
        ours, theirs = self.compared.value, self.compared.published
        return (
            f'{self.table}, {self.row}, {self.column}: {ours:.4g} against {theirs:.4g} '
            f'({self.compared.ratio:.2f} times)'
        )

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


def count_text(cells: Sequence[ComparedCell]) -> str:
    """How many cells have each verdict, in words."""
    verdicts = [cell.compared.verdict for cell in cells]
    return ', '.join(f'{verdicts.count(verdict)} {verdict.value}' for verdict in Verdict)


def worst_first(cells: Sequence[ComparedCell]) -> list[ComparedCell]:
    """The cells that are worse, the greatest ratio first."""
    worse = [c for c in cells if c.compared.verdict is Verdict.WORSE]
    return sorted(worse, key=lambda c: -c.compared.ratio)
