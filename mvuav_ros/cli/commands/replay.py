"""``mvuav replay``: the nodes over recordings, without a ROS graph, and what it says of each."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Sequence
from contextlib import closing
from typing import TYPE_CHECKING, Any, Optional

import typer

from mvuav_ros.cli import options
from mvuav_ros.cli.terminal import frame_progress, report_account, report_each, say
from mvuav_ros.detectors import DETECTORS
from mvuav_ros.messages.untrusted import visible
from mvuav_ros.offline.stopping import Interrupted, Stop, stop_on_signals
from mvuav_ros.recordings.account import SourceError

if TYPE_CHECKING:
    from rich.progress import Progress

    from mvuav_ros.offline.replay.batch import Plan
    from mvuav_ros.offline.replay.job import JobProgress, ReplayJob, ReplayOutcome


_MAX_REASONS = 5


def replay_all(
    planned: Plan, processes: int, cluster: str | None, stop: Stop
) -> list[ReplayOutcome]:
    """Replay what is not finished yet, report each recording at its end, and keep the manifest.

    The outcomes are in the order of the jobs.

    Raises:
        RecordingError: the manifest cannot be read or written.
        SourceError: the cluster cannot be used.
    """
    from mvuav_ros.offline.replay.batch import Manifest, run_jobs
    from mvuav_ros.offline.replay.job import is_own_input, refuse_own_input

    jobs, several = planned.jobs, len(planned.jobs) > 1
    outcomes: list[ReplayOutcome] = []
    manifest = None
    if planned.folder is not None:
        if all(map(is_own_input, jobs)):
            # Before there is a manifest among the input's files.
            refuse_own_input(jobs[0])
        manifest = Manifest(planned.folder, jobs)
        outcomes, jobs = manifest.begin(jobs)
        for outcome in outcomes:
            _report(outcome, several)
    # Without a thread of its own: this process forks.
    with frame_progress(thread=False) as progress:
        bars = _Bars(progress, jobs)
        with closing(run_jobs(jobs, processes, cluster, stop, bars.show)) as ended:
            for count, (number, outcome) in enumerate(ended, 1):
                outcomes.append(outcome)
                bars.end(number, count)
                if manifest is not None:
                    manifest.take(outcome)
                if outcome.frames or outcome.failure:
                    _report(outcome, several)
    if manifest is not None:
        manifest.end()
    failed = sum(bool(outcome.failure) for outcome in outcomes)
    if failed and len(planned.jobs) > 1:
        say(f'mvuav: {failed} of {len(planned.jobs)} recordings failed', err=True)
    places = {job.output: place for place, job in enumerate(planned.jobs)}
    return sorted(outcomes, key=lambda outcome: places[outcome.output])


class _Bars:
    """A bar for each recording that is under way, and of several one for all of them."""

    def __init__(self, bars: Progress, jobs: Sequence[ReplayJob]) -> None:
        self._bars, self._count, is_batch = bars, len(jobs), len(jobs) > 1
        self._overall = bars.add_task('recordings', total=self._count, visible=is_batch)
        first = [] if is_batch else [bars.add_task(visible(job.source), total=None) for job in jobs]
        self._tasks = dict(enumerate(first))

    def show(self, number: int, state: JobProgress) -> None:
        """How far one of them is."""
        name, done, total = state
        if number not in self._tasks:
            self._tasks[number] = self._bars.add_task(name, total=None)
        task = self._tasks[number]
        self._bars.update(task, description=name, completed=done, total=total, refresh=True)

    def end(self, number: int, count: int) -> None:
        """One of them has ended, the ``count``-th; a single one's bar stays."""
        if self._count > 1 and number in self._tasks:
            self._bars.remove_task(self._tasks.pop(number))
        self._bars.update(self._overall, completed=count, refresh=True)
        if count == self._count:
            self._bars.stop()


def _report(outcome: ReplayOutcome, several: bool = False) -> None:
    """Say what became of a recording; if it is one of several, each reason names it."""
    name = outcome.source if several else ''
    results = f'results for {outcome.processed} of {outcome.frames} frames'
    if outcome.done_before:
        say(f'{outcome.output}: finished before, {results}')
    elif not outcome.failure:
        say(f'{outcome.output}: {results}')
    reasons = sorted(outcome.rejected.items(), key=lambda item: -item[1])
    said = [f'{count} without a result: {reason}' for reason, count in reasons[:_MAX_REASONS]]
    if rest := sum(count for _, count in reasons[_MAX_REASONS:]):
        said.append(f'{rest} without a result for other reasons')
    report_each('warning', said, name)
    if outcome.account is not None:
        report_account(outcome.account, name)
    else:  # of a replay that was finished before
        report_each('damage', outcome.errors, name)
        report_each('note', outcome.warnings, name)
    if outcome.failure:
        say(f'mvuav: {outcome.failure}', err=True)


@options.describes_run
def replay(
    sources: list[str] = typer.Argument(
        ...,
        metavar='INPUT...',
        help='Bags, videos, folders or globs of images, folders of them; or their URLs.',
    ),
    output: str = typer.Option(
        ...,
        '--output',
        '-o',
        help='The bag to write, OUT.mcap; with several inputs a folder for their bags; or a URL.',
    ),
    nodes: str = typer.Option(','.join(DETECTORS), help='Nodes to run, separated by commas.'),
    param: options.Param = None,
    keep_inputs: bool = typer.Option(
        False,
        '--keep-inputs',
        help="Also copy the input's topics; images as /image_raw, with the calibration that "
        'was used.',
    ),
    debug_images: bool = typer.Option(False, '--debug-images', help='Also write the debug images.'),
    storage: options.Format = options.Storage.MCAP,
    split_mb: options.SplitMb = 0,
    jobs: Optional[int] = typer.Option(
        None, help='Number of cores that share the work; default: all.', min=1
    ),
    dask: options.Dask = None,
    strict: options.Strict = False,
    force: options.Force = False,
    **run: Any,
) -> dict[str, Any]:
    """Run the nodes' own code over recordings and write their topics as mcap bags.

    The messages are those that the live nodes publish for the same images.

    With a folder as output, manifest.json lists the outcome of each recording, and finished
    recordings are skipped.
    """
    from mvuav_ros.offline.replay.batch import plan
    from mvuav_ros.parameters.parameter_file import complete, node_names

    settings = options.RunOptions(**run).settings(node_names(nodes), param or ())
    settings = dataclasses.replace(
        settings,
        parameters=complete(settings.parameters),
        keep_inputs=keep_inputs,
        debug_images=debug_images,
        split_bytes=storage.split_bytes(split_mb),
    )
    planned = plan(sources, output, settings, overwrite=force, absolute=dask is not None)
    jobs = jobs or len(os.sched_getaffinity(0))
    with stop_on_signals() as stop:
        outcomes = replay_all(planned, jobs, dask, stop)
    if stop:
        raise Interrupted(stop.number)
    result = {'recordings': [outcome.record() for outcome in outcomes]}
    if any(outcome.failure for outcome in outcomes):
        raise options.CommandFailedError(result, typer.Exit(1))
    if strict and any(outcome.rejected or outcome.errors for outcome in outcomes):
        lost = SourceError('--strict: something was lost or rejected; see the warnings')
        raise options.CommandFailedError(result, lost)
    return result
