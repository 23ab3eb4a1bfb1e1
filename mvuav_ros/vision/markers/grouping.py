"""Bright pixels to clusters: the thesis's modified k-means grouping (Appendices A and B)."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.markers.results import Cluster
from mvuav_ros.vision.point_operations import Mask

# Beyond these a frame is noise or glare, not lights, and grouping it would stall the stream.
MAX_BRIGHT_FRACTION = 0.05
MAX_BRIGHT_SMALL_FRAME = 4096
MAX_CLUSTERS = 1000


class GroupingError(ValueError):
    """The bright pixels are too many to be markers; the message says how many."""


def bright_pixels(mask: Mask) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """The mask's pixels in the program's scan order: column by column, each from the top.

    Args:
        mask: (height, width) uint8, non-zero where bright.

    Returns:
        x and y, each (n,) int32, px.

    Raises:
        GroupingError: more than 5 % of the frame is bright.
    """
    height = mask.shape[0]
    count = cv2.countNonZero(mask)
    if count > max(MAX_BRIGHT_FRACTION * mask.size, MAX_BRIGHT_SMALL_FRAME):
        raise GroupingError(f'{100 * count / mask.size:.0f} % of the frame is above the threshold')
    if count == 0:
        return np.empty(0, np.int32), np.empty(0, np.int32)
    points = cv2.findNonZero(mask).reshape(-1, 2)
    order = np.argsort(points[:, 0] * height + points[:, 1], kind='stable')
    x, y = points[order].T
    return np.ascontiguousarray(x, np.int32), np.ascontiguousarray(y, np.int32)


def group_pixels(
    x: NDArray[np.int32], y: NDArray[np.int32], grouping_distance: int
) -> list[Cluster]:
    """Group pixels around seeds: the first pixel left, with all within T of it.

    A group is every pixel left with x in [x_seed, x_seed + T] and |y - y_seed| <= T, bounds
    included; its centre is the mean of its pixels. A light wider than T falls into several
    groups; lights closer than T share one.

    Args:
        x: (n,) px, in scan order (see `bright_pixels`).
        y: (n,) px.
        grouping_distance: T, px.

    Returns:
        The clusters in scan order of their seeds.

    Raises:
        GroupingError: there are more than `MAX_CLUSTERS`.
    """
    clusters: list[Cluster] = []
    left = np.ones(len(x), bool)
    ends = np.searchsorted(x, x + grouping_distance, side='right')
    seed = 0
    while seed < len(x):
        if len(clusters) == MAX_CLUSTERS:
            raise GroupingError(f'more than {MAX_CLUSTERS} clusters above the threshold')
        reach = slice(seed, int(ends[seed]))
        near = left[reach] & (np.abs(y[reach] - y[seed]) <= grouping_distance)
        area = int(np.count_nonzero(near))
        clusters.append(
            Cluster(float(x[reach][near].sum()) / area, float(y[reach][near].sum()) / area, area)
        )
        left[reach] &= ~near
        rest = left[seed:]
        step = int(rest.argmax())
        if not rest[step]:
            break
        seed += step
    return clusters
