"""The sky and the hills on the horizon around a camera that turns."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.simulation.camera import PinholeCamera
from mvuav_ros.simulation.ground import horizon_anchor
from mvuav_ros.simulation.runway_truth import CameraPose
from mvuav_ros.simulation.sky import HORIZON, draw_sky
from mvuav_ros.simulation.texture import smooth_noise

TURN = math.radians(60.0)
"""The panorama reaches this much farther than the frame on either side; then it is mirrored."""
RISE = math.radians(40.0)
HILLS = math.radians(0.5)
"""Height of the hills."""
_BELOW = 8
_HILL = np.array((196.0, 176.0, 150.0), np.float32)


class Panorama:
    """Sky and hills, drawn once, then turned and moved under the camera."""

    def __init__(self, camera: PinholeCamera, detail: float, rng: np.random.Generator) -> None:
        self._camera = camera
        width = camera.width + round(2 * TURN * camera.fx)
        self._horizon_row = round(camera.height + RISE * camera.fx)
        self._middle = 0.5 * (width - 1)
        sky = draw_sky(
            (width, self._horizon_row + _BELOW),
            self._horizon_row,
            camera.fx,
            rng,
            cloudiness=detail,
        )
        ridge = smooth_noise((2, width), 0.12 * camera.fx, rng, octaves=5)[0]
        top = self._horizon_row - HILLS * camera.fx * np.clip(0.5 + 0.3 * ridge, 0.05, 1.0)
        highest = math.floor(top.min())
        rows = np.arange(highest, sky.shape[0], dtype=np.float32)[:, None]
        cover = np.clip(rows - top + 0.5, 0.0, 1.0)[:, :, None]
        fade = np.clip((self._horizon_row - rows) / (HILLS * camera.fx), 0.0, 1.0)[:, :, None]
        hill = HORIZON + (0.35 + 0.65 * fade) * (_HILL - HORIZON)
        low = sky[highest:]
        low[...] = np.rint(low + cover * (hill - low)).astype(np.uint8)
        self._sky = sky

    def view(self, pose: CameraPose) -> NDArray[np.uint8]:
        """A new sky, (height, width, 3), of the sky; below the horizon there is haze."""
        x, y, slope = horizon_anchor(self._camera, pose)
        c, s = math.cos(slope), math.sin(slope)
        centre = self._middle - self._camera.fx * pose.yaw
        level = np.array(
            [
                (c, s, centre - c * x - s * y),
                (-s, c, self._horizon_row + s * x - c * y),
            ]
        )
        image = np.empty((self._camera.height, self._camera.width, 3), np.uint8)
        lowest = max(y + math.tan(slope) * (column - x) for column in (0, self._camera.width))
        rows = min(max(math.ceil(lowest) + 2, 0), self._camera.height)
        if rows:
            image[:rows] = cv2.warpAffine(
                self._sky,
                level,
                (self._camera.width, rows),
                flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
                borderMode=cv2.BORDER_REFLECT_101,
            )
        image[rows:] = np.rint(HORIZON).astype(np.uint8)
        return image
