"""A straight line in Hesse's normal form, x cos(theta) + y sin(theta) = rho.

Coordinates are pixels with (0, 0) at the centre of the top-left one, x right, y down; theta is in
radians. (rho, theta) and (-rho, theta + pi) are the same line.
"""

from __future__ import annotations

import math
from typing import NamedTuple

Ends = tuple[float, float, float, float]

NO_ENDS: Ends = (math.nan, math.nan, math.nan, math.nan)
_PARALLEL = 1e-12
_ROUNDING = 1e-9


class NormalForm(NamedTuple):
    """rho (px) and theta (rad) of a line."""

    rho: float
    theta: float

    def normalised(self) -> NormalForm:
        """The same line with theta in (-pi/2, pi/2]."""
        turns = math.ceil(self.theta / math.pi - 0.5)
        if turns == 0:
            return self
        theta = self.theta - turns * math.pi
        # Rounding may leave theta at the excluded end of the interval.
        if theta <= -math.pi / 2:
            turns, theta = turns - 1, theta + math.pi
        return NormalForm(-self.rho if turns % 2 else self.rho, theta)

    def facing(self, theta: float) -> NormalForm:
        """The same line with its own theta at most pi/2 away from ``theta``."""
        turns = round((self.theta - theta) / math.pi)
        if turns == 0:
            return self
        return NormalForm(-self.rho if turns % 2 else self.rho, self.theta - turns * math.pi)

    def moved_down(self, rows: float) -> NormalForm:
        """The line of the whole frame, from a line of a slice that starts ``rows`` rows below."""
        return NormalForm(self.rho + rows * math.sin(self.theta), self.theta)


def segment_ends(line: NormalForm, width: int, height: int) -> Ends:
    """Cut a line to a frame of so many px (the thesis's Hough Lines Calculator).

    Returns:
        x, y, x2, y2 on the rectangle of the outermost pixels' centres, the upper end first (the
        left one where the line is horizontal); NaN where the line misses the frame.
    """
    cos, sin = math.cos(line.theta), math.sin(line.theta)
    if not (width > 0 and height > 0 and math.isfinite(line.rho) and math.isfinite(cos)):
        return NO_ENDS
    foot_x, foot_y = line.rho * cos, line.rho * sin
    first, last = -math.inf, math.inf
    for foot, step, limit in ((foot_x, -sin, width - 1.0), (foot_y, cos, height - 1.0)):
        if abs(step) < _PARALLEL:
            if not -_ROUNDING <= foot <= limit + _ROUNDING:
                return NO_ENDS
            continue
        enters, leaves = sorted((-foot / step, (limit - foot) / step))
        first, last = max(first, enters), min(last, leaves)
    if first > last + _ROUNDING:
        return NO_ENDS
    (x, y), (x2, y2) = (
        (
            min(max(foot_x - t * sin, 0.0), width - 1.0),
            min(max(foot_y + t * cos, 0.0), height - 1.0),
        )
        for t in (first, last)
    )
    # cos(90°) is not quite 0: which end of a horizontal line is the upper one must not be noise.
    wrong_way = x > x2 if abs(y - y2) < _ROUNDING else y > y2
    return (x2, y2, x, y) if wrong_way else (x, y, x2, y2)


def clip_segment(
    x1: float, y1: float, x2: float, y2: float, right: float, bottom: float
) -> Ends | None:
    """The part of a segment with 0 <= x <= right and 0 <= y <= bottom (Liang-Barsky)."""
    enter, leave = 0.0, 1.0
    for start, step, limit in ((x1, x2 - x1, right), (y1, y2 - y1, bottom)):
        if step == 0.0:
            if not 0.0 <= start <= limit:
                return None
            continue
        first, last = sorted((-start / step, (limit - start) / step))
        enter, leave = max(enter, first), min(leave, last)
    if not enter <= leave:
        return None
    dx, dy = x2 - x1, y2 - y1
    return x1 + enter * dx, y1 + enter * dy, x1 + leave * dx, y1 + leave * dy
