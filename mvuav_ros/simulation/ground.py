"""The ground plane as a camera sees it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import accumulate
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.simulation.airfield import TERRAIN_ORIGIN, TERRAIN_STEP, Surface, draw_terrain
from mvuav_ros.simulation.pinhole import CameraPose, seen_by
from mvuav_ros.simulation.sky import HORIZON
from mvuav_ros.simulation.texture import tileable_noise, to_bytes
from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.frames import Matrix, read_only
from mvuav_ros.vision.point_operations import Pixels

_PAD = 1
_MIN_SIZE = 4

Floats = NDArray[np.float32]


@dataclass(frozen=True)
class _Axis:
    """Where the reductions along one axis lie: sizes in texels, the whole texture first; else m."""

    origin: float
    step: float
    sizes: list[int]
    wraps: bool

    @property
    def offsets(self) -> list[int]:
        """Where each reduction begins, texels."""
        return [*accumulate((size + 2 * _PAD for size in self.sizes[:-1]), initial=_PAD)]

    @property
    def total(self) -> int:
        """Texels of all reductions together."""
        return sum(size + 2 * _PAD for size in self.sizes)

    def texels(
        self, metres: Floats, bins: NDArray[np.int32], footprint: NDArray[np.float64]
    ) -> Floats:
        """In the row of reductions, at places whose bins say what a pixel covers there (m)."""
        level = np.log2(np.maximum(footprint / self.step, 1.0)).astype(int)
        level = np.minimum(level, len(self.sizes) - 1)
        scale = np.array(self.sizes, np.float32)[level]
        start = np.array(self.offsets, np.float32)[level] - np.float32(0.5)
        # In periods: what is left of the decimal point is how often the texture was repeated.
        period = self.sizes[0] * self.step
        place = metres * np.float32(1.0 / period) - np.float32(self.origin / period)
        if self.wraps:
            place -= np.floor(place)
        place *= scale.take(bins, mode='clip')
        place += start.take(bins, mode='clip')
        return place


class Ripmap:
    """All reductions of one ground texture by powers of two along x and along y, in one image.

    A pixel near the horizon covers metres across but a kilometre along: a mipmap, reduced alike
    in both directions, would either flicker along the runway or blur its edges across.
    """

    def __init__(
        self, texture: Pixels, origin: tuple[float, float], step: tuple[float, float], *, wrap: bool
    ) -> None:
        """Reduce a texture (ny, nx, channels); columns go along x, rows along y.

        Its first corner (origin) and the size of a texel (step) are x and y, m; one that wraps
        goes on forever by repeating itself.
        """
        ny, nx = texture.shape[:2]
        self._x = _Axis(origin[0], step[0], _halvings(nx), wrap)
        self._y = _Axis(origin[1], step[1], _halvings(ny), wrap)
        border = cv2.BORDER_WRAP if wrap else cv2.BORDER_REPLICATE
        atlas = np.zeros((self._y.total, self._x.total, texture.shape[2]), np.uint8)
        across = texture
        for rows, y0 in zip(self._y.sizes, self._y.offsets, strict=True):
            if rows != ny:
                across = cv2.resize(across, (nx, rows), interpolation=cv2.INTER_AREA)
            level = across
            for columns, x0 in zip(self._x.sizes, self._x.offsets, strict=True):
                if columns != nx:
                    level = cv2.resize(level, (columns, rows), interpolation=cv2.INTER_AREA)
                padded = cv2.copyMakeBorder(level, _PAD, _PAD, _PAD, _PAD, border)
                atlas[y0 - _PAD : y0 + rows + _PAD, x0 - _PAD : x0 + columns + _PAD] = padded
        self._atlas = read_only(atlas)

    def sample(
        self,
        x: Floats,
        y: Floats,
        bins: NDArray[np.int32],
        along: NDArray[np.float64],
        across: NDArray[np.float64],
    ) -> Pixels:
        """The texture, (rows, columns, channels), at places on the ground, (rows, columns), m.

        ``bins`` says which entries of ``along`` and ``across`` a pixel covers along x and y, m.
        """
        map_x, map_y = self._x.texels(x, bins, along), self._y.texels(y, bins, across)
        border = cv2.BORDER_REPLICATE
        return cv2.remap(self._atlas, map_x, map_y, cv2.INTER_LINEAR, borderMode=border)


def _halvings(size: int) -> list[int]:
    sizes = [size]
    while sizes[-1] % 2 == 0 and sizes[-1] // 2 >= _MIN_SIZE:
        sizes.append(sizes[-1] // 2)
    return sizes


MAX_DEPTH = 60_000.0  # depth at which the ground ends in haze, m
MIN_DEPTH = 1.0
_BAND_ROWS = 48  # the image is drawn in bands whose arrays fit into the processor's cache
_BIN_SHIFT = 22
"""Depth goes into bins of half an octave: a float's exponent and the first bit after it."""
_HAZE_SHIFT = 18
_GRAIN_REACH = 4.0  # grass grain is drawn where a pixel covers less than this along the view, m

_GRAIN_STEP, _GRAIN_SIZE = 0.25, 512


class Ground(NamedTuple):
    """Textures of the ground."""

    land: Ripmap
    runway: Ripmap
    grain: Ripmap | None
    corners: NDArray[np.float64]  # (4, 3), m: the rectangle that the runway's texture covers


@lru_cache(maxsize=2)
def load_ground(width: float, length: float, detail: float, seed: int) -> Ground:
    """Draw the textures (half a second), or take them from the last flights."""
    land = draw_terrain(length, detail, seed)
    surface = Surface(land, width, length, detail, seed)
    grain = None
    if detail > 0.0:
        rng = np.random.default_rng((seed, 1003))
        noise = tileable_noise(_GRAIN_SIZE, 14.0, rng)
        grass = to_bytes(128.0 * (1.0 + 0.08 * detail * noise))
        step = (_GRAIN_STEP, _GRAIN_STEP)
        grain = Ripmap(cv2.merge([grass] * 3), (0.0, 0.0), step, wrap=True)
    x0, y0 = surface.origin
    x1, y1 = x0 + surface.size[0], y0 + surface.size[1]
    return Ground(
        Ripmap(land, TERRAIN_ORIGIN, (TERRAIN_STEP, TERRAIN_STEP), wrap=True),
        Ripmap(surface.texture, surface.origin, surface.step, wrap=False),
        grain,
        read_only(np.array([(x0, y0, 0.0), (x1, y0, 0.0), (x1, y1, 0.0), (x0, y1, 0.0)])),
    )


class GroundPainter:
    """Draws the ground below the horizon into images of one camera."""

    def __init__(self, ground: Ground, camera: CameraModel, visibility: float) -> None:
        self._ground = ground
        self._camera = camera
        self._visibility = visibility
        self._columns = np.arange(camera.width, dtype=np.float32)
        self._rows = np.arange(camera.height, dtype=np.float32)

    def paint(self, image: Pixels, pose: CameraPose) -> None:
        """Paint the ground over an image of the sky, (height, width, 3) uint8, in place."""
        rays = pose.rotation @ np.linalg.inv(self._camera.matrix)
        height = float(pose.position[2])
        # How far a ray of unit depth falls; depth is height / fall.
        fall_x, fall_y, fall_1 = -rays[2]
        least = np.float32(height / MAX_DEPTH)
        table = _FootprintTable(height, self._camera.k[0], self._visibility)
        strip = self._strip_mask(pose)
        for first in range(0, self._camera.height, _BAND_ROWS):
            last = min(first + _BAND_ROWS, self._camera.height)
            across, down = (0.0, self._camera.width - 1.0), (float(first), last - 1.0)
            corner_falls = [fall_x * u + fall_y * v + fall_1 for u in across for v in down]
            if max(corner_falls) <= least:
                continue
            column_part = self._columns * np.float32(fall_x)
            row_part = self._rows[first:last] * np.float32(fall_y) + np.float32(fall_1)
            fall = row_part[:, None] + column_part
            mask = None
            if min(corner_falls) <= least:
                mask = (fall > least).view(np.uint8) * np.uint8(255)
                np.maximum(fall, least, out=fall)
            band = self._draw_band(fall, rays, pose, first, table, strip[first:last])
            if height / min(max(min(corner_falls), float(least)), 1e9) > 0.01 * self._visibility:
                band = table.add_haze(band, fall)
            if mask is None:
                image[first:last] = band
            else:
                cv2.copyTo(band, mask, image[first:last])

    def _draw_band(
        self,
        fall: Floats,
        rays: Matrix,
        pose: CameraPose,
        first: int,
        table: _FootprintTable,
        strip: Pixels,
    ) -> Pixels:
        rows = self._rows[first : first + len(fall)]
        depth = np.float32(pose.position[2]) / fall
        places = []
        for axis in (0, 1):
            row_part = rows * np.float32(rays[axis, 1]) + np.float32(rays[axis, 2])
            place = row_part[:, None] + self._columns * np.float32(rays[axis, 0])
            place *= depth
            place += np.float32(pose.position[axis])
            places.append(place)
        x, y = places
        bins = (fall.view(np.int32) >> _BIN_SHIFT) - table.first_bin
        band = self._ground.land.sample(x, y, bins, table.along, table.between)
        left, top, columns, height = cv2.boundingRect(strip)
        if columns and height:
            part = (slice(top, top + height), slice(left, left + columns))
            where = x[part], y[part], bins[part]
            runway = self._ground.runway.sample(*where, table.along, table.across)
            cv2.copyTo(runway, strip[part], band[part])
        # The nearest pixels of a band lie at its bottom, or at a side of it when banking.
        nearest = float(max(fall[-1, 0], fall[-1, -1], fall[0, 0], fall[0, -1]))
        covered = pose.position[2] / (self._camera.k[0] * nearest * min(nearest, 1.0))
        if self._ground.grain is not None and covered < _GRAIN_REACH:
            grain = self._ground.grain.sample(x, y, bins, table.along, table.across)
            cv2.multiply(band, grain, dst=band, scale=1.0 / 128.0)
        return band

    def _strip_mask(self, pose: CameraPose) -> Pixels:
        """255 where the texture of the runway is seen."""
        mask = np.zeros((self._camera.height, self._camera.width), np.uint8)
        polygon = (self._ground.corners - pose.position) @ pose.rotation
        polygon = _cut(polygon, polygon[:, 2] - MIN_DEPTH)
        # To the frame and somewhat more, since OpenCV's coordinates overflow.
        for axis, size in enumerate((self._camera.width, self._camera.height)):
            focal, centre = self._camera.matrix[axis, (axis, 2)].tolist()
            for sign, limit in ((1.0, -float(size)), (-1.0, 2.0 * size)):
                beyond = focal * polygon[:, axis] + (centre - limit) * polygon[:, 2]
                polygon = _cut(polygon, sign * beyond)
        if len(polygon) >= 3:
            places = np.rint(seen_by(self._camera, polygon) * 16).astype(np.int32)
            cv2.fillConvexPoly(mask, places, 255, cv2.LINE_8, 4)
        return mask


class _FootprintTable:
    """What a pixel covers on the ground, and how much haze is before it, by its depth."""

    def __init__(self, height: float, focal: float, visibility: float) -> None:
        self.first_bin, falls = _bins(_BIN_SHIFT)
        depth = np.minimum(height / falls, MAX_DEPTH)
        self.across = depth / focal
        self.along = self.across * np.maximum(1.0 / falls, 1.0)
        # Land is seen from any direction: between both, neither blurred nor flickering.
        self.between = self.across**0.6 * self.along**0.4
        self._first_haze, falls = _bins(_HAZE_SHIFT)
        clear = np.exp(-np.minimum(height / falls, MAX_DEPTH) / visibility)
        self._clear = np.rint(255.0 * clear).astype(np.uint8)

    def add_haze(self, band: Pixels, fall: Floats) -> Pixels:
        """The band with haze before it."""
        steps = np.right_shift(fall.view(np.int32), _HAZE_SHIFT)
        steps -= self._first_haze
        clear = np.take(self._clear, steps, mode='clip')
        clear3 = cv2.merge([clear] * 3)
        seen = cv2.multiply(band, clear3, scale=1.0 / 255.0)
        return cv2.add(seen, cv2.LUT(clear3, _HAZE))


def _bins(shift: int) -> tuple[int, NDArray[np.float64]]:
    """The first bin's number and the middle of each, for falls from 2^-20 to 4."""
    first, last = (int(np.float32(fall).view(np.int32)) >> shift for fall in (2.0**-20, 4.0))
    edges = (np.arange(first, last + 2, dtype=np.int64) << shift).astype(np.int32)
    edges = edges.view(np.float32).astype(np.float64)
    return first, np.sqrt(edges[:-1] * edges[1:])


def _cut(corners: NDArray[np.float64], inside: NDArray[np.float64]) -> NDArray[np.float64]:
    """The part of a flat polygon (n, 3) on one side of a plane, by how far inside corners are."""
    kept: list[NDArray[np.float64]] = []
    for here, following, a, b in zip(
        corners, np.roll(corners, -1, axis=0), inside, np.roll(inside, -1), strict=True
    ):
        if a >= 0.0:
            kept.append(here)
        if (a >= 0.0) != (b >= 0.0):
            kept.append(here + a / (a - b) * (following - here))
    return np.array(kept).reshape(-1, 3)


_HAZE: Pixels = np.rint(HORIZON * (255.0 - np.arange(256)[:, None]) / 255.0).astype(np.uint8)[None]
"""What haze adds to a pixel, by how clear the air before it is, 0 to 255."""
