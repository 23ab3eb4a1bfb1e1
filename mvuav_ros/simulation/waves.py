"""Smooth functions of time: sums of sines whose phases come from a seed."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np


class Sine(NamedTuple):
    """One term: amplitude, frequency (Hz), phase at time 0 (rad)."""

    amplitude: float
    frequency: float
    phase: float


class Wave(NamedTuple):
    """A sum of sines; its unit is its amplitudes'."""

    terms: tuple[Sine, ...]

    def at(self, time: float) -> float:
        """The value at a time (s)."""
        return sum(a * math.sin(2 * math.pi * f * time + p) for a, f, p in self.terms)


def random_wave(rng: np.random.Generator, terms: Iterable[tuple[float, float]]) -> Wave:
    """Give (amplitude, Hz) pairs phases of their own."""
    return Wave(tuple(Sine(a, f, float(rng.uniform(0.0, 2 * math.pi))) for a, f in terms))
