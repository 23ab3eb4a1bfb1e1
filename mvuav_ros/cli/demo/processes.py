"""The demo's nodes as processes."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from types import TracebackType
from typing import IO

_MOST_OUTPUT = 1 << 16


class NodeProcesses:
    """Starts executables of the package and ends them together.

    What they print is kept and shown only if one of them fails.
    """

    def __init__(self, domain_id: int) -> None:
        self._environment = {**os.environ, 'ROS_DOMAIN_ID': str(domain_id)}
        self._running: list[tuple[str, subprocess.Popen[bytes], IO[bytes]]] = []

    def start(
        self, executable: str, arguments: Sequence[str] = (), before: Sequence[str] = ()
    ) -> None:
        """Start one, as ``ros2 run mvuav_ros EXECUTABLE BEFORE --ros-args ARGUMENTS`` does."""
        log = tempfile.TemporaryFile()  # noqa: SIM115 - lives as long as the process
        command = [sys.executable, '-m', 'mvuav_ros', executable, *before]
        command += ['--ros-args', *arguments]
        process = subprocess.Popen(
            command, env=self._environment, stdout=log, stderr=subprocess.STDOUT
        )
        self._running.append((executable, process, log))

    def output(self, executable: str) -> str:
        """What the first process of an executable has printed so far."""
        log = next(log for name, _, log in self._running if name == executable)
        return os.pread(log.fileno(), _MOST_OUTPUT, 0).decode(errors='replace')

    def failure(self) -> str:
        """Why a process has ended although it should run; empty while all do."""
        for name, process, log in self._running:
            if process.poll() is not None:
                log.seek(0)
                words = log.read().decode(errors='replace').strip()
                return f'{name} ended with status {process.returncode}: {words}'
        return ''

    def __enter__(self) -> NodeProcesses:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        for _, process, _ in self._running:
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
        for _, process, log in self._running:
            try:
                process.wait(timeout=5.0)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
            log.close()
