"""Confidence intervals over flights, and spectra."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy import special

from mvuav_ros.offline.evaluation.metrics import Array


class Interval(NamedTuple):
    """A value with the ends of its 95 % confidence interval; NaN ends where it has none."""

    value: float
    low: float
    high: float

    def text(self, digits: int) -> str:
        """As a cell of a table: value and interval, each with so many digits after the point."""
        value = f'{self.value:.{digits}f}'
        if math.isnan(self.low):
            return value
        return f'{value} [{self.low:.{digits}f}, {self.high:.{digits}f}]'


def pooled_rms(repeats: Sequence[Array]) -> Interval:
    """RMS over all repeats, with the interval that their scatter allows.

    Measurements of one flight hang together (they share its vibration's phases), so that only
    whole flights are taken as independent: the interval is Student's t of their mean squares.
    NaN does not count.
    """
    squares = np.array([float(np.nanmean(r**2)) for r in repeats if np.isfinite(r).any()])
    if squares.size == 0:
        return Interval(math.nan, math.nan, math.nan)
    mean = float(squares.mean())
    if squares.size == 1:
        return Interval(math.sqrt(mean), math.nan, math.nan)
    error = float(squares.std(ddof=1)) / math.sqrt(squares.size)
    reach = float(special.stdtrit(squares.size - 1, 0.975)) * error
    return Interval(
        math.sqrt(mean), math.sqrt(max(mean - reach, 0.0)), math.sqrt(max(mean + reach, 0.0))
    )


class Spectrum(NamedTuple):
    """Power spectral density: frequencies (Hz) and density (unit² per Hz)."""

    frequency: Array
    density: Array

    def peaks(self, most: int, least_share: float = 0.002) -> list[float]:
        """The frequencies (Hz) of the strongest maxima in rising order.

        Below ``least_share`` of the strongest one's density a maximum is noise.
        """
        inner = self.density[1:-1]
        top = (inner >= self.density[:-2]) & (inner > self.density[2:])
        top &= inner > least_share * float(self.density.max(initial=0.0))
        places = np.flatnonzero(top) + 1
        strongest = places[np.argsort(self.density[places])[::-1][:most]]
        return sorted(float(self.frequency[place]) for place in strongest)

    def amplitude(self, frequency: float, reach: float) -> float:
        """Amplitude of the sine at a frequency: from the power within ``reach`` (Hz) of it."""
        near = np.abs(self.frequency - frequency) <= reach
        step = float(self.frequency[1] - self.frequency[0])
        return math.sqrt(2.0 * float(self.density[near].sum()) * step)


def spectrum(values: Array, rate: float, seconds: float = 10.0) -> Spectrum:
    """Welch's power spectral density of a signal (n,) without NaN, as deviation from its mean.

    The rate is samples per second; the length of a segment (s) is the inverse of the resolution.
    """
    from scipy import signal

    length = min(len(values), round(seconds * rate))
    frequency, density = signal.welch(values, rate, nperseg=length, detrend='constant')
    return Spectrum(np.asarray(frequency), np.asarray(density))
