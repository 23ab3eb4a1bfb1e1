"""One replay in a process of its own, so that the panel stays quick and a run can be ended."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from mvuav_ros.offline.processes import ProcessDiedError, Report, Told, Worker
from mvuav_ros.offline.replay.job import ReplayJob, ReplayOutcome, ReplaySettings, attempt
from mvuav_ros.offline.stopping import Stop
from mvuav_ros.panel.runs import SavedRun
from mvuav_ros.parameters.declaration import Value
from mvuav_ros.recordings.errors import RecordingError

_ENDING_TIME = 5.0
_NICENESS = 5


class RunFailedError(RuntimeError):
    """A run came to nothing, with the reason."""


@dataclass(frozen=True)
class RunRequest:
    """What is to be run.

    Attributes:
        name: of the run.
        kind: the node.
        source: the recording.
        parameters: of the node.
        output: the bag to write.
        settings: the name of the parameters' set.
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

        Args:
            request: what to run.
            progress: called with the frames done and, where that is known, how many there are.

        Raises:
            RunFailedError: it failed, or was cancelled.
        """
        # Spawned: a forked child would lack the threads of ROS.
        worker = self._worker = await asyncio.to_thread(Worker, _measured_replay)
        try:
            worker.send(0, request)
            if self.cancelled:
                worker.request_stop()
            while isinstance(message := await asyncio.to_thread(worker.receive), Told):
                progress(message.message.done, message.message.total)
        except ProcessDiedError as error:
            raise RunFailedError('cancelled' if self.cancelled else str(error)) from None
        finally:
            await asyncio.to_thread(worker.end, _ENDING_TIME)
        if not isinstance(message.result, SavedRun):
            raise RunFailedError('cancelled' if self.cancelled else str(message.error))
        return message.result


def _measured_replay(request: RunRequest, report: Report, stop: Stop) -> SavedRun:
    """Runs in the worker."""
    os.nice(_NICENESS)
    settings = ReplaySettings({request.kind: request.parameters})
    job = ReplayJob(str(request.source), str(request.output), settings)
    outcome: ReplayOutcome = attempt(job, report, stop)
    if outcome.failure or outcome.interrupted:
        raise RecordingError(outcome.failure or 'interrupted')
    from mvuav_ros.panel.measuring import measured_run

    return measured_run(request, outcome)
