"""How far what is around a strip has moved from one working image to the next."""

from __future__ import annotations

import math
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.approach.derotation import Derotation
from mvuav_ros.vision.approach.edges import Strip
from mvuav_ros.vision.approach.numeric import vertex

_REACH = 6
"""Px of the working image by which a camera may turn between two frames."""
_LEAST, _MOST = 40, 96
"""Px, of the compared part's sides."""
_ALIKE = 0.5
"""Correlation from which two parts show the same."""


class Registration:
    """Compares each working image with the last one."""

    def __init__(self) -> None:
        self._last: NDArray[Any] | None = None
        self._now: NDArray[Any] | None = None
        self.gray = np.zeros((0, 0), np.uint8)
        """The newest working image in 256 grey levels."""
        self.moving = False
        """The newest image differs from the last one; a still says nothing new."""
        self.unchanged = 0
        """Images that were the same as the newest."""

    def take(self, pixels: NDArray[Any]) -> None:
        """Take in the next working image, (height, width) or (height, width, 3)."""
        # A copy: the caller may use the image's memory for the next one.
        gray = pixels.copy() if pixels.ndim == 2 else cv2.extractChannel(pixels, 1)
        if gray.dtype != np.uint8:
            gray = gray.astype(np.float32)
        self._last, self._now = self._now, np.asarray(gray)
        self.gray = self._now.astype(np.uint8) if gray.dtype != np.uint8 else self._now
        same = self._last is not None and np.array_equal(self._last, self._now)
        self.moving = self._last is not None and not same
        self.unchanged = self.unchanged + 1 if same else 0

    def shift(self, strip: Strip, level: Derotation) -> tuple[float, float]:
        """Px to the right and down by which the surroundings of the last frame's strip have moved.

        Both are on the levelled working image; the shift is 0 where nobody can tell.
        """
        last, now = self._last, self._now
        if last is None or now is None or last.shape != now.shape or last.dtype != now.dtype:
            return 0.0, 0.0
        box = _box(strip, level, last.shape)
        if box is None:
            return 0.0, 0.0
        first, top, end, bottom = box
        part = last[top:bottom, first:end]
        around = now[top - _REACH : bottom + _REACH, first - _REACH : end + _REACH]
        alike = cv2.matchTemplate(around, part, cv2.TM_CCOEFF_NORMED)
        row, column = np.unravel_index(int(alike.argmax()), alike.shape)
        if not alike[row, column] > _ALIKE:
            return 0.0, 0.0
        right = column - _REACH + vertex(alike[row], int(column))
        down = row - _REACH + vertex(alike[:, column], int(row))
        cos, sin = math.cos(level.slope), math.sin(level.slope)
        return cos * right + sin * down, -sin * right + cos * down


def _box(
    strip: Strip, level: Derotation, size: tuple[int, ...]
) -> tuple[int, int, int, int] | None:
    """First column, first row, column and row after the last one of what is compared."""
    x, y, left, right, _, near = (float(value) for value in strip)
    at_x, at_y = level.to_frame(x + 0.25 * (left + right) * near, y + 0.5 * near)
    at_x, at_y = (at_x + 0.5) / level.factor - 0.5, (at_y + 0.5) / level.factor - 0.5
    if not math.isfinite(at_x + at_y):
        return None
    height, width = size[:2]
    half_wide = 0.5 * min(max(1.5 * (right - left) * near, _LEAST), _MOST)
    half_high = 0.5 * min(max(1.5 * near, _LEAST), _MOST)
    first, end = max(_REACH, int(at_x - half_wide)), min(width - _REACH, int(at_x + half_wide))
    top, bottom = max(_REACH, int(at_y - half_high)), min(height - _REACH, int(at_y + half_high))
    if end - first < _LEAST // 2 or bottom - top < _LEAST // 2:
        return None
    return first, top, end, bottom
