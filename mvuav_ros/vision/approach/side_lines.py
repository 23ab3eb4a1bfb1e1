"""A runway's edges from the bright lines along its sides: they end where its pavement ends.

Painted side stripes, and concrete beside a streak of rubber, are the clearest thing in a runway far
away. Their inner sides look like the edges of a darker strip, and their middles like painted lines;
the runway's edge is where the line's outer side is. Beside the side stripe there may be a
shoulder's line outside and markings or rubber inside.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from itertools import chain
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.approach.evidence import brightness_of
from mvuav_ros.vision.approach.strip_edges import EdgePoints, Edges, LevelledFrame, Strip, rows_of
from mvuav_ros.vision.approach.tuning import LINES


class Line(NamedTuple):
    """A line along an edge.

    Attributes:
        far: its middle at the far end, widths of the runway outside of the expected edge.
        near: at the near end.
        clearness: in usual ridges of the place.
    """

    far: float
    near: float
    clearness: float

    @property
    def middle(self) -> float:
        """Half way between both ends."""
        return 0.5 * (self.far + self.near)


class Choice(NamedTuple):
    """The runway's lines along its left and its right edge.

    Attributes:
        lines: of the left and of the right one.
        shoulders: from 0 to 1, whether there are two clear lines on both sides, as far apart.
    """

    lines: tuple[Line, Line]
    shoulders: float


def choose(
    left: list[Line], right: list[Line], expected: tuple[float, float], away_cost: float
) -> Choice:
    """Which lines are the runway's, among those along its left and its right edge.

    Markings within the runway are fainter than its side line. Of two clear lines on both sides, as
    far apart, the outer ones are the shoulders'.

    Args:
        left: at least one line.
        right: likewise.
        expected: where the edges are expected, widths outside of where `Line` counts from.
        away_cost: log odds lost per width from there.
    """
    clear = [_clear(lines) for lines in (left, right)]
    gaps = [_gaps(lines, of) for lines, of in zip((left, right), clear, strict=True)]
    chosen, most = [], []
    for side, lines in enumerate((left, right)):
        shoulders = [0.0] * len(lines)
        for outer, gap, share in gaps[side]:
            for _, its_gap, its_share in gaps[1 - side]:
                if abs(gap - its_gap) < LINES.same:
                    shoulders[outer] = max(shoulders[outer], min(share, its_share))
        odds = [
            math.log(is_clear + 1e-9)
            - away_cost * abs(line.middle - expected[side])
            - LINES.shoulder_cost * shoulder
            for line, is_clear, shoulder in zip(lines, clear[side], shoulders, strict=True)
        ]
        chosen.append(lines[odds.index(max(odds))])
        most.append(max(shoulders))
    return Choice((chosen[0], chosen[1]), min(most))


def _clear(lines: list[Line]) -> list[float]:
    """From 0 to 1, whether each line is as clear as the clearest."""
    clearest = max(1e-6, *(line.clearness for line in lines), 0.0)
    behind = (LINES.clear_share - line.clearness / clearest for line in lines)
    return [1.0 / (1.0 + math.exp(share / LINES.clear_doubt)) for share in behind]


def _gaps(lines: list[Line], clear: list[float]) -> list[tuple[int, float, float]]:
    """Of clear lines outside of others: which, how far outside, and whether both are clear."""
    known = [number for number, share in enumerate(clear) if share > LINES.min_clear]
    return [
        (outer, gap, min(clear[outer], clear[inner]))
        for outer in known
        for inner in known
        if (gap := lines[outer].middle - lines[inner].middle) > LINES.same
    ]


Numbers = NDArray[np.floating[Any]]
_ALONG = (np.arange(LINES.rows) + 0.5) / LINES.rows
"""Where the rows are between the far and the near end."""
_PLACES = round(LINES.reach / LINES.step)
_ACROSS = np.arange(-_PLACES, _PLACES + 1) * LINES.step
"""Where the samples are, from inside to outside, widths from the expected edge."""


class SideLines:
    """The side lines of one runway that is followed; strips are (6,).

    Attributes:
        shoulders: from 0 to 1, how often shoulders have lines too, on both sides and as far apart.
    """

    def __init__(self) -> None:
        self.shoulders = 0.0

    def find(
        self,
        frame: LevelledFrame,
        strip: Strip,
        known: Edges | None = None,
        *,
        coloured: bool = False,
    ) -> Edges | None:
        """Measure both edges of a narrow runway by the outer sides of the lines along a strip's.

        Lines are expected between the strip's edges and those known, or where colour has shown
        those. None if the lines are not clear, or the runway is too wide.
        """
        rows, expected, outwards = rows_of(strip, _ALONG)
        if outwards[1, -1] >= LINES.max_width:
            return None
        columns = expected[:, :, None] + outwards[:, :, None] * _ACROSS
        found = _distinct(_brightness(frame, columns, rows))
        left, right = (0.0, 0.0) if known is None else _away(strip, known)
        if coloured:
            lines, shoulders = choose(*found, (left, right), LINES.away_from_colour_cost)
        else:
            lines, shoulders = choose(*found, (0.5 * left, 0.5 * right), LINES.away_cost)
        self.shoulders += LINES.memory * (shoulders - self.shoulders)
        if min(line.clearness for line in lines) <= LINES.min_clearness:
            return None
        return self._outer_sides(frame, strip, np.array(lines)[:, :2])

    def _outer_sides(
        self, frame: LevelledFrame, strip: Strip, middles: NDArray[np.float64]
    ) -> Edges | None:
        """Both edges from the lines with middles (2, 2) at the far and the near end, in widths.

        None where there is no line.
        """
        rows, expected, outwards = rows_of(strip, _ALONG)
        across = middles[:, :1] + _ALONG * (middles[:, 1:] - middles[:, :1])
        middle = expected + outwards * across
        step = min(LINES.step, LINES.max_fine_step / float(outwards[1, -1]))
        inside, beyond = round(LINES.inside / step), round(LINES.beyond / step)
        beside = np.arange(-inside, beyond + 1) * step
        profiles = _brightness(frame, middle[:, :, None] + outwards[:, :, None] * beside, rows)
        # Blur is the same number of px everywhere, and so a larger share of the far end's width.
        halves = profiles.reshape(2, 2, LINES.rows // 2, -1).mean(axis=2)
        found = [[_outer_side(half, 2 * inside + 2) for half in side] for side in halves]
        outer = step * (np.array(found) - inside)
        if np.isnan(outer).any():
            return None
        left, right = (
            EdgePoints(
                rows,
                middle[side] + outwards[side] * np.interp(_ALONG, (0.25, 0.75), outer[side]),
                np.ones(rows.size),
                1.0,
            )
            for side in (0, 1)
        )
        return left, right


def _away(strip: Strip, points: Edges) -> tuple[float, float]:
    """How far outside of a strip's left and right edge points lie, in its widths."""
    away = []
    for edge, slope in zip(points, strip[2:4].tolist(), strict=True):
        depth = edge.rows - strip[1]
        offsets = (edge.columns - strip[0] - slope * depth) / ((strip[3] - strip[2]) * depth)
        weights = edge.weights + 1e-6
        away.append(float((offsets * weights).sum() / weights.sum()))
    return -away[0], away[1]


@dataclass(frozen=True, eq=False)
class _LineFan:
    """All straight lines of a width along an edge.

    Attributes:
        reach: samples between a line's middle and what is beside it.
        ends: (n, 2) middle at the far and at the near end, widths of the runway.
        at: (rows, n) samples through which they go.
        worth: (n,) factor of the clearness: those that run askew count less.
        same: (n, n) whether two are no more than half a width apart.
    """

    reach: int
    ends: Numbers
    at: NDArray[np.intp]
    worth: Numbers
    same: NDArray[np.bool_]


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
    worth = 1.0 - LINES.turned_cost * turned
    centre = ends.mean(axis=1)
    same = np.abs(centre[:, None] - centre) < half
    return _LineFan(reach, ends, at + rows * middles.size, worth, same)


def _brightness(
    frame: LevelledFrame, columns: NDArray[Any], rows: NDArray[Any]
) -> NDArray[np.float32]:
    """(2, rows, places) grey levels of the frame at places of the levelled working image."""
    pixels, _, _ = frame.at(columns, rows[:, None])
    return brightness_of(pixels).reshape(columns.shape)


def _distinct(brightness: NDArray[np.float32]) -> tuple[list[Line], list[Line]]:
    """Along either edge the clearest lines that are apart from one another, of any width."""
    found: tuple[list[Line], list[Line]] = [], []
    of_widths = [_lines(brightness, half) for half in LINES.half_widths]
    for kept, *lines in zip(found, *of_widths, strict=True):
        for line in sorted(chain(*lines), key=lambda line: -line.clearness):
            if all(abs(line.middle - other.middle) > LINES.apart for other in kept):
                kept.append(line)
    return found


def _lines(brightness: NDArray[np.float32], half: float) -> list[list[Line]]:
    """Along either edge the clearest lines of a width that are apart from one another."""
    fan = _line_fan(half)
    reach = fan.reach
    smooth = cv2.blur(brightness.reshape(2 * LINES.rows, -1), (reach | 1, 1))
    sides = np.maximum(smooth[:, : -2 * reach], smooth[:, 2 * reach :])
    ridges = np.maximum(smooth[:, reach:-reach] - sides, 0.0).reshape(2, -1)
    usual = ridges.mean(axis=1, keepdims=True)
    np.minimum(ridges, LINES.max_ridge * usual + 1.0, out=ridges)
    votes = ridges.take(fan.at, axis=1).sum(axis=1)
    usual = ridges.mean(axis=1, keepdims=True) + LINES.noise
    found = []
    for clear in votes * fan.worth / (usual * LINES.rows):
        lines = []
        for _ in range(3):
            best = int(clear.argmax())
            far, near = fan.ends[best].tolist()
            lines.append(Line(far, near, float(clear[best])))
            clear[fan.same[best]] = 0.0
        found.append(lines)
    return found


def _outer_side(profile: NDArray[np.float32], within: int) -> float:
    """Where a line, brightest within the first samples, has become half as bright outwards.

    NaN where nothing beyond is darker.
    """
    peak = int(profile[:within].argmax())
    beyond: list[float] = profile[peak:].tolist()
    # The first minimum after the peak: there may be another line farther outside.
    dark, lowest = beyond[0] - LINES.min_depth, 0
    for place in range(1, len(beyond)):
        if beyond[place] < beyond[lowest]:
            lowest = place
        elif beyond[place - 1] < dark:
            break
    half = 0.5 * (beyond[0] + beyond[lowest])
    if beyond[lowest] > dark:
        return math.nan
    last = next(place for place, value in enumerate(beyond) if value <= half) - 1
    return float(peak + last) + (beyond[last] - half) / (beyond[last] - beyond[last + 1])
