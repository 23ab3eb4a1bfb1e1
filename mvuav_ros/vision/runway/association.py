"""Which measured line is compared with which known one."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import permutations

from mvuav_ros.vision.runway.normal_form import NormalForm

# A pair beyond the limits costs more than any pair within them, so that one wild measurement
# cannot pull the good ones apart.
_BEYOND_LIMITS = 2.0
_FEW = 4
"""Lines of which every assignment is tried: importing SciPy takes longer than all of the rest."""


def by_index(rows: int, measured: int) -> list[int | None]:
    """Compare by the order of the peaks, as the thesis does: row i with peak i.

    Returns:
        For each row the index of its measured line, or None.
    """
    return [row if row < measured else None for row in range(rows)]


def by_distance(
    known: Sequence[NormalForm | None],
    measured: Sequence[NormalForm],
    rho_limit: float,
    theta_limit: float,
) -> list[int | None]:
    """Assign measured lines to known ones with the least change of rho and theta altogether.

    Measured lines that are left over go to the free rows, in their order.

    Args:
        known: one line per row; None: the row is free.
        measured: at most as many lines as there are rows.
        rho_limit: px, above 0; change of rho up to which two lines may be the same.
        theta_limit: rad, above 0; change of theta up to which they may be.

    Returns:
        For each row the index of its measured line, or None.
    """
    assigned: list[int | None] = [None] * len(known)
    rows = [row for row, line in enumerate(known) if line is not None]
    left_over = list(range(len(measured)))
    if rows and measured:
        costs = [
            [_cost(line, candidate, rho_limit, theta_limit) for candidate in measured]
            for line in known
            if line is not None
        ]
        for row, column in _cheapest(costs):
            assigned[rows[row]] = column
            left_over.remove(column)
    free = (row for row, line in enumerate(known) if line is None)
    # More measured lines than free rows cannot be left over: zip ends with the shorter.
    for row, index in zip(free, left_over, strict=False):
        assigned[row] = index
    return assigned


def _cost(known: NormalForm, measured: NormalForm, rho_limit: float, theta_limit: float) -> float:
    """0 to 1 for a change within both limits, 2 to 3 beyond."""
    new = measured.facing(known.theta)
    rho = abs(new.rho - known.rho) / rho_limit
    theta = abs(new.theta - known.theta) / theta_limit
    distance = math.hypot(rho, theta) / math.sqrt(2)
    if rho <= 1 and theta <= 1:
        return distance
    return _BEYOND_LIMITS + distance / (1 + distance)


def _cheapest(costs: Sequence[Sequence[float]]) -> list[tuple[int, int]]:
    """Pairs of row and column, each used once, as many as there can be, of the least sum."""
    rows, columns = len(costs), len(costs[0])
    if max(rows, columns) > _FEW:
        from scipy.optimize import linear_sum_assignment

        return [(int(r), int(c)) for r, c in zip(*linear_sum_assignment(costs), strict=True)]
    if rows > columns:
        swapped = list(zip(*costs, strict=True))
        return sorted((row, column) for column, row in _cheapest(swapped))
    ways = permutations(range(columns), rows)
    best = min(ways, key=lambda way: sum([costs[row][column] for row, column in enumerate(way)]))
    return list(enumerate(best))
