"""From a shape to the rows of the result, each with the thesis's correction."""

from __future__ import annotations

import math
from dataclasses import replace

from mvuav_ros.parameters.runway_detector import RunwayDetectorParameters
from mvuav_ros.vision.approach.derotation import line_through
from mvuav_ros.vision.approach.results import ROLES, Point
from mvuav_ros.vision.runway.correction import CorrectionLimits, RhoThetaCorrection
from mvuav_ros.vision.runway.detector import correction_limits
from mvuav_ros.vision.runway.normal_form import Ends, NormalForm, segment_ends
from mvuav_ros.vision.runway.results import LineRole, RunwayLine

Segment = tuple[Point, Point]


class LineCorrection:
    """The rho/theta correction of each role's line."""

    def __init__(self, parameters: RunwayDetectorParameters) -> None:
        self._corrections = {role: RhoThetaCorrection(_for_one_line(parameters)) for role in ROLES}

    def configure(self, parameters: RunwayDetectorParameters) -> None:
        """Use other parameters; the lines stay known."""
        for correction in self._corrections.values():
            correction.configure(_for_one_line(parameters))

    def reset(self) -> None:
        """Forget the lines."""
        for correction in self._corrections.values():
            correction.reset()

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
        return tuple(
            self._row(role, segments.get(role), votes.get(role, math.nan), confidence, size)
            for role in ROLES
        )

    def _row(
        self,
        role: LineRole,
        segment: Segment | None,
        votes: float,
        confidence: float,
        size: tuple[int, int],
    ) -> RunwayLine:
        measured = None if segment is None else line_through(*segment[0], *segment[1])
        (row,) = self._corrections[role].correct([] if measured is None else [measured])
        if segment is None or measured is None or row.line is None:
            return RunwayLine(role=role)
        x, y, x2, y2 = _confine(row.line, segment, size)
        return RunwayLine(
            peak=ROLES.index(role),
            rho=row.line.rho,
            theta=row.line.theta,
            votes=votes,
            rho_raw=measured.rho,
            theta_raw=measured.theta,
            rho_flag=row.rho_flag,
            theta_flag=row.theta_flag,
            x=x,
            y=y,
            x2=x2,
            y2=y2,
            role=role,
            confidence=confidence,
        )


def _for_one_line(parameters: RunwayDetectorParameters) -> CorrectionLimits:
    return replace(correction_limits(parameters), rows=1, by_index=True)


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
