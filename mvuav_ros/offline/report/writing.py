"""A report's files: the page, and its tables and figures beside it."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path

from mvuav_ros.messages.untrusted import visible
from mvuav_ros.offline.report.model import Report, Table
from mvuav_ros.offline.report.page import render_page
from mvuav_ros.recordings.remote import write_whole

PAGE = 'index.html'
DATA = 'report.json'


def write_report(report: Report, folder: Path) -> Path:
    """Write ``index.html``, ``report.json``, and each table (CSV, JSON) and figure (PNG).

    Args:
        report: what to write.
        folder: made if it is missing; files of the same names are overwritten.

    Returns:
        The page.

    Raises:
        RecordingError: a file cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for table in report.tables():
        write_csv(table, folder / f'{table.key}.csv')
        _write_json(table.records(), folder / f'{table.key}.json')
    for figure in report.figures():
        write_whole(folder / f'{figure.key}.png', figure.png)
    _write_json(as_data(report), folder / DATA)
    page = folder / PAGE
    write_whole(page, render_page(report))
    return page


def write_csv(table: Table, path: Path) -> None:
    """Write a table with all digits of its numbers; what is missing stays empty."""
    write_whole(path, csv_text(table))


def csv_text(table: Table) -> str:
    """What `write_csv` writes."""
    stream = io.StringIO(newline='')
    writer = csv.writer(stream)
    writer.writerow([column.heading for column in table.columns])
    for record in table.records():
        cells = ['' if value is None else value for value in record.values()]
        writer.writerow([visible(cell) if isinstance(cell, str) else cell for cell in cells])
    return stream.getvalue()


def as_data(report: Report) -> dict[str, object]:
    """Settings, tables and the report's own data as JSON knows them."""
    return {
        'title': report.title,
        'settings': dict(report.settings),
        **report.data,
        'tables': {table.key: table.records() for table in report.tables()},
        'figures': {figure.key: f'{figure.key}.png' for figure in report.figures()},
    }


def _write_json(value: object, path: Path) -> None:
    write_whole(path, json.dumps(value, indent=2) + '\n')
