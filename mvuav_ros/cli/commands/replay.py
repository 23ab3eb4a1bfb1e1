"""``mvuav replay``: the nodes over recordings, without a ROS graph, and what it says of each."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from contextlib import closing
from typing import TYPE_CHECKING, Annotated, Any, Optional

import typer

from mvuav_ros.cli.options import (
    CameraInfo,
    CommandFailedError,
    Dask,
    Force,
    Format,
    ImageTopic,
    Param,
    ParamsFile,
    SplitMb,
    Storage,
    Strict,
)
from mvuav_ros.cli.terminal import frame_progress, report_account, report_damage, say
from mvuav_ros.detectors import DETECTORS
from mvuav_ros.messages.untrusted import visible
from mvuav_ros.offline.stopping import Interrupted, Stop, stop_on_signals

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

    from mvuav_ros.offline.replay.batch import Plan
    from mvuav_ros.offline.replay.job import JobProgress, ReplayJob, ReplayOutcome


_MAX_REASONS = 5


def replay_all(
    planned: Plan, processes: int, cluster: str | None, stop: Stop
) -> list[ReplayOutcome]:
    """Replay what is not finished yet, report each recording at its end, and keep the manifest.

    Raises:
        RecordingError: the manifest cannot be read or written.
        SourceError: the cluster cannot be used.
    """
    from mvuav_ros.offline.replay.batch import Manifest
    from mvuav_ros.offline.replay.job import is_own_input, refuse_own_input

    jobs = planned.jobs
    outcomes: list[ReplayOutcome] = []
    manifest = None
    if planned.folder is not None:
        if all(map(is_own_input, jobs)):
            # Before there is a manifest among the input's files.
            refuse_own_input(jobs[0])
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
    import cv2

    from mvuav_ros.offline.replay.job import attempt
    from mvuav_ros.processing.process_tuning import keep_freed_memory

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
    from mvuav_ros.offline.replay.batch import run_jobs
    from mvuav_ros.offline.replay.job import JobProgress

    events = run_jobs(jobs, at_once, cluster, stop)
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
    for reason, count in reasons[:_MAX_REASONS]:
        say(f'warning: {count} without a result: {reason}', err=True)
    if len(reasons) > _MAX_REASONS:
        rest = sum(count for _, count in reasons[_MAX_REASONS:])
        say(f'warning: {rest} without a result for other reasons', err=True)
    if outcome.account is not None:
        report_account(outcome.account)
    else:  # of a replay that was finished before
        report_damage(outcome.errors)
        say(*(f'note: {warning}' for warning in outcome.warnings), err=True)
    if outcome.failure:
        say(f'mvuav: {outcome.failure}', err=True)


def replay(
    sources: Annotated[
        list[str],
        typer.Argument(
            metavar='INPUT...',
            help='Bags, videos, folders or globs of images, folders of them; or their URLs.',
        ),
    ],
    output: Annotated[
        str,
        typer.Option(
            '--output',
            '-o',
            help='The bag to write, OUT.mcap; with several inputs a folder for their bags; '
            'or a URL.',
            show_default=False,
        ),
    ],
    nodes: Annotated[str, typer.Option(help='Nodes to run, separated by commas.')] = ','.join(
        DETECTORS
    ),
    image_topic: ImageTopic = None,
    params_file: ParamsFile = None,
    param: Param = None,
    fps: Annotated[
        Optional[float],
        typer.Option(
            help='Frame rate of images without stamps (folder: 30, video: its own).',
            min=0.001,
            max=1e6,
        ),
    ] = None,
    start: Annotated[
        float, typer.Option(help='Start at this time of the recording, s.', min=0.0, max=1e9)
    ] = 0.0,
    duration: Annotated[
        Optional[float], typer.Option(help='Length of the part to process, s.', min=0.0, max=1e9)
    ] = None,
    every: Annotated[
        int, typer.Option(help='Process only every N-th frame.', metavar='N', min=1)
    ] = 1,
    camera_info: CameraInfo = None,
    image_is_rectified: Annotated[
        bool,
        typer.Option(
            '--image-is-rectified',
            help='The images are rectified: P of the calibration holds, without distortion.',
        ),
    ] = False,
    keep_inputs: Annotated[
        bool,
        typer.Option(
            '--keep-inputs',
            help="Also copy the input's topics; images as /image_raw, with the calibration that "
            'was used.',
        ),
    ] = False,
    debug_images: Annotated[
        bool, typer.Option('--debug-images', help='Also write the debug images.')
    ] = False,
    gamma: Annotated[
        float,
        typer.Option(
            help='out = in ** gamma on every image (eq. 3.2), as video_source does: above 1 '
            'darkens, below 1 brightens; 1: off.',
            min=0.01,
            max=100.0,
        ),
    ] = 1.0,
    storage: Format = Storage.MCAP,
    split_mb: SplitMb = 0,
    jobs: Annotated[
        Optional[int],
        typer.Option(
            help='Number of cores that share the work; default: all.',
            min=1,
            show_default=False,
        ),
    ] = None,
    dask: Dask = None,
    strict: Strict = False,
    force: Force = False,
) -> dict[str, Any]:
    """Run the nodes' own code over recordings and write their topics as mcap bags.

    The messages are those that the live nodes publish for the same images.

    With a folder as output, manifest.json lists the outcome of each recording, and finished
    recordings are skipped.
    """
    from mvuav_ros.offline.replay.batch import plan
    from mvuav_ros.offline.replay.job import ReplaySettings
    from mvuav_ros.parameters.parameter_file import complete, node_names, resolve_parameters
    from mvuav_ros.sources.calibration import load_calibration
    from mvuav_ros.sources.source import Selection, SourceError

    chosen = node_names(nodes)
    assignments = list(param or [])
    if image_is_rectified:
        assignments += [f'{node}:image_is_rectified:=true' for node in chosen]
    settings = ReplaySettings(
        parameters=complete(resolve_parameters(chosen, params_file, assignments)),
        image_topic=image_topic,
        fps=fps,
        selection=Selection(start, duration, every),
        keep_inputs=keep_inputs,
        debug_images=debug_images,
        gamma=gamma,
        camera=load_calibration(camera_info) if camera_info else None,
        split_bytes=storage.split_bytes(split_mb),
    )
    planned = plan(
        sources,
        output,
        settings,
        overwrite=force,
        absolute=dask is not None,
    )
    jobs = jobs or len(os.sched_getaffinity(0))
    with stop_on_signals() as stop:
        outcomes = replay_all(planned, jobs, dask, stop)
    if stop:
        raise Interrupted(stop.number)
    result = {'recordings': [outcome.record() for outcome in outcomes]}
    if any(outcome.failure for outcome in outcomes):
        raise CommandFailedError(result, typer.Exit(1))
    if strict and any(outcome.lossy for outcome in outcomes):
        lost = SourceError('--strict: something was lost or rejected; see the warnings')
        raise CommandFailedError(result, lost)
    return result
