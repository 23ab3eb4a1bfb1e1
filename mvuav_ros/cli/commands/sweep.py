"""``mvuav sweep``: the nodes over a grid of parameters and several inputs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mvuav_ros.cli.progress import frame_progress
from mvuav_ros.missing_module import explain_missing_module
from mvuav_ros.recordings.errors import RecordingError
from mvuav_ros.recordings.sources.frame import SourceError

if TYPE_CHECKING:
    from mvuav_ros.offline.sweep.run import RunResult

CSV = 'sweep.csv'


Sources = Annotated[
    list[str],
    typer.Argument(
        metavar='INPUT...',
        help="Bags, videos, image folders, or flights such as 'sim:tanker?motion=roll&seed=3'.",
    ),
]
Param = Annotated[
    list[str] | None,
    typer.Option(help='node:name:=value,value,…; several make a grid.', show_default=False),
]
Output = Annotated[
    Path, typer.Option('--output', '-o', help='Folder for table, trends and report.')
]
Nodes = Annotated[
    str | None,
    typer.Option(help='Nodes to run; those of --param if left out.', show_default=False),
]
ParamsFile = Annotated[
    Path | None,
    typer.Option(help='A ROS 2 parameter file for all runs.', show_default=False),
]
ImageTopic = Annotated[str | None, typer.Option(help='Image topic of bags that have several.')]
Dask = Annotated[
    str | None,
    typer.Option(help="Use a Dask cluster, by its scheduler's address.", metavar='tcp://…'),
]


def sweep(
    sources: Sources,
    param: Param = None,
    output: Output = Path('out/sweep'),
    nodes: Nodes = None,
    params_file: ParamsFile = None,
    image_topic: ImageTopic = None,
    jobs: Annotated[int, typer.Option(help='Runs at a time.', min=1)] = 1,
    dask: Dask = None,
    force: Annotated[bool, typer.Option('--force', help='Overwrite what is there.')] = False,
) -> None:
    """Run every combination of parameters on every INPUT; keep the numbers and draw trends.

    Leaves sweep.csv, index.html, and every table and figure. A run that fails is reported and
    does not stop the others; the exit status is 1 then.
    """
    try:
        from mvuav_ros.offline.node_parameters import node_names, resolve_parameters
        from mvuav_ros.offline.report.writing import write_csv, write_report
        from mvuav_ros.offline.sweep import run as sweeping
        from mvuav_ros.offline.sweep.report import sweep_report, sweep_table
        from mvuav_ros.processing.registry import PROCESSORS
    except ImportError as error:
        raise SourceError(explain_missing_module('sweep', error)) from error

    axes = [sweeping.parse_axis(text) for text in param or []]
    swept = list(dict.fromkeys(axis.node for axis in axes))
    base = resolve_parameters(node_names(nodes, swept or [*PROCESSORS]), params_file)
    runs = sweeping.plan_runs(sources, axes, base, image_topic)
    if (output / CSV).exists() and not force:
        raise RecordingError(f'{output / CSV} exists; --force overwrites it')
    results = []
    with frame_progress() as progress:
        task = progress.add_task('sweep', total=len(runs))
        for result in sweeping.sweep(runs, jobs, dask):
            results.append(result)
            progress.advance(task)
    results = sweeping.in_order(results)
    described = {
        'inputs': ', '.join(sources),
        'parameters swept': ', '.join(
            f'{axis.title} = {", ".join(map(str, axis.values))}' for axis in axes
        ),
        'other parameters': ', '.join(f'{n}: {g or "defaults"}' for n, g in base.items()),
        'jobs': dask or jobs,
    }
    output.mkdir(parents=True, exist_ok=True)
    write_csv(sweep_table(results, axes), output / CSV)
    page = write_report(sweep_report(results, axes, described), output)
    _tell(results, page)


def _tell(results: list[RunResult], page: Path) -> None:
    failed = [result for result in results if result.error]
    for result in failed:
        typer.echo(
            f'warning: run {result.run.number} ({result.run.source}) failed: {result.error}',
            err=True,
        )
    typer.echo(f'{page}: {len(results) - len(failed)} of {len(results)} runs')
    if failed:
        raise typer.Exit(1)
