"""A grid of parameters over several inputs: runs, table, and trends as in the GUI of the thesis."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from mvuav_ros.detectors import DETECTORS
from mvuav_ros.messages.untrusted import visible
from mvuav_ros.offline.evaluation.evaluation_run import replay
from mvuav_ros.offline.evaluation.metrics import Metric, metric_groups, metrics_of
from mvuav_ros.offline.replay.job import ReplaySettings
from mvuav_ros.offline.report import Cell, Column, Figure, Report, Section, Table
from mvuav_ros.offline.tasks import each
from mvuav_ros.parameters.declaration import ParameterError, Value
from mvuav_ros.parameters.parameter_file import NODE_PARAMETERS, parse_assignment
from mvuav_ros.recordings.account import counted
from mvuav_ros.recordings.layout import absolute_place, recordings_in


@dataclass(frozen=True)
class Axis:
    """A parameter and the values that it takes in turn."""

    node: str
    name: str
    values: tuple[Value, ...]

    @property
    def title(self) -> str:
        """As the user wrote it."""
        return f'{self.node}:{self.name}'


@dataclass(frozen=True)
class SweepRun:
    """One input with one set of parameters."""

    number: int  # from 1
    source: str
    values: tuple[Value, ...]  # of the axes, in their order
    settings: ReplaySettings  # with these values among the parameters


@dataclass(frozen=True)
class RunResult:
    """A run's numbers and what is missing in them, or why it failed."""

    run: SweepRun
    metrics: tuple[Metric, ...] = ()
    error: str = ''
    losses: tuple[str, ...] = ()

    @cached_property
    def cells(self) -> dict[str, Cell]:
        """The numbers by their columns."""
        return {metric.column: metric.cell for metric in self.metrics}


def parse_axis(text: str) -> Axis:
    """Read ``node:name:=value,value,…``; one value is an axis of one, ``[1,2,3]`` is one value.

    Raises:
        ParameterError: the form is another, the node or parameter is unknown, or a value of the
            list is not valid.
    """
    target, sign, values = text.partition(':=')
    parts = [part.strip() for part in re.split(r',(?![^\[]*\])', values)]
    if not sign or not all(parts):
        raise ParameterError(
            text, 'write node:name:=value,value as in marker_tracker:search_radius:=4,6,8'
        )
    assignments = [parse_assignment(f'{target}:={part}') for part in parts]
    node, name, _ = assignments[0]
    if node not in DETECTORS:
        raise ParameterError(text, f'there are {", ".join(DETECTORS)}')
    spec = NODE_PARAMETERS[node].spec(name)
    return Axis(node, name, tuple(spec.convert(value) for _, _, value in assignments))


def plan_runs(
    sources: Sequence[str], axes: Sequence[Axis], settings: ReplaySettings
) -> list[SweepRun]:
    """Every combination of the axes' values, on every input; of a folder of them, on each.

    ``settings`` hold for all runs, their parameters where no axis has others.

    Raises:
        ParameterError: a parameter occurs twice, or its node is not to run.
    """
    base = settings.parameters
    for axis in axes:
        if axis.node not in base:
            raise ParameterError(axis.title, f'{axis.node} is not among {", ".join(base)}')
    titles = [axis.title for axis in axes]
    for title in titles:
        if titles.count(title) > 1:
            raise ParameterError(title, 'occurs twice; list its values in one --param')
    runs = []
    inputs = [each for source in sources for each in recordings_in(source)]
    grid = itertools.product(inputs, itertools.product(*(axis.values for axis in axes)))
    for number, (source, values) in enumerate(grid, 1):
        parameters = {node: dict(given) for node, given in base.items()}
        for axis, value in zip(axes, values, strict=True):
            parameters[axis.node][axis.name] = value
        runs.append(SweepRun(number, source, values, replace(settings, parameters=parameters)))
    return runs


def do_run(run: SweepRun) -> tuple[list[Metric], list[str]]:
    """Replay one run's input and measure; with what could not be read.

    Raises:
        SourceError, RecordingError, ParameterError: see `replay`.
    """
    replayed = replay(run.source, run.settings)
    return metrics_of(replayed), replayed.errors


def sweep(runs: Sequence[SweepRun], jobs: int = 1, dask: str | None = None) -> Iterator[RunResult]:
    """Do the runs, as `each` does tasks; one that fails is reported."""
    tasks = runs
    if dask:
        # A worker may run in another folder.
        tasks = [
            replace(run, source=absolute_place(run.source), settings=run.settings.absolute())
            for run in runs
        ]
    for one in each(do_run, tasks, jobs, dask):
        run = runs[one.number]
        if one.result is not None:
            metrics, losses = one.result
            yield RunResult(run, tuple(metrics), losses=tuple(losses))
        else:
            words = ' '.join(str(one.error).split())
            yield RunResult(run, error=words or type(one.error).__name__)


_MARKS = 'osD^vP*X'
_MAX_TICKS = 24
_MAX_COLUMNS = 6
"""Of a table, so that it fits a printed page."""
_MAX_LEVEL = 12
"""Labels that fit side by side; more stand upright."""


def sweep_table(results: Sequence[RunResult], axes: Sequence[Axis]) -> Table:
    """One row for each run, in order; metrics that a run lacks are empty."""
    columns = list(dict.fromkeys(m.column for r in results for m in r.metrics))
    rows = tuple(
        (*_run_cells(result), *map(result.cells.get, columns), result.error or None)
        for result in results
    )
    headings = (*_run_columns(axes), *map(Column, columns), Column('error'))
    return Table('sweep', 'Runs', headings, rows)


def sweep_report(
    results: Sequence[RunResult], axes: Sequence[Axis], settings: Mapping[str, Cell]
) -> Report:
    """Table and trends of results in the order of the runs."""
    good = [result for result in results if not result.error]
    groups = metric_groups(result.metrics for result in good)
    lead = (
        f'{counted(len(results), "run")}: {counted(len(axes), "parameter")}, '
        f'{counted(len({result.run.source for result in results}), "input")}.',
        *(f'Run {r.run.number} failed: {r.error}' for r in results if r.error),
        *(f'Run {r.run.number}, not all is in it: {loss}' for r in results for loss in r.losses),
    )
    states = tuple((*_run_cells(result), result.error or 'ok') for result in results)
    runs = Table('runs', 'What was run', (*_run_columns(axes), Column('state')), states)
    sections = [Section('Runs', (), (runs, *_metric_tables(good, groups)))]
    if groups:
        titles = {place: axis.title for place, axis in enumerate(axes)}
        shown = {place: titles[place] for place in titles if len(axes[place].values) > 1} or titles
        together = _trends('trends_subplot', 'All trends', good, groups, shown)
        singles = (
            _trends(f'trend_{_key(g)}', g.capitalize(), good, {g: names}, shown)
            for g, names in groups.items()
        )
        sections += [
            Section('Trends together', (), (together,)),
            Section('Trends grouped by input', (), _grouped(good, groups, shown)),
            Section('Trends one by one', (), tuple(singles)),
        ]
    return Report('Parameter sweep', lead, settings, tuple(sections))


def _run_columns(axes: Sequence[Axis]) -> tuple[Column, ...]:
    return (Column('run'), Column('input'), *(Column(axis.title) for axis in axes))


def _run_cells(result: RunResult) -> tuple[Cell, ...]:
    run = result.run
    return (run.number, run.source, *map(_cell, run.values))


def _metric_tables(
    results: Sequence[RunResult], groups: Mapping[str, Sequence[str]]
) -> Iterator[Table]:
    """Whole groups side by side as far as they fit; all of them are too wide for a page."""
    parts: list[list[str]] = [[]]
    for group, names in groups.items():
        if parts[-1] and sum(len(groups[g]) for g in parts[-1]) + len(names) > _MAX_COLUMNS:
            parts.append([])
        parts[-1].append(group)
    for number, part in enumerate(parts, 1):
        columns = [name for group in part for name in groups[group]]
        rows = [(result.run.number, *map(result.cells.get, columns)) for result in results]
        title, heading = ', '.join(part).capitalize(), ' | '.join(('run', *columns))
        yield Table.of(f'numbers_{number}', title, heading, rows)


def _trends(
    key: str,
    title: str,
    results: Sequence[RunResult],
    groups: Mapping[str, Sequence[str]],
    shown: Mapping[int, str],
) -> Figure:
    """A diagram for each group, two in a row."""
    from mvuav_ros.offline.report_figures import COLORS, drawing, label

    numbers, ticks = [result.run.number for result in results], _ticks(results, shown)
    x = ': '.join(['run', *shown.values()]) if ticks else 'run'
    rows, height = math.ceil(len(groups) / 2), 2.6 if len(groups) > 1 else 3.0
    with drawing(9.6, 0.6 + height * rows) as canvas:
        panels = canvas.figure.subplots(rows, min(len(groups), 2), squeeze=False).ravel()
        for axes, (group, names) in zip(panels, groups.items(), strict=False):
            for index, name in enumerate(names):
                values = [result.cells.get(name, math.nan) for result in results]
                mark, plain = _MARKS[index % len(_MARKS)], Column.parse(name).name
                color = COLORS[index % len(COLORS)]
                axes.plot(numbers, values, f'{mark}-', color=color, ms=4, lw=1.0, label=plain)
            label(axes, group.capitalize(), x, _unit(names))
            axes.locator_params('x', integer=True)
            if ticks:
                axes.set_xticks(numbers, ticks)
            axes.legend(loc='best')
        for axes in panels[len(groups) :]:
            axes.set_visible(False)
    return Figure(key, title, canvas.png)


def _grouped(
    results: Sequence[RunResult], groups: Mapping[str, Sequence[str]], shown: Mapping[int, str]
) -> tuple[Figure, ...]:
    """Bars over the values of the parameters shown (place: title), one colour for each input."""
    from mvuav_ros.offline.report_figures import COLORS, drawing, label, legend_below

    sources = list(dict.fromkeys(result.run.source for result in results))
    cells = list(dict.fromkeys(result.run.values for result in results))
    titles = [', '.join(str(_cell(values[n])) for n in shown) or 'defaults' for values in cells]
    width = 0.8 / len(sources)
    figures = []
    for group, names in groups.items():
        with drawing(9.6, 0.8 + 2.3 * len(names)) as canvas:
            panels = canvas.figure.subplots(len(names), 1, squeeze=False, sharex=True)[:, 0]
            for panel, name in zip(panels, names, strict=True):
                for index, source in enumerate(sources):
                    own = (result for result in results if result.run.source == source)
                    found = {r.run.values: r.cells.get(name, math.nan) for r in own}
                    heights = [found.get(cell, math.nan) for cell in cells]
                    # From a legend matplotlib leaves out what begins with an underscore.
                    spaced = ' ' * source.startswith('_')
                    offset = (index - 0.5 * (len(sources) - 1)) * width
                    color, places = COLORS[index % len(COLORS)], np.arange(len(cells)) + offset
                    panel.bar(places, heights, width, color=color, label=spaced + visible(source))
                panel.grid(axis='x', visible=False)
                label(panel, Column.parse(name).name, '', _unit([name]))
            upright = 0 if len(cells) <= _MAX_LEVEL else 90
            panels[-1].set_xticks(range(len(cells)), titles, rotation=upright)
            panels[-1].set_xlabel(', '.join(shown.values()) or 'parameters')
            legend_below(canvas.figure, panels[0], columns=1)
        figures.append(Figure(f'grouped_{_key(group)}', group.capitalize(), canvas.png))
    return tuple(figures)


def _ticks(results: Sequence[RunResult], shown: Mapping[int, str]) -> list[str]:
    """Run numbers with the value below, where one parameter is shown and that fits."""
    if len(shown) != 1 or len(results) > _MAX_TICKS:
        return []
    (place,) = shown
    return [f'{r.run.number}:\n{_cell(r.run.values[place])}' for r in results]


def _cell(value: object) -> Cell:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, (int, str)):
        return value
    return f'{value:g}' if isinstance(value, float) else str(value)


def _unit(names: Sequence[str]) -> str:
    unit = Column.parse(names[0]).unit
    return f'[{unit}]' if unit else 'count'


def _key(group: str) -> str:
    return re.sub(r'\W+', '_', group)
