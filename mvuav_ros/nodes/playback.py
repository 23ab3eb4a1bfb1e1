"""When the frames of a recording are due."""

from __future__ import annotations

import time
from threading import Event

LONGEST_GAP = 5.0
"""Seconds; a recording that pauses longer goes on after this."""


class Pace:
    """Waits until a frame is due, by its stamp or at a fixed rate."""

    def __init__(self) -> None:
        self._last_stamp_ns: int | None = None
        self._due = 0.0

    def wait(self, stamp_ns: int, rate: float, stop: Event) -> None:
        """Sleep until the frame is due; returns early when ``stop`` is set.

        Args:
            stamp_ns: the frame's stamp, ns.
            rate: frames per second; 0: by the stamps.
            stop: ends the wait.
        """
        now = time.monotonic()
        if self._last_stamp_ns is None:
            self._due = now
        elif rate > 0:
            self._due += 1.0 / rate
        else:
            gap = (stamp_ns - self._last_stamp_ns) * 1e-9
            self._due += min(max(gap, 0.0), LONGEST_GAP)
        self._last_stamp_ns = stamp_ns
        if self._due > now:
            stop.wait(self._due - now)
        elif now - self._due > 1.0:
            # Too slow for the pace: go on from here instead of racing to catch up.
            self._due = now
