"""Tables, figures and sections: what a report says, apart from how it looks."""

from __future__ import annotations

import math
import re
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal


class JudgedCell(ABC):
    """A cell with a verdict beside it."""

    value: str | float
    """What CSV and JSON hold."""

    @property
    @abstractmethod
    def mark(self) -> Literal['good', 'bad', 'neutral']:
        """The verdict's colour."""

    @abstractmethod
    def parts(self, digits: int) -> tuple[str, str, str]:
        """Value, its interval, and the verdict as people read them; any may be empty."""


Cell = str | float | int | JudgedCell | None
_GROUPED = 10_000
"""Counts from here on are written with commas."""


@dataclass(frozen=True)
class Column:
    """One column of a table; ``digits`` are those after the point of its numbers."""

    name: str
    unit: str = ''
    digits: int = 3

    @property
    def heading(self) -> str:
        """Name and unit."""
        return f'{self.name} [{self.unit}]' if self.unit else self.name

    @classmethod
    def parse(cls, text: str) -> Column:
        """Read ``name [unit] .digits``, of which the name is enough."""
        match = re.fullmatch(r'(.*?)(?: \[(.*)\])?(?: \.(\d))?', text)
        assert match is not None  # everything is a name at least
        return cls(match[1], match[2] or '', int(match[3] or cls.digits))


@dataclass(frozen=True)
class Table:
    """Numbers with names.

    Attributes:
        key: file name without suffix.
        title: what a reader calls it.
        columns: of every row.
        rows: one cell per column; None or NaN where there is no number.
        notes: below it, one paragraph each.
    """

    key: str
    title: str
    columns: tuple[Column, ...]
    rows: tuple[tuple[Cell, ...], ...]
    notes: tuple[str, ...] = ()

    @classmethod
    def of(
        cls, key: str, title: str, heading: str, rows: Iterable[Sequence[Cell]], *notes: str
    ) -> Table:
        """A table whose columns are written as `Column.parse` reads them, with ``|`` between.

        Examples:
            >>> table = Table.of('lines', 'Lines', 'line | distance [px] .2', [('left', 1.0)])
            >>> table.columns[1]
            Column(name='distance', unit='px', digits=2)
        """
        columns = tuple(Column.parse(text) for text in heading.split(' | '))
        return cls(key, title, columns, tuple(map(tuple, rows)), notes)

    def __post_init__(self) -> None:
        for row in self.rows:
            if len(row) != len(self.columns):
                raise ValueError(f'{self.key}: {len(row)} cells for {len(self.columns)} columns')

    def records(self) -> list[dict[str, Cell]]:
        """The rows with their columns' headings; missing numbers as None, compared ones plain."""
        headings = [column.heading for column in self.columns]
        return [dict(zip(headings, map(_known, row), strict=True)) for row in self.rows]

    def text(self, row: int, column: int) -> str:
        """One cell as people read it."""
        digits = self.columns[column].digits
        given = self.rows[row][column]
        value = _known(given)
        if value is None:
            return '–'  # noqa: RUF001
        if isinstance(given, JudgedCell):
            return ' '.join(filter(None, given.parts(digits)))
        if isinstance(value, float):
            return f'{value:.{digits}f}'
        return f'{value:,}' if isinstance(value, int) and value >= _GROUPED else str(value)


@dataclass(frozen=True)
class Figure:
    """A figure; ``png`` is the file's content, ``alt`` says what it shows."""

    key: str
    title: str
    png: bytes = field(repr=False)
    alt: str = ''
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Section:
    """Text, then tables and figures in order."""

    title: str
    paragraphs: tuple[str, ...] = ()
    items: tuple[Table | Figure, ...] = ()


@dataclass(frozen=True)
class Report:
    """Everything on the page.

    Attributes:
        title: of the page.
        lead: paragraphs at its beginning.
        settings: what made it, by name; shown and kept as JSON.
        sections: in order.
        data: what report.json holds besides settings, tables and figures.
    """

    title: str
    lead: tuple[str, ...]
    settings: Mapping[str, Cell]
    sections: tuple[Section, ...] = ()
    data: Mapping[str, object] = field(default_factory=dict)

    def tables(self) -> list[Table]:
        """All tables in order."""
        return [i for section in self.sections for i in section.items if isinstance(i, Table)]

    def figures(self) -> list[Figure]:
        """All figures in order."""
        return [i for section in self.sections for i in section.items if isinstance(i, Figure)]


def is_number(text: str) -> bool:
    """Whether a text is a number as somebody else prints it, with its interval or its bound."""
    return text in ('N/A', '') or text.lstrip('<-')[:1].isdigit()


def _known(value: Cell) -> str | float | int | None:
    if isinstance(value, JudgedCell):
        value = value.value
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
