"""Pixel-wise image functions shared by the marker and runway schemes (thesis eqs 3.2-3.4)."""

from __future__ import annotations

import math
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

Pixels = NDArray[Any]  # uint8 or uint16, (height, width) or (height, width, channels)
Mask = NDArray[Any]  # uint8, (height, width), 255 or 0


def full_scale(image: Pixels) -> int:
    """The greatest value that a pixel of ``image`` can have: 255 or 65535."""
    return 255 if image.itemsize == 1 else 65535


def gamma_correct(image: Pixels, gamma: float) -> Pixels:
    """Apply out = in ** gamma on the range 0 to 1 (eq. 3.2) to uint8 or uint16 of any shape.

    Gamma above 1 darkens; 1 returns the image itself.

    Raises:
        ValueError: gamma is not a positive number.
    """
    if not (math.isfinite(gamma) and gamma > 0):
        raise ValueError(f'gamma must be a number above 0, not {gamma}')
    if gamma == 1.0:
        return image
    scale = full_scale(image)
    levels = np.arange(scale + 1, dtype=np.float64) / scale
    table = np.round(levels**gamma * scale).astype(image.dtype)
    return table[image]


def intensity(bgr: Pixels) -> Pixels:
    """Weigh the colours to grey: I = 0.299 R + 0.587 G + 0.114 B (eq. 3.3), rounded.

    Args:
        bgr: (height, width, 3), blue first; a single-channel image is returned as it is.
    """
    if bgr.ndim == 2:
        return bgr
    return cv2.cvtColor(bgr, cv2.COLOR_BGR2GRAY)


BLUE_FIRST, RED_FIRST = (0, 1, 2), (2, 1, 0)  # places of blue, green and red


def select_channel(
    image: Pixels, channel: str, colors: tuple[int, int, int] = BLUE_FIRST
) -> Pixels:
    """Take ``blue``, ``green`` or ``red``, the ``brightest`` of them, or the ``intensity``.

    Args:
        image: (height, width, 3), or (height, width), which is returned as it is.
        channel: one of these; the intensity is that of an image with blue first.
        colors: places of blue, green and red; there may be a fourth channel beside them.
    """
    if image.ndim == 2:
        return image
    if channel == 'intensity':
        return intensity(image)
    if channel == 'brightest':
        planes = cv2.split(image)
        blue, green, red = (planes[place] for place in colors)
        return cv2.max(cv2.max(blue, green, dst=blue), red, dst=blue)
    return cv2.extractChannel(image, colors[('blue', 'green', 'red').index(channel)])


def threshold(gray: Pixels, level: float) -> Mask:
    """Separate pixels (uint8 or uint16) above a fraction of full scale, 255, from the rest, 0.

    It compares ``>`` as the thesis's programs do (im2bw); eq. 3.4 is written with ``>=``, which
    differs only where level x full scale is a whole number.
    """
    limit = level * full_scale(gray)
    if gray.size == 0:
        return np.zeros(gray.shape, np.uint8)
    if gray.itemsize == 1:
        return cv2.threshold(gray, limit, 255, cv2.THRESH_BINARY)[1]
    return (gray > limit).view(np.uint8) * np.uint8(255)
