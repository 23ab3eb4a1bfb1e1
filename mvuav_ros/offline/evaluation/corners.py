"""How often both runway edges are found, against corners labelled by hand."""

from __future__ import annotations

import csv
import math
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from mvuav_ros.vision.runway.normal_form import NormalForm
from mvuav_ros.vision.runway.results import LineRole, RunwayLine

LEAST_TOLERANCE = 3.0
"""Px."""
TOLERANCE_SHARE = 0.05
"""Of the near end's width."""
WARM_UP = 24
"""Frames before the first that counts."""
_CORNERS = ('near_left', 'near_right', 'far_right', 'far_left')
_COLUMNS = ('file', *(f'{corner}_{axis}' for corner in _CORNERS for axis in 'xy'))

Point = tuple[float, float]


class CornersError(ValueError):
    """A file of corners that cannot be used, with the reason."""


@dataclass(frozen=True)
class LabelledFrame:
    """One image's labels, px.

    Attributes:
        file: name of the image, beside the labels.
        near_left: corner.
        near_right: corner.
        far_right: corner.
        far_left: corner.
    """

    file: str
    near_left: Point
    near_right: Point
    far_right: Point
    far_left: Point

    @property
    def tolerance(self) -> float:
        """How far a line may pass from its edge's corners, px."""
        return max(LEAST_TOLERANCE, TOLERANCE_SHARE * math.dist(self.near_left, self.near_right))


@dataclass(frozen=True)
class FrameScore:
    """How one frame's edges were found.

    Attributes:
        file: name of the image.
        left: the larger distance of the left edge's line from its two corners, px; infinite if
            no such line was reported.
        right: likewise.
        tolerance: px.
    """

    file: str
    left: float
    right: float
    tolerance: float

    @property
    def found(self) -> bool:
        """Both edges."""
        return max(self.left, self.right) <= self.tolerance

    @property
    def error(self) -> float:
        """The worse edge's, in tolerances."""
        return max(self.left, self.right) / self.tolerance

    @property
    def failure(self) -> str:
        """Empty, or its class: ``missing``, ``left_off``, ``right_off`` or ``both_off``."""
        if self.found:
            return ''
        if not math.isfinite(self.error):
            return 'missing'
        if self.left > self.tolerance:
            return 'both_off' if self.right > self.tolerance else 'left_off'
        return 'right_off'


@dataclass(frozen=True)
class CornersScore:
    """A run's result; the first `WARM_UP` frames do not count in the shares.

    Attributes:
        frames: all of them, in order.
    """

    frames: tuple[FrameScore, ...]

    @property
    def counted(self) -> tuple[FrameScore, ...]:
        """The frames after the warm-up."""
        return self.frames[WARM_UP:]

    @property
    def left(self) -> float:
        """Share of frames with the left edge found; NaN without frames."""
        return _share(frame.left <= frame.tolerance for frame in self.counted)

    @property
    def right(self) -> float:
        """Share of frames with the right edge found."""
        return _share(frame.right <= frame.tolerance for frame in self.counted)

    @property
    def both(self) -> float:
        """Share of frames with both edges found."""
        return _share(frame.found for frame in self.counted)

    @property
    def reported(self) -> float:
        """Share of frames with a line reported for both edges."""
        return _share(math.isfinite(frame.error) for frame in self.counted)

    @property
    def failures(self) -> dict[str, int]:
        """How many of the counted frames are of which class of failure."""
        return dict(Counter(frame.failure for frame in self.counted if frame.failure))

    def figures(self) -> dict[str, object]:
        """For a JSON file; null where no line was reported."""
        return {
            'both_found': self.both,
            'left_found': self.left,
            'right_found': self.right,
            'reported': self.reported,
            'failures': self.failures,
            'warm_up': WARM_UP,
            'frames': [
                {
                    'file': frame.file,
                    'left_px': frame.left if math.isfinite(frame.left) else None,
                    'right_px': frame.right if math.isfinite(frame.right) else None,
                    'tolerance_px': frame.tolerance,
                    'found': frame.found,
                }
                for frame in self.frames
            ],
        }


def read_corners(path: Path) -> list[LabelledFrame]:
    """Read a file of labels.

    Raises:
        CornersError: it has other columns, no rows, or something that is no number.
    """
    with path.open(newline='', encoding='utf-8') as file:
        reader = csv.DictReader(file)
        missing = [name for name in _COLUMNS if name not in (reader.fieldnames or ())]
        if missing:
            raise CornersError(f'{path}: no column {", ".join(missing)}')
        frames = [_frame(path, number, row) for number, row in enumerate(reader, 2)]
    if not frames:
        raise CornersError(f'{path}: no rows')
    return frames


def score_frame(labels: LabelledFrame, lines: Iterable[RunwayLine]) -> FrameScore:
    """Hold one frame's lines against its labels."""
    errors = {LineRole.LEFT_EDGE: math.inf, LineRole.RIGHT_EDGE: math.inf}
    corners = {
        LineRole.LEFT_EDGE: (labels.near_left, labels.far_left),
        LineRole.RIGHT_EDGE: (labels.near_right, labels.far_right),
    }
    for line in lines:
        if line.found and line.role in errors:
            form = NormalForm(line.rho, line.theta)
            distance = max(_distance(form, corner) for corner in corners[line.role])
            errors[line.role] = min(errors[line.role], distance)
    return FrameScore(
        labels.file, errors[LineRole.LEFT_EDGE], errors[LineRole.RIGHT_EDGE], labels.tolerance
    )


def _frame(path: Path, number: int, row: dict[str, str | None]) -> LabelledFrame:
    try:
        points = [
            (float(row[f'{corner}_x'] or ''), float(row[f'{corner}_y'] or ''))
            for corner in _CORNERS
        ]
    except ValueError as error:
        raise CornersError(f'{path}, line {number}: {error}') from error
    return LabelledFrame(row['file'] or '', *points)


def _distance(line: NormalForm, point: Point) -> float:
    return abs(point[0] * math.cos(line.theta) + point[1] * math.sin(line.theta) - line.rho)


def _share(values: Iterable[bool]) -> float:
    found = list(values)
    return sum(found) / len(found) if found else math.nan
