"""A runway's edges from the bright lines along its sides: they end where its pavement ends.

Painted side stripes, and concrete beside a streak of rubber, are the clearest thing in a runway far
away. Their inner sides look like the edges of a darker strip, and their middles like painted lines;
the runway's edge is where the line's outer side is. Beside the side stripe there may be a
shoulder's line outside and markings or rubber inside. One frame shows now this one clearer, now
that one; over some frames they differ, or stay alike, and then nobody can know.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.approach.evidence import opponent_channels
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


class _Known:
    """A line seen in earlier frames.

    Attributes:
        place: widths outside of the edge as followed.
        clearness: of the clearest line's, on average.
        clear: from 0 to 1, whether it is as clear as the clearest.
        log_odds: that it is the runway's, but for a common offset.
        number: of the line in the newest frame, if it shows it.
    """

    def __init__(self, place: float) -> None:
        self.place, self.clearness, self.clear, self.log_odds = place, 0.0, 0.0, 0.0
        self.number: int | None = None


class LineChoice:
    """The lines along both edges of a runway.

    Attributes:
        shoulders: from 0 to 1, whether there are two clear lines on both sides, as far apart.
    """

    def __init__(self) -> None:
        self.shoulders = 0.0
        self._sides = _Side(), _Side()

    def move(self, outwards: tuple[float, float]) -> None:
        """Both edges have moved outwards, widths."""
        for side, moved in zip(self._sides, outwards, strict=True):
            side.move(moved)

    def expect(self, outwards: tuple[float, float], *, colour: bool = False) -> None:
        """Where the strips' mean, or colour, has the edges: widths outside of those followed."""
        for side, mean in zip(self._sides, outwards, strict=True):
            side.mean += 0.5 * (mean - side.mean)
            side.away_less = LINES.away_from_colour_cost if colour else LINES.away_cost

    def choose(
        self,
        lines: tuple[list[Line], list[Line]],
        offsets: tuple[float, float] = (0.0, 0.0),
        scale: float = 1.0,
    ) -> tuple[Line, Line] | None:
        """The runway's lines among those of a frame; None where it does not show both.

        Args:
            lines: along the left and along the right edge, at least one of each.
            offsets: from the edges as followed to those as expected in `Line`, widths.
            scale: width expected in `Line` over the width followed.
        """
        for side, found, offset in zip(self._sides, lines, offsets, strict=True):
            side.take_in(found, offset, scale)
        left, right = self._sides
        self.shoulders = min(left.weigh(right), right.weigh(left))
        numbers = left.chosen(), right.chosen()
        if numbers[0] is None or numbers[1] is None:
            return None
        return lines[0][numbers[0]], lines[1][numbers[1]]


class _Side:
    def __init__(self) -> None:
        self.known: list[_Known] = []
        self.mean = 0.0
        self.away_less = LINES.away_cost
        self._frames = 0

    def move(self, outwards: float) -> None:
        for line in self.known:
            line.place -= outwards
        self.mean -= outwards

    def take_in(self, lines: list[Line], offset: float, scale: float) -> None:
        places = [offset + scale * line.middle for line in lines]
        clearest = max(1e-6, *(line.clearness for line in lines))
        shares = [line.clearness / clearest for line in lines]
        self._frames += 1
        memory = max(LINES.memory, 1.0 / self._frames)
        left = dict(enumerate(places))
        for line in sorted(self.known, key=lambda line: -line.clearness):
            line.number = None
            if abs(line.place - offset) > LINES.choice_reach * scale:
                continue
            near = min(left, key=lambda number: abs(left[number] - line.place), default=None)
            seen = 0.0
            if near is not None and abs(left[near] - line.place) < LINES.same:
                line.place += 0.3 * (left.pop(near) - line.place)
                line.number, seen = near, shares[near]
            line.clearness += memory * (seen - line.clearness)
        for number, place in left.items():
            line = _Known(place)
            line.clearness, line.number = memory * shares[number], number
            self.known.append(line)
        most = max(line.clearness for line in self.known)
        self.known = [line for line in self.known if line.clearness >= LINES.min_kept * most]
        for line in self.known:
            behind = LINES.clear_share - line.clearness / max(most, 1e-6)
            line.clear = 1.0 / (1.0 + math.exp(behind / LINES.clear_doubt))

    def weigh(self, other: _Side) -> float:
        """How likely each line is the runway's; from 0 to 1 whether there are shoulders' lines."""
        gaps, its_gaps = self._gaps(), other._gaps()
        most = 0.0
        for line in self.known:
            shoulder = max(
                (
                    min(share, its_share)
                    for outer, gap, share in gaps
                    for _, its_gap, its_share in its_gaps
                    if outer is line and abs(gap - its_gap) < LINES.same
                ),
                default=0.0,
            )
            most = max(most, shoulder)
            line.log_odds = math.log(line.clear + 1e-9)
            line.log_odds -= self.away_less * abs(line.place - self.mean)
            line.log_odds -= LINES.shoulder_cost * shoulder
        return most

    def chosen(self) -> int | None:
        """The number of the runway's line in the newest frame."""
        return max(self.known, key=lambda line: line.log_odds).number

    def _gaps(self) -> list[tuple[_Known, float, float]]:
        """Of clear lines outside of others: which, how far outside, and whether both are clear."""
        clear = [line for line in self.known if line.clear > LINES.min_clear]
        return [
            (outer, outer.place - inner.place, min(outer.clear, inner.clear))
            for outer in clear
            for inner in clear
            if outer.place - inner.place > LINES.same
        ]


Numbers = NDArray[np.floating[Any]]
_ALONG = (np.arange(LINES.rows) + 0.5) / LINES.rows
"""Where the rows are between the far and the near end."""
_HALVES = slice(None, LINES.rows // 2), slice(LINES.rows // 2, None)
_PLACES = round(LINES.reach / LINES.step)
_ACROSS = np.arange(-_PLACES, _PLACES + 1) * LINES.step
"""Where the samples are, from inside to outside, widths from the expected edge."""


def edges_by_lines(
    frame: LevelledFrame,
    strip: Strip,
    choose: Callable[[tuple[list[Line], list[Line]]], tuple[Line, Line] | None],
) -> Edges | None:
    """Measure both edges of a narrow runway by the outer sides of the lines along a strip's.

    ``choose`` says which of those along the left and along the right edge are the runway's. None
    if the lines are not clear, or the runway is too wide.
    """
    if float(strip[3] - strip[2]) * strip[5] >= LINES.max_width:
        return None
    rows, expected, outwards = rows_of(strip, _ALONG)
    columns = expected[:, :, None] + outwards[:, :, None] * _ACROSS
    brightness = _brightness(frame, columns, rows)
    lines = choose(_distinct(brightness))
    if lines is None or min(line.clearness for line in lines) <= LINES.min_clearness:
        return None
    middle = expected + outwards * np.array([f + _ALONG * (n - f) for f, n, _ in lines])
    step = min(LINES.step, LINES.max_fine_step / float(outwards[1, -1]))
    inside, beyond = round(LINES.inside / step), round(LINES.beyond / step)
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
        centre: (n,) middle half way between the ends.
    """

    reach: int
    ends: Numbers
    at: NDArray[np.intp]
    worth: Numbers
    centre: Numbers


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
    return _LineFan(reach, ends, at + rows * middles.size, worth, ends.mean(axis=1))


def _brightness(
    frame: LevelledFrame, columns: NDArray[Any], rows: NDArray[Any]
) -> NDArray[np.float32]:
    """(2, rows, places) grey levels of the frame at places of the levelled working image."""
    pixels, _, _ = frame.at(columns, rows[:, None])
    return opponent_channels(pixels)[0].reshape(columns.shape)


def _distinct(brightness: NDArray[np.float32]) -> tuple[list[Line], list[Line]]:
    """Along either edge the clearest lines that are apart from one another, of any width."""
    found: tuple[list[Line], list[Line]] = [], []
    for half in LINES.half_widths:
        for side, lines in enumerate(_lines(brightness, half)):
            found[side].extend(lines)
    for lines in found:
        lines.sort(key=lambda line: -line.clearness)
        kept: list[Line] = []
        for line in lines:
            if all(abs(line.middle - other.middle) > LINES.apart for other in kept):
                kept.append(line)
        lines[:] = kept
    return found


def _lines(brightness: NDArray[np.float32], half: float) -> Iterator[list[Line]]:
    """Along either edge the clearest lines of a width that are apart from one another."""
    fan = _line_fan(half)
    reach = fan.reach
    smooth = cv2.blur(brightness.reshape(2 * LINES.rows, -1), (reach | 1, 1))
    sides = np.maximum(smooth[:, : -2 * reach], smooth[:, 2 * reach :])
    ridges = np.maximum(smooth[:, reach:-reach] - sides, 0.0).reshape(2, LINES.rows, -1)
    for ridge in ridges:
        ridge = np.minimum(ridge, LINES.max_ridge * cv2.mean(ridge)[0] + 1.0)
        votes = ridge.ravel().take(fan.at).sum(axis=0)
        usual = cv2.mean(ridge)[0] + LINES.noise
        clear = votes * fan.worth / (usual * LINES.rows)
        found = []
        for _ in range(3):
            best = int(clear.argmax())
            far, near = fan.ends[best].tolist()
            found.append(Line(far, near, float(clear[best])))
            clear[np.abs(fan.centre - fan.centre[best]) < half] = 0.0
        yield found


def _outer_side(profile: NDArray[np.float32], within: int) -> float:
    """Where a line, brightest within the first samples, has become half as bright outwards."""
    peak = int(profile[:within].argmax())
    beyond = profile[peak:]
    # The first minimum after the peak: there may be another line farther outside.
    rising = (np.diff(beyond) >= 0) & (beyond[:-1] < beyond[0] - LINES.min_depth)
    lowest = int(rising.argmax()) if rising.any() else int(beyond.argmin())
    half = 0.5 * (beyond[0] + beyond[lowest])
    last = int(np.count_nonzero(beyond[: lowest + 1] > half)) - 1
    if last < 0 or last + 1 > lowest:
        return float(peak)
    part = (beyond[last] - half) / max(float(beyond[last] - beyond[last + 1]), 1e-6)
    return float(peak + last + part)


class LinedEdges:
    """The side lines of one runway that is followed; strips are (6,).

    Attributes:
        shoulders: from 0 to 1, whether shoulders have lines too, on both sides and as far apart.
    """

    def __init__(self) -> None:
        self.shoulders = 0.0
        self._choice = LineChoice()

    def move(self, before: Strip, after: Strip) -> None:
        """The runway's edges have moved."""
        self._choice.move(_outwards(before, after))

    def expect(self, strip: Strip, other: Strip) -> None:
        """The edges may be where another strip has them."""
        self._choice.expect(_outwards(strip, other))

    def expect_colour(self, strip: Strip, points: Edges) -> None:
        """The edges are where colour has shown them."""
        away = []
        for edge, slope in zip(points, strip[2:4], strict=True):
            depth = edge.rows - strip[1]
            offsets = (edge.columns - strip[0] - slope * depth) / ((strip[3] - strip[2]) * depth)
            away.append(float(np.average(offsets, weights=edge.weights + 1e-6)))
        self._choice.expect((-away[0], away[1]), colour=True)

    def find(self, frame: LevelledFrame, strip: Strip, about: Strip) -> Edges | None:
        """Both edges in the next frame, if it shows the lines of the runway followed as ``strip``.

        They are looked for ``about`` another strip.
        """
        offsets = _outwards(strip, about)
        depth = LINES.compared_depth * float(strip[5])
        expected = float(about[3] - about[2]) * float(strip[1] + depth - about[1])
        scale = expected / (float(strip[3] - strip[2]) * depth)

        def choose(lines: tuple[list[Line], list[Line]]) -> tuple[Line, Line] | None:
            return self._choice.choose(lines, offsets, scale)

        found = edges_by_lines(frame, about, choose)
        self.shoulders = self._choice.shoulders
        return found


def _outwards(strip: Strip, other: Strip) -> tuple[float, float]:
    """How far the other's left and right edge lie outside of a strip's, in its widths."""
    depth = LINES.compared_depth * float(strip[5])
    row = float(strip[1]) + depth
    width = float(strip[3] - strip[2]) * depth
    left, right = (
        float(other[0] + other[side] * (row - other[1]) - strip[0] - strip[side] * depth)
        for side in (2, 3)
    )
    return -left / width, right / width
