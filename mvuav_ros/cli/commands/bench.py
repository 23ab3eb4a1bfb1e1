"""``mvuav bench``: how fast, beside what any implementation needs."""

from __future__ import annotations

import json
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from mvuav_ros.cli.bench.approach import approach_cases
from mvuav_ros.cli.bench.case import Measurement, measure
from mvuav_ros.cli.bench.live import LiveResult, live_cases, measure_live
from mvuav_ros.cli.bench.live_table import print_results
from mvuav_ros.cli.bench.markers import marker_cases
from mvuav_ros.cli.bench.replay import replay_cases
from mvuav_ros.cli.bench.runway import runway_cases
from mvuav_ros.cli.bench.simulation import simulation_cases
from mvuav_ros.cli.options import Json
from mvuav_ros.cli.progress import frame_progress

SUITES = {
    'markers': marker_cases,
    'runway': runway_cases,
    'approach': approach_cases,
    'simulation': simulation_cases,
    'replay': replay_cases,
}

LIVE = 'live'
"""The suite of processes on real DDS, which takes minutes and is run only when named."""
LIVE_SECONDS = 5.0


def bench(
    suite: Annotated[
        list[str] | None,
        typer.Argument(
            help=f'Suites to run: {", ".join(SUITES)}; default: all of these. live: the nodes as '
            'processes on real DDS, compared with a subscriber that only receives the images.'
        ),
    ] = None,
    seconds: Annotated[float, typer.Option(help='Time for each case, s.', min=0.01)] = 1.0,
    as_json: Json = None,
    check: Annotated[
        bool, typer.Option('--check', help='Exit with status 1 if a limit is exceeded.')
    ] = False,
    full: Annotated[
        bool, typer.Option('--full', help='With live: every size, encoding, transport and rate.')
    ] = False,
) -> None:
    """Measure medians in one process, each case in turn with its baseline; or live nodes."""
    known = (*SUITES, LIVE)
    unknown = [name for name in suite or () if name not in known]
    if unknown:
        raise typer.BadParameter(f'{", ".join(unknown)}; there are {", ".join(known)}')
    names = suite or list(SUITES)
    measurements = _measure([name for name in names if name != LIVE], seconds)
    results = _measure_live(full, max(seconds, LIVE_SECONDS)) if LIVE in names else []
    if measurements:
        _print(measurements)
    if results:
        print_results(results, _console())
    if as_json is not None:
        figures = [m.figures() for m in measurements] + [r.figures() for r in results]
        as_json.write_text(json.dumps(figures, indent=2) + '\n')
    kept = [m.within_limits for m in measurements] + [r.within_limits for r in results]
    if check and not all(kept):
        raise typer.Exit(1)


def _measure_live(full: bool, seconds: float) -> list[LiveResult]:
    cases, results = live_cases(full), []
    with frame_progress() as progress:
        task = progress.add_task('bench live', total=len(cases))
        for case in cases:
            results += measure_live(case, seconds)
            progress.advance(task)
    return results


def _measure(names: list[str], seconds: float) -> list[Measurement]:
    cases = [case for name in names for case in SUITES[name]()]
    measurements = []
    with frame_progress() as progress:
        task = progress.add_task('bench', total=len(cases))
        for case in cases:
            measurements.append(measure(case, seconds))
            progress.advance(task)
    return measurements


def _print(measurements: list[Measurement]) -> None:
    table = Table(box=None, pad_edge=False)
    for heading in ('case', 'median', 'beside', 'median', 'ratio', 'limit', ''):
        table.add_column(heading, justify='left' if heading in ('case', 'beside', '') else 'right')
    for m in measurements:
        table.add_row(
            m.case.name,
            _milliseconds(m.median_ms),
            m.case.baseline_name,
            _milliseconds(m.baseline_ms),
            f'{m.ratio:.2f}' if m.ratio is not None else '',
            _limit(m),
            m.case.note if m.within_limits else f'{m.case.note} EXCEEDED'.strip(),
        )
    _console().print(table)


def _console() -> Console:
    console = Console(markup=False, highlight=False)
    if not console.is_terminal:
        console = Console(markup=False, highlight=False, width=160)
    return console


def _limit(m: Measurement) -> str:
    if m.case.limit_ratio is not None:
        return f'{m.case.limit_ratio:g} x'
    return f'{m.case.limit_ms:g} ms' if m.case.limit_ms is not None else ''


def _milliseconds(value: float | None) -> str:
    return '' if value is None else f'{value:.3f} ms'
