"""A runway's edges: the outer sides of the bright lines along it, stripes or bare concrete."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.approach.evidence import brightness_of
from mvuav_ros.vision.approach.strip_edges import Edges, LevelledFrame, Strip, rows_of, sample_edges
from mvuav_ros.vision.approach.strips import strips_through
from mvuav_ros.vision.approach.tuning import LINES

Numbers = NDArray[np.floating[Any]]


class Line(NamedTuple):
    """A line along an edge; its middle is in widths of the runway outside of the expected edge."""

    far: float  # middle at the far end
    near: float  # at the near end
    clearness: float  # in usual ridges of the place

    @property
    def middle(self) -> float:
        """Half way between both ends."""
        return 0.5 * (self.far + self.near)


def choose(
    left: list[Line], right: list[Line], expected: tuple[float, float], away_cost: float
) -> tuple[Line, Line]:
    """Which lines are the runway's, among those along its left and its right edge.

    Markings within the runway are fainter than its side line. Of two clear lines on both sides, as
    far apart, the outer ones are the shoulders'. Log odds are lost per width from where the edges
    are expected, widths outside of where `Line` counts from.
    """
    both = left, right
    middles = [np.array([line.middle for line in lines]) for lines in both]
    clear = [_clear(np.array([line.clearness for line in lines])) for lines in both]
    # How far each line is outside of each other one, and whether both are clear.
    gaps = [middle[:, None] - middle for middle in middles]
    pairs = [
        np.minimum.outer(share, share) * (gap > LINES.same)
        for share, gap in zip(clear, gaps, strict=True)
    ]
    chosen = []
    for side, lines in enumerate(both):
        alike = np.abs(np.subtract.outer(gaps[side], gaps[1 - side])) < LINES.same
        shoulder = (np.minimum.outer(pairs[side], pairs[1 - side]) * alike).max(axis=(1, 2, 3))
        odds = np.log(clear[side] + 1e-9) - LINES.shoulder_cost * shoulder
        odds -= away_cost * np.abs(middles[side] - expected[side])
        chosen.append(lines[int(odds.argmax())])
    return chosen[0], chosen[1]


def _clear(clearness: Numbers) -> Numbers:
    """From 0 to 1, whether each line is as clear as the clearest."""
    ahead: Numbers = clearness / max(float(clearness.max()), 1e-6) - LINES.clear_share
    return np.asarray(1.0 / (1.0 + np.exp(-ahead / LINES.clear_doubt)))


_ALONG = (np.arange(LINES.rows) + 0.5) / LINES.rows
"""Where the rows are between the far and the near end."""
_PLACES = round(LINES.reach / LINES.step)
_ACROSS = np.arange(-_PLACES, _PLACES + 1) * LINES.step
"""Where the samples are, from inside to outside, widths from the expected edge."""


def find_side_lines(
    frame: LevelledFrame,
    strip: Strip,
    known: Edges | None = None,
    *,
    coloured: bool = False,
) -> Edges | None:
    """Measure both edges of a narrow runway by the outer sides of the lines along a strip's, (6,).

    Lines are expected between the strip's edges and those known, or where colour has shown
    those. None if the lines are not clear or seen in too few rows, or the runway is too wide.
    """
    rows, expected, outwards = rows_of(strip, _ALONG)
    if outwards[1, -1] >= LINES.max_width:
        return None
    columns = expected[:, :, None] + outwards[:, :, None] * _ACROSS
    pixels, _ = frame.at(columns, rows[:, None])
    one, other = _distinct(brightness_of(pixels).reshape(columns.shape))
    left, right = (0.0, 0.0) if known is None else _away(strip, known)
    share, cost = (1.0, LINES.away_from_colour_cost) if coloured else (0.5, LINES.away_cost)
    lines = choose(one, other, (share * left, share * right), cost)
    if min(line.clearness for line in lines) <= LINES.min_clearness:
        return None
    rows, edges, outwards = rows_of(strip, np.array([0.0, 1.0]))
    middles = edges + outwards * np.array(lines)[:, :2]
    sides = _outer_sides(frame, strips_through(middles[None], rows, rows[None])[0])
    plain = sides is not None and min(side.support for side in sides) > LINES.min_support
    return sides if plain else None


def _outer_sides(frame: LevelledFrame, strip: Strip) -> Edges | None:
    """Both edges from the lines whose middles are a strip's; None without sides alike."""
    samples = sample_edges(frame, strip, LINES.beyond)
    falls = np.maximum(samples.steps(brightness_of(samples.pixels)), 0.0)
    deepest = falls.max(axis=2)
    size = float(deepest.mean())
    left, right = np.median(deepest, axis=1).tolist()
    # The land is about as dark on both sides; a joint between slabs is not as dark as it.
    if size < LINES.min_depth or min(left, right) < LINES.min_alike * max(left, right):
        return None
    sides = samples.fit(np.minimum(falls, size), size)
    # The fall of a line thinner than a step, whose weight is its width in steps, is found half a
    # step from its middle.
    half = 0.5 * float(samples.across[samples.base] - samples.across[0])
    parts = [np.array_split(side.weights[side.weights > 0], 2) for side in sides]
    widths = np.array([[part.sum() / max(part.size, 1) for part in each] for each in parts])
    outside = half * np.maximum(1.0 - 1.5 * widths + 0.5 * widths[:, ::-1], 0.0)
    one, other = (
        replace(side, outside=tuple(each)) for side, each in zip(sides, outside, strict=True)
    )
    return one, other


def _away(strip: Strip, points: Edges) -> tuple[float, float]:
    """How far outside of a strip's left and right edge points lie, in its widths."""
    away = []
    for edge, slope in zip(points, strip[2:4].tolist(), strict=True):
        depth = edge.rows - strip[1]
        offsets = (edge.columns - strip[0] - slope * depth) / ((strip[3] - strip[2]) * depth)
        away.append(float(np.average(offsets, weights=edge.weights + 1e-6)))
    return -away[0], away[1]


@dataclass(frozen=True, eq=False)
class _LineFan:
    """All straight lines of a width along an edge."""

    reach: int  # samples between a line's middle and what is beside it
    ends: Numbers  # (n, 2) middle at the far and at the near end, widths of the runway
    at: NDArray[np.intp]  # (rows, n) samples through which they go
    worth: Numbers  # (n,) factor of the clearness: those that run askew count less


@lru_cache
def _line_fan(half: float) -> _LineFan:
    reach = round(half / LINES.step)
    middles = _ACROSS[reach:-reach]
    near_edge = np.nonzero(np.abs(middles) <= LINES.max_away)[0]
    far, near = (each.ravel() for each in np.meshgrid(near_edge, near_edge, indexing='ij'))
    turned = np.abs(middles[far] - middles[near])
    straight = turned <= LINES.max_turned
    far, near, turned = far[straight], near[straight], turned[straight]
    rows = np.arange(LINES.rows)[:, None]
    at = np.rint(far + (near - far) * (rows / (LINES.rows - 1))).astype(np.intp)
    ends = np.stack([middles[far], middles[near]], axis=1)
    return _LineFan(reach, ends, at + rows * middles.size, 1.0 - LINES.turned_cost * turned)


def _distinct(brightness: NDArray[np.float32]) -> list[list[Line]]:
    """Along either edge the clearest lines that are apart from one another, of any width."""
    fans = [_line_fan(half) for half in LINES.half_widths]
    ends = np.concatenate([fan.ends for fan in fans])
    middles = ends.mean(axis=1)
    found: list[list[Line]] = []
    for clear in np.concatenate([_clearness(brightness, fan) for fan in fans], axis=1):
        lines: list[Line] = []
        while len(lines) < LINES.most and (not lines or clear.any()):
            best = int(clear.argmax())
            far, near = ends[best].tolist()
            lines.append(Line(far, near, float(clear[best])))
            clear[np.abs(middles - middles[best]) <= LINES.apart] = 0.0
        found.append(lines)
    return found


def _clearness(brightness: NDArray[np.float32], fan: _LineFan) -> Numbers:
    """(2, n) of all lines of a fan along either edge."""
    reach = fan.reach
    smooth = cv2.blur(brightness.reshape(2 * LINES.rows, -1), (reach | 1, 1))
    sides = np.maximum(smooth[:, : -2 * reach], smooth[:, 2 * reach :])
    ridges = np.maximum(smooth[:, reach:-reach] - sides, 0.0).reshape(2, -1)
    usual = ridges.mean(axis=1, keepdims=True)
    np.minimum(ridges, LINES.max_ridge * usual + 1.0, out=ridges)
    votes = ridges.take(fan.at, axis=1).sum(axis=1)
    usual = ridges.mean(axis=1, keepdims=True) + LINES.noise
    return np.asarray(votes * fan.worth / (usual * LINES.rows))
