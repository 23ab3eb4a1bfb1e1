"""Reflections that look like markers and drift slowly."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.simulation.camera import PinholeCamera

DRIFT = 6.0
"""Greatest way from the middle, px."""
CLEAR = 45.0
"""Distance that is kept from every marker's path and other glares where there is room, px."""
_TRIES = 60


class Glares:
    """A number of reflections, each at a place of its own clear of the markers' paths."""

    def __init__(
        self,
        count: int,
        camera: PinholeCamera,
        paths: NDArray[np.float64],
        rng: np.random.Generator,
    ) -> None:
        taken = paths[np.isfinite(paths).all(axis=1)]
        chosen: list[NDArray[np.float64]] = []
        low, high = np.array((20.0, 20.0)), np.array((camera.width, camera.height)) - 20.0
        for _ in range(count):
            best, best_room = low, -1.0
            for place in rng.uniform(low, high, (_TRIES, 2)):
                room = float(np.hypot(*(taken - place).T).min()) if len(taken) else math.inf
                if room > best_room:
                    best, best_room = place, room
                if room >= CLEAR:
                    break
            chosen.append(best)
            taken = np.vstack((taken, best))
        self._middles = np.array(chosen).reshape(-1, 2)
        self._phases = rng.uniform(0.0, 2 * math.pi, (count, 2))

    def places(self, time: float) -> NDArray[np.float64]:
        """(n, 2), px, at a time (s)."""
        turn = 2 * math.pi * time / np.array((7.0, 9.0))
        return np.asarray(self._middles + DRIFT * np.sin(turn + self._phases), np.float64)
