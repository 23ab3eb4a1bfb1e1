"""What is behind the tanker: sky, the laboratory's blue foam, or nothing."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.simulation.camera import PinholeCamera
from mvuav_ros.simulation.sky import draw_sky
from mvuav_ros.simulation.texture import smooth_noise, to_bytes
from mvuav_ros.vision.frames import Matrix
from mvuav_ros.vision.point_operations import Pixels

MARGIN = 48
"""px around the frame, for a camera that shakes."""
FOAM = np.array((150.0, 96.0, 58.0), np.float32)
PLAIN = 64.0
SKY_BRIGHTNESS = 0.62
"""Exposed for the lights: a cloud stays well below the thesis's threshold of 179."""
CLOUDINESS = 0.6


class Background:
    """An image at infinity, seen by a camera that turns a little."""

    def __init__(
        self,
        kind: str,
        camera: PinholeCamera,
        color: bool,
        detail: float,
        rng: np.random.Generator,
    ) -> None:
        self._camera = camera
        image = _DRAWERS[kind](camera, detail, rng)
        self._wide: Pixels = image if color else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
        inside = slice(MARGIN, -MARGIN)
        self._middle: Pixels = np.ascontiguousarray(self._wide[inside, inside])

    def view(self, turned: Matrix | None) -> Pixels:
        """A new image of the background.

        Args:
            turned: the camera's rotation from its steady attitude; None for none.
        """
        if turned is None:
            return self._middle.copy()
        k = self._camera.matrix
        shift = np.array([(1.0, 0.0, MARGIN), (0.0, 1.0, MARGIN), (0.0, 0.0, 1.0)])
        wide_from_frame = shift @ k @ turned.T @ np.linalg.inv(k)
        return cv2.warpPerspective(
            self._wide,
            wide_from_frame,
            (self._camera.width, self._camera.height),
            flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
            borderMode=cv2.BORDER_REPLICATE,
        )


def _sky(camera: PinholeCamera, detail: float, rng: np.random.Generator) -> NDArray[np.uint8]:
    width, height = _size(camera)
    return draw_sky(
        (width, height),
        1.25 * height,
        camera.fx,
        rng,
        brightness=SKY_BRIGHTNESS,
        cloudiness=CLOUDINESS * detail,
    )


def _foam(camera: PinholeCamera, detail: float, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Boards of extruded foam: a fine grain, faint flow marks, seams, uneven lamplight."""
    width, height = _size(camera)
    unit = camera.width / 640.0
    grain = smooth_noise((height, width), 5.0 * unit, rng, octaves=2)
    flow = smooth_noise((height, width), 12.0 * unit, rng, octaves=3, stretch=14.0)
    y, x = np.mgrid[0:height, 0:width].astype(np.float32)
    lamp = np.exp(-(((x / width - 0.42) / 0.75) ** 2 + ((y / height - 0.35) / 0.8) ** 2))
    shade = 0.62 + 0.5 * lamp + detail * (0.012 * grain + 0.018 * flow)
    for part in (0.27, 0.73):
        seam = np.abs(x - part * width - 0.01 * y)
        shade -= 0.16 * np.exp(-((seam / (1.6 * unit)) ** 2))
    return to_bytes(FOAM * shade[:, :, None])


def _plain(camera: PinholeCamera, detail: float, rng: np.random.Generator) -> NDArray[np.uint8]:
    width, height = _size(camera)
    return np.full((height, width, 3), round(PLAIN), np.uint8)


def _size(camera: PinholeCamera) -> tuple[int, int]:
    return camera.width + 2 * MARGIN, camera.height + 2 * MARGIN


_DRAWERS = {'sky': _sky, 'foam': _foam, 'plain': _plain}
