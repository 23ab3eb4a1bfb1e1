"""Drawing that the debug images share."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.point_operations import Pixels

Canvas = NDArray[np.uint8]
Color = tuple[int, int, int]
Point = tuple[float, float]

WHITE, BLACK = (255, 255, 255), (0, 0, 0)

# OpenCV draws between whole pixels unless coordinates carry fractional bits.
_SHIFT = 4
_FARTHEST = 1e5
_FONT = cv2.FONT_HERSHEY_SIMPLEX


def eight_bits(image: Pixels) -> Canvas:
    """An image in 8 bits, itself if it has them."""
    return (image >> 8 if image.dtype == np.uint16 else image).astype(np.uint8, copy=False)


def blank(height: int, width: int, *channels: int) -> Canvas:
    """Black, at least 1 x 1 px."""
    return np.zeros((max(1, height), max(1, width), *channels), np.uint8)


def canvas_of(image: Pixels) -> tuple[Canvas, float]:
    """A copy of an image to draw on, (height, width, 3), and by how much larger to draw on it."""
    canvas = np.array(eight_bits(image))
    if canvas.ndim == 2:
        canvas = np.stack([canvas] * 3, axis=2)
    return canvas, max(1.0, min(image.shape[:2]) / 240)


def draw_line(canvas: Canvas, first: Point, last: Point, color: Color, thickness: int) -> None:
    """Draw a line between two points (x, y), fractions of px."""
    begin, end = (
        [round(min(max(value, -_FARTHEST), _FARTHEST) * 2**_SHIFT) for value in point]
        for point in (first, last)
    )
    cv2.line(canvas, begin, end, color, thickness, cv2.LINE_AA, _SHIFT)


def write(
    canvas: Canvas, text: str, place: tuple[int, int], size: float, color: Color = WHITE
) -> None:
    """Write a line of ASCII text on a black box that keeps it readable on any canvas.

    Its lower left corner is at ``place`` (x, y in px); ``size`` is OpenCV's font scale.
    """
    thickness = max(1, round(2 * size))
    (width, height), below = cv2.getTextSize(text, _FONT, size, thickness)
    x, y = place
    cv2.rectangle(canvas, (x - 2, y - height - 2), (x + width + 1, y + below), BLACK, -1)
    cv2.putText(canvas, text, place, _FONT, size, color, thickness, cv2.LINE_AA)


def write_centred(
    canvas: Canvas, text: str, centre: tuple[int, int], size: float, color: Color = WHITE
) -> None:
    """Write a line of text, its middle at ``centre`` (x, y in px)."""
    thickness = max(1, round(2 * size))
    (width, height), _ = cv2.getTextSize(text, _FONT, size, thickness)
    place = centre[0] - width // 2, centre[1] + height // 2
    cv2.putText(canvas, text, place, _FONT, size, color, thickness, cv2.LINE_AA)
