"""Many recordings on a Dask cluster, whose machines share the paths or reach the URLs."""

from __future__ import annotations

import logging
import time
import uuid
from collections.abc import Generator, Iterator, Sequence
from importlib import import_module
from queue import Empty, SimpleQueue
from typing import Any

from mvuav_ros.offline.replay.job import JobProgress, ReplayJob, ReplayOutcome, attempt
from mvuav_ros.offline.replay.many import Event
from mvuav_ros.offline.stopping import Stop
from mvuav_ros.processing.process_tuning import keep_freed_memory
from mvuav_ros.sources.source import SourceError

_POLL = 0.1
_CONNECT_TIME = 10
_CLOSING_TIME = 30
"""Seconds that interrupted tasks have to close their files."""


def connect(address: str) -> tuple[Any, Any]:
    """A client of the scheduler at `address`, and the module `distributed`.

    Raises:
        SourceError: Dask is not installed, or there is no scheduler.
    """
    try:
        distributed: Any = import_module('distributed')
    except ImportError as error:
        raise SourceError(
            f'--dask needs Dask: pip install "mvuav_ros[dask]", here and on the workers ({error})'
        ) from error
    # It would log attempt after attempt, with tracebacks.
    logging.getLogger('distributed').setLevel(logging.CRITICAL)
    try:
        client = distributed.Client(address, timeout=_CONNECT_TIME, set_as_default=False)
    except (OSError, ValueError) as error:
        raise SourceError(f'--dask {address}: no Dask scheduler answers there') from error
    return client, distributed


def run_on_cluster(
    jobs: Sequence[ReplayJob], address: str, interrupted: Stop
) -> Generator[Event, None, None]:
    """Do the jobs on a cluster, as many at a time as its workers have threads.

    Their paths are absolute, or URLs; a job whose worker dies is done again by another. The
    scheduler's address is such as ``tcp://10.0.0.1:8786``.

    Yields:
        Each job's progress and, at its end, its outcome.

    Raises:
        SourceError: Dask is not installed, or there is no scheduler.
    """
    client, distributed = connect(address)
    run = f'mvuav-{uuid.uuid4().hex}'
    with client:
        stop = distributed.Event(run, client=client)
        progress: SimpleQueue[tuple[int, JobProgress]] = SimpleQueue()
        client.subscribe_topic(run, lambda event: progress.put(_progress(event[1])))
        numbers = {
            client.submit(_work, job, number, run, pure=False): number
            for number, job in enumerate(jobs)
        }
        waiting = set(numbers)
        asked = 0.0
        while waiting and not (asked and time.monotonic() > asked + _CLOSING_TIME):
            if interrupted and not asked:
                asked = time.monotonic()
                stop.set()
            time.sleep(_POLL)
            yield from _drained(progress)
            for future in [future for future in waiting if future.done()]:
                waiting.discard(future)
                number = numbers[future]
                yield number, _outcome(future, jobs[number])


def _work(job: ReplayJob, number: int, run: str) -> ReplayOutcome:
    """Runs on a worker."""
    distributed: Any = import_module('distributed')
    worker = distributed.get_worker()
    asked_for = distributed.Event(run)
    stop = Stop()
    looked = time.monotonic()

    def report(progress: JobProgress) -> None:
        nonlocal looked
        worker.log_event(run, [number, *progress])
        if progress.done == 0 or time.monotonic() > looked + 0.5:
            looked = time.monotonic()
            if asked_for.is_set():
                stop.request()

    keep_freed_memory()
    try:
        return attempt(job, report, stop)
    finally:
        stop.close()


def _progress(message: Any) -> tuple[int, JobProgress]:
    number, name, done, total = message
    return number, JobProgress(name, done, total)


def _drained(queue: SimpleQueue[tuple[int, JobProgress]]) -> Iterator[Event]:
    try:
        while True:
            yield queue.get_nowait()
    except Empty:
        return


def _outcome(future: Any, job: ReplayJob) -> ReplayOutcome:
    if future.status == 'finished':
        outcome: ReplayOutcome = future.result()
        return outcome
    reason = future.exception() if future.status == 'error' else future.status
    return ReplayOutcome(job.source, job.output, failure=f'Dask: {" ".join(str(reason).split())}')
