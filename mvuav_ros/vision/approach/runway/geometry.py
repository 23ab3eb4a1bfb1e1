"""Where strips are, which of them overlap, and points along them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.approach.edges import EdgePoints, Edges, Strip
from mvuav_ros.vision.approach.runway.search import Strips

_SIDE_MARGIN, _LEAST_MARGIN, _ABOVE, _BELOW = 1.2, 36.0, 18.0, 2.7
_POINTS = 12
_NARROWEST = 5.0
"""Px of the near end: what is narrower shows too little to be told from specks in clouds."""
_AT_TOP, _LEAST_BELOW_TOP = 6.0, 8.0
"""Px: of what meets above that row so many must be in view; less is a letter at the top. Run 2
below its horizon, and text on the motorway."""
_MOST_ABOVE = 1.0
"""Heights of the image by which the vanishing point may lie above it."""
_AGREE = 2.0
"""Px between edges measured on the frame and the mean, at most."""


def columns_at(strips: Strips, rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, 2, 2) columns of the left and the right edge at two rows, px."""
    depth = rows - strips[:, 1:2]
    edges = [strips[:, 0:1] + strips[:, column : column + 1] * depth for column in (2, 3)]
    return np.stack(edges, axis=1)


def strips_through(
    columns: NDArray[np.float64], rows: NDArray[np.float64], ends: NDArray[np.float64]
) -> Strips:
    """Strips whose edges pass through columns at two rows."""
    slopes = (columns[:, :, 1] - columns[:, :, 0]) / (rows[1] - rows[0])
    gap = np.maximum(slopes[:, 1] - slopes[:, 0], 0.02)
    depth = (columns[:, 1, 1] - columns[:, 0, 1]) / gap
    x, y = columns[:, 0, 1] - slopes[:, 0] * depth, rows[1] - depth
    found = np.stack([x, y, slopes[:, 0], slopes[:, 1], ends[:, 0] - y, ends[:, 1] - y], axis=1)
    found[:, 5] = np.maximum(found[:, 5], 4.0)
    return found


def surrounding_box(strips: Strips) -> tuple[float, float, float, float]:
    """The part of an image that is needed to describe strips."""
    x, y, left, right, _, near = strips.T
    first, last = x + left * near, x + right * near
    margin = max(_SIDE_MARGIN * float((last - first).max()), _LEAST_MARGIN)
    return (
        float(np.minimum(first, x).min()) - margin,
        float(y.min()) - _ABOVE,
        float(np.maximum(last, x).max()) + margin,
        float((y + _BELOW * near).max()) + 4,
    )


def apart(strips: Strips, odds: NDArray[np.float64]) -> NDArray[np.intp]:
    """Numbers of the strips that differ, best first."""
    best = strips[int(odds.argmax())]
    rows = best[1] + np.array([0.4, 1.0]) * best[5]
    columns = columns_at(strips, rows)
    width = float(columns[int(odds.argmax()), 1, 1] - columns[int(odds.argmax()), 0, 1])
    kept: list[int] = []
    for index in np.argsort(-odds, kind='stable'):
        if not kept or (
            odds[index] > odds[kept[0]] - 9.0
            and np.abs(columns[kept] - columns[index]).max(axis=(1, 2)).min() > 0.08 * width + 0.5
        ):
            kept.append(int(index))
    return np.array(kept, np.intp)


def overlap(strip: Strip, other: Strip) -> bool:
    """Whether two strips share half of the narrower one, and meet at about the same place."""
    row = np.array([strip[1] + strip[5]])
    (left, right), (first, last) = columns_at(np.stack([strip, other]), row)[:, :, 0]
    width, its = right - left, max(last - first, 1e-6)
    return bool(
        min(last, right) - max(first, left) > 0.5 * min(width, its)
        and abs(other[1] - strip[1]) < 0.6 * strip[5]
        and width / 3 < its < 3 * width
    )


def points_along(
    mean: NDArray[np.float64], rows: NDArray[np.float64], spread: NDArray[np.float64]
) -> Edges:
    """The mean's edges as points, the fewer the less they are known."""
    share = (np.arange(_POINTS) + 0.5) / _POINTS
    at = rows[0] + share * (rows[1] - rows[0])
    edges = []
    for side in (0, 1):
        columns = mean[side, 0] + share * (mean[side, 1] - mean[side, 0])
        weight = 1.0 / (1.0 + float(spread[side].max()) ** 2)
        edges.append(EdgePoints(at, columns, np.full(_POINTS, weight), 1.0))
    left, right = edges
    return left, right


def strip_through(
    corners: NDArray[np.float64], rows: NDArray[np.float64], ends: NDArray[np.float64]
) -> Strip:
    """The strip whose edges pass through corners at two rows."""
    left, right = (corners[:, 1] - corners[:, 0]) / (rows[1] - rows[0])
    depth = (corners[1, 1] - corners[0, 1]) / max(right - left, 1e-3)
    return np.array([corners[0, 1] - left * depth, rows[1] - depth, left, right, *ends])


def agrees(exact: EdgePoints, mean: EdgePoints) -> bool:
    """Whether points measured on the frame lie along the mean."""
    used = exact.weights > 0
    if np.count_nonzero(used) < 4:
        return False
    expected = np.interp(exact.rows[used], mean.rows, mean.columns)
    slope = (mean.columns[-1] - mean.columns[0]) / (mean.rows[-1] - mean.rows[0])
    beyond = exact.rows[used] - np.clip(exact.rows[used], mean.rows[0], mean.rows[-1])
    apart = np.abs(exact.columns[used] - expected - slope * beyond)
    # The median is that low.
    return bool(2 * np.count_nonzero(apart < _AGREE) > apart.size)


def is_plausible(strip: Strip, size: tuple[int, int]) -> bool:
    """Whether a strip can be a runway seen from the air; of an image of that height and width."""
    if not np.isfinite(strip).all():
        return False
    x, y, left, right, far, near = strip
    height, columns = size
    width = right - left
    return bool(
        0.05 < width < 8.0
        and width * near > _NARROWEST
        and abs(left + right) / 2 < 2.0 * width
        and -0.5 * columns < x < 1.5 * columns
        and -_MOST_ABOVE * height < y < height - 6
        and near > far
        and (y > _AT_TOP or y + near > _LEAST_BELOW_TOP)
    )
