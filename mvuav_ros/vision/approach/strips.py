"""A strip on the ground: where it is, and the Kalman filter on its two edges."""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.approach.attitude import Derotation, turn_edge
from mvuav_ros.vision.approach.strip_edges import EdgePoints, Edges, Strip, Strips
from mvuav_ros.vision.approach.tuning import EDGES, SEARCH, STRIP


def level_of(near: float) -> int:
    """Of the pyramid, on which a near end so many px deep is neither too deep nor too shallow."""
    return max(0, math.ceil(math.log2(max(near, 1.0) / SEARCH.max_level_depth)))


def columns_at(strips: Strips, rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, 2, 2) columns of the left and the right edge at two rows, px: (2,), or (n, 2)."""
    depth = (rows - strips[:, 1:2])[:, None]
    return strips[:, 0, None, None] + strips[:, 2:4, None] * depth


def strips_through(
    columns: NDArray[np.float64], rows: NDArray[np.float64], ends: NDArray[np.float64]
) -> Strips:
    """Strips whose edges pass through columns at two rows, (2,) or (n, 2)."""
    slopes = (columns[:, :, 1] - columns[:, :, 0]) / (rows[..., 1] - rows[..., 0])[..., None]
    gap = np.maximum(slopes[:, 1] - slopes[:, 0], 0.02)
    depth = (columns[:, 1, 1] - columns[:, 0, 1]) / gap
    x, y = columns[:, 0, 1] - slopes[:, 0] * depth, rows[..., 1] - depth
    found = np.stack([x, y, slopes[:, 0], slopes[:, 1], ends[:, 0] - y, ends[:, 1] - y], axis=1)
    found[:, 5] = np.maximum(found[:, 5], 4.0)
    return found


def end_rows(strip: Strip) -> NDArray[np.float64]:
    """(2,) of the far and of the near end, px."""
    return np.asarray(strip[1] + strip[4:6])


def points_along(
    strip: Strip, spread: NDArray[np.float64], variance: NDArray[np.float64] | float = 0.0
) -> Edges:
    """A mean strip's edges between its ends as points, the fewer the less they are known.

    Their spread is (2, 2) px, of the left and of the right edge at both ends; likewise the
    variance of the mean itself, px².
    """
    rows = end_rows(strip)
    at = rows[0] + _SHARES * (rows[1] - rows[0])
    ends = columns_at(strip[None], rows)[0]
    columns = ends[:, :1] + _SHARES * (ends[:, 1:] - ends[:, :1])
    weights = 1.0 / (1.0 + spread.max(axis=1) ** 2)
    doubts = np.sqrt(spread**2 + variance)
    left, right = (
        EdgePoints(at, edge, np.full(STRIP.points, weight), 1.0, tuple(doubt))
        for edge, weight, doubt in zip(columns, weights, doubts, strict=True)
    )
    return left, right


_SHARES = (np.arange(STRIP.points) + 0.5) / STRIP.points
"""Where the points of a mean's edge are, from its far to its near end."""


def strip_along(edges: Edges, strip: Strip) -> Strip:
    """The strip along points of both edges, between the ends of another one."""
    lines = [np.polyfit(edge.rows, edge.columns, 1, w=edge.weights + 1e-3) for edge in edges]
    ends = end_rows(strip)
    corners = np.array([np.polyval(line, ends) for line in lines])
    return np.asarray(strips_through(corners[None], ends, ends[None])[0])


def is_plausible(strip: Strip, size: tuple[int, int]) -> bool:
    """Whether a strip can be a runway seen from the air; of an image of that height and width."""
    if not np.isfinite(strip).all():
        return False
    x, y, left, right, far, near = strip
    height, columns = size
    width = right - left
    return bool(
        0.05 < width < 8.0
        and width * near > STRIP.min_width
        and abs(left + right) / 2 < 2.0 * width
        and -0.5 * columns < x < 1.5 * columns
        and -STRIP.max_above * height < y < height - 6
        and near > far
        and (y > STRIP.top_row or y + near > STRIP.min_below_top)
    )


class Shape:
    """Two edges, each x = p + a (y - reference row), on the levelled working image.

    The state is (4,): p and a of the left edge, p and a of the right edge.
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

    def variances(self, rows: NDArray[np.float64]) -> NDArray[np.float64]:
        """(2, n) px², of the left and of the right edge's columns in (n,) rows."""
        away = np.stack((np.ones_like(rows), rows - self.reference))
        edges = self.covariance[:2, :2], self.covariance[2:, 2:]
        return np.stack([((edge @ away) * away).sum(axis=0) for edge in edges])

    @property
    def vanishing_point(self) -> tuple[float, float]:
        """Where the edges meet, px; very far away where they are parallel."""
        p_left, left, p_right, right = self.state.tolist()
        depth = (p_left - p_right) / max(right - left, 1e-3)
        return p_left + left * depth, self.reference + depth

    def predict(self, rightwards: float = 0.0, downwards: float = 0.0) -> None:
        """One frame passes, in which the image was seen to move, px."""
        left, right = self.slopes
        self.state[[0, 2]] += rightwards
        self.reference += downwards
        change = (STRIP.slope_sigma + STRIP.slope_share_sigma * abs(right - left)) ** 2
        # A turn to the side moves both edges alike, one up or down each by its slope.
        upwards = np.array([left, right])
        moved = STRIP.yaw_sigma**2 + STRIP.pitch_sigma**2 * np.multiply.outer(upwards, upwards)
        self.covariance[::2, ::2] += moved
        self.covariance += np.diag((0.04, change, 0.04, change))

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
            weight = points.weights / (STRIP.point_sigma**2 * EDGES.correlated_rows)
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
    """A strip that is followed, whatever it is: what the tracker needs to know of it."""

    max_misses: ClassVar[int]
    min_length: ClassVar[float] = 0.0  # widths from end to end; what is shorter is something else

    def __init__(self, strip: Strip) -> None:
        self.shape = Shape(strip)
        # Rows from the vanishing point to both ends, px of the working image; smoothed.
        self.far, self.near = float(strip[4]), float(strip[5])
        self.near_seen = self.near  # in the newest frame alone
        self.age = 0  # frames
        self.misses = 0  # looks in a row in which it was not seen
        self.points: Edges | None = None  # in the newest frame, if seen
        self.predicted = False  # they are no more than where it was followed to

    @property
    def rank(self) -> float:
        """Log odds with which it stands against other tracks."""
        raise NotImplementedError

    @property
    def preference(self) -> float:
        """Log odds with which it stands against the one that is shown."""
        return self.rank

    @property
    def showable(self) -> bool:
        """Enough frames have spoken for it."""
        return True

    @property
    def confidence(self) -> float:
        """In its report, 0 to 1."""
        raise NotImplementedError

    @property
    def lost(self) -> bool:
        """It has not been seen for too long."""
        return self.misses > self.max_misses

    def length(self, focal: float) -> float:
        """Widths from end to end: what is w wide and d away looks focal w / d wide, px."""
        left, right = self.shape.slopes
        return focal * (1.0 / self.far - 1.0 / self.near) / max(right - left, 1e-3)

    def lies_above(self, row: float | None) -> bool:
        """Whether it lies wholly above a row, px, if that is known."""
        _, y = self.shape.vanishing_point
        return row is not None and y + self.near <= row

    def give_up(self) -> None:
        """Count it as lost."""
        self.misses = self.max_misses + 1

    def strip(self) -> Strip:
        """(6,) where it is."""
        _, left, _, right = self.shape.state.tolist()
        return np.array([*self.shape.vanishing_point, left, right, self.far, self.near])

    def ends_in_view(self, level: Derotation) -> list[bool]:
        """Whether the far and the near end are, and no border of a picture cuts the edges off."""
        x, y, left, right, far, _ = self.strip().tolist()
        # Evidence may end a row before the edges do.
        margin = 2.0 * 2 ** level_of(self.near_seen)
        depth = np.array([[far - margin], [self.near_seen + margin]])
        places = np.stack(np.broadcast_arrays(x + depth * (left, right), y + depth))
        on_frame = np.stack(level.to_working(*places))
        size = np.array([level.width, level.height]).reshape(2, 1, 1)
        inside = [(at > -0.5) & (at < size - 0.5) for at in (places, on_frame)]
        return list(np.all(inside, axis=(0, 1, 3)))

    def covers(self, strip: Strip) -> bool:
        """Whether they share half of the narrower one, and meet at about the same place."""
        (x, y, a, b, _, near), (x2, y2, a2, b2, _, _) = self.strip().tolist(), strip.tolist()
        left, right = x + a * near, x + b * near
        first, last = x2 + a2 * (y + near - y2), x2 + b2 * (y + near - y2)
        width, its = right - left, max(last - first, 1e-6)
        return bool(
            min(last, right) - max(first, left) > 0.5 * min(width, its)
            and abs(y2 - y) < 0.6 * near
            and width / 3 < its < 3 * width
        )

    def turn(self, old: Derotation, new: Derotation) -> None:
        """Go over to another derotation."""
        self.shape.turn(old, new)

    def follow_ends(self, far_row: float, near_row: float) -> None:
        """Take in the rows of both ends in the newest frame."""
        _, y = self.shape.vanishing_point
        far, near = max(far_row - y, 1.0), near_row - y
        if not math.isfinite(near):
            return
        share = max(STRIP.end_memory, 1.0 / self.age)
        self.near_seen = near
        self.near += share * (near - self.near)
        self.far += share * (far - self.far)
        self.near = max(self.near, self.far + 3.0)
