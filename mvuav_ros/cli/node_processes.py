"""Processes of the package, for the demo and the live benchmark."""

from __future__ import annotations

import os
import random
import signal
import socket
import subprocess
import sys
import tempfile
import time
from contextlib import AbstractContextManager

from mvuav_ros.sources.source import SourceError

_LOOK = 0.02
_ENDING_TIME = 10.0


def claim_domain() -> tuple[int, socket.socket]:
    """A ROS domain that nothing else of ours uses on this machine, until the socket is closed.

    Two that played images in one domain would answer each other's. The claim is a name that the
    kernel keeps: there is no file that somebody could have put there.

    Raises:
        SourceError: all hundred are in use.
    """
    for number in random.SystemRandom().sample(range(1, 101), 100):
        # Closed by whoever uses the domain.
        claim = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        try:
            claim.bind(f'\0mvuav_ros_domain_{number}')
        except OSError:
            claim.close()
        else:
            return number, claim
    raise SourceError('the ROS domains 1 to 100 are all in use')


class NodeProcess:
    """A module that runs as a process; what it prints is kept."""

    def __init__(self, domain_id: int, module: str, *arguments: str) -> None:
        self._name = arguments[0] if arguments else module
        self._log = tempfile.TemporaryFile()  # noqa: SIM115 - lives as long as the process
        self._process = subprocess.Popen(
            [sys.executable, '-m', module, *arguments],
            env={**os.environ, 'ROS_DOMAIN_ID': str(domain_id)},
            stdout=self._log,
            stderr=subprocess.STDOUT,
        )
        self.pid = self._process.pid

    def output(self) -> str:
        """What it has printed so far."""
        size = os.fstat(self._log.fileno()).st_size
        return os.pread(self._log.fileno(), size, 0).decode(errors='replace')

    def failure(self) -> str:
        """Why it has ended although it should run; empty while it does."""
        status = self._process.poll()
        return '' if status is None else f'{self._name} ended with status {status}: {self.output()}'

    def wait_for(self, start: str, seconds: float = 120.0) -> str:
        """The first line that it prints that starts so.

        Raises:
            SourceError: it ends without one, or none comes in time.
        """
        end = time.monotonic() + seconds
        while True:
            # In this order: what it prints last is read after its end.
            failure = self.failure()
            for line in self.output().splitlines(keepends=True):
                if line.startswith(start) and line.endswith('\n'):
                    return line.strip()
            if failure:
                raise SourceError(failure)
            if time.monotonic() > end:
                raise SourceError(f'{self._name} did not start within {seconds:.0f} s')
            time.sleep(_LOOK)

    def interrupt(self) -> None:
        """Ask it to end."""
        self._process.send_signal(signal.SIGINT)

    def end(self) -> None:
        """Wait for its end, which comes by force if it takes too long."""
        try:
            self._process.wait(_ENDING_TIME)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._log.close()


class NodeProcesses(AbstractContextManager['NodeProcesses']):
    """Processes in a ROS domain of their own, which end together.

    Other ROS systems on the network are neither received nor disturbed.
    """

    def __init__(self) -> None:
        self.domain_id, self._claim = claim_domain()
        self._running: list[NodeProcess] = []

    def start(self, module: str, *arguments: str) -> NodeProcess:
        """Start one, as ``python -m MODULE ARGUMENTS`` does."""
        self._running.append(NodeProcess(self.domain_id, module, *arguments))
        return self._running[-1]

    def failure(self) -> str:
        """Why one has ended although it should run; empty while all do."""
        return next(filter(None, (process.failure() for process in self._running)), '')

    def __exit__(self, *_: object) -> None:
        for process in self._running:
            process.interrupt()
        for process in self._running:
            process.end()
        self._claim.close()
