"""Ctrl-C and SIGTERM must not tear the closing of a file apart."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

_SIGNALS = (signal.SIGINT, signal.SIGTERM)
_CLEANING_TIME = 5.0
"""Seconds."""


class Terminated(KeyboardInterrupt):
    """SIGTERM, which ends a command in the same way as Ctrl-C."""


class Interrupter:
    """A handler of SIGINT and SIGTERM: the first one ends the command.

    A second Ctrl-C could come at any moment of the clean-up that the first one has set off: it is
    ignored, unless the command is still there after some seconds.
    """

    def __init__(self) -> None:
        self._deaf_until = 0.0

    def __call__(self, number: int, _frame: FrameType | None) -> None:
        """Raise KeyboardInterrupt, or `Terminated`."""
        if time.monotonic() >= self._deaf_until:
            self._deaf_until = time.monotonic() + _CLEANING_TIME
            raise Terminated if number == signal.SIGTERM else KeyboardInterrupt


def interrupt_on_signals() -> None:
    """Have SIGINT and SIGTERM end the command, in the same way."""
    interrupter = Interrupter()
    for number in _SIGNALS:
        signal.signal(number, interrupter)


def ignore_signals() -> None:
    """Let nothing disturb the rest of a command that is ending."""
    for number in _SIGNALS:
        signal.signal(number, signal.SIG_IGN)


@contextmanager
def held_back() -> Iterator[None]:
    """Let SIGINT and SIGTERM wait until the block is done; only the main thread gets them."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    arrived: list[int] = []
    previous = {number: signal.getsignal(number) for number in _SIGNALS}
    for number in _SIGNALS:
        signal.signal(number, lambda which, _: arrived.append(which))
    try:
        yield
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)
        if arrived:
            signal.raise_signal(arrived[0])
