"""A frame made small enough to be searched, and its channels of brightness and opponent colours."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.point_operations import Pixels

WORKING_WIDTH = 320
"""Px; images much wider than this are shrunk by a whole factor for the search."""

OPPONENT = np.array([(0.114, 0.587, 0.299), (1.0, -0.5, -0.5), (0.0, -1.0, 1.0)], np.float32)
"""Brightness (eq. 3.3), blue against yellow, red against green; from blue, green, red."""

Table = NDArray[np.float32]
"""(channels, rows, columns + 1) sums along the rows; element x is that of the x columns before."""


def shrunk(image: Pixels) -> tuple[Pixels, int]:
    """A frame, not empty, about `WORKING_WIDTH` px wide, and px of the frame per px of it."""
    height, width = image.shape[:2]
    factor = max(1, min(round(width / WORKING_WIDTH), height))
    return _shrunk_by(image, factor), factor


def halved(pixels: Pixels) -> Pixels:
    """The next level of a pyramid."""
    return _shrunk_by(pixels, 2)


def _shrunk_by(image: Pixels, factor: int) -> Pixels:
    if factor == 1:
        return image
    height, width = image.shape[:2]
    size = (width // factor, height // factor)
    whole = image[: size[1] * factor, : size[0] * factor]
    return np.asarray(cv2.resize(whole, size, interpolation=cv2.INTER_AREA))


def grey_levels(pixels: Pixels) -> NDArray[np.float32]:
    """The pixels as 256 grey levels, those of 16 bits too."""
    levels = pixels.astype(np.float32)
    if pixels.dtype == np.uint16:
        levels /= 256
    return levels


def opponent_channels(pixels: Pixels) -> list[NDArray[np.float32]]:
    """Brightness alone of a grey image, else the three channels of `OPPONENT`; grey levels."""
    levels = grey_levels(pixels)
    if pixels.ndim == 2:
        return [levels]
    return [np.ascontiguousarray(channel) for channel in cv2.split(cv2.transform(levels, OPPONENT))]


def row_sums(
    channels: Sequence[NDArray[Any]] | NDArray[Any], first_row: int = 0, table: Table | None = None
) -> Table:
    """Sums along the rows of channels, which are of the rows from ``first_row`` on.

    An earlier table of the same size is overwritten; its rows above stay as they are.
    """
    if table is None:
        rows, columns = channels[0].shape
        table = np.zeros((len(channels), first_row + rows, columns + 1), np.float32)
    for channel, sums in zip(channels, table, strict=True):
        # Several times as fast as adding up one row after the other.
        area = np.asarray(cv2.integral(channel, sdepth=cv2.CV_64F))
        np.subtract(area[1:], area[:-1], out=sums[first_row:], casting='same_kind')
    return table
