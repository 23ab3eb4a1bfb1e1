"""What is behind everything: sky with clouds, hills around a camera, foam boards, or nothing."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.simulation.pinhole import CameraPose, seen_by
from mvuav_ros.simulation.texture import smooth_noise, smoothstep, to_bytes
from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.frames import Matrix
from mvuav_ros.vision.point_operations import Pixels

ZENITH = np.array((168.0, 112.0, 62.0), np.float32)
HORIZON = np.array((222.0, 204.0, 184.0), np.float32)
CLOUD = np.array((246.0, 243.0, 240.0), np.float32)
CLOUD_BASE = np.array((205.0, 196.0, 188.0), np.float32)
_TILE = 1024
TURN = math.radians(60.0)
"""The panorama reaches this much farther than the frame on either side; then it is mirrored."""
RISE = math.radians(40.0)
_FRAMES = 3
"""It reaches no farther than this many frames: of a telephoto lens, 60 degrees are gigabytes."""
HILLS = math.radians(0.5)  # height of the hills
_BELOW = 8
_HILL = np.array((196.0, 176.0, 150.0), np.float32)

MARGIN = 48  # px around the frame, for a camera that shakes
FOAM = np.array((150.0, 96.0, 58.0), np.float32)
PLAIN = 64.0
SKY_BRIGHTNESS = 0.62
"""Exposed for the lights: a cloud stays well below the thesis's threshold of 179."""
CLOUDINESS = 0.6
_WARP = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP


def draw_sky(
    size: tuple[int, int],
    horizon_row: float,
    focal: float,
    rng: np.random.Generator,
    *,
    brightness: float = 1.0,
    cloudiness: float = 1.0,
) -> NDArray[np.uint8]:
    """Draw the sky around the horizon, below which its haze goes on.

    The focal length (px) says how high above the horizon a row is; 0 is no clouds.

    Returns:
        (height, width, 3) uint8, blue first.
    """
    width, height = size
    rows = np.arange(height, dtype=np.float32)[:, None]
    columns = np.arange(width, dtype=np.float32)[None, :] - 0.5 * width
    elevation = np.maximum((horizon_row - rows) / focal, 0.0)
    haze = np.exp(-elevation / 0.22)
    sky = ZENITH + haze[:, :, None] * (HORIZON - ZENITH)
    sky = np.repeat(sky, width, axis=1)
    if cloudiness > 0.0:
        # Clouds grow with their height above the horizon and are flatter than wide.
        near = elevation + 0.10
        map_x = (0.5 * _TILE + 240.0 * columns / focal / near).astype(np.float32)
        map_y = np.repeat((-400.0 * np.log(near)).astype(np.float32), width, axis=1)
        layer = smooth_noise((_TILE, _TILE), 150.0, rng, octaves=6, gain=0.55)
        light = smooth_noise((_TILE, _TILE), 60.0, rng, octaves=4)
        border = cv2.BORDER_REFLECT_101
        seen, lit = (
            cv2.remap(tile, map_x, map_y, cv2.INTER_LINEAR, borderMode=border)
            for tile in (layer, light)
        )
        cover = 0.85 * cloudiness * smoothstep(0.1, 1.5, seen) * (1.0 - 0.75 * haze)
        shade = np.clip(0.62 + 0.22 * lit + 0.16 * seen, 0.0, 1.0)[:, :, None]
        cloud = CLOUD_BASE + shade * (CLOUD - CLOUD_BASE)
        cloud -= sky
        cloud *= cover[:, :, None]
        sky += cloud
    sky *= brightness
    return to_bytes(sky)


class Panorama:
    """Sky and hills, drawn once, then turned and moved under the camera."""

    def __init__(self, camera: CameraModel, detail: float, rng: np.random.Generator) -> None:
        self._camera = camera
        width = camera.width + min(round(2 * TURN * camera.k[0]), 2 * _FRAMES * camera.width)
        rise = min(RISE * camera.k[0], _FRAMES * camera.height)
        self._horizon_row = round(camera.height + rise)
        self._middle = 0.5 * (width - 1)
        size = width, self._horizon_row + _BELOW
        sky = draw_sky(size, self._horizon_row, camera.k[0], rng, cloudiness=detail)
        ridge = smooth_noise((2, width), 0.12 * camera.k[0], rng, octaves=5)[0]
        top = self._horizon_row - HILLS * camera.k[0] * np.clip(0.5 + 0.3 * ridge, 0.05, 1.0)
        highest = math.floor(top.min())
        rows = np.arange(highest, sky.shape[0], dtype=np.float32)[:, None]
        cover = np.clip(rows - top + 0.5, 0.0, 1.0)[:, :, None]
        fade = np.clip((self._horizon_row - rows) / (HILLS * camera.k[0]), 0.0, 1.0)[:, :, None]
        hill = HORIZON + (0.35 + 0.65 * fade) * (_HILL - HORIZON)
        low = sky[highest:]
        low[...] = np.rint(low + cover * (hill - low)).astype(np.uint8)
        self._sky = sky

    def view(self, pose: CameraPose) -> NDArray[np.uint8]:
        """A new sky, (height, width, 3), of the sky; below the horizon there is haze."""
        # Where the horizon is straight ahead, and its slope in the image.
        ahead = pose.rotation.T @ (pose.rotation[:, 2] * (1.0, 1.0, 0.0))
        ((x, y),) = seen_by(self._camera, ahead[None]).tolist()
        slope = math.atan2(pose.rotation[2, 0], -pose.rotation[2, 1])
        c, s = math.cos(slope), math.sin(slope)
        centre = self._middle - self._camera.k[0] * pose.yaw
        row = self._horizon_row + s * x - c * y
        level = np.array([(c, s, centre - c * x - s * y), (-s, c, row)])
        image = np.empty((self._camera.height, self._camera.width, 3), np.uint8)
        lowest = max(y + math.tan(slope) * (column - x) for column in (0, self._camera.width))
        rows = min(max(math.ceil(lowest) + 2, 0), self._camera.height)
        if rows:
            size, border = (self._camera.width, rows), cv2.BORDER_REFLECT_101
            image[:rows] = cv2.warpAffine(self._sky, level, size, flags=_WARP, borderMode=border)
        image[rows:] = np.rint(HORIZON).astype(np.uint8)
        return image


class Background:
    """An image at infinity, seen by a camera that turns a little."""

    def __init__(
        self, kind: str, camera: CameraModel, color: bool, detail: float, rng: np.random.Generator
    ) -> None:
        self._camera = camera
        size = camera.width + 2 * MARGIN, camera.height + 2 * MARGIN
        image = _draw(kind, size, camera, detail, rng)
        self._wide: Pixels = image if color else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
        inside = slice(MARGIN, -MARGIN)
        self._middle: Pixels = np.ascontiguousarray(self._wide[inside, inside])

    def view(self, turned: Matrix | None) -> Pixels:
        """A new image, by the camera's rotation from its steady attitude; None for none."""
        if turned is None:
            return self._middle.copy()
        k = self._camera.matrix
        shift = np.array([(1.0, 0.0, MARGIN), (0.0, 1.0, MARGIN), (0.0, 0.0, 1.0)])
        wide_from_frame = shift @ k @ turned.T @ np.linalg.inv(k)
        size, border = (self._camera.width, self._camera.height), cv2.BORDER_REPLICATE
        return cv2.warpPerspective(
            self._wide, wide_from_frame, size, flags=_WARP, borderMode=border
        )


def _draw(
    kind: str, size: tuple[int, int], camera: CameraModel, detail: float, rng: np.random.Generator
) -> NDArray[np.uint8]:
    if kind == 'sky':
        clouds = CLOUDINESS * detail
        return draw_sky(
            size, 1.25 * size[1], camera.k[0], rng, brightness=SKY_BRIGHTNESS, cloudiness=clouds
        )
    if kind == 'plain':
        return np.full((*size[::-1], 3), round(PLAIN), np.uint8)
    return _draw_foam(size, camera.width / 640.0, detail, rng)


def _draw_foam(
    size: tuple[int, int], unit: float, detail: float, rng: np.random.Generator
) -> NDArray[np.uint8]:
    """Boards of extruded foam: a fine grain, faint flow marks, seams, uneven lamplight."""
    width, height = size
    grain = smooth_noise((height, width), 5.0 * unit, rng, octaves=2)
    flow = smooth_noise((height, width), 12.0 * unit, rng, octaves=3, stretch=14.0)
    y, x = np.mgrid[0:height, 0:width].astype(np.float32)
    lamp = np.exp(-(((x / width - 0.42) / 0.75) ** 2 + ((y / height - 0.35) / 0.8) ** 2))
    shade = 0.62 + 0.5 * lamp + detail * (0.012 * grain + 0.018 * flow)
    for part in (0.27, 0.73):
        seam = np.abs(x - part * width - 0.01 * y)
        shade -= 0.16 * np.exp(-((seam / (1.6 * unit)) ** 2))
    return to_bytes(FOAM * shade[:, :, None])
