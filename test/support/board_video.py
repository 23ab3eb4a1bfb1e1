"""Videos of a calibration board that is moved before a lens, drawn from a seed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.board import Board
from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.point_operations import Pixels
from mvuav_ros.vision.reprojection import rotation_of

Array = NDArray[np.float64]

TEXEL = 40  # px of the board's picture along a square
COLUMNS, ROWS = 9, 6  # inner corners of the board
SQUARE = 0.03  # side of a square, m
_remap: Any = cv2.remap
WIDTH, HEIGHT = 640, 480  # of the images through a lens from the seed, px


@dataclass(frozen=True)
class BoardVideo:
    """How a checkerboard is moved and seen."""

    seed: int  # of the lens, the motion and all noise
    places: int = 40  # at which the board is held still, each tilted by 15 to 45 degrees
    pause: int = 4  # frames for which it is held
    steps: int = 5  # frames from one place to the next, in which motion blurs
    corner_noise: float = 0.2  # by which a corner is beside its place in a frame, px (1 sigma)
    lens: CameraModel | None = None  # that is looked through instead of one from the seed

    @property
    def camera(self) -> CameraModel:
        """The lens, if none is given the one of the seed."""
        if self.lens is not None:
            return self.lens
        rng = np.random.default_rng((self.seed, 1))
        focal = WIDTH * rng.uniform(0.7, 1.4)
        x, y = 0.5 * np.array((WIDTH, HEIGHT)) - 0.5 + rng.uniform(-12, 12, 2)
        k = (focal, 0.0, x, 0.0, focal * rng.uniform(0.995, 1.005), y, 0.0, 0.0, 1.0)
        edge = 0.5 * WIDTH / focal
        radial = rng.uniform(-0.16, 0.05) / edge**2
        d = (radial, -0.25 * radial / edge**2, *rng.uniform(-5e-4, 5e-4, 2), 0.0)
        return CameraModel(WIDTH, HEIGHT, k, d)

    @property
    def corners(self) -> Array:
        """(n, 3), of the inner corners from the board's middle, m; row after row."""
        points = Board(COLUMNS, ROWS, SQUARE).points
        return np.asarray(points - 0.5 * points[-1])

    def poses(self) -> Iterator[tuple[Array, Array]]:
        """Rotation vector and place (m) of the board's middle, (6,), and its step to the next."""
        rng = np.random.default_rng((self.seed, 2))
        camera, stops = self.camera, []
        size, focal = (camera.width, camera.height), camera.k[0]
        for _ in range(self.places):
            direction, tilt = rng.uniform(0, 2 * np.pi), np.radians(rng.uniform(15, 45))
            turn = (tilt * np.cos(direction), tilt * np.sin(direction), rng.uniform(-0.4, 0.4))
            depth = focal / camera.width * rng.uniform(0.35, 0.6)
            beside = rng.uniform(-0.25, 0.25, 2) * size / focal * depth
            stops.append(np.array((*turn, *beside, depth)))
        for here, there in zip(stops, stops[1:] + stops[:1], strict=True):
            yield from [(here, np.zeros(6))] * self.pause
            step = (there - here) / self.steps
            yield from ((here + number * step, step) for number in range(1, self.steps))

    def images(self) -> Iterator[Pixels]:
        """Grey images, with corners beside their places, motion blur and a sensor's noise."""
        rng = np.random.default_rng((self.seed, 3))
        ground = float(rng.uniform(60, 160))
        camera = self.camera
        size = camera.width, camera.height
        # Of the centres of quarters of pixels.
        axes = (np.arange(2 * side) / 2 - 0.25 for side in size)
        pixels = np.stack(np.meshgrid(*axes), axis=-1)
        rays = camera.undistort(pixels.reshape(-1, 2)).reshape(pixels.shape).astype(np.float32)
        picture = self.picture()
        for pose, step in self.poses():
            squares = pose[5] / camera.k[0] / SQUARE  # per pixel
            noise = rng.normal(0, self.corner_noise * squares, (ROWS, COLUMNS, 2))
            moved = np.pad(noise, ((2, 2), (2, 2), (0, 0)), mode='edge').astype(np.float32)
            # Over four tenths of the time between two frames.
            parts = np.linspace(-0.2, 0.2, 5) if step.any() else np.zeros(1)
            mean = np.zeros(rays.shape[:2], np.float32)
            for part in parts:
                met = cv2.perspectiveTransform(rays, self._texels(pose + part * step))
                met -= TEXEL * _remap(moved, (met + 0.5) / TEXEL, None, cv2.INTER_LINEAR)
                mean += _remap(picture, met, None, cv2.INTER_LINEAR, borderValue=(ground,))
            image = cv2.resize(mean / len(parts), size, interpolation=cv2.INTER_AREA)
            image = cv2.GaussianBlur(image, (0, 0), 0.6)
            yield np.clip(image + rng.normal(0, 1.5, image.shape), 0, 255).astype(np.uint8)

    def picture(self) -> Pixels:
        """The printed board with a white margin of one square."""
        squares = np.add.outer(np.arange(ROWS + 3), np.arange(COLUMNS + 3)) % 2
        colors = squares * 215 + 20
        colors[[0, -1]], colors[:, [0, -1]] = 235, 235
        return np.kron(colors, np.ones((TEXEL, TEXEL))).astype(np.uint8)

    def _texels(self, pose: Array) -> Array:
        """(3, 3), from rays, x / z and y / z, to the picture's pixels."""
        rotation = rotation_of(pose[:3])
        place = pose[3:] + rotation @ self.corners[0]
        plane = np.column_stack((rotation[:, 0], rotation[:, 1], place))
        first = 0.5 - 2 * TEXEL
        scale = TEXEL / SQUARE
        return np.linalg.inv(plane @ np.array([(1, 0, first), (0, 1, first), (0, 0, scale)]))
