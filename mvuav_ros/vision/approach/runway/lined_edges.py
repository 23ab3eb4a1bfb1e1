"""A runway's edges by the lines along its sides, and what earlier frames tell of those."""

from __future__ import annotations

import numpy as np

from mvuav_ros.vision.approach.edges import Edges, LevelledFrame, Strip
from mvuav_ros.vision.approach.runway.line_choice import Line, LineChoice
from mvuav_ros.vision.approach.runway.side_lines import edges_by_lines

_MIDDLE = 0.7
"""Share of the near end's depth in which edges are compared."""


class LinedEdges:
    """The side lines of one runway that is followed; strips are (6,).

    Attributes:
        shoulders: from 0 to 1, whether shoulders have lines too, on both sides and as far apart.
        other: odds that another line is the runway's, farther from the found one than allowed.
    """

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """Begin anew: the lines were not looked for in a frame."""
        self.other, self.shoulders = 0.0, 0.0
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

    def find(
        self, frame: LevelledFrame, strip: Strip, about: Strip, tolerance: float
    ) -> Edges | None:
        """Both edges in the next frame, if it shows the lines of the runway followed as ``strip``.

        They are looked for ``about`` another strip; at the near end an edge may be wrong by
        ``tolerance``, px.
        """
        offsets = _outwards(strip, about)
        depth = _MIDDLE * float(strip[5])
        expected = float(about[3] - about[2]) * float(strip[1] + depth - about[1])
        scale = expected / (float(strip[3] - strip[2]) * depth)
        width = float((strip[3] - strip[2]) * strip[5])

        def choose(lines: tuple[list[Line], list[Line]]) -> tuple[Line, Line] | None:
            return self._choice.choose(lines, offsets, scale, width)

        found = edges_by_lines(frame, about, choose)
        self.other = self._choice.other(tolerance / width) if found else 0.0
        self.shoulders = self._choice.shoulders
        return found


def _outwards(strip: Strip, other: Strip) -> tuple[float, float]:
    """How far the other's left and right edge lie outside of a strip's, in its widths."""
    depth = _MIDDLE * float(strip[5])
    row = float(strip[1]) + depth
    width = float(strip[3] - strip[2]) * depth
    left, right = (
        float(other[0] + other[side] * (row - other[1]) - strip[0] - strip[side] * depth)
        for side in (2, 3)
    )
    return -left / width, right / width
