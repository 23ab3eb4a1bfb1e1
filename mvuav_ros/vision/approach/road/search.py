"""Looking for strips everywhere below the horizon, without knowing anything."""

from __future__ import annotations

import numpy as np

from mvuav_ros.vision.approach.features import CHANNELS, Table
from mvuav_ros.vision.approach.road.strip import CEILING, Shapes, bounds_of, contrasts
from mvuav_ros.vision.approach.targets import EdgeProfile, Target

_SAMPLES = 6
_TAPER = 0.45
"""Depth of a band's first row, in depths of its last."""
_NARROWEST = 3.0
"""Px; a narrower near end tells nothing."""
_MOST_BEYOND = 0.2
"""Of the width: how far outside the image a vanishing point is looked for."""


class Band:
    """All strips of one width over height that end at about one depth below the horizon."""

    def __init__(
        self,
        look: EdgeProfile,
        depth: float,
        ratio: float,
        offsets: tuple[float, ...],
        height: int,
        width: int,
    ) -> None:
        """Lay out where to look.

        Args:
            look: of the target.
            depth: of the near end below the horizon, px.
            ratio: strip's width over the camera's height.
            offsets: camera's way from the middle of the strip over the strip's width.
            height: of the levelled images, px.
            width: likewise.
        """
        self.width = ratio * depth
        self._height = height
        self._slopes = np.array([(-(o + 0.5) * ratio, (0.5 - o) * ratio) for o in offsets])
        self._rows = np.unique(np.rint(np.geomspace(_TAPER * depth, depth, _SAMPLES))).astype(int)
        step = max(1, min(8, int(self.width / 4)))
        beyond = int(_MOST_BEYOND * width)
        self._points = np.arange(-beyond, width + beyond, step)
        x = self._points[:, None, None]
        bounds = np.stack(
            bounds_of(
                x + self._slopes[:, 0, None] * self._rows,
                x + self._slopes[:, 1, None] * self._rows,
                look,
            )
        )
        bounds = np.rint(np.clip(bounds + 0.5, 0, width)).astype(np.int32)
        self._bounds = bounds.astype(np.float32)
        self._index = bounds + (self._rows * (width + 1)).astype(np.int32)
        self._middles = self._points[:, None] + 0.5 * self._slopes.sum(axis=1) * depth

    @property
    def size(self) -> int:
        """Places looked up."""
        return self._index.size

    def find(self, table: Table, look: EdgeProfile, horizon_row: float, most: int) -> Shapes:
        """The best strips of this band, best first.

        Args:
            table: row sums of the levelled features.
            look: of the target.
            horizon_row: of the vanishing points, px.
            most: how many at most.
        """
        top = round(horizon_row)
        stride = table.shape[2]
        found: list[tuple[float, float, float, float]] = []
        if top + self._rows[0] < 0 or top + self._rows[-1] >= self._height:
            return np.empty((0, 4))
        flat = table.reshape(CHANNELS, -1)
        sums = flat.take(self._index + np.int32(top * stride), axis=1, mode='clip')
        _, size = contrasts(sums, self._bounds, look)
        gain = np.minimum(size, CEILING * look.floor).mean(axis=2)
        for _ in range(most):
            point, number = np.unravel_index(int(gain.argmax()), gain.shape)
            if gain[point, number] <= look.floor:
                break
            left, right = (float(slope) for slope in self._slopes[number])
            found.append((float(self._points[point]), float(horizon_row), left, right))
            # Strips whose near ends have nearly the same middle are the same strip.
            near = np.abs(self._middles - self._middles[point, number]) < 0.7 * self.width
            gain[near] = 0.0
        return np.array(found).reshape(-1, 4)


class Search:
    """Takes a share of the bands in each frame, so that no frame takes long."""

    def __init__(self, target: Target, height: int, width: int) -> None:
        depths = np.geomspace(10, 0.6 * height, 9)
        bands = [
            Band(target.look, float(depth), ratio, target.offsets, height, width)
            for depth in depths
            for ratio in target.ratios
            if _NARROWEST <= ratio * depth <= 0.9 * width
        ]
        self._bands = bands
        self._next = 0

    def find(
        self,
        table: Table,
        look: EdgeProfile,
        horizon_row: float,
        share: float = 0.25,
        most: int = 3,
    ) -> Shapes:
        """Candidates of the next bands' turn; after 1 / ``share`` frames all had theirs."""
        effort = share * sum(band.size for band in self._bands)
        found = [np.empty((0, 4))]
        while effort > 0:
            band = self._bands[self._next]
            self._next = (self._next + 1) % len(self._bands)
            effort -= band.size
            found.append(band.find(table, look, horizon_row, most))
        return np.concatenate(found)
