"""Which of the lines along a side is the runway's, told from many frames.

Beside the side stripe there may be a shoulder's line outside and markings or rubber inside. One
frame shows now this one clearer, now that one; over some frames they differ, or stay alike, and
then nobody can tell.
"""

from __future__ import annotations

import math
from typing import NamedTuple


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


# Constants of the choice, chosen on runs 3 and 5 and their variants; lengths are shares of the
# runway's width.
_MEMORY = 0.1
"""Share of a new frame in how clear a line is on average."""
_SAME = 0.1
"""Between places of one line in two frames, and between like gaps of both sides."""
_SHIFT = 1.2
"""Px, standard deviation by which all lines of a side seem to move from one frame to the next,
besides what was foreseen."""
_REACH = 0.3
"""From where an edge is expected to the lines that are looked for."""
_CLEAREST, _CLEAR_DOUBT = 0.85, 0.05
"""Share of the clearest line's clearness, on average, from which another one is as good a side
line, and its doubt: the markings within run 3 have 0.6 to 0.85, the shoulders' lines of run 5 0.9
and more."""
_AWAY_LESS, _AWAY_FROM_COLOUR = 4.0, 20.0
"""Log odds by which a line is less likely that is a width away from where the strips' mean has the
edge, and from where colour shows it."""
_SHOULDER_LESS = 4.0
"""Log odds by which the outer of two clear lines is less likely, where the other side has two as
well and as far apart: those are the shoulders'."""
_HELD = 0.7
"""Log odds by which another line must be likelier than the one held."""
_FORGOTTEN = 0.05
"""Average clearness below which a line is given up."""
_CLEAR = 0.01
"""From 0 to 1, from which a line is compared with the other side's."""


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
            side.away_less = _AWAY_FROM_COLOUR if colour else _AWAY_LESS

    def choose(
        self,
        lines: tuple[list[Line], list[Line]],
        offsets: tuple[float, float] = (0.0, 0.0),
        scale: float = 1.0,
        width: float = 20.0,
    ) -> tuple[Line, Line] | None:
        """The runway's lines among those of a frame; None where it does not show both.

        Args:
            lines: along the left and along the right edge, at least one of each.
            offsets: from the edges as followed to those as expected in `Line`, widths.
            scale: width expected in `Line` over the width followed.
            width: the latter, px.
        """
        for side, found, offset in zip(self._sides, lines, offsets, strict=True):
            side.take_in(found, offset, scale, _SHIFT / width)
        left, right = self._sides
        self.shoulders = min(left.weigh(right), right.weigh(left))
        numbers = left.chosen(), right.chosen()
        if numbers[0] is None or numbers[1] is None:
            return None
        return lines[0][numbers[0]], lines[1][numbers[1]]

    def other(self, apart: float) -> float:
        """Odds of lines more than so many widths from the chosen ones: of the worse side."""
        return max(side.other(apart) for side in self._sides)


class _Side:
    def __init__(self) -> None:
        self.known: list[_Known] = []
        self.mean = 0.0
        self.away_less = _AWAY_LESS
        self._held: _Known | None = None
        self._frames = 0

    def move(self, outwards: float) -> None:
        for line in self.known:
            line.place -= outwards
        self.mean -= outwards

    def take_in(self, lines: list[Line], offset: float, scale: float, sigma: float) -> None:
        places = [offset + scale * line.middle for line in lines]
        clearest = max(1e-6, *(line.clearness for line in lines))
        shares = [line.clearness / clearest for line in lines]
        self._frames += 1
        memory = max(_MEMORY, 1.0 / self._frames)
        left = dict(enumerate(places))
        shift = self._shift(places, shares, sigma)
        for line in sorted(self.known, key=lambda line: -line.clearness):
            line.place += shift
            line.number = None
            if abs(line.place - offset) > _REACH * scale:
                continue
            near = min(left, key=lambda number: abs(left[number] - line.place), default=None)
            seen = 0.0
            if near is not None and abs(left[near] - line.place) < _SAME:
                line.place += 0.3 * (left.pop(near) - line.place)
                line.number, seen = near, shares[near]
            line.clearness += memory * (seen - line.clearness)
        for number, place in left.items():
            line = _Known(place)
            line.clearness, line.number = memory * shares[number], number
            self.known.append(line)
        most = max(line.clearness for line in self.known)
        self.known = [line for line in self.known if line.clearness >= _FORGOTTEN * most]
        for line in self.known:
            behind = _CLEAREST - line.clearness / max(most, 1e-6)
            line.clear = 1.0 / (1.0 + math.exp(behind / _CLEAR_DOUBT))

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
                    if outer is line and abs(gap - its_gap) < _SAME
                ),
                default=0.0,
            )
            most = max(most, shoulder)
            line.log_odds = math.log(line.clear + 1e-9)
            line.log_odds -= self.away_less * abs(line.place - self.mean)
            line.log_odds -= _SHOULDER_LESS * shoulder
        return most

    def chosen(self) -> int | None:
        """The number of the runway's line in the newest frame."""
        best = max(self.known, key=lambda line: line.log_odds)
        held = self._held if self._held in self.known else None
        if held is None or best.log_odds > held.log_odds + _HELD:
            held = best
        self._held = held
        return held.number

    def other(self, apart: float) -> float:
        held = self._held
        if held is None:
            return 0.0
        return sum(
            math.exp(min(line.log_odds - held.log_odds, 5.0))
            for line in self.known
            if abs(line.place - held.place) > apart
        )

    def _gaps(self) -> list[tuple[_Known, float, float]]:
        """Of clear lines outside of others: which, how far outside, and whether both are clear."""
        clear = [line for line in self.known if line.clear > _CLEAR]
        return [
            (outer, outer.place - inner.place, min(outer.clear, inner.clear))
            for outer in clear
            for inner in clear
            if outer.place - inner.place > _SAME
        ]

    def _shift(self, places: list[float], shares: list[float], sigma: float) -> float:
        """By how much the known lines are moved in this frame, so that they fit best."""
        best, moved = 0.0, 0.0
        if not self.known:
            return moved
        seen = list(zip(places, shares, strict=True))
        for line in self.known:
            for place in places:
                shift = place - line.place
                if abs(shift) > 3.0 * sigma:
                    continue
                fit = -0.5 * (shift / sigma) ** 2
                for known in self.known:
                    fit += known.clearness * max(
                        0.0,
                        *(
                            share * (1.0 - abs(other - known.place - shift) / _SAME)
                            for other, share in seen
                        ),
                    )
                if fit > best:
                    best, moved = fit, shift
        return moved
