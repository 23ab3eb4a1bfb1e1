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
    if not _count_bright(mask):
        return np.empty(0, np.int32), np.empty(0, np.int32)
    points = cv2.findNonZero(mask).reshape(-1, 2)
    x, y = np.divmod(np.sort(points[:, 0] * height + points[:, 1]), height)
    return x.astype(np.int32), y.astype(np.int32)


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
    if len(x) == 0:
        return []
    mask = np.zeros((int(y.max()) + 1, int(x[-1]) + 1), np.uint8)
    mask[y, x] = 255
    return _group(mask, grouping_distance)


def group_mask(mask: Mask, grouping_distance: int) -> list[Cluster]:
    """The same of all of a mask's bright pixels.

    Raises:
        GroupingError: more than 5 % of the frame is bright, or there are more than
            `MAX_CLUSTERS`.
    """
    return _group(mask, grouping_distance) if _count_bright(mask) else []


def _count_bright(mask: Mask) -> int:
    count = cv2.countNonZero(mask)
    if count > max(MAX_BRIGHT_FRACTION * mask.size, MAX_BRIGHT_SMALL_FRAME):
        raise GroupingError(f'{100 * count / mask.size:.0f} % of the frame is above the threshold')
    return count


def _group(mask: Mask, grouping_distance: int) -> list[Cluster]:
    clusters: list[Cluster] = []
    height = mask.shape[0]
    # Column after column, as the scan goes: the search for the next seed is one over bytes.
    bright = bytearray(cv2.transpose(mask))
    left = np.frombuffer(bright, np.uint8).reshape(-1, height)
    seed = bright.find(255)
    while seed >= 0:
        if len(clusters) == MAX_CLUSTERS:
            raise GroupingError(f'more than {MAX_CLUSTERS} clusters above the threshold')
        column, row = divmod(seed, height)
        top = max(row - grouping_distance, 0)
        group = left[column : column + grouping_distance + 1, top : row + grouping_distance + 1]
        pixels = cv2.findNonZero(group).reshape(-1, 1, 2)
        area = len(pixels)
        down, across = cv2.sumElems(pixels)[:2]
        # The sums are whole numbers, so that the means are exactly those of the pixels.
        clusters.append(Cluster((column * area + across) / area, (top * area + down) / area, area))
        group.fill(0)
        seed = bright.find(255, seed)
    return clusters
