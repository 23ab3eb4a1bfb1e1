"""Times of single frames and of their stages."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TypeVar, TypeVarTuple

ResultT = TypeVar('ResultT')
Given = TypeVarTuple('Given')


class Stopwatch:
    """Times stages of a frame; several passes over the same frames, of which the least counts.

    On a machine with other work the least time is the one that says how long the code takes.
    """

    def __init__(self) -> None:
        self._times: dict[str, dict[int, float]] = {}

    def time(
        self, stage: str, frame: int, work: Callable[[*Given], ResultT], *given: *Given
    ) -> ResultT:
        """Call the work with what is given and note how long it took."""
        start = time.perf_counter()
        result = work(*given)
        self.note(stage, frame, time.perf_counter() - start)
        return result

    def note(self, stage: str, frame: int, elapsed: float) -> None:
        """Take in a time (s) that was measured elsewhere."""
        times = self._times.setdefault(stage, {})
        times[frame] = min(elapsed, times.get(frame, elapsed))

    @property
    def stages(self) -> list[str]:
        """In order of first use."""
        return list(self._times)

    def frames(self, stage: str) -> int:
        """Frames in which the stage ran."""
        return len(self._times[stage])

    def total_s(self, stage: str) -> float:
        """Sum over the frames, s."""
        return sum(self._times[stage].values())
