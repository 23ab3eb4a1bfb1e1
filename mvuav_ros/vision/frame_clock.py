"""The times of a detector's frames."""

from __future__ import annotations

import operator

_SHORTEST_NS = 1000
"""From one frame to the next: no camera is that fast, but numbers of frames, s and ms are."""


class FrameClock:
    """Takes the stamps of frames, which do not go back."""

    def __init__(self) -> None:
        self.gap_ns: int | None = None  # from the frame before to the newest; None of the first
        self._span_ns: tuple[int, int] | None = None  # stamps of the first frame and the newest

    def take(self, stamp_ns: int) -> int:
        """The next frame's stamp, ns, as a plain whole number.

        Raises:
            TypeError: it is no whole number.
            ValueError: it is before the last one.
        """
        # A float would be seconds; unsigned ones of NumPy wrap around.
        stamp_ns = operator.index(stamp_ns)
        first_ns, last_ns = self._span_ns or (stamp_ns, stamp_ns)
        if stamp_ns < last_ns:
            raise ValueError(f'stamp {stamp_ns} ns is before {last_ns} ns: see reset')
        self.gap_ns = None if self._span_ns is None else stamp_ns - last_ns
        self._span_ns = first_ns, stamp_ns
        return stamp_ns

    @property
    def elapsed(self) -> float:
        """Seconds since the first frame: those since 1970 leave a float 0.2 µs of resolution."""
        first_ns, last_ns = self._span_ns or (0, 0)
        return (last_ns - first_ns) * 1e-9

    @property
    def remark(self) -> str:
        """That the newest stamp can hardly be in ns; empty where it may be."""
        if not 0 < (self.gap_ns or 0) < _SHORTEST_NS:
            return ''
        return f'{self.gap_ns} ns after the frame before: is the stamp in ns?'

    def remarked(self, status: str) -> str:
        """A frame's status with that remark behind it."""
        return '; '.join(filter(None, (status, self.remark)))
