"""Maps of steps of brightness and colour, and of painted lines, in units of the local texture."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.approach.tuning import LEVELS, SEARCH
from mvuav_ros.vision.point_operations import Pixels

WORKING_WIDTH = 320
"""Px; images much wider than this are shrunk by a whole factor for the search."""

OPPONENT = np.array([(0.114, 0.587, 0.299), (1.0, -0.5, -0.5), (0.0, -1.0, 1.0)], np.float32)
"""Brightness (eq. 3.3), blue against yellow, red against green; from blue, green, red."""

Table = NDArray[np.float32]
"""(channels, rows, columns + 1) sums along the rows; element x is that of the x columns before."""


def shrunk_by(image: Pixels, factor: int) -> Pixels:
    """A frame, not smaller than a factor, with so many times fewer rows and columns."""
    if factor == 1:
        return image
    height, width = image.shape[:2]
    size = (width // factor, height // factor)
    whole = image[: size[1] * factor, : size[0] * factor]
    return np.asarray(cv2.resize(whole, size, interpolation=cv2.INTER_AREA))


def as_grey(image: Pixels) -> Pixels:
    """One channel of a frame of three that are alike, as a grey camera's driver may send it.

    So its encoding changes no result, and no time is lost on colours that are not there.
    """
    # A few pixels are enough for nearly every frame in colour.
    if image.ndim == 3 and (image[::16, ::16, :1] == image[::16, ::16, 1:]).all():
        gray, *others = cv2.split(image)
        if all(np.array_equal(gray, other) for other in others):
            return np.asarray(gray)
    return image


def opponent_channels(pixels: Pixels) -> list[NDArray[np.float32]]:
    """Brightness alone of a grey image, else the three channels of `OPPONENT`; grey levels."""
    levels = pixels.astype(np.float32)
    if pixels.ndim == 2:
        return [levels]
    return [np.ascontiguousarray(channel) for channel in cv2.split(cv2.transform(levels, OPPONENT))]


def brightness_of(pixels: Pixels) -> NDArray[np.float32]:
    """Of `opponent_channels` the first alone."""
    levels = pixels.astype(np.float32)
    return levels if pixels.ndim == 2 else np.asarray(cv2.transform(levels, OPPONENT[:1]))


def row_sums(channels: Sequence[NDArray[Any]] | NDArray[Any]) -> Table:
    """Sums along the rows of channels."""
    rows, columns = channels[0].shape
    table = np.zeros((len(channels), rows, columns + 1), np.float32)
    for channel, sums in zip(channels, table, strict=True):
        # Several times as fast as adding up one row after the other.
        area = np.asarray(cv2.integral(channel, sdepth=cv2.CV_64F))
        np.subtract(area[1:], area[:-1], out=sums, casting='same_kind')
    return table


UNIT = 16
"""Of the evidence maps: so many are one local texture."""
COARSE = 4
"""Evidence units of the search are so many times coarser: sums of eight fit into a byte."""
_MAX_COARSE = 15
CHANNELS = 4
"""Of the maps: brightness, blue against yellow, red against green, paint."""
MIRROR = np.array([-1, -1, -1, 1], np.int8)
"""Of a right edge steps have the other sign, paint has none."""


class GreyLevels:
    """Of a camera's frames: how many bits they have, and how much of the grey levels they use.

    Those of 10 to 14 bits use the lower part of 16; in fog, or underexposed, hardly any is used.
    """

    def __init__(self) -> None:
        self._bits = 8
        self._newest_bits: deque[int] = deque(maxlen=LEVELS.bit_frames)
        self._ends: NDArray[np.float64] | None = None  # between which most of the pixels are

    def levels(self, image: Pixels) -> Pixels:
        """A frame in 256 grey levels, by the brightest pixel of this camera by now.

        But for the first, two of the last frames must show more bits: one may be damaged.
        """
        if image.size == 0:
            return image
        if image.dtype != np.uint8:
            newest = max(8, int(image.max()).bit_length())
            self._newest_bits.append(newest)
            both = sorted(self._newest_bits)[-2:]
            self._bits = newest if self._bits == 8 else max(self._bits, both[0])
            image = np.minimum(image >> (self._bits - 8), 255).astype(np.uint8)
        return self._stretched(image)

    def _stretched(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """With more contrast, where the last frames had little."""
        step = max(1, image.shape[1] // LEVELS.columns)
        # Of all channels: what has plain colours is in no fog.
        ends = np.percentile(image[::step, ::step], LEVELS.shares)
        if ends[1] - ends[0] < LEVELS.min_spread:
            return image
        last = ends if self._ends is None else self._ends
        self._ends = last + LEVELS.memory * (ends - last)
        low, high = self._ends
        gain = min(LEVELS.usual_spread / (high - low), LEVELS.max_gain)
        if gain <= 1.0:
            return image
        table = (np.arange(256) - low) * gain + LEVELS.darkest
        return np.asarray(cv2.LUT(image, np.clip(table, 0, 255).astype(np.uint8)), np.uint8)


def shrink_levels(image: Pixels) -> tuple[NDArray[Any], int]:
    """A frame, not empty, about `WORKING_WIDTH` px wide, and px of the frame per px of it."""
    height, width = image.shape[:2]
    factor = max(1, min(round(width / WORKING_WIDTH), height))
    return shrunk_by(image, factor), factor


def in_common(one: NDArray[Any], other: NDArray[Any]) -> NDArray[Any]:
    """What both sides agree in: the smaller of two values of one sign, else 0.

    Examples:
        >>> in_common(np.array([3.0, -3.0, 3.0]), np.array([5.0, -2.0, -1.0]))
        array([ 3., -2.,  0.])
    """
    least: NDArray[Any] = np.minimum(one, other)
    most = np.maximum(one, other)
    # The median of both and 0.
    np.maximum(least, np.minimum(most, 0, out=most), out=least)
    return least


@dataclass(frozen=True, eq=False)
class EvidenceMap:
    """A levelled image, or a part of it, as evidence."""

    sums: Table  # of the 1 or 3 opponent channels, grey levels
    evidence: NDArray[np.int8]  # (height, width, 4) in `UNIT`: steps to the right, and paint
    texture: NDArray[np.float32]  # (height, width) of brightness, grey levels

    @property
    def height(self) -> int:
        """Rows."""
        return int(self.evidence.shape[0])

    @property
    def width(self) -> int:
        """Columns."""
        return int(self.evidence.shape[1])

    def packed(self, blank: int) -> NDArray[np.int32]:
        """((blank + height) * width,) all channels of a pixel in one number, coarse.

        The blank rows above have no evidence, nor have the first and the last column, which stand
        for all beside the image.
        """
        coarse = np.zeros((blank + self.height, self.width, CHANNELS), np.int8)
        inner = coarse[blank:, 1:-1]
        np.floor_divide(self.evidence[:, 1:-1], COARSE, out=inner)
        np.maximum(inner, -_MAX_COARSE, out=inner)
        np.minimum(inner, _MAX_COARSE, out=inner)
        return coarse.view(np.int32).ravel()

    def at(self, rows: NDArray[Any], columns: NDArray[Any]) -> tuple[NDArray[np.int8], Any]:
        """Evidence of left and right edges at columns (2, ...) in rows, and whether it is in view.

        It is (2, ..., 4), 0 outside of the image. Steps of a right edge have the other sign.
        """
        column = np.rint(columns).astype(np.int32)
        row = np.asarray(rows, np.int32)
        # As unsigned numbers those below 0 are too large as well.
        inside = (column.view(np.uint32) < self.width) & (row.view(np.uint32) < self.height)
        index = row * np.int32(self.width) + column
        index *= inside
        values = self.evidence.reshape(-1, CHANNELS).view(np.int32).ravel().take(index)
        values *= inside
        evidence = values.view(np.int8).reshape((*column.shape, CHANNELS))
        evidence[1] *= MIRROR
        return evidence, inside

    def in_common(
        self, rows: NDArray[Any], columns: NDArray[Any]
    ) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
        """What both edges of `at` have in common, in textures, and whether both are in view."""
        found, inside = self.at(rows, columns)
        common = in_common(found[0], found[1]).astype(np.float32)
        return common * np.float32(1 / UNIT), inside[0] & inside[1]

    def means(
        self, rows: NDArray[Any], first: NDArray[Any], last: NDArray[Any]
    ) -> tuple[NDArray[Any], NDArray[np.bool_]]:
        """Mean of each channel between columns, in the image; and where there are any."""
        ends = np.stack([first, last])
        ends += 0.5
        np.maximum(ends, 0, out=ends)
        begin, end = np.rint(np.minimum(ends, self.width, out=ends)).astype(np.intp)
        np.maximum(end, begin, out=end)
        start = np.minimum(np.maximum(rows, 0), self.height - 1) * (self.width + 1)
        flat = self.sums.reshape(len(self.sums), -1)
        total = flat.take(start + end, axis=1)
        total -= flat.take(start + begin, axis=1)
        return total / np.maximum(end - begin, 1), end > begin


def gather_evidence(pixels: NDArray[Any], hidden: NDArray[np.bool_] | None = None) -> EvidenceMap:
    """Make the maps of a levelled image of 256 grey levels, or colours.

    There is no evidence where it is hidden, (height, width).
    """
    channels = opponent_channels(pixels)
    brightness = channels[0]
    floors = (SEARCH.brightness_floor, SEARCH.colour_floor, SEARCH.colour_floor)
    planes = [_quantised(_steps(*each)) for each in zip(channels, floors, strict=False)]
    planes += [np.zeros_like(planes[0])] * (CHANNELS - 1 - len(planes))
    change = np.zeros_like(brightness)
    np.abs(brightness[:, 1:] - brightness[:, :-1], out=change[:, :-1])
    planes.append(_quantised(_paint(brightness, change)))
    evidence = np.asarray(cv2.merge(planes), np.int8)
    texture = cv2.blur(np.minimum(change, np.float32(20.0), out=change), (31, 9))
    if hidden is not None:
        evidence[hidden] = 0
    return EvidenceMap(row_sums(channels), evidence, np.asarray(texture, np.float32))


def _quantised(values: NDArray[np.float32]) -> NDArray[np.int8]:
    """In units of the maps; ``values`` are lost."""
    most = SEARCH.most_evidence * UNIT
    values *= UNIT
    return np.clip(values, -most, most, out=values).astype(np.int8)


def _steps(channel: NDArray[np.float32], floor: float) -> NDArray[np.float32]:
    """How much larger a channel is to the right of each pixel than to its left, in textures."""
    reach = SEARCH.step_reach
    kernel = np.array([[-1] * reach + [0] + [1] * reach], np.float32) / reach
    step = cv2.filter2D(channel, -1, kernel, borderType=cv2.BORDER_REPLICATE)
    size: NDArray[Any] = np.abs(step)
    # One bright roof must not hide the field beside it.
    np.minimum(size, 4.0 * float(size[::3, ::3].mean()) + floor, out=size)
    usual = np.asarray(cv2.blur(size, SEARCH.texture_window), np.float32)
    usual *= 1.25
    usual += floor
    return np.asarray(np.divide(step, usual, out=usual), np.float32)


def _paint(brightness: NDArray[np.float32], change: NDArray[np.float32]) -> NDArray[np.float32]:
    """How much brighter each pixel is than the pixels on both sides, in textures."""
    ridge = np.zeros_like(brightness)
    for reach in SEARCH.ridge_reaches:
        sides = np.maximum(brightness[:, : -2 * reach], brightness[:, 2 * reach :])
        inner = ridge[:, reach:-reach]
        np.subtract(brightness[:, reach:-reach], sides, out=sides)
        np.maximum(inner, sides, out=inner)
    limit = 4.0 * float(change.mean()) + 1.0
    usual = np.asarray(cv2.blur(np.minimum(change, limit), SEARCH.texture_window), np.float32)
    usual *= 1.5
    usual += 1.5
    ridge /= usual
    return np.asarray(cv2.dilate(ridge, np.ones((1, 3), np.uint8)), np.float32)
