"""Processes that do tasks: for replay, sweeps, evaluations, the panel and bench."""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import sys
import time
from collections import deque
from collections.abc import Callable, Generator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from typing import Any, Generic, Literal, NamedTuple, TypeVar

import cv2

from mvuav_ros.offline.stopping import (
    LOOK,
    SIGNALS,
    Stop,
    signals_held_back,
    stop_on_signals,
)
from mvuav_ros.processing.process_tuning import keep_freed_memory
from mvuav_ros.recordings.account import Account, collect, collecting

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
        with signals_held_back():
            self._process.start()
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
