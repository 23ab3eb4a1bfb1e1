"""The Hough transform of an edge image (thesis eq. 3.25), in MATLAB's cells."""

from __future__ import annotations

import math
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.point_operations import Mask

Accumulator = NDArray[Any]  # whole numbers: float32 as OpenCV counts, or intp as NumPy does

# More would be hundreds of megabytes per frame, for cells far smaller than a pixel.
MAX_CELLS = 2**24
_TABLE_BYTES = 2**26
_BLOCK_VOTES = 2**20
_TWO_BYTES = np.dtype('<u2')


class HoughGrid:
    """The cells of the Hough transform for one size of image, and the counting of votes.

    rho and theta are those of `normal_form`, in coordinates of the edge image.

    Attributes:
        theta: (columns,) rad, from -pi/2 up to below pi/2 in equal steps of at most the resolution.
        rho: (cells,) px, symmetric about 0; steps of the resolution, as wide as the diagonal.
        first_reachable_cell: cells of rho before this one get no vote: cos(theta) and coordinates
            are not negative.
    """

    def __init__(
        self, height: int, width: int, rho_resolution: float, theta_resolution_deg: float
    ) -> None:
        """Lay the cells out, for edge images of so many rows and columns.

        Raises:
            ValueError: there would be more than `MAX_CELLS` cells.
        """
        # 90 / (90 / 161) is above 161 by rounding, which must not make a 162nd step.
        quarter = math.ceil(90 / theta_resolution_deg - 1e-9)
        half = math.ceil(math.hypot(height - 1, width - 1) / rho_resolution)
        if 2 * quarter * (2 * half + 1) > MAX_CELLS:
            raise ValueError(
                f'{2 * quarter} x {2 * half + 1} Hough cells are more than {MAX_CELLS}: '
                'take coarser resolutions or fewer rows'
            )
        degrees = np.linspace(-90, 90, 2 * quarter + 1)[:-1]
        self.theta: NDArray[np.float64] = degrees * (np.pi / 180)
        self.rho: NDArray[np.float64] = np.arange(-half, half + 1.0) * rho_resolution
        self._width = width
        # The cell of pixel (x, y) is the whole part of the sum of two entries.
        self._x_part = np.outer(np.arange(width), np.cos(self.theta)) / rho_resolution
        self._y_part = np.outer(np.arange(height), np.sin(self.theta)) / rho_resolution
        self._y_part += half + 0.5
        self.first_reachable_cell = int(self._y_part[-1, 0])
        self.shape = self.theta.size, self.rho.size - self.first_reachable_cell
        self._column_starts = np.arange(self.theta.size) * self.shape[1] - self.first_reachable_cell
        self._table = self._pixel_table()

    def accumulate(self, edges: Mask) -> Accumulator:
        """Count the edge pixels (height, width) uint8, 0 or 1, contiguous, of every cell.

        Returns:
            (theta, rho) votes, rho from `first_reachable_cell` on. This is the transpose of
            MATLAB's matrix: its column-major order, which decides between equal peaks, is the
            order in memory.
        """
        return self.count(np.flatnonzero(edges.view(np.bool_)))

    def count(self, pixels: NDArray[np.intp]) -> Accumulator:
        """As `accumulate`, of edge pixels that are given by their indices in the flat image."""
        # Each block makes all cells anew, which is not to take longer than to count its votes.
        block = max(1, max(_BLOCK_VOTES, math.prod(self.shape)) // self.theta.size)
        votes = self._count(pixels[:block])
        for start in range(block, pixels.size, block):
            votes += self._count(pixels[start : start + block])
        return votes

    def _count(self, pixels: NDArray[np.intp]) -> Accumulator:
        flat = self._flat_cells(pixels)
        size = math.prod(self.shape)
        if flat.dtype == _TWO_BYTES and flat.size:
            # OpenCV counts pairs of bytes; NumPy would first make 64-bit numbers of all cells.
            # A table's pixels are too few for float32 to lose count.
            octets = flat.view(np.uint8).reshape(*flat.shape, 2)
            rows = -(-size // 256)
            counts = cv2.calcHist([octets], (1, 0), None, (rows, 256), (0, rows, 0, 256))
            return counts.ravel()[:size].reshape(self.shape)
        return np.bincount(flat.ravel(), minlength=size).reshape(self.shape)

    def _flat_cells(self, pixels: NDArray[np.intp]) -> NDArray[np.integer]:
        """The cells in which each pixel votes, indices of the flat accumulator: (pixels, theta)."""
        if self._table is not None:
            # Without 'clip', NumPy would buffer the rows to check indices that are in range.
            return self._table.take(pixels, axis=0, mode='clip')
        y, x = np.divmod(pixels, self._width)
        position = self._x_part.take(x, axis=0, mode='clip')
        position += self._y_part.take(y, axis=0, mode='clip')
        flat: NDArray[np.intp] = position.astype(np.intp)
        flat += self._column_starts
        return flat

    def _pixel_table(self) -> NDArray[np.integer] | None:
        """`_flat_cells` of all pixels, or None where the table would be too large."""
        dtype = _TWO_BYTES if math.prod(self.shape) <= 2**16 else np.dtype(np.int32)
        height = self._y_part.shape[0]
        shape = (height, self._width, self.theta.size)
        if math.prod(shape) * dtype.itemsize > _TABLE_BYTES:
            return None
        table = np.empty(shape, dtype)
        for y in range(height):
            np.add(self._x_part, self._y_part[y], out=table[y], casting='unsafe')
        # Below 0 in the first column; 16 bits wrap around there and back again.
        table += self._column_starts.astype(dtype)
        return table.reshape(-1, self.theta.size)


class HoughVideo:
    """The Hough transform of one edge image after the other.

    In a video most edges stay where they were: only pixels that came or went are counted. Votes
    are whole numbers, so the sums are those of the whole image.
    """

    def __init__(self, grid: HoughGrid) -> None:
        self.grid = grid
        self._edges: Mask | None = None
        self._votes: Accumulator | None = None

    def accumulate(self, edges: Mask) -> Accumulator:
        """As `HoughGrid.accumulate`; neither ``edges`` nor the votes may be changed."""
        # None until the votes are those of these edges: memory may run out in between.
        before, self._edges = self._edges, None
        if before is None or self._votes is None or not self._follow(before, edges, self._votes):
            self._votes = self.grid.accumulate(edges)
        self._edges = edges
        return self._votes

    def _follow(self, before: Mask, edges: Mask, votes: Accumulator) -> bool:
        """Bring the votes up to date, unless counting all of them is less work."""
        changed = cv2.bitwise_xor(before, edges)
        if cv2.countNonZero(changed) >= cv2.countNonZero(edges):
            return False
        pixels = np.flatnonzero(changed.view(np.bool_))
        came = edges.ravel().take(pixels).view(np.bool_)
        for some, add in ((pixels[came], np.add), (pixels[~came], np.subtract)):
            if some.size:
                add(votes, self.grid.count(some), out=votes)
        return True
