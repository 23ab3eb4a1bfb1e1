"""From a shape to the rows of the result, each with the thesis's flags."""

from __future__ import annotations

import math

from mvuav_ros.parameters.runway_detector import RunwayDetectorParameters
from mvuav_ros.vision.approach.derotation import line_through
from mvuav_ros.vision.approach.results import ROLES, Point
from mvuav_ros.vision.runway.correction import jumps
from mvuav_ros.vision.runway.normal_form import Ends, NormalForm, segment_ends
from mvuav_ros.vision.runway.results import LineRole, RunwayLine

Segment = tuple[Point, Point]


class LineFlags:
    """Compares each role's line with the one before, as the thesis does (section 4.3.2.4).

    A flagged line is reported as it is: the shape was followed as a whole, and an older line would
    no longer be one of its edges.
    """

    def __init__(self, parameters: RunwayDetectorParameters) -> None:
        self.configure(parameters)
        self.reset()

    def configure(self, parameters: RunwayDetectorParameters) -> None:
        """Use other thresholds; the lines stay known."""
        self._parameters = parameters

    def reset(self) -> None:
        """Forget the lines."""
        self._last: dict[LineRole, NormalForm] = {}

    def rows(
        self,
        segments: dict[LineRole, Segment],
        votes: dict[LineRole, float],
        confidence: float,
        size: tuple[int, int],
    ) -> tuple[RunwayLine, ...]:
        """The result's rows, one for each of `ROLES`.

        Args:
            segments: ends of the lines that are there, px on the frame.
            votes: edge points that speak for a line, where they were counted.
            confidence: of the shape.
            size: width and height of the frame, px.
        """
        found = []
        for index, role in enumerate(ROLES):
            segment = segments.get(role)
            if segment is None:
                self._last.pop(role, None)
                found.append(RunwayLine(role=role))
                continue
            line = line_through(*segment[0], *segment[1])
            last, self._last[role] = self._last.get(role, line), line
            flags = jumps(line, last, self._parameters)
            ends = _confine(line, segment, size)
            number = votes.get(role, math.nan)
            found.append(RunwayLine(index, *line, number, *line, *flags, *ends, role, confidence))
        return tuple(found)


def _confine(line: NormalForm, segment: Segment, size: tuple[int, int]) -> Ends:
    """The part of a line that lies beside a segment and on the frame, upper end first."""
    x, y, x2, y2 = segment_ends(line, *size)
    if math.isnan(x):
        return x, y, x2, y2
    length = math.hypot(x2 - x, y2 - y)
    if length == 0.0:
        return x, y, x2, y2
    across, down = (x2 - x) / length, (y2 - y) / length
    along = sorted((px - x) * across + (py - y) * down for px, py in segment)
    first, last = max(0.0, along[0]), min(length, along[1])
    if first > last:
        return math.nan, math.nan, math.nan, math.nan
    return x + first * across, y + first * down, x + last * across, y + last * down
