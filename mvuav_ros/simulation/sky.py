"""A sky with clouds that flatten towards the horizon."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.simulation.texture import smooth_noise, smoothstep, to_bytes

ZENITH = np.array((168.0, 112.0, 62.0), np.float32)
HORIZON = np.array((222.0, 204.0, 184.0), np.float32)
CLOUD = np.array((246.0, 243.0, 240.0), np.float32)
CLOUD_BASE = np.array((205.0, 196.0, 188.0), np.float32)
_TILE = 1024


def draw_sky(
    size: tuple[int, int],
    horizon_row: float,
    focal: float,
    rng: np.random.Generator,
    *,
    brightness: float = 1.0,
    cloudiness: float = 1.0,
) -> NDArray[np.uint8]:
    """Draw the sky around the horizon.

    Args:
        size: width and height, px.
        horizon_row: of the image, px; below it the haze of the horizon goes on.
        focal: focal length, px, which says how high above the horizon a row is.
        rng: the source of randomness.
        brightness: factor of all colours.
        cloudiness: 0 is a clear sky.

    Returns:
        (height, width, 3) uint8, blue first.
    """
    width, height = size
    rows = np.arange(height, dtype=np.float32)[:, None]
    columns = np.arange(width, dtype=np.float32)[None, :] - 0.5 * width
    elevation = np.maximum((horizon_row - rows) / focal, 0.0)
    haze = np.exp(-elevation / 0.22)
    sky = ZENITH + haze[:, :, None] * (HORIZON - ZENITH)
    sky = np.repeat(sky, width, axis=1)
    if cloudiness > 0.0:
        # Clouds grow with their height above the horizon and are flatter than wide.
        near = elevation + 0.10
        map_x = (0.5 * _TILE + 240.0 * columns / focal / near).astype(np.float32)
        map_y = np.broadcast_to((-400.0 * np.log(near)).astype(np.float32), map_x.shape)
        layer = smooth_noise((_TILE, _TILE), 150.0, rng, octaves=6, gain=0.55)
        light = smooth_noise((_TILE, _TILE), 60.0, rng, octaves=4)
        seen, lit = (
            cv2.remap(
                tile,
                map_x,
                np.ascontiguousarray(map_y),
                cv2.INTER_LINEAR,
                borderMode=cv2.BORDER_REFLECT_101,
            )
            for tile in (layer, light)
        )
        cover = 0.85 * cloudiness * smoothstep(0.1, 1.5, seen) * (1.0 - 0.75 * haze)
        shade = np.clip(0.62 + 0.22 * lit + 0.16 * seen, 0.0, 1.0)[:, :, None]
        cloud = CLOUD_BASE + shade * (CLOUD - CLOUD_BASE)
        cloud -= sky
        cloud *= cover[:, :, None]
        sky += cloud
    sky *= brightness
    return to_bytes(sky)
