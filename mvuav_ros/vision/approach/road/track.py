"""One strip followed from frame to frame."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.approach.derotation import Derotation, turn_edge
from mvuav_ros.vision.approach.edges import EdgePoints, find_edges
from mvuav_ros.vision.approach.features import Colours, Table
from mvuav_ros.vision.approach.road.strip import score_strips
from mvuav_ros.vision.approach.shape import Shape
from mvuav_ros.vision.approach.targets import EdgeProfile, Target

_MEMORY = 0.15
"""Share of the newest frame in what a track remembers of its looks."""
_END_MEMORY = 0.6
_SUPPORT_RANGE, _LEAST_SHARP = 0.25, 0.2
_MOST_MISSES = 10
_OFF_HORIZON = 7.0
"""Px of the working image between the horizon seen and where the edges meet; beyond, less and
less likely."""
_SHORT, _LONG = 0.35, 0.75
"""Natural logarithm of the far end's distance over the near end's: of no runway, of any."""
_HIGH, _LOW = 0.6, 0.8
"""Share of the image's height at which a road under the camera ends: of no road, of any."""
_CONVINCING, _CERTAIN = 7.0, 10.0
"""Sums of merit above the target's ``start_score``."""
_LEAST_AGE = 8
_FADES = 0.8
_WIDTH_SPREAD = 0.6
"""Natural logarithm."""
_WIDEST_PER_ROW = 0.07
"""Usual width over height, per px of the near end below the horizon, at most."""


class Track:
    """A shape, what it looks like, and how well it has done.

    Attributes:
        shape: its edges.
        far: its first row, px below the vanishing point.
        near: the row after its last one, likewise; smoothed.
        near_seen: the same in the newest frame alone.
        contrast: (channels,) inside minus outside.
        quality: strip score times the support of the edges, averaged over the last frames.
        open_end: its near end is out of sight.
        age: frames.
        misses: frames in a row in which it was not seen.
        points: of the left and the right edge in the newest frame, if seen.
    """

    def __init__(
        self,
        number: int,
        candidate: NDArray[np.float64],
        span: tuple[float, float],
        contrast: NDArray[np.float64],
    ) -> None:
        self.number = number
        self.shape = Shape(candidate, span[1])
        self.far, self.near = span
        self.near_seen = self.near
        self.contrast = contrast
        self.quality = 0.0
        self.score = 0.0
        self.support = 0.0
        self.merit = 0.0
        self.open_end = False
        self.age = 0
        self.evidence = 0.0
        self.misses = 0
        self.points: tuple[EdgePoints, EdgePoints] | None = None

    @property
    def width(self) -> float:
        """At the near end, px of the working image."""
        left, right = self.shape.slopes
        return (right - left) * self.near

    @property
    def middle(self) -> float:
        """Column of the near end's middle, px of the levelled working image."""
        array = self.shape.as_array()
        return float(array[0] + 0.5 * (array[2] + array[3]) * self.near)

    @property
    def near_row(self) -> float:
        """Px of the levelled working image."""
        return self.shape.vanishing_point[1] + self.near

    def turn(self, old: Derotation, new: Derotation) -> None:
        """Go over to another level."""
        shape = self.shape
        for first in (0, 2):
            p, slope = (float(v) for v in shape.state[first : first + 2])
            shape.state[first : first + 2] = turn_edge(p, slope, shape.reference, old, new)

    def step(
        self,
        image: NDArray[Any],
        level: Derotation,
        table: Table,
        horizon_row: float | None,
        horizon_sigma: float,
        target: Target,
        look: EdgeProfile,
        colours: Colours,
    ) -> None:
        """Follow it into the next frame."""
        self.age += 1
        shape = self.shape
        shape.predict()
        array = shape.as_array()
        if not np.isfinite(array).all():
            self.misses = _MOST_MISSES + 1
            return
        span = self.far, self.near
        left, right = find_edges(image, level, array, span, self.contrast, target.look, colours)
        # A taxiway may join on one side.
        support = 0.5 * (left.support + right.support)
        if look.painted:
            support = math.sqrt(left.support * right.support)
        self.support = support
        row = array[1] + 0.7 * self.near + 0.3 * self.far
        shape.move_reference(row)
        shape.update(left, right, horizon_row, horizon_sigma)
        array = shape.as_array()
        if not self._plausible(array, table, target):
            self.misses = _MOST_MISSES + 1
            return
        scores = score_strips(table, array[None], look)
        sharp = min(max((support - target.least_support) / _SUPPORT_RANGE, 0.0), 1.0)
        credible = self._credibility(array[1], horizon_row, table.shape[1], target)
        self.score = float(scores.score[0]) * sharp * credible
        self.quality += max(_MEMORY, 1.0 / self.age) * (self.score - self.quality)
        self.merit = self.quality * _likelihood(float(array[2]), float(array[3]), self.near, target)
        seen = self.score > 0.5 * target.keep_score and sharp > _LEAST_SHARP
        self.points = (left, right) if seen else None
        self.misses = 0 if seen else self.misses + 1
        if seen:
            self.contrast = self.contrast + _MEMORY * (scores.contrast[0] - self.contrast)
            share = max(_END_MEMORY, 1.0 / self.age)
            self.far += share * (float(scores.far[0]) - self.far)
            self.near_seen = float(scores.near[0])
            self.near += share * (self.near_seen - self.near)
            self.near = max(self.near, self.far + 3.0)
            self.open_end = bool(scores.open_end[0])

    def weigh(self, target: Target, steady: bool) -> None:
        """Let the newest frame speak for or against the track; in a turn only against it."""
        change = self.merit - target.start_score
        if steady or change < 0:
            self.evidence = min(max(self.evidence + change, 0.0), _CERTAIN)

    @property
    def believed(self) -> bool:
        """Enough frames have spoken for it."""
        return self.evidence >= _CONVINCING and self.age >= _LEAST_AGE

    @property
    def certain(self) -> bool:
        """So many frames have spoken for it that more would not count."""
        return self.evidence >= _CERTAIN

    @property
    def confidence(self) -> float:
        """0 to 1: one half where it is just believed, less while it is not seen."""
        return self.quality / (self.quality + 1.0) * _FADES**self.misses

    @property
    def lost(self) -> bool:
        """It has not been seen for too long."""
        return self.misses > _MOST_MISSES

    def _plausible(self, array: NDArray[np.float64], table: Table, target: Target) -> bool:
        if not np.isfinite(array).all():
            return False
        x, y, left, right = (float(v) for v in array)
        width = right - left
        aside = abs(left + right) / 2 / max(width, 1e-6)
        height, columns = table.shape[1], table.shape[2] - 1
        return (
            0.03 < width < target.widest
            and aside < target.farthest_aside
            and -0.5 * columns < x < 1.5 * columns
            and -0.5 * height < y < height - 4
        )

    def _credibility(
        self, y: float, horizon_row: float | None, height: int, target: Target
    ) -> float:
        """1 for what a strip on the ground must look like, down to 0."""
        off = 0.0
        if horizon_row is not None:
            off = max(0.0, abs(y - horizon_row) / _OFF_HORIZON - 1.0)
        credibility = math.exp(-0.5 * off**2)
        if target.has_ends:
            extent = math.log(self.near / max(self.far, 1.0))
            return credibility * min(max((extent - _SHORT) / (_LONG - _SHORT), 0.0), 1.0)
        reached = (y + self.near) / height
        return credibility * min(max((reached - _HIGH) / (_LOW - _HIGH), 0.0), 1.0)


def _likelihood(left: float, right: float, near: float, target: Target) -> float:
    """1 for the usual offsets and widths, less beyond.

    What is as wide as the camera is high and yet ends close below the horizon is a bush or a roof:
    a runway is that wide from nearby alone, where its near end lies far below.
    """
    width = max(right - left, 1e-6)
    aside = max(0.0, abs(left + right) / 2 / width - target.usual_offset) / target.offset_spread
    narrow, usual = target.usual_widths
    wide = max(0.0, math.log(width / usual), math.log(narrow / width)) / _WIDTH_SPREAD
    shallow = 0.0
    if target.has_ends:
        shallow = max(0.0, math.log(width / (_WIDEST_PER_ROW * near))) / _WIDTH_SPREAD
    return math.exp(-0.5 * (aside**2 + wide**2 + shallow**2))
