"""Counts and times of a processing node's frames, for ``/diagnostics``."""

from __future__ import annotations

import time
from collections import Counter, deque
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

WINDOW = 5.0
"""Seconds over which rates, latencies and recent troubles are taken."""
_LONGEST_REASON = 300
_PERCENTILES = {
    'latency_p50_ms': ('total', 50),
    'latency_p95_ms': ('total', 95),
    'latency_p99_ms': ('total', 99),
    **{f'{stage}_p50_ms': (stage, 50) for stage in ('transport', 'decode', 'process', 'publish')},
}
"""Of `FrameTimes`."""


class FrameTimes(NamedTuple):
    """Where the time of one processed frame went, s.

    Attributes:
        transport: from the publisher to us; NaN if the middleware does not tell.
        decode: bytes to image.
        process: image to messages.
        publish: messages to the middleware.
        total: from taking the bytes to the last message, waiting included.
    """

    transport: float
    decode: float
    process: float
    publish: float
    total: float


class FrameStatistics:
    """What came in, what went out, how long it took and what was rejected, and why."""

    def __init__(self) -> None:
        self._arrivals: deque[float] = deque()
        self._results: deque[tuple[float, FrameTimes]] = deque()
        self._rejections: deque[float] = deque()
        self.received = 0
        self.processed = 0
        self.rejected: Counter[str] = Counter()
        self.last_reason = ''
        self.restart()

    def restart(self) -> None:
        """Images are expected from now on."""
        self._arrivals.clear()
        self._quiet_since = time.monotonic()

    def arrived(self) -> None:
        """Count a frame."""
        self.received += 1
        self._quiet_since = time.monotonic()
        self._arrivals.append(self._quiet_since)

    def processed_one(self, times: FrameTimes) -> None:
        """Count the results of a frame."""
        self.processed += 1
        self._results.append((time.monotonic(), times))

    def reject(self, kind: str, reason: str) -> None:
        """Count a frame that got no result, by kind (``bad image``), and keep the reason."""
        self.rejected[kind] += 1
        self._rejections.append(time.monotonic())
        self.last_reason = reason[:_LONGEST_REASON]

    def problems(self) -> list[str]:
        """What was wrong with the frames of the last seconds, in words."""
        self._forget_old()
        rejected, arrived = len(self._rejections), len(self._arrivals)
        return [f'{rejected} of {arrived} images rejected: {self.last_reason}'] if rejected else []

    @property
    def silent(self) -> bool:
        """Whether no frame came within the last seconds."""
        self._forget_old()
        return not self._arrivals

    @property
    def quiet_for(self) -> float:
        """Seconds since the last frame, or since frames are expected."""
        return time.monotonic() - self._quiet_since

    def values(self) -> dict[str, str]:
        """Key-values of a diagnostic status."""
        self._forget_old()
        times = [times for _, times in self._results]
        return {
            'input_rate_hz': f'{len(self._arrivals) / WINDOW:.1f}',
            'output_rate_hz': f'{len(self._results) / WINDOW:.1f}',
            **{key: _percentile_ms(times, *which) for key, which in _PERCENTILES.items()},
            'frames_received': str(self.received),
            'frames_processed': str(self.processed),
            'frames_rejected': str(self.rejected.total()),
            **{f'rejected_{kind.replace(" ", "_")}': str(n) for kind, n in self.rejected.items()},
            'last_rejection': self.last_reason,
        }

    def _forget_old(self) -> None:
        oldest = time.monotonic() - WINDOW
        for times in (self._arrivals, self._rejections):
            while times and times[0] < oldest:
                times.popleft()
        while self._results and self._results[0][0] < oldest:
            self._results.popleft()


def _percentile_ms(times: Sequence[FrameTimes], stage: str, percent: int) -> str:
    values = [getattr(each, stage) * 1e3 for each in times]
    return f'{np.percentile(values, percent):.2f}' if values else 'nan'
