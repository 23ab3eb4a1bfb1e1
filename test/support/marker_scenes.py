"""Frames with marker lights at known places, for tests."""

import cv2
import numpy as np

from mvuav_ros.vision.image import Image

# Left wing, left stabilizer, rudder, right stabilizer, right wing; px from the tanker's centre.
TANKER = np.array([(-150, 0), (-60, -20), (0, -60), (60, -20), (150, 0)], float)


def tanker_at(x: float = 320, y: float = 240, roll_deg: float = 0.0) -> np.ndarray:
    """The five markers' places, (5, 2) px; right wing down is positive roll."""
    c, s = np.cos(np.radians(roll_deg)), np.sin(np.radians(roll_deg))
    return TANKER @ np.array([(c, s), (-s, c)]) + (x, y)


def draw(places, size=(640, 480), radius=4) -> np.ndarray:
    image = np.full((size[1], size[0]), 40, np.uint8)
    for x, y in places:
        center = (round(x * 16), round(y * 16))
        cv2.circle(image, center, radius * 16, 255, -1, cv2.LINE_8, 4)
    return image


def image(places, **keywords) -> Image:
    return Image(draw(places, **keywords), 'mono8')
