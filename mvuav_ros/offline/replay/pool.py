"""Many recordings on one machine: a process for each, so many at a time."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Generator, Sequence
from multiprocessing.connection import Connection, wait
from multiprocessing.context import ForkProcess
from typing import NamedTuple

import cv2

from mvuav_ros.offline.replay.interruptions import held_back, ignore_signals, interrupt_on_signals
from mvuav_ros.offline.replay.job import JobProgress, ReplayJob, ReplayOutcome, attempt
from mvuav_ros.offline.replay.memory import keep_freed_memory

Event = tuple[int, JobProgress | ReplayOutcome]
"""The number of a job, and how far it is or what became of it."""

_SIGNALS = (signal.SIGINT, signal.SIGTERM)
_CLOSING_TIME = 30.0
"""Seconds that interrupted processes have to close their files."""


class _Running(NamedTuple):
    number: int
    job: ReplayJob
    process: ForkProcess


def run_in_processes(jobs: Sequence[ReplayJob], at_once: int) -> Generator[Event, None, None]:
    """Do the jobs, each in a process of its own.

    A process that dies costs its own recording only. Interrupted, the processes close their files.

    Args:
        jobs: in the order in which they are begun.
        at_once: the number of processes at a time.

    Yields:
        Each job's progress and, at its end, its outcome.
    """
    waiting = list(enumerate(jobs))[::-1]
    running: dict[Connection, _Running] = {}
    threads = max(1, (os.cpu_count() or 1) // at_once)
    try:
        while waiting or running:
            while waiting and len(running) < at_once:
                number, job = waiting.pop()
                connection, process = _start(job, threads)
                running[connection] = _Running(number, job, process)
            ready = wait(list(running))
            for connection in [connection for connection in running if connection in ready]:
                number, job, process = running[connection]
                try:
                    message = connection.recv()
                except EOFError:
                    message = _died(job, process)
                if isinstance(message, ReplayOutcome):
                    process.join()
                    connection.close()
                    del running[connection]
                yield number, message
    finally:
        with held_back():
            _end([entry.process for entry in running.values()])


def _start(job: ReplayJob, threads: int) -> tuple[Connection, ForkProcess]:
    # Forked, as importing everything anew takes a second; this process has no threads yet.
    context = multiprocessing.get_context('fork')
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=_work, args=(job, sender, threads), daemon=True)
    # Until the child has its own handlers, Ctrl-C would end it with a traceback.
    signal.pthread_sigmask(signal.SIG_BLOCK, _SIGNALS)
    try:
        process.start()
    finally:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, _SIGNALS)
    sender.close()
    return receiver, process


def _work(job: ReplayJob, sender: Connection, threads: int) -> None:
    # Ctrl-C reaches the whole group: the parent passes it on as SIGTERM, once.
    interrupt_on_signals()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, _SIGNALS)
        cv2.setNumThreads(threads)
        keep_freed_memory()
        outcome = ReplayOutcome(job.source, job.output)
        attempt(job, outcome, lambda progress: _tell(sender, progress), ahead=threads > 1)
        ignore_signals()
        _tell(sender, outcome)
    except KeyboardInterrupt:
        ignore_signals()


def _tell(sender: Connection, message: JobProgress | ReplayOutcome) -> None:
    parent = multiprocessing.parent_process()
    # The pipe would not break: processes forked later hold it open as well.
    if parent is not None and os.getppid() != parent.pid:
        raise KeyboardInterrupt
    sender.send(message)


def _died(job: ReplayJob, process: ForkProcess) -> ReplayOutcome:
    process.join()
    reason = f'status {process.exitcode}'
    if process.exitcode is not None and process.exitcode < 0:
        reason = signal.Signals(-process.exitcode).name
        if reason == 'SIGKILL':
            reason += ' (out of memory?)'
    return ReplayOutcome(job.source, job.output, error=f'its process ended with {reason}')


def _end(processes: list[ForkProcess]) -> None:
    for process in processes:
        process.terminate()
    for process in processes:
        process.join(_CLOSING_TIME)
        if process.exitcode is None:
            process.kill()
            process.join()
