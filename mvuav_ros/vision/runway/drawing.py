"""Drawing that the debug images share."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

Canvas = NDArray[np.uint8]
Color = tuple[int, int, int]
Point = tuple[int, int]

WHITE, BLACK = (255, 255, 255), (0, 0, 0)

_FONT = cv2.FONT_HERSHEY_SIMPLEX


def write(canvas: Canvas, text: str, place: Point, size: float, color: Color = WHITE) -> None:
    """Write a line of text on a black box that keeps it readable on any canvas.

    Args:
        canvas: (height, width, 3) uint8, drawn on.
        text: ASCII.
        place: x, y of the text's lower left corner, px.
        size: OpenCV's font scale.
        color: blue, green, red.
    """
    thickness = max(1, round(2 * size))
    (width, height), below = cv2.getTextSize(text, _FONT, size, thickness)
    x, y = place
    cv2.rectangle(canvas, (x - 2, y - height - 2), (x + width + 1, y + below), BLACK, -1)
    cv2.putText(canvas, text, place, _FONT, size, color, thickness, cv2.LINE_AA)


def write_centred(
    canvas: Canvas, text: str, centre: Point, size: float, color: Color = WHITE
) -> None:
    """Write a line of text, its middle at ``centre`` (x, y in px)."""
    thickness = max(1, round(2 * size))
    (width, height), _ = cv2.getTextSize(text, _FONT, size, thickness)
    place = centre[0] - width // 2, centre[1] + height // 2
    cv2.putText(canvas, text, place, _FONT, size, color, thickness, cv2.LINE_AA)
