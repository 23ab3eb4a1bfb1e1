"""One replay in a process of its own, so that the panel stays quick and a run can be ended."""

from __future__ import annotations

import asyncio
import multiprocessing
import os
import signal
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import cv2

from mvuav_ros.offline.replay.interruptions import interrupt_on_signals
from mvuav_ros.offline.replay.job import (
    JobProgress,
    ReplayJob,
    ReplayOutcome,
    ReplaySettings,
    attempt,
)
from mvuav_ros.panel.runs import SavedRun
from mvuav_ros.parameters.declaration import Value
from mvuav_ros.recordings.errors import RecordingError

_ENDING_TIME = 5.0
_NICENESS = 5


class RunFailedError(RuntimeError):
    """A run came to nothing, with the reason."""


class RunProcess:
    """A run under way."""

    def __init__(self) -> None:
        self._process: Any = None
        self.cancelled = False

    def cancel(self) -> None:
        """End it; `run` then raises."""
        self.cancelled = True
        if self._process is not None and self._process.is_alive():
            self._process.terminate()

    async def run(
        self,
        name: str,
        kind: str,
        source: Path,
        parameters: dict[str, Value],
        output: Path,
        progress: Callable[[int, int | None], None],
        settings: str = '',
    ) -> SavedRun:
        """Replay a recording with a node's code and measure its results.

        Args:
            name: of the run; empty: it is not kept and gets no report.
            kind: the node.
            source: the recording.
            parameters: of the node.
            output: the bag to write.
            progress: called with the frames done and, where that is known, how many there are.
            settings: the name of the parameters' set.

        Raises:
            RunFailedError: it failed, or was cancelled.
        """
        # A forked child would inherit the threads of ROS, which are not there any more.
        context = multiprocessing.get_context('spawn')
        ours, theirs = context.Pipe(duplex=False)
        job = ReplayJob(str(source), output, ReplaySettings({kind: parameters}))
        self._process = context.Process(
            target=_work, args=(theirs, job, name, kind, settings), daemon=True
        )
        await asyncio.to_thread(self._process.start)
        theirs.close()
        try:
            while True:
                message = await asyncio.to_thread(_next, ours)
                if isinstance(message, JobProgress):
                    progress(message.done, message.total)
                elif isinstance(message, SavedRun):
                    return message
                else:
                    raise RunFailedError('cancelled' if self.cancelled else str(message))
        finally:
            ours.close()
            await asyncio.to_thread(self._end)

    def _end(self) -> None:
        self._process.join(_ENDING_TIME)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()


def _next(connection: Connection) -> object:
    try:
        return connection.recv()
    except (EOFError, OSError):
        return 'the process ended'


def _work(connection: Connection, job: ReplayJob, name: str, kind: str, settings: str) -> None:
    interrupt_on_signals()
    # Ctrl-C in the terminal goes to the panel, which ends its run.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.nice(_NICENESS)
    cv2.setNumThreads(1)
    outcome = ReplayOutcome(job.source, job.output)
    try:
        attempt(job, outcome, connection.send, ahead=False)
        if outcome.error:
            connection.send(outcome.error)
            return
        from mvuav_ros.panel.measuring import measured_run

        parameters = job.settings.parameters[kind]
        connection.send(measured_run(name, kind, job.source, parameters, outcome, settings))
    except RecordingError as error:
        connection.send(str(error))
    except (KeyboardInterrupt, BrokenPipeError):
        pass
