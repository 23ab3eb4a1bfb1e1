"""How the surroundings of a strip move between frames, and what stands still while they do."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.approach.attitude import Derotation, vertex
from mvuav_ros.vision.approach.strip_edges import LevelledFrame, Strip, sample_edges
from mvuav_ros.vision.approach.tuning import MOTION


class Registration:
    """Compares each working image with the last one."""

    def __init__(self) -> None:
        self.gray = self._last = np.zeros((0, 0), np.uint8)
        """The newest working image, and the one before."""
        self.moving = False
        """The newest image differs from the last one; a still says nothing new."""
        self.unchanged = 0
        """Images that were the same as the newest."""
        self.is_plain = False
        """The newest image is all alike, as of a camera or a link that fails."""
        self.alike = math.nan
        """Correlation of a strip's surroundings with the last image, the best of all strips'."""

    def take(self, pixels: NDArray[Any]) -> None:
        """Take in the next working image, (height, width) or (height, width, 3)."""
        self._last = self.gray
        # A copy: the caller may use the image's memory for the next one.
        gray = pixels.copy() if pixels.ndim == 2 else cv2.extractChannel(pixels, 1)
        self.gray = np.asarray(gray)
        same = np.array_equal(self.gray, self._last)
        self.moving = self._last.size > 0 and not same
        self.unchanged = self.unchanged + 1 if same else 0
        self.is_plain = float(cv2.meanStdDev(self.gray)[1].item()) < MOTION.min_contrast
        self.alike = math.nan

    def leave_out(self) -> None:
        """Compare the next image with the one before the newest."""
        self.gray = self._last

    def shift(self, strip: Strip, level: Derotation) -> tuple[float, float]:
        """Px to the right and down by which the surroundings of the last frame's strip have moved.

        Both are on the levelled working image; the shift is 0 where nobody can know.
        """
        box = _box(strip, level, self._last.shape)
        if box is None:
            return 0.0, 0.0
        near, far = MOTION.reaches
        right, down, alike = self._match(box, near)
        self.alike = float(np.fmax(self.alike, alike))
        if math.isnan(right):
            right, down, alike = self._match(box, far)
            # Farther off there may be the like by chance, above all in a torn picture.
            if math.isnan(right) or not self._has_moved(round(right), round(down)):
                return 0.0, 0.0
            self.alike = float(np.fmax(self.alike, alike))
        cos, sin = math.cos(level.slope), math.sin(level.slope)
        return cos * right + sin * down, -sin * right + cos * down

    def _match(self, box: NDArray[np.int_], reach: int) -> tuple[float, float, float]:
        """Px to the right and down to what is most alike, NaN if not like it; and its correlation.

        The box is as of `_box`.
        """
        (first, top), (end, bottom) = box.tolist()
        left, upper = max(first - reach, 0), max(top - reach, 0)
        around = self.gray[upper : bottom + reach, left : end + reach]
        alike = cv2.matchTemplate(around, self._last[top:bottom, first:end], cv2.TM_CCOEFF_NORMED)
        row, column = (int(place) for place in np.unravel_index(alike.argmax(), alike.shape))
        # What is most alike at the end of the reach is more so beyond.
        is_inside = 0 < row < alike.shape[0] - 1 and 0 < column < alike.shape[1] - 1
        if not (is_inside and alike[row, column] > MOTION.min_correlation):
            return math.nan, math.nan, alike[row, column]
        right = left + column - first + vertex(alike[row], column)
        down = upper + row - top + vertex(alike[:, column], row)
        return right, down, alike[row, column]

    def _has_moved(self, right: int, down: int) -> bool:
        """Whether the whole picture is more like the last one moved by so many px."""
        (height, width), x, y = self.gray.shape, max(right, 0), max(down, 0)
        places = (self.gray, x, y), (self._last, x - right, y - down), (self._last, x, y)
        # Coarse, as it may have turned as well.
        now, moved, still = (
            cv2.resize(
                image[upper : upper + height - abs(down), left : left + width - abs(right)],
                MOTION.coarse,
                interpolation=cv2.INTER_AREA,
            )
            for image, left, upper in places
        )
        error, usual = (cv2.norm(now, other, cv2.NORM_L1) for other in (moved, still))
        return error < MOTION.max_error_moved * usual


def _box(strip: Strip, level: Derotation, size: tuple[int, ...]) -> Any:
    """(2, 2) first column and row of what is compared, and the ones after the last; else None."""
    x, y, left, right, _, near = strip.tolist()
    middle = level.to_working(x + 0.25 * (left + right) * near, y + 0.5 * near)
    sides = np.clip([1.5 * (right - left) * near, 1.5 * near], MOTION.min_side, MOTION.max_side)
    box = np.trunc(np.multiply.outer((-0.5, 0.5), sides) + middle)
    nearest = MOTION.reaches[0]
    box = np.clip(box, nearest, np.array(size[1::-1]) - nearest)
    # Not if the middle is nowhere.
    return box.astype(int) if (np.diff(box, axis=0) >= MOTION.min_side // 2).all() else None


class GroundMotion(NamedTuple):
    """The newest working image, (height, width), and what an earlier one says that it shows."""

    now: NDArray[np.uint8]
    before: NDArray[np.uint8]  # the earlier image: of what stands still in the picture
    moved: NDArray[np.uint8]  # the same, moved as the ground was: of what lies on the ground
    plane: NDArray[np.float64]  # (3, 3) by which it was moved
    ratios: NDArray[np.float32]
    """(height, width) logarithms of how much worse motion explains a pixel than standing still."""

    def still_odds(self, strip: Strip, level: Derotation) -> float:
        """Log odds by which a strip's edges stand still in the picture, not on the ground.

        They are low where the ground does not move the edges aside, as along a runway that is flown
        along, or where the land beside does not move as the ground should.
        """
        x, y, left, right, *ends = strip
        aside = MOTION.beside * (right - left)
        land, _ = self._ratios(np.array([x, y, left - aside, right + aside, *ends]), level)
        edges, away = self._ratios(strip, level)
        ratio = min(np.minimum(edges, (away / MOTION.map_sigma) ** 2).sum(), -land.sum())
        near_end = self._near_ratio(strip, level)
        # Where that is out of sight, or moves, the edges say enough.
        ratio = near_end if near_end > max(ratio, 0.0) else ratio
        odds = MOTION.still_weight * (ratio - MOTION.still_doubt)
        return float(np.clip(odds, -MOTION.most_still_odds, MOTION.most_still_odds))

    def _near_ratio(self, strip: Strip, level: Derotation) -> float:
        """As of `_ratios`, of the near end, which lies across the way along a runway."""
        x, y, left, right, _, near = strip.tolist()
        columns = x + near * np.linspace(left, right, MOTION.near_places + 2)[1:-1]
        rows = y + near + np.arange(-MOTION.near_reach, MOTION.near_reach + 1.0)[:, None]
        across, down = np.broadcast_arrays(*level.to_working(columns, rows))
        places = across.astype(np.float32), down.astype(np.float32)
        found = cv2.remap(self.ratios, *places, cv2.INTER_NEAREST)
        least, most = found.min(axis=0), found.max(axis=0)
        # It is one edge, and counts as two.
        return 2.0 * float(np.where(most > -least, most, least).mean())

    def _ratios(self, strip: Strip, level: Derotation) -> Any:
        """(2,) logarithms of how much worse motion explains each edge than standing still does.

        Also (2,) px by which the ground would have moved them across themselves.
        """
        frames = (LevelledFrame(image, replace(level, factor=1)) for image in self[:3])
        now, *others = (sample_edges(frame, strip, 0.0) for frame in frames)
        spare, places = MOTION.spare, now.across.size
        images = np.stack([each.pixels for each in (now, *others)], dtype=float)
        # (3 images, 2 edges, rows, shifts, places)
        parts = np.lib.stride_tricks.sliding_window_view(
            images.reshape(3, 2, -1, places), places - 2 * spare, axis=3
        )
        error = np.square(parts[1:] - parts[:1, :, :, spare : spare + 1]).mean(axis=(2, 4))
        still, moved = error + MOTION.still_noise**2
        at = np.stack(level.to_working(now.expected, now.rows), axis=-1)
        way = cv2.perspectiveTransform(at, self.plane) - at
        along = at[:, -1:] - at[:, :1]
        across = np.linalg.det(np.stack(np.broadcast_arrays(way, along), axis=-1))
        away = np.abs(across).mean(axis=1) / np.linalg.norm(along[:, 0], axis=1)
        # Where exactly the ground has moved to is not known.
        return np.log(moved.min(axis=1) / still[:, spare]), away


class Overlaid:
    """Learns from working images of one size what is laid over the view.

    From some frames to the next the ground moves as a plane does. What stands still where that
    says that it should have moved is burned-in text, or a window's frame: no evidence.
    """

    def __init__(self) -> None:
        # (height, width), 255 where the picture is overlaid; None where nowhere.
        self.mask: NDArray[np.uint8] | None = None
        self.motion: GroundMotion | None = None  # up to the newest image, where it was measured
        self._odds: NDArray[np.float32] | None = None
        self._first = np.zeros((0, 0), np.uint8)
        self._corners = np.zeros((0, 1, 2), np.float32)
        self._age, self._period = 0, MOTION.period

    def take(self, gray: NDArray[np.uint8]) -> None:
        """Take in the next working image, (height, width); it may not be changed later."""
        self._age += 1
        self.motion = None
        if len(self._corners):
            if self._age % self._period:
                return
            if not self._compare(gray) and self._age < MOTION.max_period:
                return
        self._first, self._age = gray, 0
        found = cv2.goodFeaturesToTrack(
            gray, MOTION.max_corners, 0.005, MOTION.corner_distance, blockSize=3
        )
        self._corners = self._corners[:0] if found is None else np.asarray(found, np.float32)

    def _compare(self, gray: NDArray[np.uint8]) -> bool:
        """Whether the ground has moved, so that other corners are better."""
        now, found, _ = cv2.calcOpticalFlowPyrLK(
            self._first,
            gray,
            self._corners,
            self._corners.copy(),
            winSize=MOTION.flow_window,
            maxLevel=MOTION.flow_levels,
        )
        known = np.asarray(found)[:, 0] > 0
        old, new = self._corners[known, 0], np.asarray(now)[known, 0]
        way = np.linalg.norm(new - old, axis=1)
        moving = way > MOTION.max_still
        if np.count_nonzero(moving) < MOTION.min_moving:
            return False
        plane, agree = cv2.findHomography(
            old[moving],
            new[moving],
            cv2.USAC_FAST,
            ransacReprojThreshold=MOTION.max_residual,
            maxIters=200,
        )
        if plane is None or agree.mean() < MOTION.min_inliers:
            # Too fast to be followed over more than a frame.
            self._period = 1
            return True
        self._period = min(self._period + 1, MOTION.period)
        replicate, size = cv2.BORDER_REPLICATE, gray.shape[::-1]
        there = cv2.warpPerspective(self._first, plane, size, borderMode=replicate)
        moved = np.asarray(there, np.uint8)
        ratios = _ratios_of_pixels(gray, self._first, moved, plane)
        # Of digits that change on a picture that stands still there may be such a map, too.
        moves = ratios < -MOTION.plain_ratio
        if np.count_nonzero(moves) < MOTION.min_moved_share * moves.size:
            return False
        self._remember(ratios)
        self.motion = GroundMotion(gray, self._first, moved, plane, ratios)
        return True

    def _remember(self, ratios: NDArray[np.float32]) -> None:
        if self._odds is None:
            self._odds = np.zeros_like(ratios)
        self._odds *= 1.0 - MOTION.forgotten
        self._odds += ratios
        np.clip(self._odds, MOTION.least_still, MOTION.most_still, out=self._odds)
        overlaid = np.where(self._odds > MOTION.min_overlaid, 255, 0).astype(np.uint8)
        self.mask = None
        if overlaid.any():
            # It may be blurred, and its steps are seen from this far.
            around = np.ones((2 * MOTION.beside_overlaid + 1,) * 2, np.uint8)
            self.mask = np.asarray(cv2.dilate(overlaid, around), np.uint8)


def _ratios_of_pixels(
    now: NDArray[np.uint8], before: NDArray[np.uint8], moved: NDArray[np.uint8], plane: Any
) -> NDArray[np.float32]:
    """As `GroundMotion.ratios`; 0 where the ground hardly moved."""
    # Where exactly the ground has moved to is not known.
    near = np.ones((3, 3), np.uint8)
    below = cv2.subtract(cv2.erode(moved, near), now)
    above = cv2.subtract(now, cv2.dilate(moved, near))
    still, on_ground = (
        cv2.blur(error.astype(np.float32), (3, 3)) ** 2 + MOTION.pixel_noise**2
        for error in (cv2.absdiff(now, before), cv2.max(below, above))
    )
    most = MOTION.most_still_odds
    ratios = np.clip(np.log(on_ground / still), -most, most)
    ratios[_moved_by(plane, now.shape) < MOTION.min_moved] = 0.0
    return np.asarray(ratios, np.float32)


def _moved_by(plane: NDArray[np.float64], size: tuple[int, ...]) -> Any:
    """Px by which the ground at each pixel has moved, interpolated."""
    few = np.stack(np.meshgrid(*(np.arange(0.0, side, 8.0) for side in size[::-1])), axis=-1)
    way = np.linalg.norm(cv2.perspectiveTransform(few, plane) - few, axis=2)
    # Beyond the plane's horizon it is anything.
    return cv2.resize(np.minimum(way, 100.0), size[::-1])
