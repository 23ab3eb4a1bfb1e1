"""Plain ground seen by a camera that moves over it: fields, a strip of pavement, painted lines."""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray

FOCAL = 300.0
"""Px, of frames of 320 x 240."""


@cache
def _texture(seed: int) -> NDArray[np.float32]:
    texture = np.random.default_rng(seed).normal(0, 1, (512, 512)).astype(np.float32)
    return texture + 3 * cv2.GaussianBlur(texture, (0, 0), 4)


def drawn_strip(
    index: int,
    *,
    height: float,
    width: float,
    speed: float = 0.6,
    horizon: float = 100.0,
    aside: float = 0.0,
    seed: int = 1,
    ends: tuple[float, float] = (-1e9, 1e9),
) -> NDArray[np.uint8]:
    """Frame of a number: grey pavement with white side lines and a dashed middle, on grass.

    Lengths are m, the speed m per frame; ``aside`` is how far the camera is to the right of the
    strip's middle; the strip lies between two ``ends`` ahead of the first frame's camera.
    """
    texture = _texture(seed)
    rows, columns = np.mgrid[:240, :320].astype(np.float32)
    down, right = rows - horizon, columns - 160.0
    ahead = height * FOCAL / np.maximum(down, 0.5)
    across = right * ahead / FOCAL + aside
    along = ahead + speed * index
    # Texture of 0.5 m that fades where pixels are larger than it.
    noise = cv2.remap(
        texture, (across * 2) % 511, (along * 2) % 511, cv2.INTER_LINEAR
    ) / np.maximum(1.0, ahead / FOCAL * 4)
    ground = np.array((60.0, 120.0, 95.0)) + 9 * noise[:, :, None]
    on_strip = (np.abs(across) < 0.5 * width) & (along > ends[0]) & (along < ends[1])
    asphalt = np.array((105.0, 105.0, 105.0)) + 4 * noise[:, :, None]
    image = np.where(on_strip[:, :, None], asphalt, ground)
    line = np.abs(np.abs(across) - 0.5 * width + 0.4) < 0.08
    line |= (np.abs(across) < 0.08) & (along % 9 < 3)
    image[line & on_strip] = 225
    image[down <= 0.5] = (225, 200, 180)
    image = cv2.GaussianBlur(image, (0, 0), 0.7)
    sensor = np.random.default_rng(index).normal(0, 2, image.shape)
    return np.clip(image + sensor, 0, 255).astype(np.uint8)
