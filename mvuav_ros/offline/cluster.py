"""Tasks on a Dask cluster, as `run_in_processes` does them on this machine."""

from __future__ import annotations

import logging
import time
import uuid
from collections.abc import Generator, Sequence
from functools import partial
from importlib import import_module
from queue import SimpleQueue
from typing import Any

from mvuav_ros.offline.processes import (
    Done,
    ProcessDiedError,
    TaskProgress,
    Work,
    attempted,
    sendable,
)
from mvuav_ros.offline.stopping import Stop
from mvuav_ros.processing.process_tuning import keep_freed_memory
from mvuav_ros.recordings.account import SourceError, collect

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
    try:
        distributed: Any = import_module('distributed')
    except ImportError as error:
        raise SourceError(
            f'--dask needs Dask: pip install "mvuav_ros[dask]", here and on the workers ({error})'
        ) from error
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
