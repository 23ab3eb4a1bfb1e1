"""Many recordings: where their results go, each in a process or on a Dask cluster; the manifest."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import time
from collections import Counter
from collections.abc import Callable, Generator, Sequence
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import cv2

import mvuav_ros
from mvuav_ros.offline.replay.job import (
    JobProgress,
    ReplayJob,
    ReplayOutcome,
    ReplaySettings,
    attempt,
    description,
    is_own_input,
)
from mvuav_ros.offline.stopping import Stop
from mvuav_ros.offline.tasks import (
    Method,
    TaskProgress,
    quick_method,
    run_in_processes,
    run_on_cluster,
)
from mvuav_ros.processing.process_tuning import keep_freed_memory
from mvuav_ros.recordings.account import RecordingError
from mvuav_ros.recordings.layout import absolute_place, by_flight, recordings_in
from mvuav_ros.recordings.remote import inside, is_url, read_text, size_at, write_text


class Plan(NamedTuple):
    """A job for each recording; ``folder`` is that of a batch's outputs, None for a single one."""

    jobs: list[ReplayJob]
    folder: str | None


def plan(
    sources: Sequence[str],
    output: str,
    settings: ReplaySettings,
    *,
    overwrite: bool = False,
    absolute: bool = False,
) -> Plan:
    """Say where the results of each recording go; of a folder of them each is one by itself.

    The output is a name that ends in .mcap or, needed for several recordings, a folder; either
    may be a URL. A single recording's results as a rosbag2 folder are that folder. Absolute paths
    hold in other processes.

    Raises:
        RecordingError: the output does not fit, or two recordings have the same name.
        OSError: the folder cannot be made.
    """
    if absolute:
        output, *sources = map(absolute_place, (output, *sources))
        settings = settings.absolute()
    sources = [each for source in sources for each in recordings_in(source)]
    is_folder = settings.split_bytes is not None
    if len(sources) == 1 and (is_folder or output.endswith('.mcap')):
        return Plan([ReplayJob(sources[0], output, settings, overwrite)], None)
    if not output.endswith('/') and Path(output).suffix and not Path(output).is_dir():
        raise RecordingError(
            f'{output}: the name of a recording must end in .mcap'
            if len(sources) == 1
            else f'{output}: several inputs need a folder as output ({len(sources)} recordings)'
        )
    ending = '' if is_folder else '.mcap'
    targets = {inside(output, name + ending): each for name, each in by_flight(sources).items()}
    if not is_url(output):
        Path(output).mkdir(parents=True, exist_ok=True)
    jobs = [ReplayJob(source, target, settings, overwrite) for target, source in targets.items()]
    return Plan(jobs, output)


def run_jobs(
    jobs: Sequence[ReplayJob],
    at_once: int,
    cluster: str | None,
    stop: Stop,
    show: Callable[[int, JobProgress], None],
) -> Generator[tuple[int, ReplayOutcome], None, None]:
    """Do the jobs in so many processes or on a Dask cluster, whose address is given.

    A single one is done here by so many threads. Interrupted, those under way close their files.
    A process that dies costs its own recording only. ``show`` gets a job's number and progress.

    Yields:
        Each job's number and, at its end, its outcome.

    Raises:
        SourceError: the cluster cannot be used.
    """
    if not jobs:
        return
    if cluster:
        messages = run_on_cluster(attempt, jobs, cluster, stop)
    elif len(jobs) == 1:
        keep_freed_memory()
        cv2.setNumThreads(1)
        yield 0, attempt(jobs[0], partial(show, 0), stop, at_once)
        return
    else:
        # Forked if possible, as to import everything takes a second; fsspec may begin a thread.
        remote = any(is_url(job.source) or is_url(job.output) for job in jobs)
        method: Method = 'spawn' if remote else quick_method()
        messages = run_in_processes(attempt, jobs, at_once, stop, method=method)
    for message in messages:
        if isinstance(message, TaskProgress):
            show(message.number, JobProgress(*message.message))
            continue
        job, outcome = jobs[message.number], message.result
        if outcome is None:
            failure = ' '.join(str(message.error).split())
            outcome = ReplayOutcome(job.source, job.output, failure=failure)
        if outcome.failure and outcome.source not in outcome.failure:
            outcome.failure = f'{outcome.source}: {outcome.failure}'
        yield message.number, outcome


MANIFEST = 'manifest.json'

_FINISHED = ('finished', 'finished before')
_REDONE = ('begun', 'interrupted', 'failed')
_COUNTS = ('frames', 'processed', 'rejected', 'errors', 'warnings')
_WRITING_INTERVAL = 1.0
"""Seconds between two versions of the file; a batch that is killed loses the last one at most."""


class Manifest:
    """A folder's manifest: version, settings, times, and for each recording its outcome.

    It is written when the batch begins, while it runs and when it ends. Recordings of other batches
    into the same folder stay in it, also of one at the same time. Every method raises
    RecordingError or OSError where the folder cannot be reached or written.
    """

    def __init__(self, folder: str, jobs: Sequence[ReplayJob]) -> None:
        """Read what an earlier batch left in the outputs' folder, or URL, for all of the jobs."""
        self._place = inside(folder, MANIFEST)
        self._settings = dataclasses.asdict(jobs[0].settings)
        self._started = datetime.now(UTC).isoformat()
        self._written = 0.0
        self._known = _entries(read_text(self._place))
        self._made_from = {job.output: _made_from(job) for job in jobs}
        self._own = {_name(job.output) for job in jobs}

    def begin(self, jobs: Sequence[ReplayJob]) -> tuple[list[ReplayOutcome], list[ReplayJob]]:
        """The outcomes that are known without any work, and the jobs that are to be done.

        An output that is finished is left as it is, one that was begun is made again, and any
        other file is in the way, unless its job may overwrite it.
        """
        settled, to_do = [], []
        for job in jobs:
            outcome = self._settled(job)
            if outcome is None:
                to_do.append(dataclasses.replace(job, overwrite=True))
                self._note(job.output, 'begun', {})
            else:
                settled.append(outcome)
        self._write()
        return settled, to_do

    def take(self, outcome: ReplayOutcome) -> None:
        """Note what became of a job."""
        counts = {name: getattr(outcome, name) for name in (*_COUNTS, 'failure')}
        word = 'failed' if outcome.failure else 'finished'
        self._note(outcome.output, 'interrupted' if outcome.interrupted else word, counts)
        if time.monotonic() > self._written + _WRITING_INTERVAL:
            self._write()

    def end(self) -> None:
        """Write the last version; what was not done by now is said to be interrupted."""
        for name, entry in self._known.items():
            if name in self._own and entry['outcome'] == 'begun':
                entry['outcome'] = 'interrupted'
        self._write()

    def _settled(self, job: ReplayJob) -> ReplayOutcome | None:
        size = size_at(job.output)
        if job.overwrite or size is None or is_own_input(job):  # `run_job` refuses the last
            return None
        known = self._known.get(_name(job.output), {})
        if self._made_from[job.output].items() <= known.items():
            if known['outcome'] in _REDONE:
                return None
            if known['outcome'] in _FINISHED and known['output_bytes'] == size:
                known['outcome'] = 'finished before'
                done = ReplayOutcome(job.source, job.output, done_before=True)
                vars(done).update({name: known[name] for name in _COUNTS})
                done.rejected = Counter(done.rejected)
                return done
        elif not known:
            self._note(job.output, 'refused', {})
        return ReplayOutcome(
            job.source,
            job.output,
            failure=f'{job.output} exists, but {MANIFEST} does not say that it was made from this '
            'input by this version with these parameters; --force overwrites it',
        )

    def _note(self, output: str, word: str, counts: dict[str, Any]) -> None:
        self._known[_name(output)] = {
            **self._made_from[output],
            'output': _name(output),
            'output_bytes': 0 if word in ('begun', 'refused') else size_at(output) or 0,
            'outcome': word,
            'noted': datetime.now(UTC).isoformat(),
            **counts,
        }

    def _write(self) -> None:
        # What another batch has noted since.
        others = _entries(read_text(self._place))
        self._known |= {name: others[name] for name in others if name not in self._own}
        content = {
            'version': mvuav_ros.__version__,
            'started': self._started,
            'ended': datetime.now(UTC).isoformat(),
            'settings': self._settings,
            'recordings': list(self._known.values()),
        }
        write_text(self._place, json.dumps(content, indent=2))
        self._written = time.monotonic()


def _entries(text: str) -> dict[str, dict[str, Any]]:
    """The recordings of an earlier manifest by their outputs; none of a damaged one."""
    try:
        entries = {str(entry['output']): entry for entry in json.loads(text)['recordings']}
    except (ValueError, KeyError, TypeError):
        return {}
    needed = {'outcome', 'output_bytes', 'version'}
    return {name: entry for name, entry in entries.items() if needed <= entry.keys()}


def _made_from(job: ReplayJob) -> dict[str, str]:
    """The job's description, with a digest of the settings, which are the same for all."""
    try:
        made_from = description(job.source, job.settings)
    except Exception:  # whatever keeps it from being read is in its outcome
        return {'version': mvuav_ros.__version__, 'input': job.source}
    settings = made_from.pop('settings')
    return {**made_from, 'settings_sha256': hashlib.sha256(settings.encode()).hexdigest()}


def _name(output: str) -> str:
    return output.rstrip('/').rpartition('/')[2]
