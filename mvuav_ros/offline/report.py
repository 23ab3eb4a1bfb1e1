"""Tables and figures as one HTML page, CSV and JSON: what a report says, and its files."""

from __future__ import annotations

import base64
import csv
import html
import io
import json
import math
import re
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import mvuav_ros
from mvuav_ros.messages.untrusted import visible
from mvuav_ros.recordings.remote import write_whole


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
    """Numbers with names; the key is the name of its files without suffix.

    Each row has a cell for every column: None or NaN where there is no number.
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
    """Everything on the page, with the settings that made it besides the version.

    ``data`` is what report.json holds besides settings, tables and figures.
    """

    title: str
    lead: tuple[str, ...]
    settings: Mapping[str, Cell]
    sections: tuple[Section, ...] = ()
    data: Mapping[str, object] = field(default_factory=dict)

    def made_by(self) -> dict[str, Cell]:
        """Version and settings."""
        return {'version': f'mvuav_ros {mvuav_ros.__version__}', **self.settings}

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


_LONGEST_TEXT = 100_000

_STYLE = Path(__file__).with_name('report.css')
_SHORT = 22
"""Tables with at most so many rows are kept on one printed page."""
_WIDE = 9
"""Tables with more columns are set smaller."""
_SCROLL = '<div class="scroll" tabindex="0">'
_WHOLE = 26
"""Texts of at most so many characters are not broken into lines."""


def escape(text: object) -> str:
    """A text as it stands in the page, whoever wrote it."""
    return html.escape(visible(text, _LONGEST_TEXT))


def render_page(report: Report) -> str:
    """The whole page."""
    sections = (*report.sections, _settings(report.made_by()))
    links = ' '.join(f'<a href="#{_anchor(s.title)}">{escape(s.title)}</a>' for s in sections)
    body = [
        f'<h1>{escape(report.title)}</h1>',
        *(f'<p class="lead">{escape(text)}</p>' for text in report.lead),
        f'<nav>{links}</nav>',
        *map(_section, sections),
    ]
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f'<title>{escape(report.title)}</title>\n<style>\n{_STYLE.read_text()}</style>\n'
        '</head>\n<body>\n<main>\n' + '\n'.join(body) + '\n</main>\n</body>\n</html>\n'
    )


def _section(section: Section) -> str:
    parts = [f'<h2 id="{_anchor(section.title)}">{escape(section.title)}</h2>']
    parts += [f'<p>{escape(text)}</p>' for text in section.paragraphs]
    parts += [_table(item) if isinstance(item, Table) else _figure(item) for item in section.items]
    return '\n'.join(parts)


def _table(table: Table) -> str:
    words = [
        any(isinstance(cell := row[number], str) and not is_number(cell) for row in table.rows)
        for number in range(len(table.columns))
    ]
    heads = ''.join(
        f'<th{_word(word)}>{escape(column.name)}'
        + (f'<span class="unit">[{escape(column.unit)}]</span>' if column.unit else '')
        + '</th>'
        for column, word in zip(table.columns, words, strict=True)
    )
    grouped = words[0] and len({row[0] for row in table.rows}) < len(table.rows)
    rows = []
    for index, row in enumerate(table.rows):
        # The first column's text begins a group and is not repeated in it.
        first = index == 0 or row[0] != table.rows[index - 1][0]
        cells = [_cell(table, index, number, word) for number, word in enumerate(words)]
        if grouped and not first:
            cells[0] = '<td></td>'
        rule = ' class="first"' if grouped and first else ''
        rows.append(f'<tr{rule}>{"".join(cells)}</tr>')
    short = ' short' if len(table.rows) <= _SHORT else ''
    short += ' wide' if len(table.columns) > _WIDE else ''
    return (
        f'<div class="table{short}" id="{escape(table.key)}"><h3>{escape(table.title)}</h3>'
        f'{_SCROLL}<table><thead><tr>{heads}</tr></thead>'
        f'<tbody>{"".join(rows)}</tbody></table></div>{_notes(table.notes)}</div>'
    )


def _cell(table: Table, row: int, column: int, word: bool) -> str:
    value = table.rows[row][column]
    if not isinstance(value, JudgedCell):
        text = table.text(row, column)
        return f'<td{_word(word, text)}>{escape(text)}</td>'
    number, interval, verdict = map(escape, value.parts(table.columns[column].digits))
    shown = f'<span class="range">{interval}</span>' if interval else ''
    return f'<td>{number}{shown} <span class="verdict {value.mark}">{verdict}</span></td>'


def _word(word: bool, text: str = '') -> str:
    if not word:
        return ''
    return ' class="word whole"' if 0 < len(text) <= _WHOLE else ' class="word"'


def _figure(figure: Figure) -> str:
    data = base64.b64encode(figure.png).decode('ascii')
    return (
        f'<figure id="{escape(figure.key)}"><h3>{escape(figure.title)}</h3>'
        f'{_SCROLL}<img alt="{escape(figure.alt or figure.title)}" '
        f'src="data:image/png;base64,{data}"></div>{_notes(figure.notes, "figcaption")}</figure>'
    )


def _notes(notes: tuple[str, ...], tag: str = 'div') -> str:
    if not notes:
        return ''
    name = '' if tag == 'figcaption' else ' class="note"'
    return f'<{tag}{name}>{"<br>".join(map(escape, notes))}</{tag}>'


def _settings(settings: Mapping[str, Cell]) -> Section:
    rows = [(name, None if value is None else str(value)) for name, value in settings.items()]
    words = 'The same settings make the same numbers, apart from times.'
    table = Table.of('made', 'What made this page', 'setting | value', rows)
    return Section('Settings', (words,), (table,))


def _anchor(title: str) -> str:
    return ''.join(c if c.isalnum() else '-' for c in title.lower()).strip('-')


PAGE = 'index.html'
DATA = 'report.json'


def write_report(report: Report, folder: Path) -> Path:
    """Write ``index.html``, ``report.json``, and each table (CSV, JSON) and figure (PNG).

    The folder is made; files of the same names are overwritten. Returns the page.

    Raises:
        RecordingError: a file cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for table in report.tables():
        write_whole(folder / f'{table.key}.csv', csv_text(table))
        _write_json(table.records(), folder / f'{table.key}.json')
    for figure in report.figures():
        write_whole(folder / f'{figure.key}.png', figure.png)
    content = {
        'title': report.title,
        'settings': report.made_by(),
        **report.data,
        'tables': {table.key: table.records() for table in report.tables()},
        'figures': {figure.key: f'{figure.key}.png' for figure in report.figures()},
    }
    _write_json(content, folder / DATA)
    page = folder / PAGE
    write_whole(page, render_page(report))
    return page


def csv_text(table: Table) -> str:
    """A table with all digits of its numbers; what is missing stays empty."""
    stream = io.StringIO(newline='')
    writer = csv.writer(stream)
    writer.writerow([column.heading for column in table.columns])
    for record in table.records():
        cells = ['' if value is None else value for value in record.values()]
        writer.writerow([visible(cell) if isinstance(cell, str) else cell for cell in cells])
    return stream.getvalue()


def _write_json(value: object, path: Path) -> None:
    write_whole(path, json.dumps(value, indent=2) + '\n')
