"""What stays where it is in the picture while the ground moves: burned-in text, a window's frame.

The ground moves as a plane does, and what is far away as the camera turns: from some frames to the
next both are about an affine map. What stands still where that map says that it should have moved
does not belong to them, and its edges are no evidence.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

_CELL = 8
"""Px of the working image: sides of the cells in which it is remembered what stands still."""
_CORNERS, _APART = 150, 5.0
"""Most corners compared, and px between them."""
_WINDOW, _LEVELS = (9, 9), 2
"""Px around a corner that are compared, and levels of the pyramid above the finest."""
_PERIOD, _LONGEST = 3, 12
"""Frames from one comparison to the next, and after which other corners are taken."""
_STILL, _MOVED = 0.25, 1.2
"""Px by which a corner that stands still may seem to have moved, and by which the ground must have
moved there before that tells anything."""
_LEAST_MOVING, _LEAST_AGREEING = 10, 0.6
"""Corners that have moved, and the share of them that fit one map, for a map to be known."""
_FIT = 1.0
"""Px by which corners may miss the map."""
_OVERLAID, _MOST_VOTES, _FORGET = 1.8, 6.0, 0.1
"""Votes, one of a comparison, from which a cell is overlaid, the most votes, and the share of them
that is forgotten in a comparison: one map that was wrong hides nothing."""


class Overlaid:
    """Learns from working images of one size what is laid over the view.

    Attributes:
        mask: (height, width) uint8, 255 where the picture is overlaid; None where nowhere.
    """

    def __init__(self) -> None:
        self.mask: NDArray[np.uint8] | None = None
        self._votes: NDArray[np.float32] | None = None
        self._first: NDArray[np.uint8] | None = None
        self._corners: NDArray[np.float32] | None = None
        self._age, self._period = 0, _PERIOD

    def take(self, gray: NDArray[np.uint8]) -> None:
        """Take in the next working image, (height, width); it may not be changed later."""
        self._age += 1
        if self._first is None or self._corners is None:
            self._begin(gray)
            return
        if self._age % self._period:
            return
        seen = self._compare(gray)
        if seen or self._age >= _LONGEST:
            self._begin(gray)

    def _begin(self, gray: NDArray[np.uint8]) -> None:
        self._first, self._age = gray, 0
        found = cv2.goodFeaturesToTrack(gray, _CORNERS, 0.005, _APART, blockSize=3)
        self._corners = None if found is None else np.asarray(found, np.float32)

    def _compare(self, gray: NDArray[np.uint8]) -> bool:
        """Whether the ground has moved, so that other corners are better."""
        assert self._first is not None
        assert self._corners is not None
        now, found, _ = cv2.calcOpticalFlowPyrLK(
            self._first,
            gray,
            self._corners,
            self._corners.copy(),
            winSize=_WINDOW,
            maxLevel=_LEVELS,
        )
        known = np.asarray(found)[:, 0] > 0
        old, new = self._corners[known, 0], np.asarray(now)[known, 0]
        way = np.linalg.norm(new - old, axis=1)
        moving = way > _STILL
        if np.count_nonzero(moving) < _LEAST_MOVING:
            return False
        plane, agree = cv2.findHomography(
            old[moving], new[moving], cv2.RANSAC, ransacReprojThreshold=_FIT, maxIters=200
        )
        if plane is None or agree.mean() < _LEAST_AGREEING:
            # Too fast to be followed over more than a frame.
            self._period = 1
            return True
        there = np.asarray(cv2.perspectiveTransform(old[:, None], plane))[:, 0]
        expected = np.linalg.norm(there - old, axis=1)
        overlaid = ~moving & (expected > _MOVED)
        if not (expected > _MOVED).any():
            return False
        self._period = min(self._period + 1, _PERIOD)
        self._vote(old[overlaid], new[way > _MOVED], gray.shape)
        return True

    def _vote(self, still: Any, moved: Any, size: tuple[int, ...]) -> None:
        height, width = size
        if self._votes is None:
            self._votes = np.zeros((height // _CELL + 1, width // _CELL + 1), np.float32)
        votes = self._votes
        votes *= 1.0 - _FORGET
        # Beside a letter that stands still there may be digits that change.
        around = cv2.dilate(self._counted(still), np.ones((3, 3), np.uint8))
        votes += np.minimum(around, 1.0) - self._counted(moved)
        np.clip(votes, 0.0, _MOST_VOTES, out=votes)
        cells = np.where(votes >= _OVERLAID, 255, 0).astype(np.uint8)
        if not cells.any():
            self.mask = None
            return
        mask = np.repeat(np.repeat(cells, _CELL, axis=0), _CELL, axis=1)
        self.mask = np.ascontiguousarray(mask[:height, :width])

    def _counted(self, places: Any) -> NDArray[np.float32]:
        """How many places (n, 2) lie in each cell."""
        assert self._votes is not None
        rows, columns = self._votes.shape
        column, row = (places / _CELL).astype(np.intp).T
        inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
        cells = row[inside] * columns + column[inside]
        counts = np.bincount(cells, minlength=rows * columns)
        return counts.reshape(rows, columns).astype(np.float32)
