"""Paths of five rigid markers on the image: many kinds of motion, at no cost of drawing."""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.simulation.shake import VIBRATIONS

Array = NDArray[np.float64]
Rng = np.random.Generator
Motion = Callable[[Rng, int, float], tuple[Array, Array, Array]]
"""From a generator, a number of frames and frames/s: x, y (px) and roll times `RADIUS` (px)."""

RADIUS = 300.0
"""px: a turn moves the outer markers by half of this times the angle."""
_PLACES = np.array([(-150.0, 0.0), (-60.0, -20.0), (0.0, -60.0), (60.0, -20.0), (150.0, 0.0)])
_CENTRE = (320.0, 240.0)
_REFERENCE_FPS = 15.0


def marker_path(kind: str, fps: float, frames: int, seed: int, noise: float) -> tuple[Array, Array]:
    """Measured places of five markers that move as one of `MOTIONS`.

    The noise is of a place, px per axis (1 sigma).

    Returns:
        Times (frames,), s, and places (frames, 5, 2), px.
    """
    rng = np.random.default_rng((seed, zlib.crc32(kind.encode()), round(fps)))
    x, y, turn = MOTIONS[kind](rng, frames, fps)
    angle = turn / RADIUS
    cos, sin = np.cos(angle)[:, None], np.sin(angle)[:, None]
    right, down = _PLACES.T
    places = np.stack((right * cos - down * sin, right * sin + down * cos), axis=-1)
    places += np.stack((x, y), axis=-1)[:, None] + _CENTRE
    return np.arange(frames) / fps, places + rng.normal(0.0, noise, places.shape)


def _three(path: Callable[[], Array]) -> tuple[Array, Array, Array]:
    return path(), path(), path()


def _pushed(accelerations: Array, fps: float) -> Array:
    """A place that accelerations (px per frame²) push about, drawn softly to the middle."""
    rate = _REFERENCE_FPS / fps
    place = velocity = 0.0
    path = []
    for acceleration in accelerations.tolist():
        velocity += acceleration - 0.003 * rate * rate * place - 0.05 * rate * velocity
        place += velocity
        path.append(place)
    return np.array(path)


def _erratic(
    rng: Rng, frames: int, fps: float, strength: float, lasting: float = 0.0
) -> tuple[Array, Array, Array]:
    """Random accelerations, px per frame² at 15 frames/s, independent or lasting (s)."""
    scale = strength * (_REFERENCE_FPS / fps) ** 2
    keep = math.exp(-1.0 / (lasting * fps)) if lasting else 0.0

    def path() -> Array:
        pushes = rng.normal(size=frames)
        for index in range(1, frames):
            pushes[index] = keep * pushes[index - 1] + math.sqrt(1 - keep**2) * pushes[index]
        return _pushed(scale * pushes, fps)

    return _three(path)


def _waves(time: Array, terms: Sequence[tuple[float, float]], phases: Array) -> Array:
    """A sum of sines of (amplitude, Hz)."""
    pairs = zip(terms, phases, strict=True)
    waves = [a * np.sin(2 * math.pi * f * time + p) for (a, f), p in pairs]
    return np.asarray(np.sum(waves, axis=0))


def _smooth(rng: Rng, frames: int, fps: float) -> tuple[Array, Array, Array]:
    time = np.arange(frames) / fps

    def wave(*terms: tuple[float, float]) -> Array:
        return _waves(time, terms, rng.uniform(0.0, 2 * math.pi, len(terms)))

    x, y = wave((70.0, 0.09), (25.0, 0.2)), wave((45.0, 0.13), (20.0, 0.23))
    return x, y, RADIUS * wave((0.1, 0.13), (0.05, 0.31))


def _jitter(rng: Rng, frames: int, fps: float, size: float) -> tuple[Array, Array, Array]:
    x, y, turn = _smooth(rng, frames, fps)
    jitter = size * rng.normal(size=(3, frames))
    return x + jitter[0], y + jitter[1], turn + jitter[2]


def _shaken(rng: Rng, frames: int, fps: float, number: int) -> tuple[Array, Array, Array]:
    """Smooth motion before a camera that one of the thesis's vibrations shakes by 1.5 px.

    The camera sees their frequencies folded below half of its rate.
    """
    time = np.arange(frames) / fps
    vibration = VIBRATIONS[number]
    harmonics = [(0.75 / k, f) for k, f in enumerate(vibration.harmonics_hz, 1)]
    terms = [(1.5, vibration.primary_hz), *harmonics]

    def path() -> Array:
        phases = rng.uniform(0.0, 2 * math.pi, len(terms) + 1)
        swell = 1.0 + 0.3 * np.sin(2 * math.pi * 0.3 * time + phases[0])
        return np.asarray(swell * _waves(time, terms, phases[1:]))

    x, y, turn = _smooth(rng, frames, fps)
    return x + path(), y + path(), turn + path()


def _in_turn(rng: Rng, frames: int, fps: float) -> tuple[Array, Array, Array]:
    """Calm and erratic quarters of the flight."""
    strength = np.where(np.arange(frames) // max(1, frames // 4) % 2, 1.9, 0.03)
    strength *= (_REFERENCE_FPS / fps) ** 2
    return _three(lambda: _pushed(strength * rng.normal(size=frames), fps))


MOTIONS: dict[str, Motion] = {
    'smooth': _smooth,
    'erratic 1.9': partial(_erratic, strength=1.9),
    'erratic 0.6': partial(_erratic, strength=0.6),
    'erratic 0.15': partial(_erratic, strength=0.15),
    'erratic 1.9, lasting 0.15 s': partial(_erratic, strength=1.9, lasting=0.15),
    'erratic 1.9, lasting 0.5 s': partial(_erratic, strength=1.9, lasting=0.5),
    'smooth and jitter 0.2 px': partial(_jitter, size=0.2),
    'smooth and jitter 0.6 px': partial(_jitter, size=0.6),
    **{f'smooth and vibration {n}': partial(_shaken, number=n) for n in (1, 2, 3)},
    'calm and erratic in turn': _in_turn,
}
"""By what a person would call them; the figures are px per frame² at 15 frames/s, or px."""
