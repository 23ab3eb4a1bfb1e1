"""The runway detector over a synthetic flight, with truth."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.offline.evaluation.line_errors import LineMatch, TrueLine, match_lines
from mvuav_ros.parameters.runway_detector import RunwayDetectorParameters
from mvuav_ros.simulation.runway import RunwayFlight
from mvuav_ros.simulation.runway_truth import LineTruth, RunwayTruth
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


@dataclass(frozen=True, eq=False)
class LineImage:
    """A frame with the detector's overlay, and the true lines' segments (k, 4) px."""

    index: int
    time: float
    overlay: NDArray[np.uint8]
    segments: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class RunwayRun:
    """One detector's results on a flight.

    Attributes:
        visible: frames in which each of `ALONG` was on the frame at the row.
        matches: every pair of a found and a true line.
        found: lines found in all frames.
        right: by frame, whether both edges were found where they are, each in its own row of the
            result (mode approach tells them apart); None where an edge was not on the frame.
        wrong: by frame, whether a row said that it holds an edge and held none.
        summary: the detector's own statistics.
        images: those asked for.
    """

    visible: tuple[int, ...]
    matches: tuple[LineMatch, ...]
    found: int
    right: tuple[bool | None, ...]
    wrong: tuple[bool, ...]
    summary: RunwaySummary
    images: tuple[LineImage, ...]

    def of(self, true: int) -> list[LineMatch]:
        """The matches of one true line (its index in `ALONG`)."""
        return [match for match in self.matches if match.true == true]


@dataclass(frozen=True, eq=False)
class FlownRunway:
    """All detectors' results on one flight."""

    settings: RunwaySettings
    runs: Mapping[str, RunwayRun]


def fly_runway(task: RunwayTask) -> FlownRunway:
    """Draw every frame once and show it to every detector."""
    flight = RunwayFlight(task.flight)
    watchers = {n: _Watcher(_make_detector(p), task.row) for n, p in task.detectors.items()}
    for index in flight.indices:
        frame = flight.frame(index)
        image = frame.image.bgr()
        for watcher in watchers.values():
            keep = flight.time(index) if index in task.images else None
            watcher.see(index, image, frame.stamp_ns, frame.truth, keep)
    return FlownRunway(task.flight, {name: w.run() for name, w in watchers.items()})


def _make_detector(parameters: RunwayDetectorParameters) -> RunwayDetector | ApproachDetector:
    if parameters.mode == 'approach':
        return ApproachDetector(parameters)
    return RunwayDetector(parameters)


class _Watcher:
    """Collects one detector's results."""

    def __init__(self, detector: RunwayDetector | ApproachDetector, row: float) -> None:
        self._detector = detector
        self._row = row
        self._visible = [0] * len(ALONG)
        self._matches: list[LineMatch] = []
        self._found = 0
        self._right: list[bool | None] = []
        self._wrong: list[bool] = []
        self._images: list[LineImage] = []

    def see(
        self,
        index: int,
        image: NDArray[np.uint8],
        stamp_ns: int,
        truth: RunwayTruth,
        keep: float | None,
    ) -> None:
        result = self._detector.process(image, stamp_ns)
        lines = [truth.line(role) for role in ALONG]
        crossing = [_crosses(line, self._row) for line in lines]
        for number, crosses in enumerate(crossing):
            self._visible[number] += crosses
        true = [
            _true(line, self._row) if crosses else _NOWHERE
            for line, crosses in zip(lines, crossing, strict=True)
        ]
        self._found += sum(line.found for line in result.lines)
        found = [NormalForm(line.rho, line.theta) for line in result.lines]
        matches = match_lines(found, true)
        self._matches += matches
        self._judge(result.lines, crossing, {(m.found, m.true) for m in matches})
        if keep is not None:
            segments = np.array([(t.x1, t.y1, t.x2, t.y2) for t in lines if t.visible])
            shown = draw_overlay(result) if isinstance(result, RunwayResult) else image
            # Red first, as figures want it.
            overlay = np.asarray(cv2.cvtColor(shown, cv2.COLOR_BGR2RGB), np.uint8)
            self._images.append(LineImage(index, keep, overlay, segments.reshape(-1, 4)))

    def _judge(
        self, lines: Sequence[RunwayLine], crossing: Sequence[bool], pairs: set[tuple[int, int]]
    ) -> None:
        """Hold the first two rows, the edges in mode approach, against the true edges."""
        own = [(edge, edge) in pairs for edge in _EDGES]
        said = [len(lines) > edge and math.isfinite(lines[edge].rho) for edge in _EDGES]
        in_view = all(crossing[edge] for edge in _EDGES)
        self._right.append(all(own) if in_view else None)
        self._wrong.append(
            any(s and not o for s, o in zip(said, own, strict=True)) if in_view else False
        )

    def run(self) -> RunwayRun:
        return RunwayRun(
            tuple(self._visible),
            tuple(self._matches),
            self._found,
            tuple(self._right),
            tuple(self._wrong),
            self._detector.statistics(),
            tuple(self._images),
        )


_NOWHERE = TrueLine(NormalForm(math.nan, math.nan), (math.nan, math.nan))


def _true(truth: LineTruth, row: float) -> TrueLine:
    """The line, with its point in a row that it crosses."""
    column = (truth.rho - row * math.sin(truth.theta)) / math.cos(truth.theta)
    return TrueLine(NormalForm(truth.rho, truth.theta), (column, row))


def _crosses(line: LineTruth, row: float) -> bool:
    return line.visible and min(line.y1, line.y2) <= row <= max(line.y1, line.y2)


_EDGES = (0, 1)
"""Places of the left and the right edge in `ALONG` and in a result of mode approach."""
