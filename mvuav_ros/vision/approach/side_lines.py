"""A runway's edges from the bright lines along its sides: they end where its pavement ends.

Painted side stripes, and concrete beside a streak of rubber, are the clearest thing in a runway far
away. Their inner sides look like the edges of a darker strip, and their middles like painted lines;
the runway's edge is where the line's outer side is.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.approach.derotation import Derotation
from mvuav_ros.vision.approach.edges import EdgePoints
from mvuav_ros.vision.approach.evidence import opponent_channels


@dataclass(frozen=True)
class SideLineParameters:
    """Constants of the search for side lines; lengths are shares of the runway's width in a row.

    Chosen on runs 3 and 5.

    Attributes:
        step: between samples across an edge.
        reach: sampled on both sides of where an edge is expected.
        farthest: between a line's middle and the expected edge.
        halves: half widths of lines.
        rows: sampled between the far and the near end.
        outwards_less: by how much a line ``farthest`` outside the expected edge counts less than
            one at it: where there are two lines, the outer one is the shoulder's.
        inwards_less: by how much one counts less that is as far inside.
        turned_less: by how much one counts less that moves by twice ``farthest`` from end to end.
        beyond: how far beyond a line's middle in which its outer side is looked for.
        noise: grey levels of ridges that are taken to be everywhere.
        weakest: share of the clearest line's clearness from which another line counts.
        widest: px of the near end from which the pavement beyond the lines can be seen, so that the
            edges are not the lines'.
        least_clearness: of the fainter line, in usual ridges of the place.
    """

    step: float = 0.02
    reach: float = 0.5
    farthest: float = 0.24
    halves: tuple[float, ...] = (0.06, 0.1)
    rows: int = 24
    outwards_less: float = 1.5
    inwards_less: float = 0.3
    turned_less: float = 0.8
    beyond: float = 0.16
    noise: float = 0.5
    weakest: float = 0.55
    widest: float = 30.0
    least_clearness: float = 1.2


SIDE_LINES = SideLineParameters()
Numbers = NDArray[np.floating[Any]]
_CLIPPED = 4.0
"""Usual ridges: more counts as that, so that one lamp is not a line."""


def edges_by_lines(
    image: NDArray[Any],
    level: Derotation,
    shape: NDArray[np.float64],
    span: tuple[float, float],
) -> tuple[EdgePoints, EdgePoints] | None:
    """Measure both edges of a narrow runway by the outer sides of the lines along them.

    Args:
        image: the frame, (height, width) or (height, width, 3), blue first.
        level: of the frame.
        shape: (4,) vanishing point and slopes, px of the levelled working image.
        span: rows from the vanishing point to the far and to the near end.

    Returns:
        Points of the left and of the right edge; None if the lines are not clear, or the runway is
        so wide that its pavement can be seen beyond them.
    """
    x, y, left, right = (float(value) for value in shape)
    if (right - left) * span[1] >= SIDE_LINES.widest:
        return None
    share = (np.arange(SIDE_LINES.rows) + 0.5) / SIDE_LINES.rows
    depth = span[0] + share * (span[1] - span[0])
    width = np.maximum((right - left) * depth, 2.0)
    count = round(SIDE_LINES.reach / SIDE_LINES.step)
    # From inside to outside.
    across = np.arange(-count, count + 1) * SIDE_LINES.step
    edges = []
    for slope, outwards in ((left, -1.0), (right, 1.0)):
        expected = x + slope * depth
        columns = expected[:, None] + outwards * across * width[:, None]
        brightness = _brightness(image, level, columns, y + depth)
        far, near, clearness = _clearest(brightness, across)
        if clearness <= SIDE_LINES.least_clearness:
            return None
        offset = far + share * (near - far)
        offset = offset + _outer_side(brightness, across, offset)
        ones = np.ones(depth.size)
        edges.append(EdgePoints(y + depth, expected + outwards * offset * width, ones, 1.0))
    return edges[0], edges[1]


def _brightness(
    image: NDArray[Any], level: Derotation, columns: NDArray[Any], rows: NDArray[Any]
) -> NDArray[np.float32]:
    """(rows, places) grey levels of the frame at places of the levelled working image."""
    on_x, on_y = level.to_frame(columns, np.broadcast_to(rows[:, None], columns.shape))
    # Fixed-point maps: with others, OpenCV 5 rounds as the arrays happen to lie in memory.
    places, parts = cv2.convertMaps(on_x.astype(np.float32), on_y.astype(np.float32), cv2.CV_16SC2)
    pixels = cv2.remap(image, places, parts, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    levels = pixels / 256.0 if image.dtype == np.uint16 else pixels
    return opponent_channels(np.asarray(levels))[0]


def _clearest(brightness: NDArray[np.float32], across: Numbers) -> tuple[float, float, float]:
    """The line nearest to where it is expected among the clear ones.

    Returns:
        Its middle at the far and at the near end, and its clearness.
    """
    lines = [line for half in SIDE_LINES.halves for line in _lines(brightness, across, half)]
    clearest = max(line[2] for line in lines)
    farthest = 2.0 * SIDE_LINES.farthest

    def worth(line: tuple[float, float, float]) -> float:
        away = (line[0] + line[1]) / farthest
        return line[2] / max(clearest, 1e-6) - (
            SIDE_LINES.outwards_less if away > 0 else SIDE_LINES.inwards_less
        ) * abs(away)

    clear = [line for line in lines if line[2] >= SIDE_LINES.weakest * clearest]
    return max(clear, key=worth)


def _lines(
    brightness: NDArray[np.float32], across: Numbers, half: float
) -> list[tuple[float, float, float]]:
    """The clearest lines of a width that are apart from one another, as `_clearest`."""
    reach = round(half / SIDE_LINES.step)
    smooth = cv2.blur(brightness, (reach | 1, 1))
    sides = np.maximum(smooth[:, : -2 * reach], smooth[:, 2 * reach :])
    ridge = np.maximum(smooth[:, reach:-reach] - sides, 0.0)
    usual = float(ridge.mean())
    ridge = np.minimum(ridge, _CLIPPED * usual + 1.0)
    middles = across[reach:-reach]
    ends = np.nonzero(np.abs(middles) <= SIDE_LINES.farthest)[0]
    far, near = (each.ravel() for each in np.meshgrid(ends, ends, indexing='ij'))
    rows = np.arange(len(ridge))
    at = np.rint(far[:, None] + (near - far)[:, None] * (rows / max(rows[-1], 1))).astype(np.intp)
    votes = ridge.ravel().take(at + rows * ridge.shape[1]).mean(axis=1)
    turned = np.abs(middles[far] - middles[near]) / (2.0 * SIDE_LINES.farthest)
    clear = (
        votes / (float(ridge.mean()) + SIDE_LINES.noise) * (1.0 - SIDE_LINES.turned_less * turned)
    )
    centre = 0.5 * (middles[far] + middles[near])
    found = []
    for _ in range(3):
        best = int(clear.argmax())
        found.append((float(middles[far[best]]), float(middles[near[best]]), float(clear[best])))
        clear[np.abs(centre - centre[best]) < half] = 0.0
    return found


def _outer_side(brightness: NDArray[np.float32], across: Numbers, middle: Numbers) -> float:
    """From a line's middle to where it has become half as bright as it is, towards outside."""
    reach = round(SIDE_LINES.beyond / SIDE_LINES.step)
    places = np.arange(-3, reach + 1) * SIDE_LINES.step
    profile = np.mean(
        [np.interp(at + places, across, row) for at, row in zip(middle, brightness, strict=True)],
        axis=0,
    )
    peak = int(profile[:8].argmax())
    beyond = profile[peak:]
    falls = np.diff(beyond)
    # The first minimum after the peak: there may be another line farther outside.
    rising = np.nonzero((falls >= 0) & (beyond[:-1] < beyond[0] - 2.0))[0]
    lowest = int(rising[0]) if rising.size else int(beyond.argmin())
    half = 0.5 * (beyond[0] + beyond[lowest])
    last = int(np.count_nonzero(beyond[: lowest + 1] > half)) - 1
    if last < 0 or last + 1 > lowest:
        return float(places[peak])
    part = (beyond[last] - half) / max(float(beyond[last] - beyond[last + 1]), 1e-6)
    return float(places[peak] + (last + part) * SIDE_LINES.step)
