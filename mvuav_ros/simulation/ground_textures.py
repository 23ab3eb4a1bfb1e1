"""The textures of the ground plane, drawn once and shared by flights."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.simulation import terrain
from mvuav_ros.simulation.ripmap import Ripmap
from mvuav_ros.simulation.runway_surface import Surface
from mvuav_ros.simulation.texture import tileable_noise, to_bytes
from mvuav_ros.vision.frames import read_only

_GRAIN_STEP, _GRAIN_SIZE = 0.25, 512


class Ground(NamedTuple):
    """Textures of the ground."""

    land: Ripmap
    runway: Ripmap
    grain: Ripmap | None
    corners: NDArray[np.float64]
    """(4, 3), m: the rectangle that the runway's texture covers."""


@lru_cache(maxsize=2)
def load_ground(width: float, length: float, detail: float, seed: int) -> Ground:
    """Draw the textures (half a second), or take them from the last flights."""
    land = terrain.draw_terrain(length, detail, seed)
    surface = Surface(land, width, length, detail, seed)
    grain = None
    if detail > 0.0:
        rng = np.random.default_rng((seed, 1003))
        noise = tileable_noise(_GRAIN_SIZE, 14.0, rng)
        grass = to_bytes(128.0 * (1.0 + 0.08 * detail * noise))
        step = (_GRAIN_STEP, _GRAIN_STEP)
        grain = Ripmap(cv2.merge([grass] * 3), (0.0, 0.0), step, wrap=True)
    x0, y0 = surface.origin
    x1, y1 = x0 + surface.size[0], y0 + surface.size[1]
    return Ground(
        Ripmap(land, terrain.ORIGIN, (terrain.STEP, terrain.STEP), wrap=True),
        Ripmap(surface.texture, surface.origin, surface.step, wrap=False),
        grain,
        read_only(np.array([(x0, y0, 0.0), (x1, y0, 0.0), (x1, y1, 0.0), (x0, y1, 0.0)])),
    )
