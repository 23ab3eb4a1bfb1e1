"""Runway lines found against the true ones."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

DISTANCE_LIMIT = 5.0
"""px; a line that passes farther off is another one."""
THETA_LIMIT = math.radians(3.0)


class Line(NamedTuple):
    """x cos theta + y sin theta = rho (px, rad)."""

    rho: float
    theta: float

    def point_at(self, row: float) -> tuple[float, float]:
        """Where it crosses a row, px; not finite for a line along the rows."""
        cos = math.cos(self.theta)
        if abs(cos) < 1e-9:
            return math.inf, row
        return (self.rho - row * math.sin(self.theta)) / cos, row


class TrueLine(NamedTuple):
    """A true line, and the point of it at which distances are taken, px."""

    line: Line
    point: tuple[float, float]


class LineMatch(NamedTuple):
    """A line found with the true one that it is: indices, distance (px), difference (rad)."""

    found: int
    true: int
    distance: float
    dtheta: float


def match_lines(found: Sequence[Line], true: Sequence[TrueLine]) -> list[LineMatch]:
    """Pair lines that are close at the true line's point and in direction, the closest first.

    Args:
        found: by the detector; lines with NaN match nothing.
        true: the same.

    Returns:
        Pairs in which each line occurs once at most.
    """
    pairs = []
    for number, line in enumerate(found):
        for index, (truth, (x, y)) in enumerate(true):
            distance = x * math.cos(line.theta) + y * math.sin(line.theta) - line.rho
            # The same line may be written with theta turned by half a circle.
            dtheta = (line.theta - truth.theta + math.pi / 2) % math.pi - math.pi / 2
            if abs(distance) <= DISTANCE_LIMIT and abs(dtheta) <= THETA_LIMIT:
                pairs.append(LineMatch(number, index, distance, dtheta))
    matched: list[LineMatch] = []
    for pair in sorted(pairs, key=lambda p: abs(p.distance)):
        if all(pair.found != m.found and pair.true != m.true for m in matched):
            matched.append(pair)
    return matched
