"""``mvuav bench``: how fast, beside what any implementation needs."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Optional

import typer

from mvuav_ros.cli.options import Json
from mvuav_ros.cli.terminal import frame_progress, print_table, say
from mvuav_ros.recordings.remote import write_whole

if TYPE_CHECKING:
    from mvuav_ros.cli.bench.cases import Measurement
    from mvuav_ros.cli.bench.live import LiveResult

SUITES = ('markers', 'runway', 'approach', 'simulation', 'replay')
_ALL = ', '.join(SUITES)
LIVE = 'live'
"""The suite of processes on real DDS, which takes minutes and is run only when named."""
LIVE_SECONDS = 5.0
_HEADINGS = ('case', 'median', 'beside', 'median', 'ratio', 'limit', '')
_LIVE_HEADINGS = (
    'node', 'image', 'Hz', 'processed', 'p50', 'p95', 'p99', 'floor p50', 'ratio',
    'answer p50', 'decode', 'process', 'publish', 'CPU', 'MB', '',
)  # fmt: skip
_LEGEND = 'Times in ms; CPU per image, all threads; memory at the end; +: the other node runs too.'
_NUMBERS = {*_HEADINGS, *_LIVE_HEADINGS} - {'node', 'image', 'case', 'beside', ''}


def bench(
    suite: Optional[list[str]] = typer.Argument(
        None,
        help=f'Suites to run: {_ALL}; default: all of these. live: the nodes as processes on real '
        'DDS, compared with a subscriber that only receives the images.',
    ),
    seconds: float = typer.Option(1.0, help='Time for each case, s.', min=0.01),
    as_json: Json = None,
    check: bool = typer.Option(False, '--check', help='Exit with status 1 if a limit is exceeded.'),
    full: bool = typer.Option(
        False, '--full', help='With live: every size, encoding, transport and rate.'
    ),
) -> None:
    """Measure medians in one process, each case in turn with its baseline; or live nodes."""
    from mvuav_ros.cli.bench import cases as work
    from mvuav_ros.cli.bench.live import live_cases, measure_live

    if unknown := [name for name in suite or () if name not in (*SUITES, LIVE)]:
        raise typer.BadParameter(f'{", ".join(unknown)}; there are {_ALL}, {LIVE}')
    names = suite or SUITES
    makers = {
        'markers': work.marker_cases,
        'runway': work.runway_cases,
        'approach': work.approach_cases,
        'simulation': work.simulation_cases,
        'replay': work.replay_cases,
    }
    cases = [case for name in names if name != LIVE for case in makers[name]()]
    live = live_cases(full) if LIVE in names else []
    with frame_progress() as progress:
        measured = [work.measure(c, seconds) for c in progress.track(cases, description='bench')]
    with frame_progress() as progress:
        tracked = progress.track(live, description='bench live')
        results = [r for c in tracked for r in measure_live(c, max(seconds, LIVE_SECONDS))]
    if measured:
        print_table(_HEADINGS, map(_row, measured), 160, numbers=_NUMBERS)
    if results:
        # From the camera's stamp to the result's arrival back at the camera; the floor is that to
        # a minimal rclpy subscriber's callback, which answers at once.
        print_table(_LIVE_HEADINGS, map(_live_row, results), 160, numbers=_NUMBERS)
        say(_LEGEND)
    both: list[Measurement | LiveResult] = [*measured, *results]
    if as_json is not None:
        write_whole(as_json, json.dumps([each.figures() for each in both], indent=2) + '\n')
    if check and not all(each.within_limits for each in both):
        raise typer.Exit(1)


def _row(m: Measurement) -> list[str]:
    limit = f'{m.case.limit_ms:g} ms' if m.case.limit_ms is not None else ''
    return [
        m.case.name,
        _milliseconds(m.median_ms),
        m.case.baseline_name,
        _milliseconds(m.baseline_ms),
        f'{m.ratio:.2f}' if m.ratio is not None else '',
        f'{m.case.limit_ratio:g} x' if m.case.limit_ratio is not None else limit,
        m.case.note if m.within_limits else f'{m.case.note} EXCEEDED'.strip(),
    ]


def _milliseconds(value: float | None) -> str:
    return '' if value is None else f'{value:.3f} ms'


def _live_row(result: LiveResult) -> list[str]:
    case = result.case
    jpeg = ' jpeg' if case.transport == 'compressed' else ''
    stages = [result.status.get(f'{s}_p50_ms', '') for s in ('decode', 'process', 'publish')]
    return [
        result.node + ('+' if len(case.nodes) > 1 else ''),
        f'{case.width}x{case.height} {case.encoding}{jpeg}',
        f'{case.hz:g}',
        f'{result.processed}/{result.sent}',
        *(f'{ms:.2f}' for ms in (*result.latency, result.floor[0])),
        f'{result.ratio:.2f}',
        f'{result.answer[0]:.2f}',
        *stages,
        f'{result.cpu_ms:.2f}',
        f'{result.memory_mb:.0f}',
        '' if result.within_limits else f'EXCEEDED {result.limit:.2f} ms',
    ]
