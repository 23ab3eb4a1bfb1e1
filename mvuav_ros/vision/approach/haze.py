"""Haze takes contrast with distance: how much there is, and the frame without it."""

from __future__ import annotations

import math
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.approach.attitude import Derotation
from mvuav_ros.vision.approach.evidence import brightness_of
from mvuav_ros.vision.approach.tuning import HAZE
from mvuav_ros.vision.point_operations import Pixels


class Haze:
    """What the air adds to the land: the brighter are its darkest places, the farther away.

    What is d rows below the horizon is seen with exp(-density / d) of its contrast, the rest is
    the sky's at the horizon: the distance over a plane is as 1 / d (Koschmieder's law).
    """

    def __init__(self) -> None:
        self.density = 0.0  # rows
        self._sky: float | None = None  # grey level at the horizon

    def take(self, pixels: Pixels, level: Derotation, row: float) -> None:
        """Measure it on a working image, whose horizon is in a row of the levelled one."""
        levelled = level.turned(pixels)
        first = round(row)
        if first < HAZE.sky_rows or first > len(levelled) - HAZE.min_rows:
            return
        gray = brightness_of(levelled[:, ::HAZE.column_step])
        sky = float(np.median(gray[first - HAZE.sky_rows : first - 1]))
        land = gray[first + HAZE.first_depth :]
        depth = np.arange(len(land)) + first + HAZE.first_depth - row
        dark = np.percentile(land, HAZE.darkest, axis=1).astype(np.float32)
        dark = cv2.blur(dark[:, None], (1, 5))[:, 0]
        contrast = np.log(np.maximum(sky - dark, 2.0))
        weight = 1.0 / depth
        x = -weight - np.average(-weight, weights=weight)
        density = float((weight * x * contrast).sum() / (weight * x * x).sum())
        share = 1.0 if self._sky is None else HAZE.memory
        self._sky = sky if self._sky is None else self._sky + share * (sky - self._sky)
        self.density += share * (density - self.density)

    def cleared(self, image: Pixels, level: Derotation, row: float) -> Pixels:
        """The frame with the contrast that its land would have without haze."""
        excess = self.density - HAZE.usual_density
        if self._sky is None or excess < HAZE.min_excess:
            return image
        height, width = image.shape[:2]
        sin, cos = math.sin(level.slope) / level.factor, math.cos(level.slope) / level.factor
        middle_x, middle_y = 0.5 * (level.factor * level.width - 1), 0.5 * (level.factor * level.height - 1)
        down = level.centre[1] - row + cos * (np.arange(height, dtype=np.float32) - middle_y)
        across = sin * (np.arange(width, dtype=np.float32) - middle_x)
        depth = down[:, None] - across
        gain = np.exp(np.minimum(excess / np.maximum(depth, 1.0), math.log(HAZE.max_gain)))
        gain[depth <= 0.0] = 1.0
        gain = gain if image.ndim == 2 else gain[..., None]
        return np.asarray(np.clip((image - np.float32(self._sky)) * gain + np.float32(self._sky + 0.5), 0, 255), np.uint8)
