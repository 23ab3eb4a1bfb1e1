"""What the camera does to an image: gain, motion blur, defocus, noise, hot pixels."""

from __future__ import annotations

import math
from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.point_operations import Pixels

_POOL_EXTRA = 1 << 17
STEP_SECONDS = 2.5
"""Mean time between two steps of the gain."""


class SensorNoise:
    """Gaussian noise of whole grey levels, cut from a pool at a random place per frame.

    Drawing a million normal numbers would take longer than the image itself.
    """

    def __init__(self, size: int, sigma: float, rng: np.random.Generator) -> None:
        normal = rng.standard_normal(size + _POOL_EXTRA, np.float32)
        noise = np.clip(np.rint(sigma * normal), -255, 255).astype(np.int16)
        self._up: NDArray[np.uint8] = np.maximum(noise, 0).astype(np.uint8)
        self._down: NDArray[np.uint8] = np.maximum(-noise, 0).astype(np.uint8)

    def add(self, image: Pixels, rng: np.random.Generator) -> None:
        """Add noise to a contiguous 8-bit image of the size given, in place."""
        start = int(rng.integers(_POOL_EXTRA))
        part = slice(start, start + image.size)
        # Two saturating additions of bytes are ten times as fast as one of mixed types.
        cv2.add(image, self._up[part].reshape(image.shape), dst=image)
        cv2.subtract(image, self._down[part].reshape(image.shape), dst=image)


def gain_steps(
    amplitude: float, duration: float, rng: np.random.Generator
) -> Callable[[float], float]:
    """An automatic gain that jumps from one value to the next, by the time (s)."""
    starts, gains = [0.0], [1.0]
    while amplitude and starts[-1] < duration:
        starts.append(starts[-1] + float(rng.uniform(0.4, 1.6)) * STEP_SECONDS)
        gains.append(1.0 + amplitude * float(rng.uniform(-1.0, 1.0)))
    return lambda time: gains[int(np.searchsorted(starts, time, side='right')) - 1]


def hot_pixels(
    width: int, height: int, count: int, rng: np.random.Generator
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Rows and columns of pixels that are always white."""
    chosen = rng.choice(width * height, min(count, width * height), replace=False)
    return np.divmod(chosen, width)


def apply_gain(image: Pixels, gain: float) -> Pixels:
    """Multiply and saturate; the image itself where the gain is 1."""
    if gain == 1.0:
        return image
    return cv2.convertScaleAbs(image, alpha=gain)


def motion_blur(image: Pixels, dx: float, dy: float) -> Pixels:
    """Smear an image along a straight path of (dx, dy) px, centred; the image itself if short."""
    length = math.hypot(dx, dy)
    if length < 0.5:
        return image
    half = math.ceil(0.5 * max(abs(dx), abs(dy)) + 0.5)
    kernel = np.zeros((2 * half + 1, 2 * half + 1), np.float32)
    for part in np.linspace(-0.5, 0.5, 4 * math.ceil(length) + 1):
        x, y = half + part * dx, half + part * dy
        column, row = math.floor(x), math.floor(y)
        fx, fy = x - column, y - row
        for r, wy in ((row, 1.0 - fy), (row + 1, fy)):
            for c, wx in ((column, 1.0 - fx), (column + 1, fx)):
                if wx * wy > 0.0:
                    kernel[r, c] += wx * wy
    kernel /= kernel.sum()
    return cv2.filter2D(image, -1, kernel, borderType=cv2.BORDER_REPLICATE)


def defocus(image: Pixels, sigma: float) -> Pixels:
    """Gaussian blur; the image itself where sigma (px) is 0."""
    if sigma == 0.0:
        return image
    return cv2.GaussianBlur(image, (0, 0), sigma, borderType=cv2.BORDER_REPLICATE)
