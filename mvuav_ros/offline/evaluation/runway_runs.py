"""The runway detector over a synthetic flight, with truth."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.offline.evaluation.line_errors import LineMatch, TrueLine, match_lines
from mvuav_ros.parameters.runway_detector import RunwayDetectorParameters
from mvuav_ros.simulation.runway import RunwayFlight
from mvuav_ros.simulation.runway_truth import LineTruth
from mvuav_ros.simulation.settings import RunwaySettings
from mvuav_ros.vision.approach.detector import ApproachDetector
from mvuav_ros.vision.runway.detector import RunwayDetector
from mvuav_ros.vision.runway.normal_form import NormalForm
from mvuav_ros.vision.runway.overlay import draw_overlay
from mvuav_ros.vision.runway.results import LineRole, RunwayLine, RunwayResult
from mvuav_ros.vision.runway.statistics import RunwaySummary

ALONG = (LineRole.LEFT_EDGE, LineRole.RIGHT_EDGE, LineRole.CENTRELINE)
"""The lines that a runway's detector looks for; a runway's ends run across."""


@dataclass(frozen=True)
class RunwayTask:
    """A flight, the parameters of each detector by name, and whose images to keep when."""

    flight: RunwaySettings
    detectors: Mapping[str, RunwayDetectorParameters]
    images: Sequence[int] = ()
    row: float = 90.0


class LineImage(NamedTuple):
    """A frame's time (s), the detector's overlay, and the true lines' segments, (k, 4) px."""

    time: float
    overlay: NDArray[np.uint8]
    segments: NDArray[np.float64]


@dataclass(eq=False)
class RunwayRun:
    """One detector's results on a flight.

    Attributes:
        visible: frames in which each of `ALONG` was on the frame at the row.
        matches: every pair of a found and a true line.
        found: lines found in all frames.
        right: by frame, whether both edges were found where they are, each in its own row of the
            result (mode approach tells them apart); None where an edge was not on the frame.
        wrong: by frame, whether a row said that it holds an edge and held none.
        images: those asked for.
        summary: the detector's own statistics.
    """

    visible: list[int] = field(default_factory=lambda: [0] * len(ALONG))
    matches: list[LineMatch] = field(default_factory=list)
    found: int = 0
    right: list[bool | None] = field(default_factory=list)
    wrong: list[bool] = field(default_factory=list)
    images: list[LineImage] = field(default_factory=list)
    summary: RunwaySummary = field(init=False)

    def of(self, true: int) -> list[LineMatch]:
        """The matches of one true line (its index in `ALONG`)."""
        return [match for match in self.matches if match.true == true]

    def add(self, lines: Sequence[RunwayLine], true: Sequence[TrueLine]) -> None:
        """Hold a frame's lines against `ALONG`, whose numbers are NaN where the frame has none."""
        in_view = [math.isfinite(line.line.rho) for line in true]
        self.visible = [n + seen for n, seen in zip(self.visible, in_view, strict=True)]
        self.found += sum(line.found for line in lines)
        matches = match_lines([NormalForm(line.rho, line.theta) for line in lines], true)
        self.matches += matches
        # The first two rows, the edges in mode approach, against the true edges.
        own = [any((m.found, m.true) == (edge, edge) for m in matches) for edge in (0, 1)]
        said = [math.isfinite(line.rho) for line in lines[:2]]
        judged = in_view[0] and in_view[1]
        self.right.append(all(own) if judged else None)
        self.wrong.append(judged and any(s and not o for s, o in zip(said, own, strict=False)))


@dataclass(frozen=True, eq=False)
class FlownRunway:
    """All detectors' results on one flight."""

    settings: RunwaySettings
    runs: Mapping[str, RunwayRun]


def fly_runway(task: RunwayTask) -> FlownRunway:
    """Draw every frame once and show it to every detector."""
    flight = RunwayFlight(task.flight)
    detectors = {
        name: (ApproachDetector if p.mode == 'approach' else RunwayDetector)(p)
        for name, p in task.detectors.items()
    }
    runs = {name: RunwayRun() for name in detectors}
    for index in flight.indices:
        frame = flight.frame(index)
        image = frame.image.bgr()
        lines = [frame.truth.line(role) for role in ALONG]
        true = [_at_row(line, task.row) for line in lines]
        for name, detector in detectors.items():
            result = detector.process(image, frame.stamp_ns)
            runs[name].add(result.lines, true)
            if index in task.images:
                segments = np.array([(t.x1, t.y1, t.x2, t.y2) for t in lines if t.visible])
                shown = draw_overlay(result) if isinstance(result, RunwayResult) else image
                # Red first, as figures want it.
                overlay = np.asarray(cv2.cvtColor(shown, cv2.COLOR_BGR2RGB), np.uint8)
                kept = LineImage(flight.time(index), overlay, segments.reshape(-1, 4))
                runs[name].images.append(kept)
    for name, detector in detectors.items():
        runs[name].summary = detector.statistics()
    return FlownRunway(task.flight, runs)


def _at_row(line: LineTruth, row: float) -> TrueLine:
    """The line with its point in a row; NaN where it does not cross the row on the frame."""
    if not line.visible or not min(line.y1, line.y2) <= row <= max(line.y1, line.y2):
        return TrueLine(NormalForm(math.nan, math.nan), (math.nan, math.nan))
    column = (line.rho - row * math.sin(line.theta)) / math.cos(line.theta)
    return TrueLine(NormalForm(line.rho, line.theta), (column, row))
