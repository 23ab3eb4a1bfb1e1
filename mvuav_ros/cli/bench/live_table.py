"""The results of ``mvuav bench live`` as a table."""

from __future__ import annotations

from rich.console import Console
from rich.table import Table

from mvuav_ros.cli.bench.live import LiveResult

_HEADINGS = (
    'node', 'image', 'Hz', 'processed', 'p50', 'p95', 'p99', 'floor p50', 'p95', 'p99', 'ratio',
    'decode', 'process', 'publish', 'CPU', 'MB', '',
)  # fmt: skip


def print_results(results: list[LiveResult], console: Console) -> None:
    """Latencies in ms from the camera's stamp to the result's arrival back at the camera.

    The floor is a minimal rclpy subscriber beside the node, from the stamp to its callback.
    """
    table = Table(box=None, pad_edge=False)
    for index, heading in enumerate(_HEADINGS):
        table.add_column(heading, justify='left' if index < 2 or not heading else 'right')
    for result in results:
        table.add_row(*_row(result))
    console.print(table)
    console.print(
        'Times in ms; CPU per image, all threads; memory at the end; +: the other node runs too.'
    )


def _row(result: LiveResult) -> list[str]:
    case = result.case
    stages = [result.status.get(f'{s}_p50_ms', '') for s in ('decode', 'process', 'publish')]
    return [
        result.node + ('+' if len(case.nodes) > 1 else ''),
        f'{case.width}x{case.height} {case.encoding}'
        + (' jpeg' if case.transport == 'compressed' else ''),
        f'{case.hz:g}',
        f'{result.processed}/{result.sent}',
        *(f'{ms:.2f}' for ms in (*result.latency, *result.floor)),
        f'{result.ratio:.2f}',
        *stages,
        f'{result.cpu_ms:.2f}',
        f'{result.memory_mb:.0f}',
        '' if result.within_limits else f'EXCEEDED {result.limit:g} x',
    ]
