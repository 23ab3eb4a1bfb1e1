"""What the benchmarks look at: the thesis's five lights, alone or above a runway that sways."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

PLACES = np.array([(-150, 0), (-60, -20), (0, -60), (60, -20), (150, 0)])
"""Left wing, left stabilizer, rudder, right stabilizer, right wing; px from the tanker's centre."""
FRAMES = 60
"""Of one turn on a circle; the last joins the first."""


def circle(radius: float) -> NDArray[np.float64]:
    """(`FRAMES`, 2) px."""
    angles = np.arange(FRAMES) * 2 * np.pi / FRAMES
    return np.asarray(radius * np.stack((np.cos(angles), np.sin(angles)), axis=-1))


def lights(
    width: int, height: int, places: NDArray[np.float64], radius: int = 4
) -> NDArray[np.uint8]:
    """Discs at fractions of pixels before a dark sky."""
    image = np.full((height, width), 40, np.uint8)
    for x, y in places:
        cv2.circle(image, (round(x * 16), round(y * 16)), radius * 16, 255, -1, cv2.LINE_8, 4)
    return image


def lights_above_runway(width: int, height: int, index: int) -> NDArray[np.uint8]:
    """A frame with something for both nodes."""
    across, down = circle(20.0)[index % FRAMES]
    tanker = lights(width, height, np.add(PLACES, (0.5 * width + across, 0.5 * height + down)))
    ground = np.zeros_like(tanker)
    # A runway that stands still would cost the detector less than one in flight.
    middle, foot = width // 2 + round(0.4 * down), height - 1
    for offset in (-width // 5, 0, width // 5):
        cv2.line(ground, (middle, 20), (middle + offset, foot), 150, 5, cv2.LINE_AA)
    return np.maximum(tanker, ground)
