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
    """One row's statistics; means and deviations are of the corrected values of found lines.

    Attributes:
        found: frames in which the row had a line.
        rho_flags: frames with the rho flag.
        theta_flags: frames with the theta flag.
        corrected: frames with either.
        rho_mean: px.
        rho_std: px.
        theta_mean: rad, in (-pi/2, pi/2].
        theta_std: rad.
    """

    found: int
    rho_flags: int
    theta_flags: int
    corrected: int
    rho_mean: float
    rho_std: float
    theta_mean: float
    theta_std: float


@dataclass(frozen=True)
class RunwaySummary:
    """The result section of the thesis's GUI.

    Attributes:
        frames: since the last reset.
        lines: one row each.
        rho_flags: frames in which any row had the rho flag, as the GUI counts ("54 / 150").
        theta_flags: frames in which any row had the theta flag.
        corrected: frames in which any row had either.
    """

    frames: int
    lines: tuple[LineSummary, ...]
    rho_flags: int = 0
    theta_flags: int = 0
    corrected: int = 0

    @property
    def flag_text(self) -> str:
        """The counts as the GUI shows them."""
        counts = {'rho': self.rho_flags, 'theta': self.theta_flags, 'combined': self.corrected}
        return ', '.join(f'{name} {count} / {self.frames}' for name, count in counts.items())


class _LineStatistics:
    def __init__(self) -> None:
        self._rho_flags = self._theta_flags = self._corrected = 0
        self._rho = RunningMoments()
        self._theta = RunningMoments()

    def add(self, line: RunwayLine) -> None:
        if not line.found:
            return
        self._rho_flags += line.rho_flag
        self._theta_flags += line.theta_flag
        self._corrected += line.corrected
        sample = NormalForm(line.rho, line.theta)
        if self._theta.count:
            # A line that turns through vertical must not average to its perpendicular: of its two
            # forms take the one that faces the mean so far.
            sample = sample.facing(self._theta.mean)
        self._rho.add(sample.rho)
        self._theta.add(sample.theta)

    def summary(self) -> LineSummary:
        mean = NormalForm(self._rho.mean, self._theta.mean)
        if self._theta.count:
            mean = mean.normalised()
        return LineSummary(
            found=self._theta.count,
            rho_flags=self._rho_flags,
            theta_flags=self._theta_flags,
            corrected=self._corrected,
            rho_mean=mean.rho,
            rho_std=self._rho.std,
            theta_mean=mean.theta,
            theta_std=self._theta.std,
        )


class RunwayStatistics:
    """Collects what the detector found, frame by frame."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Begin at zero."""
        self._frames = self._rho_flags = self._theta_flags = self._corrected = 0
        self._lines: list[_LineStatistics] = []

    def add(self, lines: Sequence[RunwayLine]) -> None:
        """Take in one frame; rows beyond ``lines`` are dropped, new ones begin at zero."""
        self._frames += 1
        found = [line for line in lines if line.found]
        self._rho_flags += any(line.rho_flag for line in found)
        self._theta_flags += any(line.theta_flag for line in found)
        self._corrected += any(line.corrected for line in found)
        del self._lines[len(lines) :]
        while len(self._lines) < len(lines):
            self._lines.append(_LineStatistics())
        for statistics, line in zip(self._lines, lines, strict=True):
            statistics.add(line)

    def summary(self) -> RunwaySummary:
        """The statistics so far."""
        return RunwaySummary(
            self._frames,
            tuple(line.summary() for line in self._lines),
            self._rho_flags,
            self._theta_flags,
            self._corrected,
        )
