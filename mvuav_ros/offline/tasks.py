"""Tasks here, in processes of this machine, or on a Dask cluster, whichever a user asks for."""

from __future__ import annotations

import logging
import time
import uuid
from collections.abc import Callable, Generator, Iterator, Sequence
from functools import partial
from importlib import import_module
from queue import SimpleQueue
from typing import Any, TypeVar

from mvuav_ros.offline.processes import (
    Done,
    ProcessDiedError,
    Report,
    ResultT,
    TaskProgress,
    Work,
    attempted,
    run_in_processes,
    sendable,
)
from mvuav_ros.offline.stopping import Interrupted, Stop, stop_on_signals
from mvuav_ros.processing.process_tuning import keep_freed_memory
from mvuav_ros.recordings.account import SourceError, collect, needed_for

_POLL = 0.1
_CONNECT_TIME = 10
_STOP_INTERVAL = 0.5
"""Seconds between two questions of a worker whether it is to end."""


def run_on_cluster(
    work: Work, tasks: Sequence[Any], address: str, stop: Stop, *, closing_time: float = 30.0
) -> Generator[TaskProgress | Done[Any], None, None]:
    """Do tasks on a cluster, as many at a time as its workers have threads.

    Paths in them are absolute, or URLs; a task whose worker dies is done again by another. The
    scheduler's address is such as ``tcp://10.0.0.1:8786``. Once the end is asked for, tasks under
    way have ``closing_time`` (s) to end as well.

    Yields:
        As `run_in_processes`.

    Raises:
        SourceError: Dask is not installed, the address is none, or there is no scheduler.
    """
    client, distributed = _connect(address)
    run = f'mvuav-{uuid.uuid4().hex}'
    with client:
        asked_to_stop = distributed.Event(run, client=client)
        reports: SimpleQueue[TaskProgress] = SimpleQueue()
        client.subscribe_topic(run, lambda event: reports.put(TaskProgress(*event[1])))
        numbers = {
            client.submit(_do, work, task, number, run, pure=False): number
            for number, task in enumerate(tasks)
        }
        waiting = set(numbers)
        deadline: float | None = None
        while waiting and (deadline is None or time.monotonic() < deadline):
            if stop and deadline is None:
                deadline = time.monotonic() + closing_time
                asked_to_stop.set()
            time.sleep(_POLL)
            while not reports.empty():
                yield reports.get()
            for future in [future for future in waiting if future.done()]:
                waiting.discard(future)
                if future.status == 'finished':
                    done: Done[Any] = future.result()
                    collect(done.accounts)
                    yield done
                else:
                    reason = future.exception() if future.status == 'error' else future.status
                    yield Done(numbers[future], None, ProcessDiedError(f'Dask: {reason}'))


def _connect(address: str) -> tuple[Any, Any]:
    with needed_for('--dask'):
        distributed: Any = import_module('distributed')
    # It would log attempt after attempt, with tracebacks.
    logging.getLogger('distributed').setLevel(logging.CRITICAL)
    try:
        # A client that was given no address would never end, and say so with a traceback.
        import_module('distributed.comm').get_address_host_port(address)
    except ValueError as error:
        raise SourceError(f'--dask {address}: {error}; write tcp://HOST:8786') from error
    try:
        client = distributed.Client(address, timeout=_CONNECT_TIME, set_as_default=False)
    except OSError as error:
        raise SourceError(f'--dask {address}: no Dask scheduler answers there') from error
    return client, distributed


def _do(work: Work, task: Any, number: int, run: str) -> Done[Any]:
    distributed: Any = import_module('distributed')
    worker, asked_to_stop = distributed.get_worker(), distributed.Event(run)
    stop, looked = Stop(), 0.0

    def report(message: Any) -> None:
        nonlocal looked
        worker.log_event(run, [number, message])
        if time.monotonic() > looked + _STOP_INTERVAL:
            looked = time.monotonic()
            if asked_to_stop.is_set():
                stop.request()

    keep_freed_memory()
    return sendable(attempted(number, partial(work, task, report, stop)))


TaskT = TypeVar('TaskT')


def each(
    work: Callable[[TaskT], ResultT],
    tasks: Sequence[TaskT],
    jobs: int = 1,
    cluster: str | None = None,
) -> Iterator[Done[ResultT]]:
    """Do the work on every task; one that fails does not stop the others.

    The work is a function of a module, so that other processes find it; with one job all is done
    in this one. With the address of a Dask scheduler its cluster does it.

    Yields:
        Tasks as they end, in any order.

    Raises:
        Interrupted: by Ctrl-C or SIGTERM, when all processes have ended.
        SourceError: the cluster cannot be used.
    """
    if not cluster and (jobs <= 1 or len(tasks) <= 1):
        yield from (attempted(number, partial(work, task)) for number, task in enumerate(tasks))
        return
    plain = partial(_plain, work)
    with stop_on_signals() as stop:
        if not cluster:
            messages = run_in_processes(plain, tasks, min(jobs, len(tasks)), stop, closing_time=0.0)
        else:
            messages = run_on_cluster(plain, tasks, cluster, stop, closing_time=0.0)
        for message in messages:
            # What is cut off by the stop has not failed.
            if isinstance(message, Done) and not (stop and message.error):
                yield message
        if stop:
            raise Interrupted(stop.number)


def all_of(
    work: Callable[[TaskT], ResultT],
    tasks: Sequence[TaskT],
    jobs: int = 1,
    advance: Callable[[], None] = lambda: None,
) -> list[ResultT]:
    """As `each`, but all results in the tasks' order; the first failure ends it.

    ``advance`` is called whenever a task has ended.
    """
    results: dict[int, ResultT] = {}
    for done in each(work, tasks, jobs):
        if done.error is not None:
            raise done.error
        assert done.result is not None
        results[done.number] = done.result
        advance()
    return [results[number] for number in range(len(tasks))]


def _plain(
    function: Callable[[TaskT], ResultT], task: TaskT, _report: Report, _stop: Stop
) -> ResultT:
    return function(task)
