"""What ``mvuav replay`` shows: progress while it runs, then what became of each recording."""

from __future__ import annotations

import os
from collections.abc import Sequence
from contextlib import closing

import typer
from rich.progress import Progress, TaskID

from mvuav_ros.cli.progress import frame_progress
from mvuav_ros.offline.replay.cluster import run_on_cluster
from mvuav_ros.offline.replay.job import JobProgress, ReplayJob, ReplayOutcome, attempt
from mvuav_ros.offline.replay.memory import keep_freed_memory
from mvuav_ros.offline.replay.pool import run_in_processes

_MOST_REASONS = 5


def replay_one(job: ReplayJob) -> ReplayOutcome:
    """Replay one recording in this process, and report it also when interrupted."""
    keep_freed_memory()
    outcome = ReplayOutcome(job.source, job.output)
    with frame_progress() as progress:
        task = progress.add_task(job.source, total=None)

        def show(state: JobProgress) -> None:
            progress.update(task, description=state.name, completed=state.done, total=state.total)

        try:
            attempt(job, outcome, show, ahead=len(os.sched_getaffinity(0)) > 1)
        finally:
            progress.stop()
            if outcome.frames or outcome.error:
                _report(outcome)
    return outcome


def replay_many(
    jobs: Sequence[ReplayJob], at_once: int, cluster: str | None
) -> list[ReplayOutcome]:
    """Replay recordings in processes or on a Dask cluster, and report each at its end.

    Raises:
        SourceError: the cluster cannot be used.
    """
    events = run_on_cluster(jobs, cluster) if cluster else run_in_processes(jobs, at_once)
    outcomes: list[ReplayOutcome] = []
    # Without a thread of its own: this process forks.
    with closing(events), frame_progress(thread=False) as progress:
        overall = progress.add_task('recordings', total=len(jobs))
        tasks: dict[int, TaskID] = {}
        for number, event in events:
            if isinstance(event, JobProgress):
                _show(progress, tasks, number, event)
                continue
            outcomes.append(event)
            if event.error and event.source not in event.error:
                event.error = f'{event.source}: {event.error}'
            if number in tasks:
                progress.remove_task(tasks.pop(number))
            progress.update(overall, completed=len(outcomes), refresh=True)
            _report(event)
    failed = sum(bool(outcome.error) for outcome in outcomes)
    if failed and len(jobs) > 1:
        typer.echo(f'mvuav: {failed} of {len(jobs)} recordings failed', err=True)
    return outcomes


def _show(progress: Progress, tasks: dict[int, TaskID], number: int, state: JobProgress) -> None:
    if number not in tasks:
        tasks[number] = progress.add_task(state.name, total=state.total)
    progress.update(tasks[number], completed=state.done, total=state.total, refresh=True)


def _report(outcome: ReplayOutcome) -> None:
    results = f'results for {outcome.answered} of {outcome.frames} frames'
    if outcome.done_before:
        typer.echo(f'{outcome.output}: finished before, {results}')
    elif not outcome.error or outcome.frames:
        typer.echo(f'{outcome.output}: {results}')
    reasons = sorted(outcome.refused.items(), key=lambda item: -item[1])
    for reason, count in reasons[:_MOST_REASONS]:
        typer.echo(f'warning: {count} without a result: {reason}', err=True)
    if len(reasons) > _MOST_REASONS:
        rest = sum(count for _, count in reasons[_MOST_REASONS:])
        typer.echo(f'warning: {rest} without a result for other reasons', err=True)
    for loss in outcome.losses:
        typer.echo(f'warning: {loss}', err=True)
    for remark in outcome.remarks:
        typer.echo(f'note: {remark}', err=True)
    if outcome.error:
        typer.echo(f'mvuav: {outcome.error}', err=True)
