"""One replay in a process of its own, so that the panel stays quick and a run can be ended."""

from __future__ import annotations

import asyncio
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import mvuav_ros
from mvuav_ros.offline.processes import ProcessDiedError, Report, Told, Worker
from mvuav_ros.offline.replay.job import ReplayJob, ReplaySettings, attempt
from mvuav_ros.offline.stopping import Stop
from mvuav_ros.panel.runs import REPORT, SavedRun
from mvuav_ros.parameters.declaration import Value
from mvuav_ros.recordings.errors import RecordingError

_ENDING_TIME = 5.0
_NICENESS = 5


class RunFailedError(RuntimeError):
    """A run came to nothing, with the reason."""


class RunRequest(NamedTuple):
    """What is to be run: a recording with a kind of node and its parameters, into a bag.

    A run with a name gets a report beside its results. ``settings`` names the parameters' set.
    """

    name: str
    kind: str
    source: Path
    parameters: dict[str, Value]
    output: Path
    settings: str = ''


class RunProcess:
    """A run under way."""

    def __init__(self) -> None:
        self._worker: Worker | None = None
        self.cancelled = False

    def cancel(self) -> None:
        """End it; `run` then raises."""
        self.cancelled = True
        if self._worker is not None:
            self._worker.request_stop()

    async def run(
        self, request: RunRequest, progress: Callable[[int, int | None], None]
    ) -> SavedRun:
        """Replay a recording with a node's code and measure its results.

        ``progress`` gets the frames done and, where that is known, how many there are.

        Raises:
            RunFailedError: it failed, or was cancelled.
        """
        run, failure = None, ''
        # Spawned: a forked child would lack the threads of ROS.
        worker = self._worker = await asyncio.to_thread(Worker, _measured_replay)
        try:
            worker.send(0, request)
            if self.cancelled:
                worker.request_stop()
            while isinstance(message := await asyncio.to_thread(worker.receive), Told):
                progress(message.message.done, message.message.total)
            run, failure = message.result, str(message.error)
        except ProcessDiedError as error:
            failure = str(error)
        finally:
            await asyncio.to_thread(worker.end, _ENDING_TIME)
        if not isinstance(run, SavedRun):
            raise RunFailedError('cancelled' if self.cancelled else failure)
        return run


def _measured_replay(request: RunRequest, report: Report, stop: Stop) -> SavedRun:
    """Runs in the worker; what it imports is much, and for the worker only."""
    from mvuav_ros.offline.evaluation.bag_report import bag_report
    from mvuav_ros.offline.evaluation.evaluation_run import read_bag
    from mvuav_ros.offline.evaluation.metrics import metrics_of
    from mvuav_ros.offline.report.writing import write_report

    os.nice(_NICENESS)
    settings = ReplaySettings({request.kind: request.parameters})
    outcome = attempt(ReplayJob(str(request.source), str(request.output), settings), report, stop)
    if outcome.failure or outcome.interrupted:
        raise RecordingError(outcome.failure or 'interrupted')
    observed = read_bag(request.output)
    observed.truth = read_bag(request.source).truth
    observed.frames = outcome.frames
    observed.rejected = outcome.frames - outcome.processed
    if request.name:
        described = {key: str(value) for key, value in request.parameters.items()}
        write_report(bag_report(observed, described), request.output.parent / REPORT)
    return SavedRun(
        name=request.name,
        kind=request.kind,
        source=str(request.source),
        parameters=request.parameters,
        metrics=tuple(m for m in metrics_of(observed) if m.name != 'time per frame'),
        version=mvuav_ros.__version__,
        made=time.time(),
        frames=outcome.frames,
        answered=outcome.processed,
        settings=request.settings,
    )
