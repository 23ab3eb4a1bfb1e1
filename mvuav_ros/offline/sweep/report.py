"""A sweep's table and its trends as the thesis's GUI has them: single, subplots, grouped."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes

import mvuav_ros
from mvuav_ros.offline.evaluation.metrics import metric_groups, name_and_unit
from mvuav_ros.offline.report.model import Cell, Column, Figure, Report, Section, Table
from mvuav_ros.offline.report.style import COLORS, drawing, label, legend_below
from mvuav_ros.offline.sweep.run import Axis as SweepAxis
from mvuav_ros.offline.sweep.run import RunResult
from mvuav_ros.recordings.recording import counted

_MARKS = 'osD^vP*X'
_MOST_TICKS = 24
_MOST_COLUMNS = 6
"""Of a table, so that it fits a printed page."""
_MOST_LEVEL = 12
"""Labels that fit side by side; more stand upright."""


def sweep_table(results: Sequence[RunResult], axes: Sequence[SweepAxis]) -> Table:
    """One row for each run, in order; metrics that a run lacks are empty."""
    columns = list(dict.fromkeys(m.column for r in results for m in r.metrics))
    rows: list[tuple[Cell, ...]] = []
    for result in results:
        values = {metric.column: metric.cell for metric in result.metrics}
        measured = (values.get(column) for column in columns)
        rows.append((*_run_cells(result), *measured, result.error or None))
    headings = (*_run_columns(axes), *map(Column, columns), Column('error'))
    return Table('sweep', 'Runs', headings, tuple(rows))


def sweep_report(
    results: Sequence[RunResult], axes: Sequence[SweepAxis], settings: Mapping[str, Cell]
) -> Report:
    """Table and trends of results in the order of the runs; settings besides the version."""
    failed = [result for result in results if result.error]
    lead = (
        f'{counted(len(results), "run")}: {counted(len(axes), "parameter")}, '
        f'{counted(len({result.run.source for result in results}), "input")}.',
        *(f'Run {r.run.number} failed: {r.error}' for r in failed),
    )
    good = [result for result in results if not result.error]
    groups = _groups(good)
    sections = [Section('Runs', (), (_key_table(results, axes), *_metric_tables(results)))]
    if groups:
        ticks = _ticks(good, axes)
        singles = tuple(_single(good, group, names, ticks) for group, names in groups.items())
        sections += [
            Section('Trends together', (), (_subplots(good, groups, ticks),)),
            Section('Trends grouped by input', (), _grouped(good, groups, axes)),
            Section('Trends one by one', (), singles),
        ]
    return Report(
        'Parameter sweep',
        lead,
        {'version': f'mvuav_ros {mvuav_ros.__version__}', **settings},
        tuple(sections),
    )


def _run_columns(axes: Sequence[SweepAxis]) -> tuple[Column, ...]:
    """What tells runs apart."""
    return (Column('run'), Column('input'), *(Column(axis.title) for axis in axes))


def _run_cells(result: RunResult) -> tuple[Cell, ...]:
    run = result.run
    return (run.number, run.source, *map(_cell, run.values))


def _key_table(results: Sequence[RunResult], axes: Sequence[SweepAxis]) -> Table:
    rows = tuple((*_run_cells(result), result.error or 'ok') for result in results)
    return Table('runs', 'What was run', (*_run_columns(axes), Column('state')), rows)


def _metric_tables(results: Sequence[RunResult]) -> list[Table]:
    """Whole groups side by side as far as they fit; all of them are too wide for a page."""
    groups = _groups(results)
    parts: list[list[str]] = [[]]
    for group, names in groups.items():
        if parts[-1] and sum(len(groups[g]) for g in parts[-1]) + len(names) > _MOST_COLUMNS:
            parts.append([])
        parts[-1].append(group)
    tables = []
    for number, part in enumerate(parts, 1):
        names = [name for group in part for name in groups[group]]
        rows = []
        for result in (result for result in results if not result.error):
            cells = {metric.column: metric.cell for metric in result.metrics}
            rows.append((result.run.number, *map(cells.get, names)))
        columns = (Column('run'), *(Column(*name_and_unit(name)) for name in names))
        title = ', '.join(part).capitalize()
        tables.append(Table(f'numbers_{number}', title, columns, tuple(rows)))
    return tables


def _groups(results: Sequence[RunResult]) -> dict[str, list[str]]:
    return metric_groups(result.metrics for result in results)


def _value(result: RunResult, column: str) -> float:
    return next((m.value for m in result.metrics if m.column == column), math.nan)


def _single(
    results: Sequence[RunResult], group: str, names: Sequence[str], ticks: Sequence[str]
) -> Figure:
    with drawing(9.6, 3.6) as canvas:
        axes = canvas.figure.subplots()
        _draw(axes, results, group, names, ticks)
    return Figure(f'trend_{_key(group)}', group.capitalize(), canvas.png)


def _subplots(
    results: Sequence[RunResult], groups: Mapping[str, Sequence[str]], ticks: Sequence[str]
) -> Figure:
    rows = math.ceil(len(groups) / 2)
    with drawing(9.6, 0.6 + 2.6 * rows) as canvas:
        panels = canvas.figure.subplots(rows, 2, squeeze=False)
        for axes, (group, names) in zip(panels.flat, groups.items(), strict=False):
            _draw(axes, results, group, names, ticks)
        for axes in list(panels.flat)[len(groups) :]:
            axes.set_visible(False)
    return Figure('trends_subplot', 'All trends', canvas.png)


def _draw(
    axes: Axes, results: Sequence[RunResult], group: str, names: Sequence[str], ticks: Sequence[str]
) -> None:
    numbers = [result.run.number for result in results]
    for index, name in enumerate(names):
        values = [_value(result, name) for result in results]
        mark, plain = _MARKS[index % len(_MARKS)], name_and_unit(name)[0]
        color = COLORS[index % len(COLORS)]
        axes.plot(numbers, values, f'{mark}-', color=color, ms=4, lw=1.0, label=plain)
    label(axes, group.capitalize(), 'run', _unit(names))
    if ticks:
        axes.set_xticks(numbers, ticks)
        axes.set_xlabel('run: value')
    axes.legend(loc='best')


def _grouped(
    results: Sequence[RunResult], groups: Mapping[str, Sequence[str]], axes: Sequence[SweepAxis]
) -> tuple[Figure, ...]:
    """Bars over the values of the parameters, one colour for each input."""
    sources = list(dict.fromkeys(result.run.source for result in results))
    cells = list(dict.fromkeys(result.run.values for result in results))
    titles = [', '.join(str(_cell(value)) for value in values) or 'defaults' for values in cells]
    figures = []
    for group, names in groups.items():
        with drawing(9.6, 0.8 + 2.3 * len(names)) as canvas:
            panels = canvas.figure.subplots(len(names), 1, squeeze=False, sharex=True)[:, 0]
            width = 0.8 / len(sources)
            for panel, name in zip(panels, names, strict=True):
                for index, source in enumerate(sources):
                    own = (result for result in results if result.run.source == source)
                    found = {result.run.values: _value(result, name) for result in own}
                    heights = [found.get(cell, math.nan) for cell in cells]
                    offset = (index - 0.5 * (len(sources) - 1)) * width
                    color, places = COLORS[index % len(COLORS)], np.arange(len(cells)) + offset
                    panel.bar(places, heights, width, color=color, label=source)
                panel.grid(axis='x', visible=False)
                label(panel, name_and_unit(name)[0], '', _unit([name]))
            panels[-1].set_xticks(
                range(len(cells)), titles, rotation=0 if len(cells) <= _MOST_LEVEL else 90
            )
            panels[-1].set_xlabel(', '.join(axis.title for axis in axes) or 'parameters')
            legend_below(canvas.figure, panels[0], columns=1)
        figures.append(Figure(f'grouped_{_key(group)}', group.capitalize(), canvas.png))
    return tuple(figures)


def _ticks(results: Sequence[RunResult], axes: Sequence[SweepAxis]) -> list[str]:
    """Run numbers with the value below, where that fits."""
    if len(axes) != 1 or len(results) > _MOST_TICKS:
        return []
    return [f'{r.run.number}:\n{_cell(r.run.values[0])}' for r in results]


def _cell(value: object) -> Cell:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, (int, str)):
        return value
    return f'{value:g}' if isinstance(value, float) else str(value)


def _unit(names: Sequence[str]) -> str:
    unit = name_and_unit(names[0])[1]
    return f'[{unit}]' if unit else 'count'


def _key(group: str) -> str:
    return re.sub(r'\W+', '_', group)
