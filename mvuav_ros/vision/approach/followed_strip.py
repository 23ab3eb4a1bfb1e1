"""A strip on the ground followed from frame to frame: its two edges and its ends."""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np

from mvuav_ros.vision.approach.derotation import Derotation, turn_edge
from mvuav_ros.vision.approach.edges import Edges, Strip

# Px of the working image: of one edge point.
_POINT_SIGMA = 0.7
# Points in neighbouring rows err alike.
_CORRELATED_ROWS = 3.0
# Per frame: the camera's yaw and pitch, px, and the change of slope of an edge.
_SIDEWAYS, _UPWARDS = 1.2, 0.8
_SLOPE_FLOOR, _SLOPE_SHARE = 0.006, 0.02
_END_MEMORY = 0.6
"""Share of the newest frame in where the ends are."""


class Shape:
    """Two edges, each x = p + a (y - reference row), on the levelled working image.

    Attributes:
        state: (4,) p and a of the left edge, p and a of the right edge.
        covariance: (4, 4).
        reference: row, px.
    """

    def __init__(self, strip: Strip) -> None:
        """Take over a candidate: as sure of its near end as of a fraction of its width."""
        x, y, left, right, _, near = (float(v) for v in strip)
        self.reference = y + near
        self.state = np.array([x + left * near, left, x + right * near, right])
        width = (right - left) * near
        place, slope = max(1.5, 0.2 * width), 0.2 * (right - left)
        self.covariance = np.diag([place**2, slope**2, place**2, slope**2])

    @property
    def slopes(self) -> tuple[float, float]:
        """Of the left and of the right edge, columns per row."""
        return float(self.state[1]), float(self.state[3])

    @property
    def vanishing_point(self) -> tuple[float, float]:
        """Where the edges meet, px; NaN where they are parallel."""
        p_left, left, p_right, right = (float(v) for v in self.state)
        if right - left < 1e-3:
            return float('nan'), float('nan')
        depth = -(p_right - p_left) / (right - left)
        return p_left + left * depth, self.reference + depth

    def predict(self, rightwards: float = 0.0, downwards: float = 0.0) -> None:
        """One frame passes, in which the image was seen to move, px."""
        left, right = self.slopes
        self.state[[0, 2]] += rightwards
        self.reference += downwards
        sideways = np.array([1.0, 0.0, 1.0, 0.0])
        upwards = np.array([left, 0.0, right, 0.0])
        change = (_SLOPE_FLOOR + _SLOPE_SHARE * abs(right - left)) ** 2
        self.covariance = (
            self.covariance
            + _SIDEWAYS**2 * np.outer(sideways, sideways)
            + _UPWARDS**2 * np.outer(upwards, upwards)
            + np.diag([0.04, change, 0.04, change])
        )

    def grow(self, rate: float) -> None:
        """The camera comes lower: both slopes become larger by a share of themselves."""
        x, y = self.vanishing_point
        if np.isfinite(y):
            self.state[[1, 3]] *= 1.0 + rate
            self.state[[0, 2]] = x + self.state[[1, 3]] * (self.reference - y)

    def turn(self, old: Derotation, new: Derotation) -> None:
        """Describe the same edges on another derotation."""
        for first in (0, 2):
            place, slope = (float(value) for value in self.state[first : first + 2])
            self.state[first : first + 2] = turn_edge(place, slope, self.reference, old, new)

    def move_reference(self, row: float) -> None:
        """Describe the same edges at another row."""
        step = row - self.reference
        matrix = np.eye(4)
        matrix[0, 1] = matrix[2, 3] = step
        self.state = matrix @ self.state
        self.covariance = matrix @ self.covariance @ matrix.T
        self.reference = row

    def update(self, edges: Edges, horizon: tuple[float, float] | None) -> None:
        """Take in the points of both edges, and that they meet at the horizon.

        Of that, its row and the vanishing point's standard deviation about it, px, may be known.
        """
        information = np.linalg.inv(self.covariance)
        vector = information @ self.state
        for first, points in zip((0, 2), edges, strict=True):
            weight = points.weights / (_POINT_SIGMA**2 * _CORRELATED_ROWS)
            depth = points.rows - self.reference
            # Sums, not products of matrices: BLAS rounds as the arrays happen to lie in memory.
            by_depth = weight * depth
            both = by_depth.sum()
            information[first : first + 2, first : first + 2] += (
                (weight.sum(), both),
                (both, (by_depth * depth).sum()),
            )
            vector[first] += (weight * points.columns).sum()
            vector[first + 1] += (by_depth * points.columns).sum()
        if horizon is not None:
            horizon_row, sigma = horizon
            below = horizon_row - self.reference
            gap = max(self.slopes[1] - self.slopes[0], 0.05)
            row = np.array([1.0, below, -1.0, -below])
            information += np.outer(row, row) / (gap * sigma) ** 2
        self.covariance = np.linalg.inv(information)
        self.state = self.covariance @ vector


class FollowedStrip:
    """What both kinds of tracks are.

    Attributes:
        shape: its edges.
        far: rows from the vanishing point to the far end, px of the working image; smoothed.
        near: likewise to the near end.
        near_seen: the same in the newest frame alone.
        open_end: its near end is out of sight.
        age: frames.
        misses: looks in a row in which it was not seen.
        points: of the edges in the newest frame, if seen.
    """

    MOST_MISSES: ClassVar[int]

    def __init__(self, strip: Strip) -> None:
        self.shape = Shape(strip)
        self.far, self.near = float(strip[4]), float(strip[5])
        self.near_seen = self.near
        self.open_end = False
        self.age = self.misses = 0
        self.points: Edges | None = None

    @property
    def lost(self) -> bool:
        """It has not been seen for too long."""
        return self.misses > self.MOST_MISSES

    def give_up(self) -> None:
        """Count it as lost."""
        self.misses = self.MOST_MISSES + 1

    def strip(self) -> Strip:
        """(6,) where it is."""
        return np.array([*self.shape.vanishing_point, *self.shape.slopes, self.far, self.near])

    def turn(self, old: Derotation, new: Derotation) -> None:
        """Go over to another derotation."""
        self.shape.turn(old, new)

    def follow_ends(self, far: float, near: float) -> None:
        """Take in where the ends are in the newest frame, rows below the vanishing point."""
        if not math.isfinite(near):
            return
        share = max(_END_MEMORY, 1.0 / self.age)
        self.near_seen = near
        self.near += share * (near - self.near)
        self.far += share * (far - self.far)
        self.near = max(self.near, self.far + 3.0)
