"""Everything bright in a whole frame, as connected pieces."""

from __future__ import annotations

import math
from functools import cached_property
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.parameters.marker_tracker import MarkerTrackerParameters
from mvuav_ros.vision.markers.centroid import CentroidMeter, Cut, Detection
from mvuav_ros.vision.markers.grouping import GroupingError, area_fits, count_bright
from mvuav_ros.vision.markers.many_centroids import clipped, measure_pixels, measure_windows
from mvuav_ros.vision.point_operations import Mask, Pixels, threshold

MAX_BLOBS = 400
LONGEST = 3.0
"""Sides of the box around a piece that may still be a light, one over the other."""
MOST_LABELLED = 0.4  # Part of the rows with bright pixels from which on all are labelled at once
LEAST_FILLED = 0.4  # Part of its box that a light fills; a disc fills 0.79


class Blob(NamedTuple):
    """Where a piece lies: inclusive px, and its number in the labels image."""

    x0: int
    x1: int
    y0: int
    y1: int
    area: int
    number: int


class Blobs:
    """The bright pieces of a frame, 8-connected, within the area limits.

    Unlike the thesis's groups around seeds a piece may be of any width, and two lights are two
    pieces for as long as a dark pixel lies between them.
    """

    def __init__(self, gray: Pixels, parameters: MarkerTrackerParameters) -> None:
        """Find the pieces.

        Raises:
            GroupingError: the frame is too bright or too noisy to hold markers.
        """
        mask = threshold(gray, parameters.threshold)
        self._gray = gray
        self._size = (gray.shape[1], gray.shape[0])
        self._chosen = np.empty(0, np.intp)
        self._stats: NDArray[Any] = np.empty((0, 5), np.int32)
        if not count_bright(mask):
            return
        self._numbers, stats = label(mask)
        count = self._count = len(stats)
        chosen = np.flatnonzero(area_fits(stats[1:, cv2.CC_STAT_AREA], parameters))
        if len(chosen) > MAX_BLOBS:
            raise GroupingError(f'{count - 1} clusters above the threshold')
        self._chosen = chosen + 1
        self._stats = stats[self._chosen]

    def __len__(self) -> int:
        return len(self._chosen)

    @cached_property
    def boxes(self) -> list[Blob]:
        """The pieces, in the order of their first pixels, row by row."""
        return [
            Blob(x, x + width - 1, y, y + height - 1, area, number)
            for number, (x, y, width, height, area) in zip(
                self._chosen.tolist(), self._stats.tolist(), strict=True
            )
        ]

    def measure_all(self, level: float, weighted: bool) -> NDArray[np.float64]:
        """All pieces' places, as `measure` finds each of them, in less time than one by one.

        Returns:
            (n, 3): x and y (px), area (px).
        """
        measured = np.empty((len(self), 3))
        x, y, width, height, area = self._stats.T.astype(np.intp)
        windows = clipped((x - 1, x + width, y - 1, y + height), self._gray)
        # The window around a thin slanting line would be far larger than the line.
        compact = np.flatnonzero((width + 2) * (height + 2) <= 4 * area + 64)
        measured[compact] = measure_windows(self._gray, windows[compact], level, weighted)
        alone = np.zeros(len(self), np.bool_)
        alone[compact] = measured[compact, 2] == area[compact]
        crowded = np.flatnonzero(~alone)
        if len(crowded):
            pixels, owner = self._own_pixels(crowded)
            measured[crowded] = measure_pixels(
                self._gray, pixels, owner, len(crowded), level, weighted
            )
        return measured

    def _own_pixels(self, pieces: NDArray[np.intp]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """The pixels of some pieces in the flattened frame, and which piece's each is."""
        index = np.full(self._count, -1)
        index[self._chosen[pieces]] = np.arange(len(pieces))
        bright = np.flatnonzero(self._numbers)
        owner = index[self._numbers.ravel()[bright]]
        own = owner >= 0
        return bright[own], owner[own]

    def measure(self, box: Blob, cut: Cut, meter: CentroidMeter) -> Detection:
        """A piece's place, without what belongs to other pieces."""
        x0, x1 = max(box.x0 - 1, 0), min(box.x1 + 1, self._size[0] - 1)
        y0, y1 = max(box.y0 - 1, 0), min(box.y1 + 1, self._size[1] - 1)
        numbers = self._numbers[y0 : y1 + 1, x0 : x1 + 1]
        own = numbers == box.number
        if np.any(~own & (numbers != 0)):
            return meter.measure_part(cut, (x0, x1, y0, y1), own)
        spot = meter.measure(cut, (x0, x1, y0, y1), self._size)
        assert spot is not None
        return spot

    def split(
        self, box: Blob, dx: float, dy: float, variance: float
    ) -> tuple[Detection, Detection]:
        """A piece that is two lights: where each of them is; spread 0, as it is not known.

        Two equal lights at a distance s along a direction have their own variance (px², along any
        direction) plus s²/4 along it. From the first to the second it is roughly (dx, dy), px.
        """
        own = self._numbers[box.y0 : box.y1 + 1, box.x0 : box.x1 + 1] == box.number
        y, x = np.nonzero(own)
        mx, my = float(x.mean()), float(y.mean())
        values, axes = np.linalg.eigh(np.cov(x, y))
        half = math.sqrt(max(float(values[1]) - variance, 0.0))
        ax, ay = half * float(axes[0, 1]), half * float(axes[1, 1])
        if ax * dx + ay * dy < 0.0:
            ax, ay = -ax, -ay
        x0, y0, area = box.x0 + mx, box.y0 + my, box.area // 2
        return Detection(x0 - ax, y0 - ay, area, 0.0), Detection(x0 + ax, y0 + ay, area, 0.0)


def label(mask: Mask) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """A mask's 8-connected pieces, as `cv2.connectedComponentsWithStats` numbers them.

    Only the rows with a bright pixel are labelled, which are few where the lights are small.

    Returns:
        (height, width), each pixel's number, 0 where it is dark; and (1 + pieces, 5), their boxes
        and areas by OpenCV's columns, of which the first row, that of the dark, is of no use.
    """
    # In pairs, as OpenCV numbers the pieces by the pair of rows in which they begin.
    bright = np.bitwise_or.reduce(_words(mask), axis=1)
    pairs = np.flatnonzero(np.bitwise_or.reduce(bright.reshape(-1, 2), axis=1))
    ends = np.flatnonzero(np.diff(pairs) > 1)
    first = pairs[np.concatenate(([0], ends + 1))] if len(pairs) else pairs
    last = pairs[np.concatenate((ends, [-1]))] if len(pairs) else pairs
    if len(pairs) > MOST_LABELLED * len(mask) / 2:
        return _label_all(mask)
    numbers = np.zeros(mask.shape, np.int32)
    found = [np.zeros((1, 5), np.int32)]
    count = 0
    for top, bottom in zip((2 * first).tolist(), (2 * last + 2).tolist(), strict=True):
        band = mask[top:bottom]
        own, stats = _label_all(band)
        stats[:, cv2.CC_STAT_TOP] += top
        if count:
            np.add(own, count, out=own, where=own > 0)
        numbers[top:bottom] = own
        found.append(stats[1:])
        count += len(stats) - 1
    return numbers, np.concatenate(found)


def _label_all(mask: Mask) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    _, numbers, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
    return np.asarray(numbers, np.int32), np.asarray(stats, np.int32)


def _words(mask: Mask) -> NDArray[np.unsignedinteger]:
    """A mask's rows, of which there are an even number, as long words where they can be."""
    height, width = mask.shape
    if height % 2:
        mask = np.concatenate((mask, np.zeros((1, width), np.uint8)))
    if width % 8 == 0 and mask.flags.c_contiguous:
        return mask.view(np.uint64)
    return mask


def may_be_light(box: Blob) -> bool:
    """Whether a piece is compact enough to be looked at more closely."""
    width, height = box.x1 - box.x0 + 1, box.y1 - box.y0 + 1
    if max(width, height) > LONGEST * min(width, height) and box.area > 4:
        return False
    return box.area >= LEAST_FILLED * width * height
