"""The land around the runway and the runway itself, as textures of the ground."""

from __future__ import annotations

import math
from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.simulation.texture import smooth_noise, smoothstep, to_bytes

TERRAIN_STEP = 2.5  # size of a texel, m
TERRAIN_SHAPE = (1536, 2048)  # rows and columns
TERRAIN_ORIGIN = (-2200.0, -1920.0)  # x and y of the first corner, m
RIVER_X, RIVER_WIDTH = -380.0, 34.0
ROAD_X, ROAD_SLOPE, ROAD_WIDTH = -260.0, 0.22, 9.0

_FIELDS = np.array(
    [
        (62, 118, 96),
        (70, 136, 122),
        (88, 158, 168),
        (54, 102, 82),
        (98, 142, 160),
        (72, 126, 100),
        (92, 118, 140),
        (60, 132, 108),
    ],
    np.float32,
)
_GRASS = np.array((66.0, 128.0, 108.0), np.float32)
_WOOD = np.array((38.0, 66.0, 46.0), np.float32)
_WATER = np.array((122.0, 104.0, 82.0), np.float32)
_ROAD = np.array((150.0, 148.0, 146.0), np.float32)
_CONCRETE = np.array((138.0, 142.0, 142.0), np.float32)

Plane = NDArray[np.float32]


def draw_terrain(length: float, detail: float, seed: int) -> NDArray[np.uint8]:
    """Draw the land without the runway, which lies along x from 0 and is so long (m).

    Returns:
        (*`TERRAIN_SHAPE`, 3) uint8, blue first; columns along x, rows along y.
    """
    rng = np.random.default_rng((seed, 1001))
    y, x = (
        (origin + TERRAIN_STEP * (np.arange(size) + 0.5)).astype(np.float32)
        for origin, size in zip(TERRAIN_ORIGIN[::-1], TERRAIN_SHAPE, strict=True)
    )
    x, y = x[None, :], y[:, None]
    land = _draw_fields(x, y, detail, rng)
    mottle = 1.0 + 0.07 * detail * smooth_noise(TERRAIN_SHAPE, 60.0, rng, octaves=5)
    wood = _draw_woods(land, y, detail, rng)
    _draw_airfield(land, x, y, length)
    river = RIVER_X + 45.0 * np.sin(y / 210.0) + 22.0 * np.sin(y / 83.0 + 1.0)
    _blend(land, _WATER, _strip((x - river).astype(np.float32), RIVER_WIDTH))
    _draw_roads(land, x, y)
    _draw_houses(land, rng, wood)
    land *= mottle[:, :, None]
    return to_bytes(land)


def _blend(land: Plane, color: Plane, cover: Plane) -> None:
    """Lay a colour over the land where there is any cover, 0 to 1."""
    part = np.nonzero(cover)
    covered = land[part]
    land[part] = covered + cover[part][:, None] * (color - covered)


def _strip(distance: Plane, width: float) -> Plane:
    """How much of each texel a strip covers, given the texel's distance from its middle."""
    inside = (0.5 * width - np.abs(distance)) / np.float32(TERRAIN_STEP) + 0.5
    return np.asarray(np.clip(inside, 0.0, 1.0), np.float32)


def _draw_fields(x: Plane, y: Plane, detail: float, rng: np.random.Generator) -> Plane:
    """A patchwork turned against the runway, each patch with its colour and its furrows."""
    angle = 0.37
    bend = smooth_noise(TERRAIN_SHAPE, 300.0, rng, octaves=2)
    u = (x * math.cos(angle) + y * math.sin(angle) + 18.0 * bend) / 260.0
    v = (y * math.cos(angle) - x * math.sin(angle)) / 170.0
    patch_u = np.floor(u)
    v = v + 0.35 * patch_u
    patch_v = np.floor(v)
    cell = (patch_u.astype(np.int32) * 31 + patch_v.astype(np.int32) * 17) % 97
    kinds = rng.integers(0, len(_FIELDS), 97)
    furrows = rng.uniform(8.0, 20.0, 97).astype(np.float32)
    land = _FIELDS[kinds].take(cell, axis=0)
    if detail > 0.0:
        wave = np.sin(2 * np.pi * furrows.take(cell) * (u - patch_u))
        land *= (1.0 + 0.035 * detail * wave)[:, :, None]
    hedge = np.minimum(
        np.minimum(u - patch_u, patch_u + 1.0 - u) * 260.0,
        np.minimum(v - patch_v, patch_v + 1.0 - v) * 170.0,
    )
    _blend(land, _WOOD, 0.75 * _strip(hedge.astype(np.float32), 6.0))
    return np.ascontiguousarray(land, np.float32)


def _draw_woods(land: Plane, y: Plane, detail: float, rng: np.random.Generator) -> Plane:
    """Woods, except right below the flight path, where these texels are too coarse for trees."""
    where = smooth_noise(TERRAIN_SHAPE, 200.0, rng, octaves=5, gain=0.55)
    where = where - 2.0 * (1.0 - smoothstep(120.0, 260.0, np.abs(y)))
    tree = smooth_noise(TERRAIN_SHAPE, 4.0, rng, octaves=2)
    wood = smoothstep(1.05, 1.15, where + 0.06 * tree)
    part = np.nonzero(wood)
    crowns = _WOOD * (1.0 + 0.28 * detail * tree[part])[:, None]
    land[part] += wood[part][:, None] * (crowns - land[part])
    return wood


def _draw_airfield(land: Plane, x: Plane, y: Plane, length: float) -> None:
    along = np.maximum(-220.0 - x, x - length - 220.0)
    across = np.abs(y + 40.0) - 190.0
    outside = np.maximum(along, across)
    _blend(land, _GRASS, 1.0 - smoothstep(0.0, 12.0, outside))
    between = smoothstep(-20.0, -15.0, x) * (1.0 - smoothstep(length + 15, length + 20, x))
    taxiway = _strip(y + 110.0, 15.0) * between
    for exit_x in (8.0, 0.5 * length, length - 8.0):
        reach = ((y > -112.0) & (y < 0.0)).astype(np.float32)
        taxiway = np.maximum(taxiway, _strip(x - exit_x, 15.0) * reach)
    apron = _strip(x - 0.3 * length, 180.0) * _strip(y + 165.0, 95.0)
    _blend(land, _CONCRETE, np.maximum(taxiway, apron))


def _draw_roads(land: Plane, x: Plane, y: Plane) -> None:
    slant = math.hypot(1.0, ROAD_SLOPE)
    crossing = ((x - ROAD_X - ROAD_SLOPE * y) / slant).astype(np.float32)
    lane = y - 420.0 - 60.0 * np.sin(x / 500.0)
    for road, width in ((crossing, ROAD_WIDTH), (np.asarray(lane, np.float32), 6.0)):
        _blend(land, _WOOD + 25.0, 0.6 * _strip(road, width + 8.0))
        _blend(land, _ROAD, _strip(road, width))


def _draw_houses(land: Plane, rng: np.random.Generator, wood: Plane) -> None:
    roofs = np.array([(72, 84, 138), (96, 100, 104), (188, 192, 194), (84, 92, 120)], np.float32)
    for _ in range(260):
        column, row = (int(rng.integers(0, size - 8)) for size in TERRAIN_SHAPE[::-1])
        x, y = TERRAIN_ORIGIN[0] + TERRAIN_STEP * column, TERRAIN_ORIGIN[1] + TERRAIN_STEP * row
        off_road = abs(x - ROAD_X - ROAD_SLOPE * y)
        near_road = 14.0 < off_road < 90.0 and abs(y) > 170.0
        near_lane = 15.0 < abs(y - 420.0 - 60.0 * math.sin(x / 500.0)) < 60.0
        if not (near_road or near_lane) or wood[row, column] > 0.5:
            continue
        height, width = rng.integers(3, 7, 2)
        roof = roofs[int(rng.integers(len(roofs)))]
        half = int(height) // 2
        land[row : row + half, column : column + width] = roof
        land[row + half : row + height, column : column + width] = 0.78 * roof


MARGIN_X, MARGIN_Y = 60.0, 6.0  # grass around the pavement that belongs to the texture, m
STRIPE = 0.9  # width of the side stripes, whose outer sides are the pavement's edges, m
_STEP_Y = 0.0625
_MAX_COLUMNS = 8192
_ASPHALT = np.array((92.0, 90.0, 88.0), np.float32)
_PAINT = np.array((236.0, 238.0, 238.0), np.float32)
_SEGMENTS = {'0': 'abcdef', '2': 'abged', '7': 'abc', '9': 'abcdfg'}
NUMBERS = ('27', '09')  # at the near and at the far end

_Adder = Callable[[float, float, float, float], None]


class Surface:
    """The texture (ny, nx, 3) uint8 of the runway, blue first; columns along x, rows along y.

    Of its first corner ``origin`` is x and y, m; ``step`` is the size of a texel, ``size`` the
    whole extent along both.
    """

    def __init__(
        self, land: NDArray[np.uint8], width: float, length: float, detail: float, seed: int
    ) -> None:
        rng = np.random.default_rng((seed, 1002))
        # Sizes are multiples of powers of two, so that they can be halved often.
        step_x = 0.25
        while (length + 2 * MARGIN_X) / step_x > _MAX_COLUMNS:
            step_x *= 2.0
        nx = 256 * math.ceil((length + 2 * MARGIN_X) / step_x / 256)
        ny = 64 * math.ceil((width + 2 * MARGIN_Y) / _STEP_Y / 64)
        self.step = (step_x, _STEP_Y)
        self.origin = (0.5 * (length - nx * step_x), -0.5 * ny * _STEP_Y)
        self._shape = (ny, nx)
        self._paint = np.zeros(self._shape, np.float32)
        ground = self._grass(land)
        pavement = self._pavement(width, length, detail, rng)
        cover = np.zeros(self._shape, np.float32)
        self._cover(cover, 0.0, length, -0.5 * width, 0.5 * width)
        ground += cover[:, :, None] * (pavement - ground)
        self._mark(width, length)
        self.size = nx * step_x, ny * _STEP_Y
        wear = 0.93 - 0.04 * detail * np.abs(smooth_noise((ny, nx), 40.0, rng, stretch=4.0))
        ground += (self._paint * wear)[:, :, None] * (_PAINT - ground)
        self.texture = to_bytes(ground)

    def _grass(self, land: NDArray[np.uint8]) -> Plane:
        """The terrain at this finer step, so that no seam shows."""
        ny, nx = self._shape
        scale = np.array(self.step) / TERRAIN_STEP
        shift = (np.array(self.origin) - TERRAIN_ORIGIN) / TERRAIN_STEP
        finer = np.column_stack((np.diag(scale), shift + 0.5 * scale - 0.5))
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        grass = cv2.warpAffine(land, finer, (nx, ny), flags=flags, borderMode=cv2.BORDER_WRAP)
        return grass.astype(np.float32)

    def _pavement(
        self, width: float, length: float, detail: float, rng: np.random.Generator
    ) -> Plane:
        x = self._centres(0)[None, :]
        y = self._centres(1)[:, None]
        shade = 1.0 + detail * (
            0.035 * smooth_noise(self._shape, 32.0, rng, octaves=3)
            + 0.05 * smooth_noise(self._shape, 16.0, rng, octaves=3, stretch=20.0)
        )
        # Lanes of the paving machine, and rubber where the wheels touch down.
        shade += 0.025 * detail * np.sign(np.sin(2 * np.pi * y / 15.0))
        for touchdown in (330.0, length - 330.0):
            rubber = np.exp(-(((x - touchdown) / 160.0) ** 2))
            wheels = np.exp(-(((np.abs(y) - 4.0) / 2.2) ** 2))
            shade -= 0.33 * rubber * wheels
        return np.asarray(_ASPHALT * shade[:, :, None], np.float32)

    def _mark(self, width: float, length: float) -> None:
        half = 0.5 * width
        for side in (1.0, -1.0):
            self._cover(self._paint, 0.0, length, side * half, side * (half - STRIPE))
        unit = width / 30.0
        dash = 80.0
        while dash + 30.0 < length - 80.0:
            self._cover(self._paint, dash, dash + 30.0, -0.45, 0.45)
            dash += 50.0
        for far in (False, True):
            self._mark_end(unit, half, length, far)

    def _mark_end(self, unit: float, half: float, length: float, far: bool) -> None:
        """Threshold bars, number, touchdown zone and aiming point, as seen when landing."""

        def add(x0: float, x1: float, y0: float, y1: float) -> None:
            if far:
                x0, x1, y0, y1 = length - x1, length - x0, -y1, -y0
            self._cover(self._paint, x0, x1, y0, y1)

        add(0.0, 1.2, -half, half)
        bars = 4
        pitch = (half - STRIPE - 3.0 * unit) / bars
        for side in (1.0, -1.0):
            for bar in range(bars):
                inner = side * (1.5 * unit + pitch * bar + 0.2 * pitch)
                add(6.0, 36.0, inner, inner + side * 0.55 * pitch)
            add(300.0, 345.0, side * 4.5 * unit, side * 10.5 * unit)
            for place in (150.0, 450.0):
                if place + 22.5 < 0.45 * length:
                    for strip in range(2):
                        inner = side * (5.0 + 3.0 * strip) * unit
                        add(place, place + 22.5, inner, inner + side * 1.8 * unit)
        draw_number(add, NUMBERS[far], 48.0, unit)

    def _cover(self, plane: Plane, x0: float, x1: float, y0: float, y1: float) -> None:
        """Raise a plane to what a rectangle (m) covers of each texel."""
        columns, cover_x = self._overlap(0, min(x0, x1), max(x0, x1))
        rows, cover_y = self._overlap(1, min(y0, y1), max(y0, y1))
        part = plane[rows, columns]
        np.maximum(part, cover_y[:, None] * cover_x[None, :], out=part)

    def _overlap(self, axis: int, low: float, high: float) -> tuple[slice, Plane]:
        """Which texels an interval (m) touches, and the part of each that it covers."""
        size = self._shape[1 - axis]
        first = (low - self.origin[axis]) / self.step[axis]
        last = (high - self.origin[axis]) / self.step[axis]
        start = min(max(math.floor(first), 0), size)
        stop = min(max(math.ceil(last), start), size)
        texel = np.arange(start, stop)
        cover = np.minimum(texel + 1.0, last) - np.maximum(texel, first)
        return slice(start, stop), np.clip(cover, 0.0, 1.0).astype(np.float32)

    def _centres(self, axis: int) -> Plane:
        size = self._shape[1 - axis]
        centres = self.origin[axis] + self.step[axis] * (np.arange(size) + 0.5)
        return np.asarray(centres, np.float32)


def draw_number(add: _Adder, number: str, x: float, unit: float) -> None:
    """Add the strokes of a number of two digits that begins at x, m; the unit is 1 on 30 m."""
    width, bar_x = 4.0 * unit, 1.6
    bar_y, middle, top = 0.22 * width, x + 7.0, x + 14.0
    for digit, left in zip(number, (5.0 * unit, -1.0 * unit), strict=True):
        right = left - width
        strokes = {
            'a': (top - bar_x, top, left, right),
            'b': (middle, top, right + bar_y, right),
            'c': (x, middle, right + bar_y, right),
            'd': (x, x + bar_x, left, right),
            'e': (x, middle, left, left - bar_y),
            'f': (middle, top, left, left - bar_y),
            'g': (middle - 0.5 * bar_x, middle + 0.5 * bar_x, left, right),
        }
        for segment in _SEGMENTS[digit]:
            add(*strokes[segment])
