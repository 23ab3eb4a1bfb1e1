"""Trends over chosen runs: over their names or a parameter; single, as subplots or grouped."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

from nicegui import ui

from mvuav_ros.offline.evaluation.metrics import metric_groups, name_and_unit
from mvuav_ros.offline.report import csv_text
from mvuav_ros.panel.controls import value_text
from mvuav_ros.panel.page import elements as el
from mvuav_ros.panel.runs import Run, run_table, varied

_FIRST = ('flag counts', 'markers by state')
_ARRANGEMENTS = {'single': 'Single', 'subplots': 'Subplots', 'grouped': 'Grouped'}
_OVER_NAMES = 'run'


class Trends:
    """Charts of any subset of the numbers of runs, those that ``mvuav sweep`` gives."""

    def __init__(self) -> None:
        self._runs: list[Run] = []
        with el.box('card'):
            with el.box('line titled wrap'):
                el.text('Trends', 'title grow', tag='h2')
                self._arrangement = ui.toggle(
                    _ARRANGEMENTS, value='single', on_change=self._draw
                ).props('dense unelevated toggle-color=primary size=sm no-caps')
                self._csv = el.button('CSV', self._export_csv)
                self._csv.tooltip('Save the numbers and parameters of the chosen runs')
            with el.box('line wrap fields'):
                self._over = el.choice([_OVER_NAMES], 'Over', _OVER_NAMES, on_change=self._draw)
                self._numbers = el.choice(
                    [], 'Numbers', [], multiple=True, on_change=self._draw
                ).props('use-chips')
            self._place = el.box()
        self.show([])

    def show(self, runs: list[Run]) -> None:
        """Draw these runs, in their order."""
        self._runs = runs
        over = [_OVER_NAMES, *varied(runs)]
        chosen = self._over.value if self._over.value in over else _OVER_NAMES
        self._over.set_options(over, value=chosen)
        columns = list(dict.fromkeys(m.column for run in runs for m in run.metrics))
        numbers = [column for column in self._numbers.value or [] if column in columns]
        self._numbers.set_options(columns, value=numbers or self._usual())
        self._csv.set_enabled(bool(runs))
        self._draw()

    def _usual(self) -> list[str]:
        groups = metric_groups(run.metrics for run in self._runs)
        first = [group for group in (*_FIRST, *groups) if group in groups]
        return list(groups[first[0]]) if first else []

    def _draw(self) -> None:
        columns, kind = list(self._numbers.value or []), self._arrangement.value
        self._place.clear()
        with self._place:
            if not self._runs:
                el.empty('No run chosen', 'Tick saved runs above to compare them.')
            elif not columns:
                el.empty('No number chosen', 'Choose one or more of the numbers above.')
            elif kind == 'subplots':
                with el.box('charts'):
                    for column in columns:
                        self._chart(line_options, [column], 220)
            else:
                self._chart(grouped_options if kind == 'grouped' else line_options, columns, 320)

    def _chart(self, options: Callable[..., Any], columns: list[str], height: int) -> None:
        chart = ui.echart(options(self._runs, columns, self._over.value)).classes('chart')
        chart.style(f'height: {height}px')
        names = ', '.join(columns)
        el.set_props(chart, data_trend=names, aria_label=f'Trend of {names}')

    def _export_csv(self) -> None:
        ui.download.content(csv_text(run_table(self._runs)), 'runs.csv')


def line_options(runs: Sequence[Run], columns: Sequence[str], over: str) -> Any:
    """A chart with a line for each column, over the runs in order of the parameter's value."""
    if over != _OVER_NAMES:
        runs = sorted(runs, key=lambda run: _order(run.parameters.get(over)))
    options = el.axes(*_title(columns), [_place(run, over) for run in runs])
    look = {'type': 'line', 'symbolSize': 7, 'symbol': 'circle'}
    options['series'] = [
        {**look, 'name': name_and_unit(each)[0], 'data': _numbers(runs, each)} for each in columns
    ]
    return options


def grouped_options(runs: Sequence[Run], columns: Sequence[str], over: str) -> Any:
    """A chart with a group of bars for each column."""
    options = el.axes(*_title(columns), [name_and_unit(column)[0] for column in columns])
    options['yAxis']['scale'] = False
    look = {'type': 'bar', 'barMaxWidth': 36}
    values = zip(*(_numbers(runs, column) for column in columns), strict=True)
    options['series'] = [
        {**look, 'name': _place(run, over), 'data': list(data)}
        for run, data in zip(runs, values, strict=True)
    ]
    return options


def _place(run: Run, over: str) -> str:
    return run.name if over == _OVER_NAMES else f'{over} {value_text(run.parameters.get(over))}'


def _order(value: Any) -> tuple[bool, float, str]:
    """Numbers by size, then words."""
    is_number = isinstance(value, (int, float)) and math.isfinite(value)
    return not is_number, float(value) if is_number else 0.0, str(value)


def _title(columns: Sequence[str]) -> tuple[str, str]:
    """Of the chart, with the unit where all columns have the same."""
    names, units = zip(*map(name_and_unit, columns), strict=True)
    title = names[0].capitalize() if len(names) == 1 else 'Trends'
    return title, units[0] if len(set(units)) == 1 else ''


def _numbers(runs: Sequence[Run], column: str) -> list[float | None]:
    found = [next((m.value for m in run.metrics if m.column == column), math.nan) for run in runs]
    return [round(value, 4) if math.isfinite(value) else None for value in found]
