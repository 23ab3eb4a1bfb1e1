"""The runway detector over images with corners labelled by hand: how often both edges are found."""

from __future__ import annotations

import csv
import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.parameters.runway_detector import RunwayDetectorParameters
from mvuav_ros.processing.tracking import draw
from mvuav_ros.recordings.account import SourceError
from mvuav_ros.vision.approach.approach_detector import ApproachDetector
from mvuav_ros.vision.approach.approach_results import ApproachResult
from mvuav_ros.vision.approach.attitude import HorizonLine
from mvuav_ros.vision.runway.results import LineRole, RunwayLine


@dataclass(frozen=True)
class Tolerance:
    """How far an edge may be from its corners along their rows: px, share of the near width."""

    least: float = 3.0
    share: float = 0.05


TOLERANCE = Tolerance()
"""Of labels by hand on images of 320 px."""
WARM_UP = 24
"""Frames before the first that counts."""
_CORNERS = ('near_left', 'near_right', 'far_right', 'far_left')
COLUMNS = ('file', *(f'{corner}_{axis}' for corner in _CORNERS for axis in 'xy'))

Point = tuple[float, float]


@dataclass(frozen=True)
class LabelledFrame:
    """The name of an image beside the labels, and the corners of the runway in it, px."""

    file: str
    near_left: Point
    near_right: Point
    far_right: Point
    far_left: Point

    def tolerance(self, allowed: Tolerance = TOLERANCE) -> float:
        """How far a line may pass from its edge's corners, px along their rows."""
        return max(allowed.least, allowed.share * abs(self.near_right[0] - self.near_left[0]))


@dataclass(frozen=True)
class FrameScore:
    """How the edges of an image were found.

    ``left`` and ``right`` are the larger horizontal error of the edge's line at its two corners'
    rows, px; infinite if no such line was reported. The confidence is NaN where neither was.
    """

    file: str
    left: float
    right: float
    tolerance: float
    confidence: float = math.nan

    @property
    def error(self) -> float:
        """The worse edge's, in tolerances."""
        return max(self.left, self.right) / self.tolerance

    @property
    def reported(self) -> bool:
        """Both edges have a line."""
        return math.isfinite(self.error)

    @property
    def found(self) -> bool:
        """Both edges."""
        return not self.failure

    @property
    def failure(self) -> str:
        """Empty, or its class: ``missing``, ``left_off``, ``right_off`` or ``both_off``."""
        if not self.reported:
            return 'missing'
        left_off, right_off = self.left > self.tolerance, self.right > self.tolerance
        if left_off and right_off:
            return 'both_off'
        return 'left_off' if left_off else 'right_off' if right_off else ''


SHARES: dict[str, tuple[str, Callable[[FrameScore], bool]]] = {
    'both_found': ('both edges found', lambda frame: frame.found),
    'left_found': ('left edge found', lambda frame: frame.left <= frame.tolerance),
    'right_found': ('right edge found', lambda frame: frame.right <= frame.tolerance),
    'reported': ('both edges reported', lambda frame: frame.reported),
    'wrong': ('both edges reported and wrong', lambda frame: frame.reported and not frame.found),
}
"""What frames are counted for, in words and by their scores."""


@dataclass(frozen=True)
class CornersScore:
    """A run's frames in order; the first `WARM_UP` do not count in the shares."""

    frames: tuple[FrameScore, ...]

    @property
    def counted(self) -> tuple[FrameScore, ...]:
        """The frames after the warm-up."""
        return self.frames[WARM_UP:]

    @property
    def shares(self) -> dict[str, float]:
        """Shares of the frames that count, as `SHARES` names them; NaN without frames."""
        counted = self.counted
        return {
            name: sum(map(is_so, counted)) / len(counted) if counted else math.nan
            for name, (_, is_so) in SHARES.items()
        }

    @property
    def first_report(self) -> int | None:
        """Number of the first frame with both edges reported, from 1; None if there is none."""
        reported = (number for number, frame in enumerate(self.frames, 1) if frame.reported)
        return next(reported, None)

    @property
    def failures(self) -> dict[str, int]:
        """How many of the counted frames are of which class of failure."""
        return dict(Counter(frame.failure for frame in self.counted if frame.failure))

    def figures(self) -> dict[str, object]:
        """For a JSON file; null where no line was reported."""
        return {
            **self.shares,
            'first_report': self.first_report,
            'failures': self.failures,
            'warm_up': WARM_UP,
            'frames': [
                {
                    'file': frame.file,
                    'left_px': frame.left if math.isfinite(frame.left) else None,
                    'right_px': frame.right if math.isfinite(frame.right) else None,
                    'tolerance_px': frame.tolerance,
                    'confidence': frame.confidence if frame.reported else None,
                    'found': frame.found,
                }
                for frame in self.frames
            ],
        }


def read_corners(path: Path) -> list[LabelledFrame]:
    """Read a file of labels.

    Raises:
        SourceError: it has other columns, no rows, or something that is no number.
    """
    frames = [
        LabelledFrame(file, *zip(numbers[::2], numbers[1::2], strict=True))
        for file, numbers in _read_rows(path, COLUMNS)
    ]
    if not frames:
        raise SourceError(f'{path}: no rows')
    return frames


def score_frame(
    labels: LabelledFrame, lines: Iterable[RunwayLine], allowed: Tolerance = TOLERANCE
) -> FrameScore:
    """Hold one frame's lines against its labels.

    Raises:
        SourceError: no error at all is allowed.
    """
    tolerance = labels.tolerance(allowed)
    if tolerance == 0:
        raise SourceError(f'{labels.file}: no error is allowed; give a tolerance above 0 px')
    confidence = math.nan
    errors = {LineRole.LEFT_EDGE: math.inf, LineRole.RIGHT_EDGE: math.inf}
    corners = {
        LineRole.LEFT_EDGE: (labels.near_left, labels.far_left),
        LineRole.RIGHT_EDGE: (labels.near_right, labels.far_right),
    }
    for line in lines:
        if line.found and line.role in errors:
            error = max(_horizontal_error(line, corner) for corner in corners[line.role])
            errors[line.role] = min(errors[line.role], error)
            confidence = line.confidence
    left, right = errors.values()
    return FrameScore(labels.file, left, right, tolerance, confidence)


def read_horizon(path: Path, frames: Sequence[LabelledFrame]) -> list[HorizonLine]:
    """Read the horizon of each labelled frame.

    The file's columns are file, row_at_centre (px) and slope_deg (right end down positive).

    Raises:
        SourceError: a column, a frame or a number is missing, or a slope is beyond 180 degrees.
    """
    lines = {}
    for file, (row, slope) in _read_rows(path, ('file', 'row_at_centre', 'slope_deg')):
        if abs(slope) > 180.0:
            raise SourceError(f'{path}: slope_deg of {file} must be -180 to 180, not {slope:g}')
        lines[file] = HorizonLine(row, math.radians(slope))
    absent = [frame.file for frame in frames if frame.file not in lines]
    if absent:
        raise SourceError(f'{path}: no row of {absent[0]}')
    return [lines[frame.file] for frame in frames]


def _read_rows(path: Path, columns: Sequence[str]) -> Iterator[tuple[str, list[float]]]:
    """The first column of each row as text, the others as numbers."""
    # With the mark before the text that spreadsheets write, or without.
    with path.open(newline='', encoding='utf-8-sig') as stream:
        reader = csv.DictReader(stream)
        try:
            missing = [name for name in columns if name not in (reader.fieldnames or ())]
            if missing:
                raise SourceError(f'{path}: no column {", ".join(missing)}')
            for row in reader:
                if None in row:  # which is where DictReader puts them
                    raise ValueError('more values than columns: a point, not a comma, is decimal')
                yield row[columns[0]], [_number(row[name] or '') for name in columns[1:]]
        except UnicodeDecodeError:
            raise SourceError(f'{path}: its text is not UTF-8') from None
        except (ValueError, csv.Error) as error:
            raise SourceError(f'{path}, line {reader.line_num}: {error}') from error


def _number(text: str) -> float:
    number = float(text)
    if not math.isfinite(number):
        raise ValueError(f'{text} is no number')
    return number


def _horizontal_error(line: RunwayLine, point: Point) -> float:
    """How far to the side of a point a line passes, px; infinite for a level line."""
    cos = math.cos(line.theta)
    if abs(cos) < 1e-6:
        return math.inf
    return abs((line.rho - point[1] * math.sin(line.theta)) / cos - point[0])


FRAME_RATE = 25
_LABEL = (255, 255, 255)
_IMAGE_WIDTH = 960


@dataclass(frozen=True)
class LabelledRun:
    """Images of one flight in a folder with their labels, and how the detector is to look at them.

    ``horizon`` is that of each frame, as an attitude sensor would know it; None without one.
    """

    folder: Path
    frames: Sequence[LabelledFrame]
    parameters: RunwayDetectorParameters
    horizon: Sequence[HorizonLine] | None = None
    gray: bool = False
    allowed: Tolerance = TOLERANCE


def run_detector(run: LabelledRun, tick: Callable[[], None]) -> CornersScore:
    """Process the images of a run in order; ``tick`` is called after each.

    Raises:
        SourceError: an image cannot be read.
    """
    scores = []
    for frame, result in _results(run):
        scores.append(score_frame(frame, result.lines, run.allowed))
        tick()
    return CornersScore(tuple(scores))


def write_images(run: LabelledRun, score: CornersScore, folder: Path) -> None:
    """Draw overlays, with the labels in white, of the best, the median and the worst frame.

    Those are ``best.png``, ``median.png`` and ``worst.png``; the worst frame of each class of
    failure that there is becomes ``failure_CLASS.png``.
    """
    folder.mkdir(parents=True, exist_ok=True)
    ranked = sorted(range(WARM_UP, len(run.frames)), key=lambda index: score.frames[index].error)
    if not ranked:
        return
    wanted = {'best': ranked[0], 'median': ranked[len(ranked) // 2], 'worst': ranked[-1]}
    for index in ranked:
        if failure := score.frames[index].failure:
            wanted[f'failure_{failure}'] = index
    for index, (frame, result) in enumerate(_results(run)):
        for name in (name for name, at in wanted.items() if at == index):
            path = folder / f'{name}.png'
            if not cv2.imwrite(str(path), _image(frame, result)):
                raise SourceError(f'{path}: cannot be written')


def _results(run: LabelledRun) -> Iterator[tuple[LabelledFrame, ApproachResult]]:
    detector = ApproachDetector(run.parameters)
    flag = cv2.IMREAD_GRAYSCALE if run.gray else cv2.IMREAD_COLOR
    for index, frame in enumerate(run.frames):
        path = run.folder / frame.file
        image = cv2.imread(str(path), flag)
        if image is None:
            raise SourceError(f'{path}: no image that can be read')
        horizon = None if run.horizon is None else run.horizon[index]
        yield frame, detector.process(image, round(index * 1e9 / FRAME_RATE), horizon)


def _image(frame: LabelledFrame, result: ApproachResult) -> NDArray[np.uint8]:
    image = draw(result)
    factor = max(1, round(_IMAGE_WIDTH / image.shape[1]))
    image = image.repeat(factor, axis=0).repeat(factor, axis=1)
    corners = np.array([frame.near_left, frame.near_right, frame.far_right, frame.far_left])
    outline = (corners + 0.5) * factor - 0.5
    cv2.polylines(image, [np.rint(outline).astype(np.int32)], True, _LABEL, 1)
    return image
