"""Trends over chosen runs: single, as subplots or grouped."""

from __future__ import annotations

import asyncio
import math
from typing import Any

from nicegui import ui

from mvuav_ros.offline.evaluation.metric import metric_groups
from mvuav_ros.offline.report.model import Figure
from mvuav_ros.offline.report.writing import csv_text
from mvuav_ros.panel.page.context import Services
from mvuav_ros.panel.page.elements import axes, box, button, empty, text
from mvuav_ros.panel.runs import SavedRun, run_table

_FIRST = ('flag counts', 'markers by state')
_WORDS = {'single': 'Single', 'subplots': 'Subplots', 'grouped': 'Grouped'}


class Trends:
    """Charts of the numbers of runs, those that ``mvuav sweep`` draws."""

    def __init__(self, services: Services) -> None:
        self._services = services
        self._runs: list[SavedRun] = []
        with box('card'):
            with box('line wrap').style('padding: 8px 8px 8px 14px'):
                text('Trends', 'title grow')
                self._arrangement = ui.toggle(
                    _WORDS,
                    value='single',
                    on_change=self._draw,
                ).props('dense unelevated toggle-color=primary size=sm no-caps')
                self._group = ui.select([], on_change=self._draw)
                self._group.props('outlined dense options-dense').style('flex: 1 1 160px')
                self._group.props['aria-label'] = 'What is drawn'
                with box('actions'):
                    self._csv = button('CSV', self._export_csv)
                    self._csv.tooltip('Save the numbers and parameters of the chosen runs')
                    self._png = button('PNG', self._export_png)
                    self._png.tooltip('Save the figure')
            self._place = box()
        self.show([])

    def show(self, runs: list[SavedRun]) -> None:
        """Draw these runs, in their order."""
        self._runs = runs
        groups = list(metric_groups(run.metrics for run in runs))
        value = self._group.value if self._group.value in groups else None
        first = [group for group in _FIRST if group in groups]
        value = value or next(iter([*first, *groups]), None)
        self._group.set_options(groups, value=value)
        for each in (self._csv, self._png):
            each.set_enabled(bool(runs))
        self._draw()

    def _draw(self) -> None:
        groups = metric_groups(run.metrics for run in self._runs)
        arrangement = self._arrangement.value
        self._group.set_enabled(arrangement != 'subplots' and bool(groups))
        self._place.clear()
        with self._place:
            if not groups:
                empty('No run chosen', 'Tick saved runs above to compare them.')
                return
            names = [run.name for run in self._runs]
            shown = list(groups) if arrangement == 'subplots' else [self._group.value]
            with box('charts' if arrangement == 'subplots' else ''):
                for group in shown:
                    options = _options(self._runs, names, group, groups[group], arrangement)
                    chart = ui.echart(options).classes('chart')
                    chart.style('height: 220px' if arrangement == 'subplots' else 'height: 320px')
                    chart.props['data-trend'] = group

    def _export_csv(self) -> None:
        ui.download.content(csv_text(run_table(self._runs)), 'runs.csv')

    async def _export_png(self) -> None:
        arrangement, group, runs = self._arrangement.value, self._group.value, list(self._runs)

        def draw() -> Figure:
            from mvuav_ros.panel.trend_figures import image_of

            return image_of(runs, arrangement, group)

        figure = await asyncio.to_thread(draw)
        ui.download.content(figure.png, f'{figure.key}.png')


def _options(
    runs: list[SavedRun], names: list[str], group: str, columns: list[str], arrangement: str
) -> Any:
    unit = next((m.unit for run in runs for m in run.metrics if m.group == group), '')
    title = group.capitalize()
    numbers = {
        column: [
            next((_number(m.value) for m in run.metrics if m.column == column), None)
            for run in runs
        ]
        for column in columns
    }
    plain = {column: column.split(' [')[0] for column in columns}
    if arrangement == 'grouped':
        options = axes(title, unit, categories=[plain[column] for column in columns])
        options['yAxis']['scale'] = False
        options['series'] = [
            {
                'name': name,
                'type': 'bar',
                'barMaxWidth': 36,
                'data': [numbers[column][index] for column in columns],
            }
            for index, name in enumerate(names)
        ]
        return options
    options = axes(title, unit, categories=names)
    options['series'] = [
        {'name': plain[column], 'type': 'line', 'symbolSize': 7, 'symbol': 'circle', 'data': values}
        for column, values in numbers.items()
    ]
    return options


def _number(value: float) -> float | None:
    return round(value, 4) if math.isfinite(value) else None
