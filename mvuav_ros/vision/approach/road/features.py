"""What tells pavement from the land beside it: brightness and colourfulness."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.approach.channels import OPPONENT, grey_levels, shrunk
from mvuav_ros.vision.point_operations import Pixels

Features = NDArray[np.float32]
"""(2, rows, columns) brightness and colourfulness, grey levels."""
CHANNELS = 2

_BRIGHTEST = 97.0
"""Percentile of brightness from which on pixels are taken to be white: clouds, haze, paint."""
_MOST_CAST = 1.3
_USUAL_CAST = 1.12
"""Blue sky may be the brightest: only what is beyond this is the image's tint."""
_EACH = 4


@dataclass(frozen=True)
class Colours:
    """How colours are taken before they are compared.

    Attributes:
        white: factors of blue, green and red that make white things white.
        gain: factor of the colourfulness.
    """

    white: tuple[float, float, float] = (1.0, 1.0, 1.0)
    gain: float = 1.0


PLAIN = Colours()


def shrink(image: Pixels) -> tuple[NDArray[np.uint8], int]:
    """A frame as `shrunk` gives it, (height, width, 3) uint8, and px of the frame per px of it."""
    image, factor = shrunk(image)
    if image.dtype == np.uint16:
        image = (image >> 8).astype(np.uint8)
    if image.ndim == 2:
        image = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
    return np.ascontiguousarray(image, np.uint8), factor


def white_of(pixels: NDArray[np.uint8]) -> tuple[float, float, float]:
    """Factors of blue, green and red that take the tint from the brightest pixels."""
    some = pixels[::_EACH, ::_EACH].reshape(-1, 3).astype(np.float32)
    brightness = some @ OPPONENT[0]
    brightest = some[brightness >= np.percentile(brightness, _BRIGHTEST)].mean(axis=0)
    factors = np.clip(brightest.mean() / np.maximum(brightest, 1.0), 1 / _MOST_CAST, _MOST_CAST)
    factors /= np.clip(factors, 1 / _USUAL_CAST, _USUAL_CAST)
    blue, green, red = (float(factor) for factor in factors)
    return blue, green, red


def features_of(pixels: NDArray[Any], colours: Colours = PLAIN, smoothing: int = 1) -> Features:
    """Brightness and colourfulness.

    Pavement is greyer than what grows beside it, whether it is darker or brighter; and what is as
    colourful as its surroundings, such as one field beside another, does not stand out.

    Args:
        pixels: (rows, columns) or (rows, columns, 3), blue first; 8 or 16 bits.
        colours: of the image.
        smoothing: columns, odd, over which colour (not brightness) is averaged, by a Gaussian.
    """
    levels = grey_levels(pixels)
    if pixels.ndim == 2:
        return np.stack([levels, np.zeros_like(levels)])
    matrix = OPPONENT.copy()
    matrix[1:] *= np.multiply(colours.white, colours.gain, dtype=np.float32)
    opponent = cv2.transform(levels, matrix)
    brightness, blue_yellow, red_green = cv2.split(opponent)
    if smoothing > 1:
        # Before the magnitude, which would take noise for colour.
        blue_yellow = cv2.GaussianBlur(blue_yellow, (smoothing, 1), 0)
        red_green = cv2.GaussianBlur(red_green, (smoothing, 1), 0)
    # cv2.magnitude rounds as the arrays happen to lie in memory; results must repeat.
    blue_yellow *= blue_yellow
    red_green *= red_green
    blue_yellow += red_green
    return np.stack([brightness, np.sqrt(blue_yellow, out=blue_yellow)])
