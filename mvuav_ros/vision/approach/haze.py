"""Haze takes contrast with distance: how dense it is, and the frame without it."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.approach.attitude import Derotation
from mvuav_ros.vision.approach.evidence import brightness_of
from mvuav_ros.vision.approach.tuning import HAZE
from mvuav_ros.vision.point_operations import Pixels


class Haze:
    """What the air adds to the land: its darkest places are the brighter, the farther away.

    Of what is d rows below the horizon exp(-density / d) of the contrast is left, as distance on a
    plane is as 1 / d (Koschmieder's law); the rest is the sky's light at the horizon.
    """

    def __init__(self) -> None:
        self._density = 0.0  # rows
        self._sky = np.zeros(3, np.float32)  # blue, green, red at the horizon, grey levels
        self._frames = self._looks = 0

    def cleared(self, image: Pixels, pixels: Pixels, level: Derotation, row: float) -> Pixels:
        """A frame, of which ``pixels`` are the working image, with the contrast of its land.

        The horizon is in a row of the levelled working image. Without haze it is the frame itself.
        """
        if self._frames % HAZE.period == 0:
            self._look(level.turned(pixels), row)
        self._frames += 1
        excess = self._density - HAZE.usual_density
        if excess < HAZE.min_excess:
            return image
        height, width = image.shape[:2]
        x, y = np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32)
        sin, cos = math.sin(level.slope) / level.factor, math.cos(level.slope) / level.factor
        middle_x, middle_y = level.to_frame(*level.centre)
        down = level.centre[1] - row + cos * (y - middle_y)
        depth = down[:, None] - sin * (x - middle_x)
        gain = np.exp(np.minimum(excess / np.maximum(depth, 1.0), math.log(HAZE.max_gain)))
        gain[depth <= 0.0] = 1.0
        sky: NDArray[np.float32] = self._sky
        if image.ndim == 2:
            sky = brightness_of(sky[None, None])[0, 0]
        else:
            gain = gain[..., None]
        light = (image - sky) * gain
        light += sky + np.float32(0.5)
        return np.asarray(np.clip(light, 0.0, 255.0), np.uint8)

    def _look(self, levelled: Pixels, row: float) -> None:
        """Measure both where sky and land are in view."""
        if not HAZE.sky_rows < row < len(levelled) - HAZE.min_rows:
            return
        first = round(row)
        above = levelled[first - HAZE.sky_rows : first - 1, :: HAZE.column_step]
        sky = np.median(above, axis=(0, 1), keepdims=True).astype(np.float32)
        land = brightness_of(levelled[first + HAZE.first_depth :, :: HAZE.column_step])
        dark = cv2.blur(np.percentile(land, HAZE.darkest, axis=1).reshape(-1, 1), (1, 5))[:, 0]
        contrast = brightness_of(sky).item() - dark
        seen = contrast >= HAZE.min_contrast
        if np.count_nonzero(seen) < HAZE.min_rows:
            return
        # Its logarithm's slope over 1 / depth, weighted by that: nearly all of it is far away.
        nearness = 1.0 / (np.flatnonzero(seen) + first + HAZE.first_depth - row)
        off = nearness - np.average(nearness, weights=nearness)
        fall = nearness * off
        density = -float((fall * np.log(contrast[seen])).sum() / (fall * off).sum())
        self._looks += 1
        share = max(HAZE.memory, 1.0 / self._looks)
        self._sky = self._sky + share * (sky.ravel() - self._sky)
        self._density += share * (density - self._density)
