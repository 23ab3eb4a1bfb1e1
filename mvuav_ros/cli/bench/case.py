"""One measurement: two callables in turn, so that a machine that slows down slows both."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from operator import truediv
from typing import NamedTuple

Action = Callable[[], object]


@dataclass(frozen=True)
class Case:
    """Something to measure, and what to hold it against; a run is usually one frame.

    The median time may be ``limit_ratio`` times the baseline's, and ``limit_ms``. A note is a
    figure from elsewhere, such as the thesis's own.
    """

    name: str
    run: Action
    baseline_name: str = ''
    baseline: Action | None = None
    limit_ratio: float | None = None
    limit_ms: float | None = None
    note: str = ''


class Measurement(NamedTuple):
    """Medians in ms; ``ratio`` is the median of the ratios pair by pair."""

    case: Case
    median_ms: float
    baseline_ms: float | None
    ratio: float | None

    @property
    def within_limits(self) -> bool:
        """Whether every limit of the case is kept."""
        limit_ratio, limit_ms = self.case.limit_ratio, self.case.limit_ms
        if limit_ratio is not None and (self.ratio is None or self.ratio > limit_ratio):
            return False
        return limit_ms is None or self.median_ms <= limit_ms

    def figures(self) -> dict[str, object]:
        """For a JSON file."""
        return {
            'case': self.case.name,
            'median_ms': self.median_ms,
            'baseline': self.case.baseline_name,
            'baseline_ms': self.baseline_ms,
            'ratio': self.ratio,
            'limit_ratio': self.case.limit_ratio,
            'limit_ms': self.case.limit_ms,
            'within_limits': self.within_limits,
        }


def measure(case: Case, seconds: float = 1.0, max_pairs: int = 3000) -> Measurement:
    """Run a case and its baseline in turn for about ``seconds``, at least five times."""
    for _ in range(3):
        case.run()
        if case.baseline is not None:
            case.baseline()
    end = time.perf_counter() + seconds
    times: list[float] = []
    baselines: list[float] = []
    while len(times) < 5 or (time.perf_counter() < end and len(times) < max_pairs):
        times.append(_time(case.run))
        if case.baseline is not None:
            baselines.append(_time(case.baseline))
    median_ms = statistics.median(times) * 1e3
    if not baselines:
        return Measurement(case, median_ms, None, None)
    ratio = statistics.median(map(truediv, times, baselines))
    return Measurement(case, median_ms, statistics.median(baselines) * 1e3, ratio)


def _time(action: Action) -> float:
    start = time.perf_counter()
    action()
    return time.perf_counter() - start
