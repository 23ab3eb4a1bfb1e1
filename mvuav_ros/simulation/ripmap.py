"""Textures reduced in both directions independently, so that grazing views are sampled right."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import accumulate

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.frames import read_only
from mvuav_ros.vision.point_operations import Pixels

_PAD = 1
_SMALLEST = 4

Floats = NDArray[np.float32]


@dataclass(frozen=True)
class _Axis:
    """Where the reductions along one axis lie: sizes in texels, the whole texture first; else m."""

    origin: float
    step: float
    sizes: list[int]

    @property
    def period(self) -> float:
        """Length of the texture, m."""
        return self.sizes[0] * self.step

    @property
    def offsets(self) -> list[int]:
        """Where each reduction begins, texels."""
        return [*accumulate((size + 2 * _PAD for size in self.sizes[:-1]), initial=_PAD)]

    @property
    def total(self) -> int:
        """Texels of all reductions together."""
        return sum(size + 2 * _PAD for size in self.sizes)

    def place(self, footprint: NDArray[np.float64]) -> tuple[Floats, Floats]:
        """For pixels that cover so much (m): the size of their reduction, and its beginning."""
        level = np.log2(np.maximum(footprint / self.step, 1.0)).astype(int)
        level = np.minimum(level, len(self.sizes) - 1)
        scale = np.array(self.sizes, np.float64)[level]
        start = np.array(self.offsets, np.float64)[level] - 0.5
        return scale.astype(np.float32), start.astype(np.float32)


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
        goes on for ever by repeating itself.
        """
        ny, nx = texture.shape[:2]
        self._wrap = wrap
        self._x = _Axis(origin[0], step[0], _halvings(nx))
        self._y = _Axis(origin[1], step[1], _halvings(ny))
        width, height = self._x.total, self._y.total
        if max(width, height) > 32766:
            raise ValueError(f'a texture of {nx} x {ny} is too large for OpenCV to sample')
        border = cv2.BORDER_WRAP if wrap else cv2.BORDER_REPLICATE
        atlas = np.zeros((height, width, texture.shape[2]), np.uint8)
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
        scratch: tuple[Floats, Floats, Floats],
    ) -> Pixels:
        """Sample the texture at places on the ground, (rows, columns), m.

        Of every pixel ``bins`` says which entries of ``along`` and ``across`` hold: what it covers
        along x and y, m. The scratch is three contiguous arrays of the same shape as x.

        Returns:
            (rows, columns, channels).
        """
        map_x, map_y, factor = scratch
        self._to_atlas(x, bins, along, self._x, (map_x, factor))
        self._to_atlas(y, bins, across, self._y, (map_y, factor))
        return cv2.remap(
            self._atlas, map_x, map_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )

    def _to_atlas(
        self,
        metres: Floats,
        bins: NDArray[np.int32],
        footprint: NDArray[np.float64],
        axis: _Axis,
        scratch: tuple[Floats, Floats],
    ) -> None:
        """Texels of the image along one axis, written to the first of ``scratch``."""
        result, factor = scratch
        scale, start = axis.place(footprint)
        # In periods: what is left of the decimal point is how often the texture was repeated.
        np.multiply(metres, np.float32(1.0 / axis.period), out=result)
        np.subtract(result, np.float32(axis.origin / axis.period), out=result)
        if self._wrap:
            np.floor(result, out=factor)
            np.subtract(result, factor, out=result)
        np.take(scale, bins, out=factor, mode='clip')
        np.multiply(result, factor, out=result)
        np.take(start, bins, out=factor, mode='clip')
        np.add(result, factor, out=result)


def _halvings(size: int) -> list[int]:
    sizes = [size]
    while sizes[-1] % 2 == 0 and sizes[-1] // 2 >= _SMALLEST:
        sizes.append(sizes[-1] // 2)
    return sizes
