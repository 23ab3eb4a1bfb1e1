"""What ``mvuav replay`` shows: progress while it runs, then what became of each recording."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import closing

import cv2
from rich.progress import Progress, TaskID

from mvuav_ros.cli.terminal import frame_progress, say, tell_account, tell_damage
from mvuav_ros.messages.untrusted import visible
from mvuav_ros.offline.replay.cluster import run_on_cluster
from mvuav_ros.offline.replay.job import JobProgress, ReplayJob, ReplayOutcome, attempt
from mvuav_ros.offline.replay.manifest import Manifest
from mvuav_ros.offline.replay.many import run_jobs
from mvuav_ros.offline.replay.outputs import Plan
from mvuav_ros.offline.stopping import Stop
from mvuav_ros.processing.process_tuning import keep_freed_memory

_MOST_REASONS = 5


def replay_all(
    planned: Plan, processes: int, cluster: str | None, stop: Stop
) -> list[ReplayOutcome]:
    """Replay what is not finished yet, report each recording at its end, and keep the manifest.

    Raises:
        RecordingError: the manifest cannot be read or written.
        SourceError: the cluster cannot be used.
    """
    jobs = planned.jobs
    outcomes: list[ReplayOutcome] = []
    manifest = None
    if planned.folder is not None:
        manifest = Manifest(planned.folder, jobs)
        outcomes, jobs = manifest.begin(jobs)
        for outcome in outcomes:
            _report(outcome)
    took = manifest.take if manifest else lambda _: None
    if cluster is None and len(jobs) == 1:
        outcomes.append(replay_one(jobs[0], processes, stop))
        took(outcomes[-1])
    elif jobs:
        outcomes += replay_many(jobs, processes, cluster, stop, took)
    if manifest is not None:
        manifest.end()
    failed = sum(bool(outcome.failure) for outcome in outcomes)
    if failed and len(planned.jobs) > 1:
        say(f'mvuav: {failed} of {len(planned.jobs)} recordings failed', err=True)
    return outcomes


def replay_one(job: ReplayJob, processes: int, stop: Stop) -> ReplayOutcome:
    """Replay one recording, and report it also when interrupted."""
    keep_freed_memory()
    cv2.setNumThreads(1)
    with frame_progress(thread=False) as progress:
        task = progress.add_task(visible(job.source), total=None)

        def show(state: JobProgress) -> None:
            progress.update(
                task, description=state.name, completed=state.done, total=state.total, refresh=True
            )

        outcome = attempt(job, show, stop, processes)
    if outcome.frames or outcome.failure:
        _report(outcome)
    return outcome


def replay_many(
    jobs: Sequence[ReplayJob],
    at_once: int,
    cluster: str | None,
    stop: Stop,
    took: Callable[[ReplayOutcome], None],
) -> list[ReplayOutcome]:
    """Replay recordings in processes or on a Dask cluster; report and hand on each at its end.

    Raises:
        SourceError: the cluster cannot be used.
    """
    events = run_on_cluster(jobs, cluster, stop) if cluster else run_jobs(jobs, at_once, stop)
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
            if event.failure and event.source not in event.failure:
                event.failure = f'{event.source}: {event.failure}'
            if number in tasks:
                progress.remove_task(tasks.pop(number))
            progress.update(overall, completed=len(outcomes), refresh=True)
            took(event)
            _report(event)
    return outcomes


def _show(progress: Progress, tasks: dict[int, TaskID], number: int, state: JobProgress) -> None:
    if number not in tasks:
        tasks[number] = progress.add_task(state.name, total=state.total)
    progress.update(tasks[number], completed=state.done, total=state.total, refresh=True)


def _report(outcome: ReplayOutcome) -> None:
    results = f'results for {outcome.processed} of {outcome.frames} frames'
    if outcome.done_before:
        say(f'{outcome.output}: finished before, {results}')
    elif not outcome.failure:
        say(f'{outcome.output}: {results}')
    reasons = sorted(outcome.rejected.items(), key=lambda item: -item[1])
    for reason, count in reasons[:_MOST_REASONS]:
        say(f'warning: {count} without a result: {reason}', err=True)
    if len(reasons) > _MOST_REASONS:
        rest = sum(count for _, count in reasons[_MOST_REASONS:])
        say(f'warning: {rest} without a result for other reasons', err=True)
    if outcome.account is not None:
        tell_account(outcome.account)
    else:  # of a replay that was finished before
        tell_damage(outcome.errors)
        say(*(f'note: {warning}' for warning in outcome.warnings), err=True)
    if outcome.failure:
        say(f'mvuav: {outcome.failure}', err=True)
