"""How much a place on the ground looks like a strip: unlike its left and its right side alike."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.approach.channels import Table
from mvuav_ros.vision.approach.numeric import best_run, in_common
from mvuav_ros.vision.approach.road.features import CHANNELS
from mvuav_ros.vision.approach.road.targets import EdgeProfile

Shapes = NDArray[np.float64]
"""(n, 4): vanishing point's x and y, and the columns by which the left and the right edge move to
the right per row below it; px on the levelled working image."""

_LEAST_GAP, _LEAST_FLANK, _MOST_FLANK = 0.4, 1.5, 24.0
_FIRST_DEPTH = 2.0
_FADED = 0.4
CEILING = 4.0
"""Floors: the contrast that counts most."""


@dataclass(frozen=True, eq=False)
class StripScores:
    """What `score_strips` says of n shapes.

    Attributes:
        score: (n,) sum over the depth of the strip, log scale, of contrast above the floor, in
            units of the floor; 0 where there is none.
        far: (n,) first row of the strip, px below the vanishing point.
        near: (n,) row after its last one, px below the vanishing point.
        contrast: (n, channels) mean of inside minus outside, grey levels.
        open_end: (n,) the strip leaves the image there.
    """

    score: NDArray[np.floating[Any]]
    far: NDArray[np.floating[Any]]
    near: NDArray[np.floating[Any]]
    contrast: NDArray[np.floating[Any]]
    open_end: NDArray[np.bool_]


def bounds_of(left: Any, right: Any, look: EdgeProfile) -> tuple[Any, ...]:
    """Columns between which a strip's outside and inside are averaged, from left to right.

    Four stretches: beside the left edge outside and inside, beside the right edge inside and
    outside. What lies in the middle of a runway, from rubber to figures, does not count.
    """
    width = right - left
    gap = np.maximum(look.gap * width, look.least_gap)
    flank = np.clip(look.flank * width, _LEAST_FLANK, _MOST_FLANK)
    inset = look.inset * width
    inside = look.inside * width
    return (
        left - gap - flank,
        left - gap,
        left + inset,
        left + inset + inside,
        right - inset - inside,
        right - inset,
        right + gap,
        right + gap + flank,
    )


def contrasts(
    sums: NDArray[Any], bounds: NDArray[Any], look: EdgeProfile
) -> tuple[NDArray[Any], NDArray[Any]]:
    """How a strip differs from both sides.

    Args:
        sums: (channels, 8, ...) row sums at the bounds.
        bounds: (8, ...) the bounds, already confined to the image.
        look: of the target.

    Returns:
        (channels, ...) what both sides have in common of inside minus outside, and (...) its
        size with the channels weighted. Of painted edges (2, ...) by how much the left and the
        right one are brighter than the inside, and their mean.
    """
    shares = bounds[1::2] - bounds[::2]
    means = (sums[:, 1::2] - sums[:, ::2]) / np.maximum(shares, 1e-3)
    left = means[:, 1] - means[:, 0]
    right = means[:, 2] - means[:, 3]
    if look.painted:
        sides = np.maximum(-np.stack([left[0], right[0]]), 0.0)
        np.minimum(sides, 2 * CEILING * look.floor, out=sides)
        size = 0.5 * (sides[0] + sides[1])
        common = sides
    else:
        common = in_common(left, right)
        size = np.hypot(look.brightness * common[0], np.minimum(common[1], 0.0))
    return common, size * _seen(bounds)


def _seen(bounds: NDArray[Any]) -> NDArray[Any]:
    """Where enough of both sides and of the strip itself is in the image."""
    shares = bounds[1::2] - bounds[::2]
    seen: NDArray[Any] = (np.minimum(shares[0], shares[3]) > 0.5) & (
        np.minimum(shares[1], shares[2]) > 0.2
    )
    return seen


def score_strips(table: Table, shapes: Shapes, look: EdgeProfile) -> StripScores:
    """Measure shapes row by row, and find where along its depth each is a strip."""
    _, height, stride = table.shape
    columns = stride - 1
    rows = np.arange(max(0, int(np.ceil(shapes[:, 1].min() + _FIRST_DEPTH))), height)
    count = shapes.shape[0]
    if rows.size < 2:
        nothing = np.zeros(count)
        return StripScores(
            nothing, nothing, nothing, np.zeros((count, CHANNELS)), np.zeros(count, bool)
        )
    depth = (rows - shapes[:, 1:2]).astype(np.float32)
    start = shapes[:, 0:1].astype(np.float32)
    left = start + shapes[:, 2:3].astype(np.float32) * depth
    right = start + shapes[:, 3:4].astype(np.float32) * depth
    # Pixel x covers [x - 0.5, x + 0.5].
    bounds = np.stack(bounds_of(left, right, look))
    bounds += np.float32(0.5)
    np.clip(bounds, 0, columns, out=bounds)
    sums = _interpolate(table, rows, bounds)
    common, size = contrasts(sums, bounds, look)
    # What is hidden speaks neither for nor against.
    seen = _seen(bounds)
    visible = (depth >= _FIRST_DEPTH) & seen
    depth = np.maximum(depth, 1.0)
    worth = visible / depth
    gain = (np.minimum(size / look.floor, CEILING) - 1.0) * worth
    _, first, last = best_run(gain)
    weight = _within(first, last, rows.size)
    # What is fainter by far than the rest is no longer the strip.
    limited = np.minimum(size, 2 * CEILING * look.floor)
    typical = (limited * weight).sum(axis=1, keepdims=True)
    floor = np.maximum(look.floor, _FADED * typical)
    _, first, last = best_run((limited - floor) * worth)
    weight = _within(first, last, rows.size)
    score = np.maximum((gain * (weight > 0)).sum(axis=1), 0.0)
    contrast = np.einsum('cnr,nr->nc', common, weight)
    if look.painted:
        score *= _balance(contrast[:, 0], contrast[:, 1])
        contrast = np.stack([-contrast.mean(axis=1), np.zeros(count)], axis=1)
    number = np.arange(count)
    far = depth[number, first]
    near = depth[number, np.maximum(last - 1, first)] + 1.0
    # Where the next row is hidden, nobody knows how far the strip goes on.
    beyond = np.minimum(last, rows.size - 1)
    open_end = (last >= rows.size - 1) | ~seen[number, beyond]
    return StripScores(score, far, near, contrast, open_end)


def _balance(left: NDArray[Any], right: NDArray[Any]) -> NDArray[Any]:
    """1 for two lines, be one of them dashed 1 : 2; less where one is faint beside the other."""
    larger = np.maximum(np.maximum(left, right), 1e-6)
    share: NDArray[Any] = np.minimum(left, right) / larger
    return np.clip((share - 0.03) / 0.22, 0.0, 1.0)


def _interpolate(table: Table, rows: NDArray[Any], bounds: NDArray[Any]) -> NDArray[Any]:
    """(channels, ..., r) row sums at r whole rows and (..., r) fractional columns."""
    channels, _, stride = table.shape
    whole = np.minimum(bounds.astype(np.int32), stride - 2)
    part = bounds - whole
    index = whole + (rows * stride).astype(np.int32)
    flat = table.reshape(channels, -1)
    below = flat.take(index, axis=1, mode='clip')
    index += 1
    above: NDArray[Any] = flat.take(index, axis=1, mode='clip')
    above -= below
    above *= part
    above += below
    return above


def _within(first: NDArray[Any], last: NDArray[Any], columns: int) -> NDArray[Any]:
    """(n, columns) equal weights that sum to 1 from ``first`` to before ``last``, else 0."""
    index = np.arange(columns)
    within = (index >= first[:, None]) & (index < last[:, None])
    share: NDArray[Any] = within / np.maximum(within.sum(axis=1, keepdims=True), 1)
    return share
