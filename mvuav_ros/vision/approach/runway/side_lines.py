"""A runway's edges from the bright lines along its sides: they end where its pavement ends.

Painted side stripes, and concrete beside a streak of rubber, are the clearest thing in a runway far
away. Their inner sides look like the edges of a darker strip, and their middles like painted lines;
the runway's edge is where the line's outer side is.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.approach.channels import opponent_channels
from mvuav_ros.vision.approach.edges import EdgePoints, Edges, LevelledFrame, Strip, rows_of
from mvuav_ros.vision.approach.runway.line_choice import Line

# Chosen on runs 3 and 5; lengths are shares of the runway's width in a row.
_STEP, _REACH = 0.02, 0.5
"""Between samples across an edge, and how far they reach on both sides of where it is expected."""
_FARTHEST = 0.32
"""Between a line's middle and the expected edge."""
_HALF_WIDTHS = (0.06, 0.1)
"""Of lines."""
_ROWS = 24
"""Sampled between the far and the near end."""
_MOST_TURNED, _TURNED_LESS = 0.24, 1.67
"""Between a line's places at the far and at the near end, at most, and by how much one counts less
for each width that it moves from end to end."""
_FINE = 0.6
"""Px between samples across a line that has been found, at most."""
_AROUND, _BEYOND = 0.06, 0.16
"""How far from its found middle a line's brightest place may be, and its sides are looked for."""
_APART = 0.12
"""Between lines that are not one."""
_NOISE = 0.5
"""Grey levels of ridges that are taken to be everywhere."""
_WIDEST = 90.0
"""Px of the near end from which the markings at the threshold are told apart, lines along the edges
themselves, so that the pavement's steps are measured instead."""
_LEAST_CLEARNESS = 1.2
"""Of the fainter line, in usual ridges of the place."""
Numbers = NDArray[np.floating[Any]]
_ALONG = (np.arange(_ROWS) + 0.5) / _ROWS
"""Where the rows are between the far and the near end."""
_HALVES = slice(None, _ROWS // 2), slice(_ROWS // 2, None)
_PLACES = round(_REACH / _STEP)
_ACROSS = np.arange(-_PLACES, _PLACES + 1) * _STEP
"""Where the samples are, from inside to outside, widths from the expected edge."""
_DEEP = 2.0
"""Grey levels below a line that are dark."""
_CLIPPED = 4.0
"""Usual ridges: more counts as that, so that one lamp is not a line."""


def edges_by_lines(
    frame: LevelledFrame,
    strip: Strip,
    choose: Callable[[tuple[list[Line], list[Line]]], tuple[Line, Line] | None],
) -> Edges | None:
    """Measure both edges of a narrow runway by the outer sides of the lines along a strip's.

    ``choose`` says which of those along the left and along the right edge are the runway's. None
    if the lines are not clear, or the runway is too wide.
    """
    if float(strip[3] - strip[2]) * strip[5] >= _WIDEST:
        return None
    rows, expected, outwards = rows_of(strip, _ALONG)
    columns = expected[:, :, None] + outwards[:, :, None] * _ACROSS
    brightness = _brightness(frame, columns, rows)
    lines = choose((_distinct(brightness[0]), _distinct(brightness[1])))
    if lines is None or min(line.clearness for line in lines) <= _LEAST_CLEARNESS:
        return None
    middle = expected + outwards * np.array([f + _ALONG * (n - f) for f, n, _ in lines])
    step = min(_STEP, _FINE / float(outwards[1, -1]))
    inside, beyond = round(_AROUND / step), round(_BEYOND / step)
    beside = np.arange(-inside, beyond + 1) * step
    across = middle[:, :, None] + outwards[:, :, None] * beside
    profiles = _brightness(frame, across, rows)
    edges = []
    for side in (0, 1):
        # Blur is the same number of px everywhere, and so a larger share of the far end's width.
        outer = [
            step * (_outer_side(profiles[side][half].mean(axis=0), 2 * inside + 2) - inside)
            for half in _HALVES
        ]
        columns = middle[side] + outwards[side] * np.interp(_ALONG, (0.25, 0.75), outer)
        edges.append(EdgePoints(rows, columns, np.ones(rows.size), 1.0))
    return edges[0], edges[1]


@dataclass(frozen=True, eq=False)
class _LineFan:
    """All straight lines of a width along an edge.

    Attributes:
        reach: samples between a line's middle and what is beside it.
        ends: (n, 2) middle at the far and at the near end, widths of the runway.
        at: (rows, n) samples through which they go.
        worth: (n,) factor of the clearness: those that run askew count less.
    """

    reach: int
    ends: Numbers
    at: NDArray[np.intp]
    worth: Numbers


@lru_cache
def _line_fan(half: float) -> _LineFan:
    reach = round(half / _STEP)
    middles = _ACROSS[reach:-reach]
    near_edge = np.nonzero(np.abs(middles) <= _FARTHEST)[0]
    far, near = (each.ravel() for each in np.meshgrid(near_edge, near_edge, indexing='ij'))
    turned = np.abs(middles[far] - middles[near])
    straight = turned <= _MOST_TURNED
    far, near, turned = far[straight], near[straight], turned[straight]
    rows = np.arange(_ROWS)[:, None]
    at = np.rint(far + (near - far) * (rows / (_ROWS - 1))).astype(np.intp)
    ends = np.stack([middles[far], middles[near]], axis=1)
    worth = 1.0 - _TURNED_LESS * turned
    return _LineFan(reach, ends, at + rows * middles.size, worth)


def _brightness(
    frame: LevelledFrame, columns: NDArray[Any], rows: NDArray[Any]
) -> NDArray[np.float32]:
    """(2, rows, places) grey levels of the frame at places of the levelled working image."""
    pixels, _, _ = frame.at(columns, rows[:, None])
    return opponent_channels(pixels)[0].reshape(columns.shape)


def _distinct(brightness: NDArray[np.float32]) -> list[Line]:
    """The clearest lines that are apart from one another, of any width."""
    lines = [line for half in _HALF_WIDTHS for line in _lines(brightness, half)]
    kept: list[Line] = []
    for line in sorted(lines, key=lambda line: -line.clearness):
        if all(abs(line.middle - other.middle) > _APART for other in kept):
            kept.append(line)
    return kept


def _lines(brightness: NDArray[np.float32], half: float) -> list[Line]:
    """The clearest lines of a width that are apart from one another."""
    fan = _line_fan(half)
    reach = fan.reach
    smooth = cv2.blur(brightness, (reach | 1, 1))
    sides = np.maximum(smooth[:, : -2 * reach], smooth[:, 2 * reach :])
    ridge = np.maximum(smooth[:, reach:-reach] - sides, 0.0)
    ridge = np.minimum(ridge, _CLIPPED * cv2.mean(ridge)[0] + 1.0)
    votes = ridge.ravel().take(fan.at).sum(axis=0)
    usual = cv2.mean(ridge)[0] + _NOISE
    clear = votes * fan.worth / (usual * _ROWS)
    centre = fan.ends.mean(axis=1)
    found = []
    for _ in range(3):
        best = int(clear.argmax())
        far, near = (float(end) for end in fan.ends[best])
        found.append(Line(far, near, float(clear[best])))
        clear[np.abs(centre - centre[best]) < half] = 0.0
    return found


def _outer_side(profile: NDArray[np.float32], within: int) -> float:
    """Where a line, brightest within the first samples, has become half as bright outwards."""
    peak = int(profile[:within].argmax())
    beyond = profile[peak:]
    # The first minimum after the peak: there may be another line farther outside.
    rising = (np.diff(beyond) >= 0) & (beyond[:-1] < beyond[0] - _DEEP)
    lowest = int(rising.argmax()) if rising.any() else int(beyond.argmin())
    half = 0.5 * (beyond[0] + beyond[lowest])
    last = int(np.count_nonzero(beyond[: lowest + 1] > half)) - 1
    if last < 0 or last + 1 > lowest:
        return float(peak)
    part = (beyond[last] - half) / max(float(beyond[last] - beyond[last + 1]), 1e-6)
    return float(peak + last + part)
