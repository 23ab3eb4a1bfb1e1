"""Many recordings on one machine: so many at a time, each in a process."""

from __future__ import annotations

from collections.abc import Generator, Sequence

from mvuav_ros.offline.processes import Method, Told, run_in_processes
from mvuav_ros.offline.replay.job import JobProgress, ReplayJob, ReplayOutcome, attempt
from mvuav_ros.offline.stopping import Stop
from mvuav_ros.recordings.remote import is_url

Event = tuple[int, JobProgress | ReplayOutcome]
"""The number of a job, and how far it is or what became of it."""


def run_jobs(jobs: Sequence[ReplayJob], at_once: int, stop: Stop) -> Generator[Event, None, None]:
    """Do the jobs, so many at a time; interrupted, those under way close their files.

    A process that dies costs its own recording only.

    Yields:
        Each job's progress and, at its end, its outcome.
    """
    # Forked, as importing everything anew takes a second; but fsspec may have begun a thread.
    remote = any(is_url(job.source) or is_url(job.output) for job in jobs)
    method: Method = 'spawn' if remote else 'fork'
    for message in run_in_processes(attempt, jobs, at_once, stop, method=method):
        if isinstance(message, Told):
            yield message.number, message.message
        elif message.result is not None:
            yield message.number, message.result
        else:
            job = jobs[message.number]
            yield message.number, ReplayOutcome(job.source, job.output, failure=str(message.error))
