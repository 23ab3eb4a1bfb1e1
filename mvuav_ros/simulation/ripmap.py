"""Textures reduced in both directions independently, so that grazing views are sampled right."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.frames import read_only
from mvuav_ros.vision.point_operations import Pixels

_PAD = 1
_SMALLEST = 4

Floats = NDArray[np.float32]


class Ripmap:
    """All reductions of one ground texture by powers of two along x and along y, in one image.

    A pixel near the horizon covers metres across but a kilometre along: a mipmap, reduced alike
    in both directions, would either flicker along the runway or blur its edges across.
    """

    def __init__(
        self,
        texture: Pixels,
        origin: tuple[float, float],
        step: tuple[float, float],
        *,
        wrap: bool,
    ) -> None:
        """Reduce a texture.

        Args:
            texture: (ny, nx, channels); columns go along x, rows along y.
            origin: x and y of the texture's first corner, m.
            step: size of a texel along x and y, m.
            wrap: whether the texture goes on for ever by repeating itself.
        """
        ny, nx = texture.shape[:2]
        self._origin, self._step, self._wrap = origin, step, wrap
        self._period = (nx * step[0], ny * step[1])
        self._nx, self._ny = _halvings(nx), _halvings(ny)
        self._column = _offsets(self._nx)
        self._row = _offsets(self._ny)
        width, height = _total(self._nx), _total(self._ny)
        if max(width, height) > 32766:
            raise ValueError(f'a texture of {nx} x {ny} is too large for OpenCV to sample')
        border = cv2.BORDER_WRAP if wrap else cv2.BORDER_REPLICATE
        atlas = np.zeros((height, width, texture.shape[2]), np.uint8)
        across = texture
        for j, rows in enumerate(self._ny):
            if j:
                across = cv2.resize(across, (nx, rows), interpolation=cv2.INTER_AREA)
            level = across
            for i, columns in enumerate(self._nx):
                if i:
                    level = cv2.resize(level, (columns, rows), interpolation=cv2.INTER_AREA)
                padded = cv2.copyMakeBorder(level, _PAD, _PAD, _PAD, _PAD, border)
                y0, x0 = self._row[j] - _PAD, self._column[i] - _PAD
                atlas[y0 : y0 + rows + 2 * _PAD, x0 : x0 + columns + 2 * _PAD] = padded
        self._atlas = read_only(atlas)

    def sample(
        self,
        x: Floats,
        y: Floats,
        bins: NDArray[np.int32],
        along: NDArray[np.float64],
        across: NDArray[np.float64],
        scratch: tuple[Floats, Floats, Floats],
    ) -> Pixels:
        """Sample the texture.

        Args:
            x: (rows, columns), m, on the ground.
            y: the same.
            bins: which entry of ``along`` and ``across`` holds for a pixel.
            along: what a pixel covers along x, m, for every bin.
            across: the same along y.
            scratch: three arrays of the shape of x, contiguous, to be overwritten.

        Returns:
            (rows, columns, channels).
        """
        map_x, map_y, factor = scratch
        self._to_atlas(x, bins, along, 0, self._nx, self._column, map_x, factor)
        self._to_atlas(y, bins, across, 1, self._ny, self._row, map_y, factor)
        return cv2.remap(
            self._atlas, map_x, map_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )

    def _to_atlas(
        self,
        metres: Floats,
        bins: NDArray[np.int32],
        footprint: NDArray[np.float64],
        axis: int,
        sizes: list[int],
        offsets: list[int],
        result: Floats,
        factor: Floats,
    ) -> None:
        level = np.log2(np.maximum(footprint / self._step[axis], 1.0)).astype(int)
        level = np.minimum(level, len(sizes) - 1)
        scale = np.array(sizes, np.float64)[level]
        start = np.array(offsets, np.float64)[level] - 0.5
        # In periods: what is left of the decimal point is how often the texture was repeated.
        np.multiply(metres, np.float32(1.0 / self._period[axis]), out=result)
        np.subtract(result, np.float32(self._origin[axis] / self._period[axis]), out=result)
        if self._wrap:
            np.floor(result, out=factor)
            np.subtract(result, factor, out=result)
        np.take(scale.astype(np.float32), bins, out=factor, mode='clip')
        np.multiply(result, factor, out=result)
        np.take(start.astype(np.float32), bins, out=factor, mode='clip')
        np.add(result, factor, out=result)


def _halvings(size: int) -> list[int]:
    sizes = [size]
    while sizes[-1] % 2 == 0 and sizes[-1] // 2 >= _SMALLEST:
        sizes.append(sizes[-1] // 2)
    return sizes


def _offsets(sizes: list[int]) -> list[int]:
    offsets = [_PAD]
    for size in sizes[:-1]:
        offsets.append(offsets[-1] + size + 2 * _PAD)
    return offsets


def _total(sizes: list[int]) -> int:
    return sum(size + 2 * _PAD for size in sizes)
