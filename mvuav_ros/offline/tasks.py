"""The same work on many inputs, in this process or several."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import TypeVar

from mvuav_ros.offline.processes import Done, Report, attempted, run_in_processes
from mvuav_ros.offline.stopping import Interrupted, Stop, stop_on_signals

TaskT = TypeVar('TaskT')
ResultT = TypeVar('ResultT')


def each(
    work: Callable[[TaskT], ResultT], tasks: Sequence[TaskT], jobs: int = 1
) -> Iterator[Done[ResultT]]:
    """Do the work on every task; one that fails does not stop the others.

    The work is a function of a module, so that other processes find it; with one job all is done
    in this one.

    Yields:
        Tasks as they end, in any order.

    Raises:
        Interrupted: by Ctrl-C or SIGTERM, when all processes have ended.
    """
    if jobs <= 1 or len(tasks) <= 1:
        yield from (attempted(number, partial(work, task)) for number, task in enumerate(tasks))
        return
    with stop_on_signals() as stop:
        done = run_in_processes(
            partial(_plain, work), tasks, min(jobs, len(tasks)), stop, closing_time=0.0
        )
        for message in done:
            if isinstance(message, Done):
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
    function: Callable[[TaskT], ResultT], task: TaskT, _told: Report, _stop: Stop
) -> ResultT:
    """Work that neither tells anything nor looks at the stop."""
    return function(task)
