"""Looking for a pipeline everywhere below the horizon, without knowing anything."""

from __future__ import annotations

import numpy as np

from mvuav_ros.vision.approach.channels import Table
from mvuav_ros.vision.approach.road.strip import CEILING, Shapes, bounds_of, contrasts
from mvuav_ros.vision.approach.road.targets import EdgeProfile

_RATIOS = (0.1, 0.2, 0.4)
"""Widths over the camera's height that are tried."""
_OFFSETS = np.array((-3.0, -1.5, -1.2, -0.7, -0.3, 0.0, 0.3, 0.7, 1.2, 1.5, 3.0))
"""The camera's ways from the strip's middle, in widths, that are tried."""
_SAMPLES = 6
_TAPER = 0.45
"""Depth of a band's first row, in depths of its last."""
_NARROWEST = 3.0
"""Px; a narrower near end tells nothing."""
_MOST_BEYOND = 0.2
"""Of the width: how far outside the image a vanishing point is looked for."""
_SHARE, _MOST = 0.25, 3
"""Of all places, those looked up in one frame, and strips of a band."""


class Band:
    """All strips of one width over height that end at about one depth below the horizon."""

    def __init__(
        self, look: EdgeProfile, depth: float, ratio: float, height: int, width: int
    ) -> None:
        """Lay out where to look on levelled images of that height and width.

        ``depth`` is the near end's below the horizon, px, ``ratio`` width over camera height.
        """
        self._width, self._height = ratio * depth, height
        self._slopes = np.stack([-(_OFFSETS + 0.5) * ratio, (0.5 - _OFFSETS) * ratio], axis=1)
        self._rows = np.unique(np.rint(np.geomspace(_TAPER * depth, depth, _SAMPLES))).astype(int)
        step = max(1, min(8, int(self._width / 4)))
        beyond = int(_MOST_BEYOND * width)
        self._points = np.arange(-beyond, width + beyond, step)
        x = self._points[:, None, None]
        left, right = (x + slopes[:, None] * self._rows for slopes in self._slopes.T)
        bounds = np.stack(bounds_of(left, right, look))
        bounds = np.rint(np.clip(bounds + 0.5, 0, width)).astype(np.int32)
        self._bounds = bounds.astype(np.float32)
        self._index = bounds + (self._rows * (width + 1)).astype(np.int32)
        self._middles = self._points[:, None] + 0.5 * self._slopes.sum(axis=1) * depth
        self.size = self._index.size

    def find(self, table: Table, look: EdgeProfile, horizon_row: float) -> Shapes:
        """The best strips of this band whose vanishing points lie on a row, best first."""
        top = round(horizon_row)
        found: list[tuple[float, ...]] = []
        if top + self._rows[0] < 0 or top + self._rows[-1] >= self._height:
            return np.empty((0, 4))
        channels, _, stride = table.shape
        flat = table.reshape(channels, -1)
        sums = flat.take(self._index + np.int32(top * stride), axis=1, mode='clip')
        _, size = contrasts(sums, self._bounds, look)
        gain = np.minimum(size, CEILING * look.floor).mean(axis=2)
        for _ in range(_MOST):
            point, number = np.unravel_index(int(gain.argmax()), gain.shape)
            if gain[point, number] <= look.floor:
                break
            found.append((self._points[point], horizon_row, *self._slopes[number]))
            # Strips whose near ends have nearly the same middle are the same strip.
            near = np.abs(self._middles - self._middles[point, number]) < 0.7 * self._width
            gain[near] = 0.0
        return np.array(found, np.float64).reshape(-1, 4)


class Search:
    """Takes a share of the bands in each frame, so that no frame takes long."""

    def __init__(self, look: EdgeProfile, height: int, width: int) -> None:
        self._bands = [
            Band(look, float(depth), ratio, height, width)
            for depth in np.geomspace(10, 0.6 * height, 9)
            for ratio in _RATIOS
            if _NARROWEST <= ratio * depth <= 0.9 * width
        ]
        self._effort = _SHARE * sum(band.size for band in self._bands)
        self._next = 0

    def find(self, table: Table, look: EdgeProfile, horizon_row: float) -> Shapes:
        """Candidates of the next bands' turn; after a few frames all had theirs."""
        effort = self._effort
        found = [np.empty((0, 4))]
        while effort > 0:
            band = self._bands[self._next]
            self._next = (self._next + 1) % len(self._bands)
            effort -= band.size
            found.append(band.find(table, look, horizon_row))
        return np.concatenate(found)
