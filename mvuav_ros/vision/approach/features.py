"""What tells pavement from the land beside it: brightness and colourfulness."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.point_operations import Pixels

WORKING_WIDTH = 320
"""Px; images much wider than this are shrunk by a whole factor for the search."""

Features = NDArray[np.float32]
Table = NDArray[np.float32]

# Rows: brightness (eq. 3.3), blue against yellow, red against green; from blue, green, red.
_OPPONENT = np.array([(0.114, 0.587, 0.299), (1.0, -0.5, -0.5), (0.0, -1.0, 1.0)], np.float32)
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


class WorkingImage(NamedTuple):
    """A frame made small enough to be searched.

    Attributes:
        pixels: (height, width, 3) uint8, blue first.
        factor: px of the frame per px of this one.
    """

    pixels: NDArray[np.uint8]
    factor: int

    def to_frame(self, position: float) -> float:
        """A coordinate on the frame, of one on this image."""
        return (position + 0.5) * self.factor - 0.5


def shrink(image: Pixels) -> WorkingImage:
    """Make a frame about `WORKING_WIDTH` px wide, in three channels of 8 bits.

    Args:
        image: (height, width) or (height, width, 3), uint8 or uint16, not empty.
    """
    height, width = image.shape[:2]
    factor = max(1, min(round(width / WORKING_WIDTH), height))
    if factor > 1:
        size = (width // factor, height // factor)
        whole = image[: size[1] * factor, : size[0] * factor]
        image = np.asarray(cv2.resize(whole, size, interpolation=cv2.INTER_AREA))
    if image.dtype == np.uint16:
        image = (image >> 8).astype(np.uint8)
    if image.ndim == 2:
        image = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
    return WorkingImage(np.ascontiguousarray(image, np.uint8), factor)


def white_of(pixels: NDArray[np.uint8]) -> tuple[float, float, float]:
    """Factors of blue, green and red that take the tint from the brightest pixels.

    Args:
        pixels: (height, width, 3), blue first.
    """
    some = pixels[::_EACH, ::_EACH].reshape(-1, 3).astype(np.float32)
    brightness = some @ _OPPONENT[0]
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
        pixels: (rows, columns) or (rows, columns, 3), blue first; uint8, or uint16, which is
            scaled to the same grey levels.
        colours: of the image.
        smoothing: columns, odd, over which colour (not brightness) is averaged, by a Gaussian.

    Returns:
        (2, rows, columns), grey levels.
    """
    levels = pixels.astype(np.float32)
    if pixels.dtype == np.uint16:
        levels /= 256
    if pixels.ndim == 2:
        return np.stack([levels, np.zeros_like(levels)])
    matrix = _OPPONENT.copy()
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


def row_sums(features: Features, first_row: int, table: Table | None = None) -> Table:
    """Sums along the rows; element x is the sum of the x columns before.

    Args:
        features: (2, rows, columns) of the rows from ``first_row`` on.
        first_row: rows of the table above it are left as they are.
        table: an earlier one of the same size, which is overwritten.

    Returns:
        (2, first_row + rows, columns + 1).
    """
    channels, rows, columns = features.shape
    if table is None:
        table = np.zeros((channels, first_row + rows, columns + 1), np.float32)
    for channel, sums in zip(features, table, strict=True):
        # Several times as fast as adding up one row after the other.
        area = np.asarray(cv2.integral(channel, sdepth=cv2.CV_64F))
        np.subtract(area[1:], area[:-1], out=sums[first_row:], casting='same_kind')
    return table
