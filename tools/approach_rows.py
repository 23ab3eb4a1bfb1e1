"""What is counted of each kind of footage: one row for each flight or clip."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.offline.evaluation.corners import WARM_UP
from mvuav_ros.parameters.runway_detector import RunwayDetectorParameters
from mvuav_ros.vision.approach.approach_detector import ApproachDetector
from mvuav_ros.vision.approach.approach_results import ApproachResult
from mvuav_ros.vision.approach.attitude import HorizonLine
from mvuav_ros.vision.approach.probability import Report
from mvuav_ros.vision.approach.track import RunwayTrack
from mvuav_ros.vision.frames import Attitude

Pixels = NDArray[Any]
MIN_CONFIDENCE = 0.5


@dataclass
class Frame:
    """One judged frame: what was reported, with which error."""

    name: str
    confidence: float
    reported: bool
    error: float
    corners: list[tuple[float, float]] | None = None
    report: Report | None = None
    outside: bool = False


@dataclass
class Row:
    """One flight, clip or set of stills.

    Attributes:
        name: for the table.
        frames: in order; the first ``warm_up`` do not count.
        first_ms: CPU of the first frame.
        later_ms: mean of the others.
        opencv_ms: mean of Canny and HoughLinesP on the same frames.
        kind: of the footage.
        check: nothing was tuned on it.
    """

    name: str
    frames: list[Frame] = field(default_factory=list)
    warm_up: int = WARM_UP
    first_ms: float = 0.0
    later_ms: float = 0.0
    opencv_ms: float = 0.0
    kind: str = ''
    check: bool = False

    @property
    def outside(self) -> float:
        """Percent of the counted frames with a wrong report in sky or text.

        A right one lies on the runway, whatever is drawn over it.
        """
        counted = self.frames[self.warm_up :]
        wrong = sum(f.reported and f.outside and f.error > 1.0 for f in counted)
        return 100 * wrong / max(len(counted), 1)

    def shares(self) -> tuple[float, float, float]:
        """Percent of the counted frames that are reported, right, and wrong."""
        counted = self.frames[self.warm_up :]
        unit = 100 / max(len(counted), 1)
        reported = sum(frame.reported for frame in counted)
        right = sum(frame.reported and frame.error <= 1.0 for frame in counted)
        return unit * reported, unit * right, unit * (reported - right)

    @property
    def first(self) -> int | None:
        """Number of the first frame that is reported, from 1."""
        return next((n for n, frame in enumerate(self.frames, 1) if frame.reported), None)

    def line(self) -> str:
        """Shares of the counted frames, the first report, and milliseconds of CPU."""
        reported, right, wrong = self.shares()
        return (
            f'{self.name:42s} {"check" if self.check else "tuned":5s} '
            f'{len(self.frames[self.warm_up :]):5d} {reported:6.1f} {right:6.1f} {wrong:6.1f} '
            f'{self.outside:6.1f} {self.first or "-":>6} '
            f'{self.first_ms:7.0f} {self.later_ms:6.1f} {self.opencv_ms:6.1f}'
        )


HEADER = (
    f'{"":42s} {"half":5s} {"count":>5} {"report":>6} {"right":>6} {"wrong":>6} {"sky":>6} '
    f'{"first":>6} {"ms 1st":>7} {"ms":>6} {"opencv":>6}'
)


def opencv_lines(image: Pixels) -> None:
    """What OpenCV's own functions take to find lines on an image of 320 px width."""
    gray = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    factor = max(1, round(gray.shape[1] / 320))
    if factor > 1:
        size = (gray.shape[1] // factor, gray.shape[0] // factor)
        gray = cv2.resize(gray, size, interpolation=cv2.INTER_AREA)
    edges = cv2.Canny(gray, 60, 150)
    cv2.HoughLinesP(edges, 1, np.pi / 180, 40, minLineLength=20, maxLineGap=5)


class Timed:
    """A detector whose CPU time is counted.

    Attributes:
        noise: seed of noise of up to one grey level on every image; none where 0.
    """

    noise = 0

    def __init__(self, width: float = 0.0) -> None:
        # Everything is reported, so that it is known how wrong the doubtful is.
        parameters = RunwayDetectorParameters(
            mode='approach', runway_width=width, min_confidence=0.0
        )
        self.detector = ApproachDetector(parameters)
        self._random = np.random.default_rng(self.noise)
        self.spent: list[float] = []
        self.opencv: list[float] = []

    def process(
        self, image: Pixels, horizon: Attitude | HorizonLine | None = None
    ) -> ApproachResult:
        """The next frame, at 25 frames/s."""
        if self.noise:
            noisy = image + self._random.integers(-1, 2, image.shape)
            image = np.clip(noisy, 0, 255).astype(np.uint8)
        begin = time.process_time()
        result = self.detector.process(image, len(self.spent) * 40_000_000, horizon)
        between = time.process_time()
        opencv_lines(image)
        self.spent.append(1e3 * (between - begin))
        self.opencv.append(1e3 * (time.process_time() - between))
        return result

    def put(self, row: Row) -> Row:
        """The times into a row."""
        row.first_ms = self.spent[0] if self.spent else 0.0
        row.later_ms = float(np.mean(self.spent[1:])) if len(self.spent) > 1 else 0.0
        row.opencv_ms = float(np.mean(self.opencv)) if self.opencv else 0.0
        return row


def judged(name: str, detector: Timed, result: ApproachResult, error: float) -> Frame:
    """A frame of a row; reported is what has a confidence of `MIN_CONFIDENCE`."""
    corners = None if result.corners is None else [(float(x), float(y)) for x, y in result.corners]
    reported = corners is not None and result.confidence >= MIN_CONFIDENCE
    track = detector.detector._finder.tracker.best
    report = track.report if isinstance(track, RunwayTrack) else None
    return Frame(name, float(result.confidence), reported, min(error, 1e6), corners, report)
