"""The part with runs over recordings, and how their numbers go with a parameter."""

from __future__ import annotations

import math
import shutil
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from nicegui import ui

from mvuav_ros.detectors import DETECTORS
from mvuav_ros.offline.evaluation.metrics import metric_groups
from mvuav_ros.offline.report import Column, csv_text
from mvuav_ros.panel import sanitized
from mvuav_ros.panel.controls import value_text
from mvuav_ros.panel.page import elements as el
from mvuav_ros.panel.page.context import Load, Page
from mvuav_ros.panel.page.playback import Frames
from mvuav_ros.panel.page.set_bar import save_set
from mvuav_ros.panel.reel import settable
from mvuav_ros.panel.runs import Run, find_bags, run_table, varied
from mvuav_ros.panel.sanitized import NameRefusedError, checked_name
from mvuav_ros.panel.sets import differences
from mvuav_ros.processing.registry import PROCESSORS

_FIRST = ('flag counts', 'markers by state')
_ARRANGEMENTS = {'single': 'Single', 'subplots': 'Subplots', 'grouped': 'Grouped'}
_OVER_NAMES = 'run'
_HEADS = ('run', 'node', 'recording', 'frames', 'other than default', 'made')
# Quasar's own checkboxes in a table have no name for who cannot see them.
_CHECKBOX = '<q-checkbox dense size="sm" v-model="props.selected" :aria-label="{}" />'
_AS_SET = 'Save to set, run and save'


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
                self._csv = el.button(
                    'CSV', lambda: ui.download.content(csv_text(run_table(self._runs)), 'runs.csv')
                )
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
        return next((list(groups[each]) for each in (*_FIRST, *groups) if each in groups), [])

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
                        self._chart([column], 220)
            else:
                self._chart(columns, 320, grouped=kind == 'grouped')

    def _chart(self, columns: list[str], height: int, *, grouped: bool = False) -> None:
        options = chart_options(self._runs, columns, self._over.value, grouped=grouped)
        chart = ui.echart(options).classes('chart')
        chart.style(f'height: {height}px')
        names = ', '.join(columns)
        el.set_props(chart, data_trend=names, aria_label=f'Trend of {names}')


def chart_options(
    runs: Sequence[Run], columns: Sequence[str], over: str, *, grouped: bool = False
) -> Any:
    """A chart with a line for each column, over the runs in order of the parameter's value.

    If ``grouped``, with a group of bars for each column instead.
    """
    if not grouped and over != _OVER_NAMES:
        runs = sorted(runs, key=lambda run: _order(run.parameters.get(over)))
    parts = [Column.parse(column) for column in columns]
    names, places = [part.name for part in parts], [_place(run, over) for run in runs]
    numbers = [_numbers(runs, column) for column in columns]
    # The unit stands in the title where all columns have the same.
    unit = parts[0].unit if len({part.unit for part in parts}) == 1 else ''
    title = names[0].capitalize() if len(parts) == 1 else 'Trends'
    options = el.axes(title, unit, names if grouped else places)
    look: dict[str, Any] = {'type': 'line', 'symbolSize': 7, 'symbol': 'circle'}
    if grouped:
        look = {'type': 'bar', 'barMaxWidth': 36}
        names, numbers = places, [list(each) for each in zip(*numbers, strict=True)]
        options['yAxis']['scale'] = False
    options['series'] = [
        {**look, 'name': name, 'data': data} for name, data in zip(names, numbers, strict=True)
    ]
    return options


def _place(run: Run, over: str) -> str:
    return run.name if over == _OVER_NAMES else f'{over} {value_text(run.parameters.get(over))}'


def _order(value: Any) -> tuple[bool, float, str]:
    is_number = isinstance(value, (int, float)) and math.isfinite(value)
    return not is_number, float(value) if is_number else 0.0, str(value)


def _numbers(runs: Sequence[Run], column: str) -> list[float | None]:
    found = [next((m.value for m in run.metrics if m.column == column), math.nan) for run in runs]
    return [round(value, 4) if math.isfinite(value) else None for value in found]


class Runs:
    """Start runs, keep them, and look at those kept; ``load`` gives their values to the node."""

    def __init__(self, page: Page, load: Load) -> None:
        self._page, self._load = page, load
        self._runner = page.services.runner
        self._last: Run | None = None
        self._bags: dict[str, Path] = {}
        self._runs: list[Run] = []
        with el.box('part runs stack'):
            with el.box('card'):
                el.text('A recording with the values that the node has now', tag='h2')
                with el.box('form'):
                    self._bag = el.choice([], 'Recording', on_change=self._opened)
                self.frames = Frames(page, lambda: self._bags.get(self._bag.value or ''))
            with el.box('card'):
                el.text('A run over the whole recording', tag='h2')
                self._make_form()
            self._result = el.box('stack')
            with el.box('card'):
                self._make_table()
            self._trends = Trends()
        page.services.runs_changed.subscribe(self.refresh)
        page.services.run_progressed.subscribe(self._show_run)
        self.refresh()
        self._show_run()

    def _make_form(self) -> None:
        with el.box('form'):
            with el.box('line wrap'):
                self._name = ui.input('Name').props('outlined dense')
                self._name.style('flex: 1 1 120px; max-width: 200px')
                self._buttons = [
                    el.button('Run', lambda: self._run(keep=False), 'play_arrow'),
                    el.button('Run and save', self._run, 'save', main=True),
                    el.button(_AS_SET, lambda: self._run(as_set=True), 'playlist_add_check'),
                ]
            with el.box('line wrap').style('min-height: 32px'):
                self._bar = ui.linear_progress(0.0, show_value=False).props('rounded size=6px')
                self._bar.classes('grow').style('min-width: 160px').props('aria-label=Progress')
                self._words = el.text('', 'small soft number').props('role=status')
                self._cancel = el.button('Cancel', self._runner.cancel)

    def _make_table(self) -> None:
        with el.box('line titled wrap'):
            el.text('Saved runs', 'title grow', tag='h2')
            self._load_one = el.button('Load its values', self._load_run)
            self._report_one = el.button('Report', self._show_report)
            self._delete_any = el.button('Delete', self._delete)
        self._table = ui.table(
            rows=[],
            columns=[{'name': head, 'label': head, 'field': head} for head in _HEADS],
            column_defaults={'align': 'left', 'sortable': True},
            row_key='run',
            selection='multiple',
            on_select=self._tick,
        ).props('flat dense binary-state-sort')
        el.set_props(self._table, no_data_label='No run saved yet. “Run and save” keeps one.')
        self._table.add_slot('header-selection', _CHECKBOX.format("'All runs'"))
        self._table.add_slot('body-selection', _CHECKBOX.format('props.row.run'))
        self._rejected = el.text('', 'small soft breaks q-pa-sm')

    def refresh(self) -> None:
        """Look for recordings and runs."""
        services = self._page.services
        self._bags = find_bags([*services.bags, services.recordings])
        chosen = self._bag.value if self._bag.value in self._bags else self._likely()
        self._bag.set_options(list(self._bags), value=chosen)
        if not self._name.value or (services.runs.folder / self._name.value).exists():
            self._name.value = services.runs.free_name()
        self._runs = services.runs.all()
        el.name_rejected(self._rejected, 'Not readable', services.runs.rejected)
        rows = [_row(run) for run in reversed(self._runs)]
        self._table.rows = rows
        self._table.selected = [row for row in rows if row['run'] in self._page.kept['ticks']]
        self._show_ticked()

    def choose_recording(self) -> None:
        """After another node was selected."""
        self._bag.value = self._likely()
        self.frames.follow_node()

    def _opened(self) -> None:
        self._page.kept['recordings'][self._page.selected] = self._bag.value
        self.frames.rewind()

    def _likely(self) -> str | None:
        kept: str | None = self._page.kept['recordings'].get(self._page.selected)
        if kept in self._bags:
            return kept
        node = self._page.node
        word = DETECTORS[node.kind].sample if node is not None else ''
        return next(iter(sorted(self._bags, key=lambda name: word not in name)), None)

    def _tick(self) -> None:
        self._page.kept['ticks'] = [row['run'] for row in self._table.selected]
        self._show_ticked()

    def _chosen(self) -> list[Run]:
        return [run for run in self._runs if run.name in self._page.kept['ticks']]

    def _show_ticked(self) -> None:
        chosen = self._chosen()
        self._load_one.set_enabled(len(chosen) == 1)
        self._report_one.set_enabled(len(chosen) == 1)
        self._delete_any.set_enabled(bool(chosen))
        self._trends.show(chosen)

    async def _load_run(self) -> None:
        (run,) = self._chosen()
        node = self._page.node
        if node is None or node.kind != run.kind:
            el.notify(f'{run.name} is one of {run.kind}: select such a node first.', bad=True)
            return
        await self._load(run.parameters, run.name)

    def _show_report(self) -> None:
        (run,) = self._chosen()
        if self._page.services.runs.report(run.name) is None:
            el.notify(f'{run.name} was made by an older version, without a report.', bad=True)
            return
        ui.navigate.to(f'/report/{run.name}', new_tab=True)

    async def _delete(self) -> None:
        names, services = [run.name for run in self._chosen()], self._page.services
        if await el.confirmed(f'Delete {", ".join(names)} with all results?', 'Delete'):
            for name in names:
                services.runs.delete(name)
            services.runs_changed.emit()

    async def _run(self, *, keep: bool = True, as_set: bool = False) -> None:
        node, services, name = self._page.node, self._page.services, self._name.value or ''
        if self._runner.is_busy:
            return
        if node is None or not node.controls:
            el.notify('No node is selected whose values a run could use.', bad=True)
            return
        if (self._bag.value or '') not in self._bags:
            el.notify('Choose a recording first.', bad=True)
            return
        with el.errors_notified():
            if keep:
                folder = services.runs.new_folder(name)
            else:
                folder = Path(tempfile.mkdtemp(dir=services.scratch))
            try:
                if as_set:
                    save_set(self._page, node, name)
            except (NameRefusedError, OSError):
                shutil.rmtree(folder)
                raise
            image_topic, camera_info_topic, imu_topic = self.frames.topics(node)
            run = Run(
                name=checked_name(name) if keep else '',
                kind=node.kind,
                source=str(self._bags[self._bag.value]),
                parameters=settable(node.kind, node.own_values),
                image_topic=image_topic,
                camera_info_topic=camera_info_topic,
                imu_topic=imu_topic,
            )
            if await self._runner.replay(run, folder) and keep:
                self._page.kept['ticks'] = [*self._page.kept['ticks'], run.name]
            services.runs_changed.emit()

    def _show_run(self) -> None:
        runner = self._runner
        for each in self._buttons:
            each.set_enabled(not runner.is_busy)
        self._cancel.set_enabled(runner.is_busy)
        self._bar.set_value(runner.fraction)
        self._words.set_text(sanitized.words(runner.words, sanitized.LONGEST_DESCRIPTION))
        if runner.last is not None and runner.last is not self._last:
            self._last = runner.last
            self._show_numbers(runner.last)

    def _show_numbers(self, run: Run) -> None:
        rows = [
            (m.name, sanitized.fixed(m.value, 0 if m.value.is_integer() else 3), m.unit)
            for m in run.metrics
        ]
        half = -(-len(rows) // 2)
        self._result.clear()
        with self._result, el.box('card'):
            what = run.name or 'The last run (not saved)'
            el.text(f'{what}: {Path(run.source).name} {run.image_topic}', tag='h2')
            with el.box('charts'):
                el.fill(el.sheet('Numbers of the run', ('', '', '')), rows[:half])
                el.fill(el.sheet('More numbers of the run', ('', '', '')), rows[half:])


def _row(run: Run) -> dict[str, str]:
    defaults = PROCESSORS[run.kind].parameters_type().as_dict()
    changed = differences(run.parameters, defaults).items()
    return {
        'run': run.name,
        'node': run.kind,
        'recording': f'{Path(run.source).name} {run.image_topic}'.rstrip(),
        'frames': f'{run.answered} of {run.frames}{", damaged" if run.lost else ""}',
        'other than default': ', '.join(f'{name} {value_text(own)}' for name, (own, _) in changed)
        or 'nothing',
        'made': time.strftime('%Y-%m-%d %H:%M', time.localtime(run.made)),
    }
