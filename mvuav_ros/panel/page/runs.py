"""The part with runs over recordings."""

from __future__ import annotations

import shutil
import time
from pathlib import Path
from typing import Any

from nicegui import background_tasks, ui

from mvuav_ros.panel.controls import value_text
from mvuav_ros.panel.names import NameRefusedError
from mvuav_ros.panel.page.context import Page
from mvuav_ros.panel.page.elements import (
    ask_to_delete,
    box,
    button,
    empty,
    icon_button,
    sheet,
    tell,
    text,
)
from mvuav_ros.panel.page.trends import Trends
from mvuav_ros.panel.run_process import RunFailedError, RunProcess, RunRequest
from mvuav_ros.panel.runs import RESULTS, SavedRun, find_bags
from mvuav_ros.processing.registry import PROCESSORS
from mvuav_ros.recordings.errors import RecordingError


class Runs:
    """Start runs, keep them, and look at those kept."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._process: RunProcess | None = None
        self._chosen: list[str] = []
        self._bags: dict[str, Path] = {}
        with (
            box('part runs', 'section').props('aria-label=Runs') as self._place,
            box('stack'),
        ):
            with box('card'):
                text('A run over a recording, with the values that the node has now', tag='h2')
                self._form()
            self._result = box('card')
            self._result.set_visibility(False)
            with box('card'):
                with box('line').style('padding: 8px 8px 4px 14px'):
                    text('Saved runs', 'title grow')
                self._list = box()
            self._trends = Trends(page.services)
        page.on_select.append(self._other_node)
        self.refresh()

    def _form(self) -> None:
        with box('form'):
            with box('line wrap'):
                self._bag = ui.select([], label='Recording').props('outlined dense options-dense')
                self._bag.classes('grow').style('min-width: 200px')
                self._name = ui.input('Name').props('outlined dense')
                self._name.style('flex: 1 1 120px; max-width: 200px')
                with box('actions'):
                    self._run = button('Run', lambda: self._start(keep=False), 'play_arrow')
                    self._save = button(
                        'Run and save', lambda: self._start(keep=True), 'save', main=True
                    )
            with box('line').style('min-height: 32px'):
                self._bar = ui.linear_progress(0.0, show_value=False).props('rounded size=6px')
                self._bar.classes('grow').props['aria-label'] = 'Progress'
                self._words = text('', 'small soft number').props('role=status')
                self._cancel = button('Cancel', self._cancel_run)
                self._cancel.disable()

    def refresh(self) -> None:
        """Look for recordings and runs."""
        self._bags = find_bags(self._page.services.bags)
        names = list(self._bags)
        value = self._bag.value if self._bag.value in names else self._likely(names)
        self._bag.set_options(names, value=value)
        if not self._name.value:
            self._name.value = self._page.services.runs.free_name()
        self._show_list()

    def _other_node(self) -> None:
        self._bag.value = self._likely(list(self._bags))

    def _likely(self, names: list[str]) -> str | None:
        kind = self._page.node.kind if self._page.node is not None else ''
        word = {'marker_tracker': 'tanker', 'runway_detector': 'runway'}.get(kind, '')
        fitting = [name for name in names if word and word in name]
        return next(iter([*fitting, *names]), None)

    def _show_list(self) -> None:
        runs = self._page.services.runs.all()
        names = [run.name for run in runs]
        self._chosen = [name for name in self._chosen if name in names]
        self._list.clear()
        with self._list:
            if not runs:
                empty('No run saved yet', '“Run and save” keeps parameters, results and input.')
            else:
                self._table(runs)
        self._show_trends()

    def _table(self, runs: list[SavedRun]) -> None:
        with box('scroll'), box('sheet words', 'table'):
            with box(tag='thead'), box(tag='tr'):
                for head in ('', 'run', 'node', 'recording', 'frames', 'other than default', ''):
                    text(head, tag='th')
            with box(tag='tbody'):
                for run in reversed(runs):
                    self._table_row(run)

    def _table_row(self, run: SavedRun) -> None:
        changed = ', '.join(
            f'{name} {value_text(value)}' for name, value in changed_values(run).items()
        )
        with box(tag='tr') as row:
            row.props['data-run'] = run.name
            with box(tag='td'):
                check = ui.checkbox(
                    value=run.name in self._chosen,
                    on_change=lambda e: self._choose(run.name, bool(e.value)),
                ).props('dense size=sm')
                check.props['aria-label'] = f'{run.name} in the trends'
            text(run.name, tag='td').tooltip(
                f'{time.strftime("%Y-%m-%d %H:%M", time.localtime(run.made))}, '
                f'mvuav_ros {run.version}'
            )
            text(run.kind, tag='td')
            text(Path(run.source).name, tag='td')
            text(f'{run.answered} of {run.frames}', tag='td')
            text(changed or 'nothing', tag='td').style(
                'max-width: 320px; overflow: hidden; text-overflow: ellipsis'
            ).tooltip(changed or 'nothing')
            with box(tag='td'):
                icon_button('delete_outline', f'Delete {run.name}', lambda: self._ask(run.name))

    def _choose(self, name: str, chosen: bool) -> None:
        self._chosen = [each for each in self._chosen if each != name]
        if chosen:
            self._chosen.append(name)
        self._show_trends()

    def _show_trends(self) -> None:
        runs = self._page.services.runs.all()
        self._trends.show([run for run in runs if run.name in self._chosen])

    def _ask(self, name: str) -> None:
        def delete() -> None:
            self._page.services.runs.delete(name)
            self._show_list()

        ask_to_delete(f'Delete {name} with its results?', delete)

    def _start(self, *, keep: bool) -> None:
        node, bag = self._page.node, self._bags.get(self._bag.value or '')
        if node is None or not node.controls:
            tell('There is no node whose values a run could take.', bad=True)
        elif bag is None:
            tell('Choose a recording first.', bad=True)
        elif self._process is None:
            try:
                folder = self._folder(keep)
            except (NameRefusedError, OSError) as error:
                tell(str(error), bad=True)
                return
            known = PROCESSORS[node.kind].parameters_type.names()
            values = {k: v for k, v in self._page.own_values().items() if k in known}
            self._process = RunProcess()
            name = folder.name
            background_tasks.create(
                self._work(self._process, name, node.kind, bag, values, folder, keep)
            )

    def _folder(self, keep: bool) -> Path:
        if keep:
            return self._page.services.runs.new_folder(self._name.value or '')
        folder = self._page.services.scratch / f'run_{time.time_ns()}'
        folder.mkdir(parents=True)
        return folder

    async def _work(
        self,
        process: RunProcess,
        name: str,
        kind: str,
        bag: Path,
        values: dict[str, Any],
        folder: Path,
        keep: bool,
    ) -> None:
        self._busy(True)
        settings = self._page.chosen_set
        try:
            request = RunRequest(name, kind, bag, values, folder / RESULTS, settings)
            run = await process.run(request, self._progress)
            if keep:
                self._page.services.runs.finish(run)
                self._chosen.append(run.name)
                self._name.value = self._page.services.runs.free_name()
            self._done(run, keep)
        except (RunFailedError, RecordingError, OSError) as error:
            self._words.set_text('cancelled' if process.cancelled else f'failed: {error}')
            keep = False
        finally:
            if not keep:
                shutil.rmtree(folder, ignore_errors=True)
            self._process = None
            self._busy(False)
            self._show_list()

    def _busy(self, busy: bool) -> None:
        self._run.set_enabled(not busy)
        self._save.set_enabled(not busy)
        self._cancel.set_enabled(busy)
        if busy:
            self._bar.set_value(0.0)
            self._words.set_text('starting')

    def _progress(self, done: int, total: int | None) -> None:
        self._bar.set_value(done / total if total else 0.0)
        self._words.set_text(f'{done} of {total} frames' if total else f'{done} frames')

    def _cancel_run(self) -> None:
        if self._process is not None:
            self._process.cancel()

    def _done(self, run: SavedRun, keep: bool) -> None:
        self._bar.set_value(1.0)
        self._words.set_text(f'{run.answered} of {run.frames} frames')
        self._result.set_visibility(True)
        self._result.clear()
        with self._result:
            title = run.name if keep else 'The last run (not saved)'
            text(f'{title}: {Path(run.source).name}', tag='h2')
            rows = [[m.name, number_text(m.value), m.unit] for m in run.metrics]
            half = -(-len(rows) // 2)
            with box('charts').style('gap: 0 12px; padding: 4px 0 8px'):
                sheet(rows[:half])
                sheet(rows[half:])


def changed_values(run: SavedRun) -> dict[str, Any]:
    """The parameters of a run that are not the default."""
    defaults = PROCESSORS[run.kind].parameters_type().as_dict()
    return {k: v for k, v in run.parameters.items() if k in defaults and defaults[k] != v}


def number_text(value: float) -> str:
    """A result as the panel writes it."""
    if value != value:
        return '-'
    return f'{value:.0f}' if value == int(value) and abs(value) < 1e9 else f'{value:.3f}'
