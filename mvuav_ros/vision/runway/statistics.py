"""Counts, means and deviations over frames: the result section of the thesis's GUI."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from mvuav_ros.vision.runway.normal_form import NormalForm
from mvuav_ros.vision.runway.results import RunwayLine


class RunningMoments:
    """Mean and sample standard deviation of a stream of numbers (Welford's method)."""

    def __init__(self) -> None:
        self.count = 0
        self._mean = 0.0
        self._squares = 0.0

    def add(self, value: float) -> None:
        """Take in one number."""
        self.count += 1
        change = value - self._mean
        self._mean += change / self.count
        self._squares += change * (value - self._mean)

    @property
    def mean(self) -> float:
        """NaN before the first number."""
        return self._mean if self.count else math.nan

    @property
    def std(self) -> float:
        """With n - 1 in the denominator, as MATLAB's ``std``; NaN before the second number."""
        return math.sqrt(self._squares / (self.count - 1)) if self.count > 1 else math.nan


@dataclass(frozen=True)
class LineSummary:
    """One row's statistics; means and deviations are of the corrected values of found lines."""

    found: int  # frames in which the row had a line
    rho_flags: int  # frames with the rho flag
    theta_flags: int
    corrected: int  # frames with either
    rho_mean: float  # px
    rho_std: float
    theta_mean: float  # rad, in (-pi/2, pi/2]
    theta_std: float


@dataclass(frozen=True)
class RunwaySummary:
    """The result section of the thesis's GUI, which counts frames ("54 / 150")."""

    frames: int  # since the last reset
    lines: tuple[LineSummary, ...]  # one row each
    rho_flags: int = 0  # frames in which any row had the rho flag
    theta_flags: int = 0
    corrected: int = 0  # frames in which any row had either

    @property
    def flag_text(self) -> str:
        """The counts as the GUI shows them."""
        counts = {'rho': self.rho_flags, 'theta': self.theta_flags, 'combined': self.corrected}
        return ', '.join(f'{name} {count} / {self.frames}' for name, count in counts.items())


class _FlagCounts:
    """Frames in which any of some lines had the rho flag, the theta flag, or either."""

    def __init__(self) -> None:
        self.counts = (0, 0, 0)

    def add(self, lines: Sequence[RunwayLine]) -> None:
        rho, theta, either = self.counts
        has_rho = any(line.rho_flag for line in lines)
        has_theta = any(line.theta_flag for line in lines)
        self.counts = rho + has_rho, theta + has_theta, either + (has_rho or has_theta)


class _LineStatistics:
    def __init__(self) -> None:
        self._flags = _FlagCounts()
        self._rho, self._theta = RunningMoments(), RunningMoments()

    def add(self, line: RunwayLine) -> None:
        if not line.found:
            return
        self._flags.add([line])
        sample = NormalForm(line.rho, line.theta)
        if self._theta.count:
            # A line that turns through vertical must not average to its perpendicular: of its two
            # forms take the one that faces the mean so far.
            sample = sample.facing(self._theta.mean)
        self._rho.add(sample.rho)
        self._theta.add(sample.theta)

    def summary(self) -> LineSummary:
        mean = NormalForm(self._rho.mean, self._theta.mean)
        found = self._theta.count
        rho, theta = mean.normalised() if found else mean
        return LineSummary(found, *self._flags.counts, rho, self._rho.std, theta, self._theta.std)


class RunwayStatistics:
    """Collects what the detector found, frame by frame."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Begin at zero."""
        self._frames, self._flags = 0, _FlagCounts()
        self._lines: list[_LineStatistics] = []

    def add(self, lines: Sequence[RunwayLine]) -> None:
        """Take in one frame; rows beyond ``lines`` are dropped, new ones begin at zero."""
        self._frames += 1
        self._flags.add([line for line in lines if line.found])
        new = len(lines) - len(self._lines)
        self._lines = self._lines[: len(lines)] + [_LineStatistics() for _ in range(new)]
        for statistics, line in zip(self._lines, lines, strict=True):
            statistics.add(line)

    def summary(self) -> RunwaySummary:
        """The statistics so far."""
        lines = tuple(line.summary() for line in self._lines)
        return RunwaySummary(self._frames, lines, *self._flags.counts)
