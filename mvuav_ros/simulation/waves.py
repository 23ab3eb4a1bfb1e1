"""Smooth functions of time: sums of sines whose phases come from a seed."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable

import numpy as np

Wave = Callable[[float], float]
"""A value by the time (s)."""


def random_wave(rng: np.random.Generator, terms: Iterable[tuple[float, float]]) -> Wave:
    """A sum of sines, whose unit is their amplitudes': (amplitude, Hz) with random phases."""
    sines = [(a, f, float(rng.uniform(0.0, 2 * math.pi))) for a, f in terms]
    return lambda time: sum(a * math.sin(2 * math.pi * f * time + p) for a, f, p in sines)
