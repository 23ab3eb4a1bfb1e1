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


class FrameTimes(NamedTuple):
    """Where the time of one answered frame went, s.

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
    """What came in, what went out, how long it took and what was refused, and why."""

    def __init__(self) -> None:
        self._arrivals: deque[float] = deque()
        self._answers: deque[tuple[float, FrameTimes]] = deque()
        self._refusals: deque[float] = deque()
        self.received = 0
        self.answered = 0
        self.refused: Counter[str] = Counter()
        self.last_reason = ''

    def arrived(self) -> None:
        """Count a frame."""
        self.received += 1
        self._arrivals.append(time.monotonic())

    def answer(self, times: FrameTimes) -> None:
        """Count the results of a frame."""
        self.answered += 1
        self._answers.append((time.monotonic(), times))

    def refuse(self, kind: str, reason: str) -> None:
        """Count a frame that got no result, by kind (``bad image``), and keep the reason."""
        self.refused[kind] += 1
        self._refusals.append(time.monotonic())
        self.last_reason = reason[:_LONGEST_REASON]

    def problems(self) -> list[str]:
        """What was wrong with the frames of the last seconds, in words."""
        self._forget_old()
        refused = len(self._refusals)
        if not refused:
            return []
        return [f'{refused} of {len(self._arrivals)} images refused: {self.last_reason}']

    @property
    def silent(self) -> bool:
        """Whether no frame came within the last seconds."""
        self._forget_old()
        return not self._arrivals

    def values(self) -> dict[str, str]:
        """Key-values of a diagnostic status."""
        self._forget_old()
        times = [times for _, times in self._answers]
        totals = _milliseconds(times, 'total')
        stages = {
            f'{stage}_p50_ms': _percentile(_milliseconds(times, stage), 50)
            for stage in ('transport', 'decode', 'process', 'publish')
        }
        return {
            'input_rate_hz': f'{len(self._arrivals) / WINDOW:.1f}',
            'output_rate_hz': f'{len(self._answers) / WINDOW:.1f}',
            'latency_p50_ms': _percentile(totals, 50),
            'latency_p95_ms': _percentile(totals, 95),
            'latency_p99_ms': _percentile(totals, 99),
            **stages,
            'frames_received': str(self.received),
            'frames_answered': str(self.answered),
            'frames_refused': str(self.refused.total()),
            **{f'refused_{kind.replace(" ", "_")}': str(n) for kind, n in self.refused.items()},
            'last_refusal': self.last_reason,
        }

    def _forget_old(self) -> None:
        oldest = time.monotonic() - WINDOW
        for times in (self._arrivals, self._refusals):
            while times and times[0] < oldest:
                times.popleft()
        while self._answers and self._answers[0][0] < oldest:
            self._answers.popleft()


def _milliseconds(times: Sequence[FrameTimes], stage: str) -> list[float]:
    return [getattr(each, stage) * 1e3 for each in times]


def _percentile(values: list[float], percent: int) -> str:
    return f'{np.percentile(values, percent):.2f}' if values else 'nan'
