"""Where exactly a strip's two edges are, near where they are expected."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.approach.derotation import Derotation
from mvuav_ros.vision.approach.features import PLAIN, Colours, features_of
from mvuav_ros.vision.approach.targets import EdgeProfile

_MOST_ROWS = 40
_SAMPLE = 0.5
"""Px of the working image between samples across an edge."""
_COLOUR_SMOOTHING = 13
"""Samples across an edge, to find its line in: JPEG rounds colour coarsely."""
_REACH_SHARE, _LEAST_REACH, _MOST_REACH = 0.35, 3.0, 8.0
_SUPPORT = 0.25
"""A row supports an edge with a step of this share of the strip's contrast."""
_WIDTHS_PER_STEP = 12.0
_USUAL_RANK = 0.15


@dataclass(frozen=True, eq=False)
class EdgePoints:
    """Points of one edge on the levelled working image.

    Attributes:
        rows: (n,) px.
        columns: (n,) px.
        weights: (n,) 0 to 1.
        support: share of the rows searched that have a step there, 0 to 1.
    """

    rows: NDArray[np.float64]
    columns: NDArray[np.float64]
    weights: NDArray[np.float64]
    support: float


def find_edges(
    image: NDArray[Any],
    level: Derotation,
    shape: NDArray[np.float64],
    span: tuple[float, float],
    contrast: NDArray[np.float64],
    look: EdgeProfile,
    colours: Colours = PLAIN,
) -> tuple[EdgePoints, EdgePoints]:
    """Measure the left and the right edge.

    Args:
        image: the frame, (height, width) or (height, width, 3), blue first.
        level: of the frame.
        shape: (4,) as in `strip`.
        span: first row and row after the last one, px below the vanishing point.
        contrast: (channels,) inside minus outside.
        look: of the target.
        colours: with which ``contrast`` was measured.
    """
    sampled = sample_edges(image, level, shape, span)
    direction, size = _direction(contrast, look)

    def steps_of(smoothing: int) -> NDArray[Any]:
        features = features_of(sampled.pixels, colours, smoothing)
        profile = direction[0] * features[0] + direction[1] * features[1]
        clipped: NDArray[Any] = np.clip(sampled.steps(profile), 0.0, size)
        return clipped

    # Noise of colour hides the line, smoothing it moves the steps: each for what it leaves alone.
    return sampled.fit(steps_of(1), steps_of(_COLOUR_SMOOTHING), size)


@dataclass(frozen=True, eq=False)
class EdgeSamples:
    """The frame's pixels across both edges.

    Attributes:
        pixels: (2 count, places) or (2 count, places, 3): rows of the left, then of the right edge.
        expected: (2, count) columns of the edges, px of the levelled working image.
        rows: (count,) likewise.
        across: (places,) px from the expected column.
        inside: (2, count, places) is on the frame.
        base: samples over which a step is measured, even.
    """

    pixels: NDArray[Any]
    expected: NDArray[np.floating[Any]]
    rows: NDArray[np.floating[Any]]
    across: NDArray[np.floating[Any]]
    inside: NDArray[np.bool_]
    base: int

    @property
    def _middle(self) -> slice:
        return slice(self.base // 2, -(self.base // 2))

    def steps(self, profile: NDArray[Any]) -> NDArray[Any]:
        """(2, count, places - base) rise of a profile of the pixels towards the strip's inside."""
        step = profile[:, self.base :] - profile[:, : -self.base]
        step = step.reshape(2, self.rows.size, -1)
        step[1] *= -1
        return np.where(self.inside[:, :, self._middle], step, 0.0)

    def fit(
        self, clear: NDArray[Any], smooth: NDArray[Any], size: float
    ) -> tuple[EdgePoints, EdgePoints]:
        """Points of both edges.

        Args:
            clear: (2, count, places - base) steps from 0 to ``size``, for the points.
            smooth: likewise, for the line along which they are looked for.
            size: of a whole step.
        """
        across = self.across[self._middle]
        left, right = (
            _fit(clear[side], smooth[side], across, self.expected[side], self.rows, size, self.base)
            for side in (0, 1)
        )
        return left, right


def sample_edges(
    image: NDArray[Any], level: Derotation, shape: NDArray[np.float64], span: tuple[float, float]
) -> EdgeSamples:
    """Take the pixels across both edges of a strip from the frame; see `find_edges`."""
    x, y, *slopes = (float(v) for v in shape)
    far, near = span
    count = int(np.clip((near - far) * level.factor, 6, _MOST_ROWS))
    depth = far + (np.arange(count) + 0.5) * ((near - far) / count)
    reach = float(np.clip(_REACH_SHARE * (slopes[1] - slopes[0]) * near, _LEAST_REACH, _MOST_REACH))
    steps = round(reach / _SAMPLE)
    across = np.arange(-steps, steps + 1) * _SAMPLE
    expected = x + np.array(slopes)[:, None] * depth
    columns = expected[:, :, None] + across
    rows = np.broadcast_to((y + depth)[None, :, None], columns.shape)
    pixels, on_x, on_y = pixels_at(image, level, columns, rows)
    # JPEG halves the resolution of colour; and where there is room, soft edges are whole steps.
    base = int(np.clip((slopes[1] - slopes[0]) * near / _WIDTHS_PER_STEP, 2, 4) / _SAMPLE)
    inside = (on_x > 0) & (on_x < image.shape[1] - 1) & (on_y > 0) & (on_y < image.shape[0] - 1)
    return EdgeSamples(pixels, expected, y + depth, across, inside, 2 * (base // 2))


def rows_of(
    shape: NDArray[np.float64], span: tuple[float, float], along: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """A runway's width and edges in some rows.

    Args:
        shape: (4,) vanishing point and slopes, px of the levelled working image.
        span: rows from the vanishing point to the far and to the near end.
        along: (n,) where the rows are, from 0, the far end, to 1.

    Returns:
        The rows (n,), the columns of the left and of the right edge (2, n), and the width, at
        least 2 px, towards outside of each of them (2, n): negative at the left one.
    """
    x, y, left, right = (float(value) for value in shape)
    depth = span[0] + along * (span[1] - span[0])
    width = np.maximum((right - left) * depth, 2.0)
    edges = x + np.array([[left], [right]]) * depth
    return y + depth, edges, np.array([[-1.0], [1.0]]) * width


def pixels_at(
    image: NDArray[Any], level: Derotation, columns: NDArray[Any], rows: NDArray[Any]
) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    """The frame at places of the levelled working image, interpolated.

    Args:
        image: the frame, (height, width) or (height, width, 3).
        level: of the frame.
        columns: (2, count, places) px.
        rows: (2, count, places) px.

    Returns:
        The pixels, (2 count, places) or (2 count, places, 3), and the frame's columns and rows,
        each as ``columns``.
    """
    on_x, on_y = level.to_frame(columns, rows)
    flat = (-1, columns.shape[-1])
    # Fixed-point maps: with others, OpenCV 5 rounds as the arrays happen to lie in memory.
    places, parts = cv2.convertMaps(
        on_x.reshape(flat).astype(np.float32), on_y.reshape(flat).astype(np.float32), cv2.CV_16SC2
    )
    pixels = cv2.remap(image, places, parts, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(pixels), on_x, on_y


def _direction(
    contrast: NDArray[np.float64], look: EdgeProfile
) -> tuple[NDArray[np.float64], float]:
    """Weights of the channels with which the inside stands out most, and by how much."""
    weights = np.array([look.brightness, 1.0])
    weighted = contrast * weights
    size = float(np.hypot(*weighted))
    return weighted * weights / max(size, 1e-6), size


def _fit(
    step: NDArray[Any],
    smooth: NDArray[Any],
    across: NDArray[Any],
    expected: NDArray[Any],
    rows: NDArray[Any],
    size: float,
    base: int,
) -> EdgePoints:
    """Choose the straight line with the most smooth steps along it, then the steps' own places."""
    count, places = step.shape
    along = (rows - rows[0]) / max(rows[-1] - rows[0], 1e-6)
    ends = np.arange(0, places, 2)
    far, near = (v.ravel() for v in np.meshgrid(ends, ends, indexing='ij'))
    at = far[:, None] + (near - far)[:, None] * along
    index = np.rint(at).astype(np.intp) + np.arange(count) * places
    middle = 0.5 * (places - 1)
    # Of equal lines the expected one.
    away = (np.abs(far - middle) + np.abs(near - middle)) / places
    votes = smooth.ravel().take(index).sum(axis=1)
    votes = votes * (1.0 - 0.3 * away)
    best = int(votes.argmax())
    chosen = np.rint(at[best]).astype(np.intp)
    near_line = chosen[:, None] + np.arange(-base // 2 - 1, base // 2 + 2)
    valid = (near_line >= 0) & (near_line < places)
    near_line = np.clip(near_line, 0, places - 1)
    local = np.where(valid, np.take_along_axis(step, near_line, axis=1), 0.0)
    total = local.sum(axis=1)
    columns = expected + (local * across[near_line]).sum(axis=1) / np.maximum(total, 1e-6)
    # A step of the contrast's size is seen by all samples around it.
    weights = np.clip(total / (base * max(size, 1e-6)), 0.0, 1.0)
    weights = np.where(weights > _SUPPORT, weights, 0.0)
    # Where there are steps everywhere, the best line is not worth much.
    rank = int(_USUAL_RANK * votes.size)
    usual = float(np.partition(votes, rank)[rank])
    support = (float(votes[best]) - usual) / (count * max(size, 1e-6))
    return EdgePoints(rows, columns, weights, float(np.clip(support, 0.0, 1.0)))
