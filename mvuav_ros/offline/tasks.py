"""Tasks here, in processes of this machine, or on a Dask cluster, whichever a user asks for."""

from __future__ import annotations

import logging
import multiprocessing
import os
import pickle
import signal
import sys
import time
import uuid
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from queue import SimpleQueue
from typing import Any, Generic, Literal, NamedTuple, TypeVar

import cv2

from mvuav_ros.offline.stopping import LOOK, SIGNALS, Interrupted, Stop, stop_on_signals
from mvuav_ros.processing.process_tuning import keep_freed_memory
from mvuav_ros.recordings.account import Account, SourceError, collect, collecting, needed_for

TaskT = TypeVar('TaskT')
ResultT = TypeVar('ResultT')

Report = Callable[[Any], None]
Work = Callable[[Any, Report, Stop], Any]
"""Takes a task, a function that reports to the parent how far it is, and when to end."""
Method = Literal['fork', 'spawn']
"""Forking is quick, but right only where the parent has no threads of its own or OpenCV's."""

_PARENT_LOOK = 1.0


def quick_method() -> Method:
    """Forking, unless this process has threads of Python: what they hold stays locked in a fork."""
    # Those that `threading` does not know of as well.
    return 'fork' if len(sys._current_frames()) == 1 else 'spawn'


class ProcessDiedError(Exception):
    """A process ended in the middle of its work."""


class TaskProgress(NamedTuple):
    """How far the work on a task is."""

    number: int
    message: Any


@dataclass(frozen=True)
class Done(Generic[ResultT]):
    """A task that has ended: its result or what went wrong, and the accounts of its inputs."""

    number: int
    result: ResultT | None
    error: Exception | None = None
    accounts: Sequence[Account] = ()


class Worker:
    """A process that does one task after the other; ``fileno`` can be read when it says something.

    Ctrl-C in a terminal reaches it too and is left to the parent, which asks by `request_stop`.
    """

    def __init__(self, work: Work, method: Method = 'spawn', threads: int = 1) -> None:
        """Start the process, with so many threads of OpenCV.

        The work is a function of a module, or an object that can be pickled.
        """
        context: Any = multiprocessing.get_context(method)
        self._connection, theirs = context.Pipe()
        forked = self._connection if method == 'fork' else None
        given = theirs, forked, work, threads
        self._process = context.Process(target=_serve, args=given, daemon=True)
        # It would let the signals through again when it is started with the first process.
        if method == 'spawn':
            resource_tracker.ensure_running()
        # Signals wait until it has handlers of its own.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
        try:
            self._process.start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        theirs.close()

    def fileno(self) -> int:
        """Can be read when `receive` has something."""
        return int(self._connection.fileno())

    def send(self, number: int, task: Any) -> None:
        """Give it a task; what has died meanwhile is reported by `receive`."""
        try:
            self._connection.send((number, task))
        except OSError:
            self._process.join()

    def receive(self) -> TaskProgress | Done[Any]:
        """Wait for what it says.

        Raises:
            ProcessDiedError: it has ended.
        """
        try:
            message: TaskProgress | Done[Any] = self._connection.recv()
        except (EOFError, OSError):
            self._process.join()
            raise ProcessDiedError(_ending(self._process.exitcode)) from None
        if isinstance(message, Done):
            collect(message.accounts)
        return message

    def request_stop(self) -> None:
        """Have the task that it is at end in good order."""
        if self._process.is_alive():
            self._process.terminate()

    def end(self, closing_time: float = 0.0) -> None:
        """End the process; after ``closing_time`` (s) by force."""
        self._connection.close()
        if closing_time:
            self._process.join(closing_time)
        if self._process.exitcode is None:
            self._process.kill()
            self._process.join()


def run_in_processes(
    work: Work,
    tasks: Sequence[Any],
    at_once: int,
    stop: Stop,
    *,
    method: Method = 'spawn',
    closing_time: float = 30.0,
) -> Generator[TaskProgress | Done[Any], None, None]:
    """Do tasks in their order in so many processes; one that dies costs its own task only.

    Once the end is asked for no task is begun, and those under way have ``closing_time`` (s) to
    end as well.

    Yields:
        What the tasks report, and each one's end, in the order in which they come.
    """
    waiting = deque(enumerate(tasks))
    threads = max(1, (os.cpu_count() or 1) // at_once)
    idle: list[Worker] = []
    busy: dict[Worker, int] = {}
    deadline: float | None = None
    try:
        while waiting or busy:
            if stop and deadline is None:
                deadline = time.monotonic() + closing_time
                waiting.clear()
                for worker in busy:
                    worker.request_stop()
            while waiting and len(busy) < at_once:
                worker = idle.pop() if idle else Worker(work, method, threads)
                number, task = waiting.popleft()
                worker.send(number, task)
                busy[worker] = number
            ready = wait([worker.fileno() for worker in busy], LOOK)
            for worker in [worker for worker in busy if worker.fileno() in ready]:
                try:
                    message = worker.receive()
                    if isinstance(message, Done):
                        del busy[worker]
                        idle.append(worker)
                except ProcessDiedError as error:
                    worker.end()
                    message = Done(busy.pop(worker), None, error)
                yield message
            if deadline is not None and time.monotonic() > deadline:
                late = ProcessDiedError(f'did not end within {closing_time:g} s, and was killed')
                yield from (Done(number, None, late) for number in busy.values())
                break
    finally:
        for worker in [*idle, *busy]:
            worker.end()


def attempted(number: int, work: Callable[[], ResultT]) -> Done[ResultT]:
    """The result of some work, or what went wrong."""
    with collecting() as accounts:
        try:
            done = Done(number, work(), accounts=accounts)
        except Exception as error:
            done = Done(number, None, error, accounts)
    collect(accounts)
    return done


def _serve(
    connection: Connection, parents_end: Connection | None, work: Work, threads: int
) -> None:
    if parents_end is not None:
        # Forked with the rest of the parent: only without it does the pipe ever break.
        parents_end.close()
    parent = os.getppid()
    with stop_on_signals() as stop:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS)
        cv2.setNumThreads(threads)
        keep_freed_memory()
        with suppress(BrokenPipeError, ConnectionResetError):
            while (given := _next_task(connection, stop, parent)) is not None:
                number, task = given

                def report(message: Any, number: int = number) -> None:
                    # The pipe need not break: processes forked later hold it open as well.
                    if os.getppid() != parent:
                        stop.request()
                    connection.send(TaskProgress(number, message))

                done = attempted(number, partial(work, task, report, stop))
                connection.send(sendable(done))


def _next_task(connection: Connection, stop: Stop, parent: int) -> tuple[int, Any] | None:
    """Wait for a task; None when there will be none any more."""
    while not stop and os.getppid() == parent:
        if connection.poll(_PARENT_LOOK):
            with suppress(EOFError):
                task: tuple[int, Any] = connection.recv()
                return task
            return None
    return None


def sendable(done: Done[Any]) -> Done[Any]:
    """With an error that survives the way to the parent."""
    if done.error is not None:
        try:
            pickle.loads(pickle.dumps(done.error))
        except Exception:
            return Done(done.number, None, RuntimeError(str(done.error)), done.accounts)
    return done


def _ending(exitcode: int | None) -> str:
    if exitcode is None or exitcode >= 0:
        return f'its process ended with status {exitcode}'
    name = signal.Signals(-exitcode).name
    return f'its process ended with {name}' + (' (out of memory?)' if name == 'SIGKILL' else '')


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
        waiting = {
            client.submit(_do, work, task, number, run, pure=False): number
            for number, task in enumerate(tasks)
        }
        deadline: float | None = None
        while waiting and (deadline is None or time.monotonic() < deadline):
            if stop and deadline is None:
                deadline = time.monotonic() + closing_time
                asked_to_stop.set()
            time.sleep(_POLL)
            while not reports.empty():
                yield reports.get()
            for future in [future for future in waiting if future.done()]:
                number = waiting.pop(future)
                if future.status == 'finished':
                    done: Done[Any] = future.result()
                    collect(done.accounts)
                    yield done
                else:
                    reason = future.exception() if future.status == 'error' else future.status
                    yield Done(number, None, ProcessDiedError(f'Dask: {reason}'))


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
