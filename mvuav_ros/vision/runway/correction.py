"""Rho/theta correction (thesis section 4.3.2.4): lines that jump keep their old values.

Which measured line is compared with which known one is decided by their order, or by distance.
"""

from __future__ import annotations

import importlib
import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations
from typing import NamedTuple

from mvuav_ros.parameters.runway_detector import RunwayDetectorParameters
from mvuav_ros.vision.runway.normal_form import NormalForm

# A pair beyond the limits costs more than any pair within them, so that one wild measurement
# cannot pull the good ones apart.
_BEYOND_LIMITS = 2.0
_ROUNDING = 1e-9
"""px and rad by which a change of whole Hough cells may seem more than it is: one of exactly a
limit is within it, whichever way its angles were rounded."""
_MAX_TRIED = 4
"""Lines of which every assignment is tried: importing SciPy takes longer than all of the rest."""


def by_distance(
    known: Sequence[NormalForm | None],
    measured: Sequence[NormalForm],
    rho_limit: float,
    theta_limit: float,
) -> list[int | None]:
    """Assign measured lines to known ones with the least change of rho and theta altogether.

    Measured lines that are left over go to the free rows (None), in their order. The limits (px,
    rad, above 0) are the changes up to which two lines may be the same.

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
    if max(rho, theta) <= 1 + _ROUNDING:
        return distance
    return _BEYOND_LIMITS + distance / (1 + distance)


def _cheapest(costs: Sequence[Sequence[float]]) -> list[tuple[int, int]]:
    """Pairs of row and column, each used once, as many as there can be, of the least sum."""
    rows, columns = len(costs), len(costs[0])
    if max(rows, columns) > _MAX_TRIED:
        from scipy.optimize import linear_sum_assignment

        return [(int(r), int(c)) for r, c in zip(*linear_sum_assignment(costs), strict=True)]
    if rows > columns:
        swapped = list(zip(*costs, strict=True))
        return sorted((row, column) for column, row in _cheapest(swapped))
    ways = permutations(range(columns), rows)
    best = min(ways, key=lambda way: sum([costs[row][column] for row, column in enumerate(way)]))
    return list(enumerate(best))


def jumps(
    line: NormalForm, last: NormalForm, parameters: RunwayDetectorParameters
) -> tuple[bool, bool]:
    """Whether rho and theta have changed by more than their thresholds."""
    new = line.facing(last.theta)
    theta_limit = math.radians(parameters.theta_error_threshold_deg)
    return (
        abs(new.rho - last.rho) > parameters.rho_error_threshold + _ROUNDING,
        abs(new.theta - last.theta) > theta_limit + _ROUNDING,
    )


class CorrectedLine(NamedTuple):
    """One row after correction; None where nothing was measured for it."""

    measured: int | None = None  # index of the measured line that the row was compared with
    line: NormalForm | None = None  # the measured line, or the old one where a flag is raised
    rho_flag: bool = False
    theta_flag: bool = False


@dataclass
class _KnownLine:
    """What a row remembers."""

    line: NormalForm  # the last corrected one
    measurements: int = 1  # up to the end of the warm-up
    held: int = 0  # frames in a row in which the line was flagged or not measured


class RhoThetaCorrection:
    """Compares the lines of each frame with the last corrected ones, row by row.

    A row's first measurements (``correction_warmup``) are believed. After that, a change of
    rho or theta beyond its limit raises that flag, and the row keeps both old values, with which
    the next frame is compared. The comparison knows that (rho, theta) and (-rho, theta + pi) are
    the same line.

    A frame in which the row has no measurement raises no flag and gives no line (absence is said,
    not filled in), but the old values are kept for the next frame. A row is held for at most
    ``max_hold`` frames in succession, flagged or without measurement. At the next such frame it is
    given up: the measurement is believed as that of a new line, with a warm-up of its own.
    """

    def __init__(self, parameters: RunwayDetectorParameters) -> None:
        self._known: list[_KnownLine | None] = []
        self.configure(parameters)

    def configure(self, parameters: RunwayDetectorParameters) -> None:
        """Use other parameters; rows that remain keep what they know."""
        self._parameters, rows = parameters, parameters.num_peaks
        self._known = self._known[:rows] + [None] * (rows - len(self._known))
        if rows > _MAX_TRIED:
            # Not in the second frame of a flight: on a busy machine it takes seconds.
            importlib.import_module('scipy.optimize')

    def reset(self) -> None:
        """Forget all lines."""
        self._known = [None] * len(self._known)

    def correct(self, measured: Sequence[NormalForm]) -> list[CorrectedLine]:
        """``num_peaks`` rows of the next frame, by lines measured, strongest first."""
        return [
            self._correct(row, index, None if index is None else measured[index])
            for row, index in enumerate(self._associate(measured))
        ]

    def _associate(self, measured: Sequence[NormalForm]) -> list[int | None]:
        parameters = self._parameters
        if parameters.association == 'index':
            # By the order of the peaks, as the thesis does.
            return [row if row < len(measured) else None for row in range(len(self._known))]
        # With limits of zero, a cell of the Hough transform is still the same line.
        theta = max(parameters.theta_error_threshold_deg, parameters.theta_resolution_deg)
        return by_distance(
            [None if known is None else known.line for known in self._known],
            measured,
            max(parameters.rho_error_threshold, parameters.rho_resolution),
            math.radians(theta),
        )

    def _correct(self, row: int, index: int | None, line: NormalForm | None) -> CorrectedLine:
        known, rho_flag, theta_flag = self._known[row], False, False
        if known is not None and line is not None:
            if known.measurements < self._parameters.correction_warmup:
                known.measurements += 1
            else:
                rho_flag, theta_flag = jumps(line, known.line, self._parameters)
        is_held = line is None or rho_flag or theta_flag
        if known is None or (is_held and 0 < self._parameters.max_hold <= known.held):
            self._known[row] = None if line is None else _KnownLine(line)
            return CorrectedLine(index, line)
        if line is None or is_held:
            known.held += 1
        else:
            known.line, known.held = line, 0
        return CorrectedLine(index, None if line is None else known.line, rho_flag, theta_flag)
