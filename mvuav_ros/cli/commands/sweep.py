"""``mvuav sweep``: the nodes over a grid of parameters and several inputs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Optional

import typer

from mvuav_ros.cli.options import Dask, Force, RunOptions, describes_run, take_folder
from mvuav_ros.cli.terminal import frame_progress, say
from mvuav_ros.detectors import DETECTORS
from mvuav_ros.offline.stopping import Interrupted

if TYPE_CHECKING:
    from mvuav_ros.offline.parameter_sweep import RunResult

CSV = 'sweep.csv'


@describes_run
def sweep(
    sources: list[str] = typer.Argument(
        ...,
        metavar='INPUT...',
        help='Bags, videos, image folders, folders of them, or flights such as '
        "'sim:tanker?motion=roll&seed=3'.",
    ),
    param: Optional[list[str]] = typer.Option(
        None, help='node:name:=value,value,…; several make a grid.'
    ),
    output: Path = typer.Option(
        Path('out/sweep'), '--output', '-o', help='Folder for table, trends and report.'
    ),
    nodes: Optional[str] = typer.Option(None, help='Nodes to run; default: those of --param.'),
    jobs: int = typer.Option(1, help='Number of runs in parallel.', min=1),
    dask: Dask = None,
    force: Force = False,
    **run: Any,
) -> None:
    """Run every combination of parameters on every INPUT; keep the numbers and draw trends.

    Leaves sweep.csv, index.html, and every table and figure. A run that fails is reported and
    does not stop the others; the exit status is 1 then. Interrupted, it leaves the same of the
    runs that are finished.
    """
    from mvuav_ros.offline import report_figures  # noqa: F401  What it lacks is said before the runs.
    from mvuav_ros.offline.parameter_sweep import parse_axis, plan_runs, sweep_report, sweep_table
    from mvuav_ros.offline.parameter_sweep import sweep as run_sweep
    from mvuav_ros.offline.report import csv_text, write_report
    from mvuav_ros.parameters.parameter_file import node_names
    from mvuav_ros.recordings.remote import write_whole

    axes = [parse_axis(text) for text in param or []]
    swept = list(dict.fromkeys(axis.node for axis in axes))
    chosen = node_names(nodes, swept or DETECTORS)
    settings = RunOptions(**run).settings(chosen)
    runs = plan_runs(sources, axes, settings)
    take_folder(output, force, CSV)
    finished: list[RunResult] = []
    interruption = None
    with frame_progress() as progress:
        made = run_sweep(runs, jobs, dask)
        try:
            for result in progress.track(made, total=len(runs), description='sweep'):
                finished.append(result)  # noqa: PERF402  As they come: the next may be the last.
        except Interrupted as ended:
            interruption = ended
            if not finished:
                raise
    results = sorted(finished, key=lambda result: result.run.number)
    described = {
        'inputs': ', '.join(sources),
        'parameters swept': ', '.join(
            f'{axis.title} = {", ".join(map(str, axis.values))}' for axis in axes
        ),
        **settings.described(),
        'jobs': dask or jobs,
    }
    write_whole(output / CSV, csv_text(sweep_table(results, axes)))
    page = write_report(sweep_report(results, axes, described), output)
    failed = [result for result in results if result.error]
    for result in failed:
        which = f'run {result.run.number} ({result.run.source})'
        say(f'warning: {which} failed: {result.error}', err=True)
    say(f'{page}: {len(results) - len(failed)} of {len(runs)} runs')
    if interruption is not None:
        raise interruption
    if failed:
        raise typer.Exit(1)
