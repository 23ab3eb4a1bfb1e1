"""One request to end, which every loop looks at: Ctrl-C and SIGTERM only set a flag."""

# A handler that raises may land anywhere: between a lock and its with, in a destructor, in a
# callback. There the interruption is lost, or the lock is never let go of.

from __future__ import annotations

import contextvars
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, wait
from contextlib import contextmanager
from types import FrameType
from typing import TypeVar

ResultT = TypeVar('ResultT')

SIGNALS = (signal.SIGINT, signal.SIGTERM)
PATIENCE = 10.0
"""Seconds after which a further signal ends the process at once."""
LOOK = 0.05
"""Seconds between two looks at the flag."""


class Interrupted(BaseException):
    """Raised where a loop has seen the request and everything is closed, never by a handler.

    No KeyboardInterrupt: typer would make status 130 of it, whatever the signal.
    """

    def __init__(self, number: int) -> None:
        super().__init__(f'interrupted by signal {number}')
        self.number = number


class Stop:
    """Whether somebody wants the work to end.

    Attributes:
        number: of the signal that asked for it; 0 before.
    """

    def __init__(self) -> None:
        self.number = 0

    def __bool__(self) -> bool:
        return self.number != 0

    def request(self, number: int = signal.SIGTERM) -> None:
        """Ask for the end; may be called by a signal's handler, and by any thread."""
        self.number = self.number or number

    def unless_requested(self, function: Callable[[], ResultT]) -> ResultT | None:
        """What a function returns, or None as soon as the end is asked for.

        It runs in a thread, which is left behind then: for what looks at no flag, such as the
        opening of a damaged recording.

        Raises:
            Exception: what the function raises.
        """
        future: Future[ResultT] = Future()

        def run() -> None:
            try:
                future.set_result(function())
            except BaseException as error:
                future.set_exception(error)

        # What is opened there is accounted for here.
        here = contextvars.copy_context()
        threading.Thread(target=here.run, args=(run,), name='opening', daemon=True).start()
        while not wait([future], LOOK).done:
            if self:
                return None
        return future.result()


@contextmanager
def stop_on_signals() -> Iterator[Stop]:
    """A request that SIGINT and SIGTERM make; once made, they are ignored after the block.

    Outside of the main thread, which alone gets signals, nothing makes it but `Stop.request`.
    """
    stop = Stop()
    requested = 0.0

    def note(number: int, _frame: FrameType | None) -> None:
        nonlocal requested
        if stop and time.monotonic() > requested + PATIENCE:
            os._exit(128 + number)
        requested = requested or time.monotonic()
        stop.request(number)

    ours = threading.current_thread() is threading.main_thread()
    before = {number: signal.signal(number, note) for number in SIGNALS} if ours else {}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            # The rest of a process that is ending must not be disturbed by a second Ctrl-C.
            signal.signal(number, signal.SIG_IGN if stop else handler)
