"""Runway lines found against the true ones."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from mvuav_ros.offline.evaluation.numbers import rms
from mvuav_ros.vision.runway.normal_form import NormalForm
from mvuav_ros.vision.runway.results import LineRole

ALONG = (LineRole.LEFT_EDGE, LineRole.RIGHT_EDGE, LineRole.CENTRELINE)
"""The lines that a runway's detector looks for; a runway's ends run across."""
DISTANCE_LIMIT = 5.0
"""px; a line that passes farther off is another one."""
THETA_LIMIT = math.radians(3.0)


class TrueLine(NamedTuple):
    """A true line, and the point of it at which distances are taken, px."""

    line: NormalForm
    point: tuple[float, float]


class LineMatch(NamedTuple):
    """A line found with the true one that it is: indices, distance (px), difference (rad)."""

    found: int
    true: int
    distance: float
    dtheta: float


def match_lines(found: Sequence[NormalForm], true: Sequence[TrueLine]) -> list[LineMatch]:
    """Pair lines that are close at the true line's point and in direction, the closest first.

    Lines with NaN match nothing; each line occurs in one pair at most.
    """
    pairs = []
    for number, line in enumerate(found):
        for index, (truth, (x, y)) in enumerate(true):
            distance = x * math.cos(line.theta) + y * math.sin(line.theta) - line.rho
            # The same line may be written with theta turned by half a circle.
            dtheta = (line.theta - truth.theta + math.pi / 2) % math.pi - math.pi / 2
            if abs(distance) <= DISTANCE_LIMIT and abs(dtheta) <= THETA_LIMIT:
                pairs.append(LineMatch(number, index, distance, dtheta))
    matched: list[LineMatch] = []
    for pair in sorted(pairs, key=lambda p: abs(p.distance)):
        if all(pair.found != m.found and pair.true != m.true for m in matched):
            matched.append(pair)
    return matched


def line_numbers(matches: Sequence[LineMatch], visible: int) -> tuple[float, float, float]:
    """Percent of the frames that show a line in which it was found; RMS of its error, px and °."""
    return (
        100.0 * len(matches) / visible if visible else math.nan,
        rms(np.array([match.distance for match in matches])),
        math.degrees(rms(np.array([match.dtheta for match in matches]))),
    )


@dataclass(eq=False)
class LineErrors:
    """Lines found on some frames against the true ones of a runway.

    Attributes:
        frames: seen.
        found: lines found in all frames.
        visible: frames in which each true line was.
        matches: every pair of a found and a true line.
    """

    frames: int = 0
    found: int = 0
    visible: list[int] = field(default_factory=lambda: [0] * len(ALONG))
    matches: list[LineMatch] = field(default_factory=list)

    def add(self, found: Sequence[NormalForm], true: Sequence[TrueLine]) -> list[LineMatch]:
        """Match a frame's lines to those of `ALONG`, which are NaN where the frame has none."""
        in_view = [math.isfinite(line.line.rho) for line in true]
        self.frames += 1
        self.found += sum(math.isfinite(line.rho) for line in found)
        self.visible = [n + seen for n, seen in zip(self.visible, in_view, strict=True)]
        matches = match_lines(found, true)
        self.matches += matches
        return matches

    def numbers(self, true: int) -> tuple[float, float, float]:
        """`line_numbers` of one true line (its index in `ALONG`)."""
        own = [match for match in self.matches if match.true == true]
        return line_numbers(own, self.visible[true])
