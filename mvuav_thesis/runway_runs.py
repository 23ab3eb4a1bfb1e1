"""The runway detector over a synthetic flight, with truth."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.offline.evaluation.metrics import ALONG, LineErrors, LineMatch, TrueLine
from mvuav_ros.parameters.runway_detector import RunwayDetectorParameters
from mvuav_ros.simulation.runway_flight import LineTruth, RunwayFlight
from mvuav_ros.simulation.settings import RunwaySettings
from mvuav_ros.vision.approach.detector import ApproachDetector
from mvuav_ros.vision.runway.debug_images import draw_overlay
from mvuav_ros.vision.runway.detector import RunwayDetector
from mvuav_ros.vision.runway.normal_form import NormalForm
from mvuav_ros.vision.runway.results import RunwayResult
from mvuav_ros.vision.runway.statistics import RunwaySummary


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
class RunwayRun(LineErrors):
    """One detector's results on a flight.

    Attributes:
        right: by frame, whether both edges were found where they are, each in its own row of the
            result (mode approach distinguishes them); None where an edge was not on the frame.
        wrong: by frame, whether a row said that it holds an edge and held none.
        images: those asked for.
        summary: the detector's own statistics.
    """

    right: list[bool | None] = field(default_factory=list)
    wrong: list[bool] = field(default_factory=list)
    images: list[LineImage] = field(default_factory=list)
    summary: RunwaySummary = field(init=False)

    def add(self, found: Sequence[NormalForm], true: Sequence[TrueLine]) -> list[LineMatch]:
        """Hold the first two rows, the edges in mode approach, against the true edges as well."""
        matches = super().add(found, true)
        own = [any((m.found, m.true) == (edge, edge) for m in matches) for edge in (0, 1)]
        said = [math.isfinite(line.rho) for line in found[:2]]
        judged = all(math.isfinite(line.line.rho) for line in true[:2])
        self.right.append(all(own) if judged else None)
        self.wrong.append(judged and any(s and not o for s, o in zip(said, own, strict=False)))
        return matches


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
            runs[name].add([NormalForm(line.rho, line.theta) for line in result.lines], true)
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
