"""Random textures."""

from __future__ import annotations

import math
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray


def smooth_noise(
    shape: tuple[int, int],
    cell: float,
    rng: np.random.Generator,
    *,
    octaves: int = 4,
    gain: float = 0.5,
    stretch: float = 1.0,
) -> NDArray[np.float32]:
    """Noise of several scales, as of clouds or soil.

    Its features are ``cell`` px at most, along x longer by ``stretch``; each octave halves their
    size, and multiplies their amplitude by ``gain``.

    Returns:
        (height, width) float32 of zero mean and unit standard deviation.
    """
    height, width = shape
    total = np.zeros(shape, np.float32)
    amplitude = 1.0
    for _ in range(octaves):
        rows = max(2, math.ceil(height / cell) + 3)
        columns = max(2, math.ceil(width / (cell * stretch)) + 3)
        grid = rng.standard_normal((rows, columns)).astype(np.float32)
        # The grid is enlarged by the same factor for any size, so its features keep their size.
        size = (round(columns * cell * stretch), round(rows * cell))
        size = (max(size[0], width), max(size[1], height))
        large = cv2.resize(grid, size, interpolation=cv2.INTER_CUBIC)
        total += amplitude * large[:height, :width]
        amplitude *= gain
        cell = max(1.0, cell / 2)
    total -= total.mean()
    total /= max(float(total.std()), 1e-6)
    return total


def tileable_noise(size: int, cell: float, rng: np.random.Generator) -> NDArray[np.float32]:
    """Noise whose opposite sides fit together, with features of ``cell`` px at most.

    Returns:
        (size, size) float32 of zero mean and unit standard deviation.
    """
    frequency = np.fft.fftfreq(size)
    radius = np.hypot(frequency[:, None], frequency[None, :])
    spectrum = np.fft.fft2(rng.standard_normal((size, size)))
    spectrum /= (1.0 + (radius * cell) ** 2) ** 0.5
    spectrum[radius < 0.25 / cell] = 0.0
    noise = np.real(np.fft.ifft2(spectrum))
    return np.asarray(noise / noise.std(), np.float32)


def smoothstep(low: float, high: float, values: NDArray[Any]) -> NDArray[np.float32]:
    """0 up to ``low``, 1 from ``high`` on, smooth between."""
    part = np.clip((values - low) / (high - low), 0.0, 1.0)
    return np.asarray(part * part * (3.0 - 2.0 * part), np.float32)


def to_bytes(image: NDArray[Any]) -> NDArray[np.uint8]:
    """Round and limit to 0 to 255."""
    limited = np.clip(image, 0.0, 255.0)
    return np.asarray(np.rint(limited, out=limited).astype(np.uint8))
