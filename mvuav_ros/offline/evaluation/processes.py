"""The same work on many inputs, in one process or several."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from typing import Generic, TypeVar

import cv2

TaskT = TypeVar('TaskT')
ResultT = TypeVar('ResultT')


@dataclass(frozen=True)
class Done(Generic[ResultT]):
    """A task that has ended: its number, and its result or what went wrong."""

    number: int
    result: ResultT | None
    error: Exception | None = None


def each(
    work: Callable[[TaskT], ResultT], tasks: Sequence[TaskT], jobs: int = 1
) -> Iterator[Done[ResultT]]:
    """Do the work on every task; one that fails does not stop the others.

    Args:
        work: a function of a module, so that another process finds it.
        tasks: its arguments.
        jobs: processes; with 1 all is done in this one.

    Yields:
        Tasks as they end, in any order.
    """
    if jobs <= 1 or len(tasks) <= 1:
        for number, task in enumerate(tasks):
            yield _attempt(number, work, task)
        return
    # A forked child would inherit OpenCV's threads, which are not there any more.
    context = multiprocessing.get_context('spawn')
    with ProcessPoolExecutor(min(jobs, len(tasks)), context, _one_thread) as pool:
        futures = {pool.submit(work, task): number for number, task in enumerate(tasks)}
        try:
            for future in as_completed(futures):
                yield _taken(futures[future], future)
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


def all_of(
    work: Callable[[TaskT], ResultT],
    tasks: Sequence[TaskT],
    jobs: int = 1,
    advance: Callable[[], None] = lambda: None,
) -> list[ResultT]:
    """As `each`, but all results in the tasks' order; the first failure ends it.

    Args:
        work: a function of a module.
        tasks: its arguments.
        jobs: processes.
        advance: called whenever a task has ended.
    """
    results: dict[int, ResultT] = {}
    for done in each(work, tasks, jobs):
        if done.error is not None:
            raise done.error
        assert done.result is not None
        results[done.number] = done.result
        advance()
    return [results[number] for number in range(len(tasks))]


def _attempt(number: int, work: Callable[[TaskT], ResultT], task: TaskT) -> Done[ResultT]:
    try:
        return Done(number, work(task))
    except Exception as error:
        return Done(number, None, error)


def _taken(number: int, future: Future[ResultT]) -> Done[ResultT]:
    try:
        return Done(number, future.result())
    except Exception as error:
        return Done(number, None, error)


def _one_thread() -> None:
    cv2.setNumThreads(1)
