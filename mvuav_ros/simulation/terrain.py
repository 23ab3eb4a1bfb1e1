"""The land around the runway: fields, woods, a river, roads, houses, the airfield's grass."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.simulation.texture import smooth_noise, smoothstep, to_bytes

STEP = 2.5
"""Size of a texel, m."""
COLUMNS, ROWS = 2048, 1536
ORIGIN = (-2200.0, -1920.0)
"""x and y of the first corner, m."""
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
        (`ROWS`, `COLUMNS`, 3) uint8, blue first; columns along x, rows along y.
    """
    rng = np.random.default_rng((seed, 1001))
    x = (ORIGIN[0] + STEP * (np.arange(COLUMNS) + 0.5)).astype(np.float32)[None, :]
    y = (ORIGIN[1] + STEP * (np.arange(ROWS) + 0.5)).astype(np.float32)[:, None]
    land = _draw_fields(x, y, detail, rng)
    mottle = 1.0 + 0.07 * detail * smooth_noise((ROWS, COLUMNS), 60.0, rng, octaves=5)
    wood = _draw_woods(land, y, detail, rng)
    _draw_airfield(land, x, y, length)
    _blend(land, _WATER, _river(x, y, RIVER_WIDTH))
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
    inside = (0.5 * width - np.abs(distance)) / np.float32(STEP) + 0.5
    return np.asarray(np.clip(inside, 0.0, 1.0), np.float32)


def _draw_fields(x: Plane, y: Plane, detail: float, rng: np.random.Generator) -> Plane:
    """A patchwork turned against the runway, each patch with its colour and its furrows."""
    angle = 0.37
    bend = smooth_noise((ROWS, COLUMNS), 300.0, rng, octaves=2)
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
    where = smooth_noise((ROWS, COLUMNS), 200.0, rng, octaves=5, gain=0.55)
    where = where - 2.0 * (1.0 - smoothstep(120.0, 260.0, np.abs(y)))
    tree = smooth_noise((ROWS, COLUMNS), 4.0, rng, octaves=2)
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


def _river(x: Plane, y: Plane, width: float) -> Plane:
    middle = RIVER_X + 45.0 * np.sin(y / 210.0) + 22.0 * np.sin(y / 83.0 + 1.0)
    return _strip((x - middle).astype(np.float32), width)


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
        column, row = int(rng.integers(0, COLUMNS - 8)), int(rng.integers(0, ROWS - 8))
        x, y = ORIGIN[0] + STEP * column, ORIGIN[1] + STEP * row
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
