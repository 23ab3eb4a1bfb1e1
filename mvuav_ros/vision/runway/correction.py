"""Rho/theta correction (thesis section 4.3.2.4): lines that jump keep their old values."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from mvuav_ros.parameters.runway_detector import RunwayDetectorParameters
from mvuav_ros.vision.runway.association import by_distance, by_index
from mvuav_ros.vision.runway.normal_form import NormalForm


def jumps(
    line: NormalForm, last: NormalForm, parameters: RunwayDetectorParameters
) -> tuple[bool, bool]:
    """Whether rho and theta have changed by more than their thresholds."""
    new = line.facing(last.theta)
    return (
        abs(new.rho - last.rho) > parameters.rho_error_threshold,
        abs(new.theta - last.theta) > math.radians(parameters.theta_error_threshold_deg),
    )


class CorrectedLine(NamedTuple):
    """One row after correction.

    ``measured`` is the index of the measured line that the row was compared with; ``line`` is the
    measured line, or the old one where a flag is raised. Both are None where nothing was measured
    for the row.
    """

    measured: int | None = None
    line: NormalForm | None = None
    rho_flag: bool = False
    theta_flag: bool = False


@dataclass
class _KnownLine:
    """What a row remembers: its last corrected line.

    ``measurements`` counts up to the end of the warm-up, ``held`` the frames in a row in which
    the line was flagged or not measured.
    """

    line: NormalForm
    measurements: int = 1
    held: int = 0


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

    def reset(self) -> None:
        """Forget all lines."""
        self._known = [None] * len(self._known)

    def correct(self, measured: Sequence[NormalForm]) -> list[CorrectedLine]:
        """Correct the lines of the next frame.

        Args:
            measured: strongest first, at most ``num_peaks``.

        Returns:
            ``num_peaks`` rows.
        """
        return [
            self._hold(row) if index is None else self._compare(row, index, measured[index])
            for row, index in enumerate(self._associate(measured))
        ]

    def _associate(self, measured: Sequence[NormalForm]) -> list[int | None]:
        parameters = self._parameters
        if parameters.association == 'index':
            return by_index(len(self._known), len(measured))
        # With limits of zero, a cell of the Hough transform is still the same line.
        theta = max(parameters.theta_error_threshold_deg, parameters.theta_resolution_deg)
        return by_distance(
            [None if known is None else known.line for known in self._known],
            measured,
            max(parameters.rho_error_threshold, parameters.rho_resolution),
            math.radians(theta),
        )

    def _compare(self, row: int, index: int, line: NormalForm) -> CorrectedLine:
        known = self._known[row]
        if known is None:
            return self._start(row, index, line)
        rho_flag, theta_flag = jumps(line, known.line, self._parameters)
        in_warmup = known.measurements < self._parameters.correction_warmup
        if in_warmup or not (rho_flag or theta_flag):
            known.line = line
            known.measurements += in_warmup
            known.held = 0
            return CorrectedLine(index, line)
        if self._is_given_up(known):
            return self._start(row, index, line)
        known.held += 1
        return CorrectedLine(index, known.line, rho_flag, theta_flag)

    def _hold(self, row: int) -> CorrectedLine:
        known = self._known[row]
        if known is not None:
            if self._is_given_up(known):
                self._known[row] = None
            known.held += 1
        return CorrectedLine()

    def _start(self, row: int, index: int, line: NormalForm) -> CorrectedLine:
        self._known[row] = _KnownLine(line)
        return CorrectedLine(index, line)

    def _is_given_up(self, known: _KnownLine) -> bool:
        return 0 < self._parameters.max_hold <= known.held
