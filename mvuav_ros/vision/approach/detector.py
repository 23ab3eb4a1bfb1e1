"""The approach scheme behind one call per frame."""

from __future__ import annotations

import math

import numpy as np

from mvuav_ros.parameters.runway_detector import RunwayDetectorParameters
from mvuav_ros.vision.approach.derotation import Derotation
from mvuav_ros.vision.approach.features import WorkingImage, shrink
from mvuav_ros.vision.approach.guidance import fit_edge, locate
from mvuav_ros.vision.approach.horizon import Horizon, HorizonFinder
from mvuav_ros.vision.approach.lines import LineCorrection, Segment
from mvuav_ros.vision.approach.results import ApproachResult, Guidance, Point
from mvuav_ros.vision.approach.targets import TARGETS
from mvuav_ros.vision.approach.track import Track
from mvuav_ros.vision.approach.tracker import Tracker
from mvuav_ros.vision.camera import CalibrationError, CameraModel
from mvuav_ros.vision.point_operations import Pixels
from mvuav_ros.vision.runway.results import LineRole
from mvuav_ros.vision.runway.statistics import RunwayStatistics, RunwaySummary

_SMALLEST = 48
"""Px, of the frame's shorter side."""
_AFRESH = 10
"""Frames between two looks for the horizon at any slope."""
_NOWHERE: Point = (math.nan, math.nan)


class ApproachDetector:
    """Finds the runway (or road, or pipeline) in one frame after the other.

    It is what the node runway_detector runs in mode approach. Not safe for calls from several
    threads at once.

    Example:
        >>> import numpy as np
        >>> from mvuav_ros import ApproachDetector
        >>> sky = np.full((240, 320, 3), (230, 180, 140), np.uint8)
        >>> result = ApproachDetector().process(sky, stamp_ns=0)
        >>> result.status, [line.found for line in result.lines]
        ('no runway: no horizon', [False, False, False, False, False])
    """

    def __init__(self, parameters: RunwayDetectorParameters | None = None) -> None:
        self._parameters = parameters or RunwayDetectorParameters()
        self._correction = LineCorrection(self._parameters)
        self._statistics = RunwayStatistics()
        self._camera: CameraModel | None = None
        self.reset()

    def configure(self, parameters: RunwayDetectorParameters) -> None:
        """Use other parameters from the next frame on; another target is searched afresh."""
        if parameters.target != self._parameters.target:
            self.reset()
        self._parameters = parameters
        self._correction.configure(parameters)

    def set_camera(self, camera: CameraModel) -> None:
        """Use a calibration from the next frame on; it may be an unusable one."""
        self._camera = camera

    def reset(self) -> None:
        """Forget earlier frames; statistics and calibration stay."""
        self._size: tuple[int, int] | None = None
        self._finder: HorizonFinder | None = None
        self._tracker: Tracker | None = None
        self._horizon: Horizon | None = None
        self._shown: Track | None = None
        self._frames = 0
        self._correction.reset()

    def reset_statistics(self) -> None:
        """Begin the statistics at zero."""
        self._statistics.reset()

    def statistics(self) -> RunwaySummary:
        """Statistics of the frames since construction or `reset_statistics`."""
        return self._statistics.summary()

    def process(self, image: Pixels, stamp_ns: int) -> ApproachResult:
        """Find the shape in the next frame.

        A frame of another size than the last one starts afresh.

        Args:
            image: (height, width) or (height, width, 3), blue first, uint8 or uint16; any size,
                also none. It is neither changed nor copied.
            stamp_ns: its time, ns; handed through.
        """
        height, width = image.shape[:2]
        if self._size != (height, width):
            self.reset()
            self._size = (height, width)
        if min(height, width) < _SMALLEST:
            status = f'the frame is too small ({width} x {height})'
            return self._absent(image, stamp_ns, None, status)
        working = shrink(image)
        level, horizon_row = self._level(working)
        tracker = self._tracker_for(working)
        track = tracker.step(image, working.pixels, level, horizon_row)
        if track is not self._shown:
            # Another shape's lines are not jumps of this one's.
            self._correction.reset()
            self._shown = track
        horizon = None if horizon_row is None else _across(level, horizon_row)
        if track is None:
            status = f'no {self._parameters.target}'
            if horizon_row is None and tracker.target.uses_horizon:
                status += ': no horizon'
            return self._absent(image, stamp_ns, horizon, status)
        return self._present(image, stamp_ns, track, level, horizon)

    def _level(self, working: WorkingImage) -> tuple[Derotation, float | None]:
        height, width = working.pixels.shape[:2]
        if not TARGETS[self._parameters.target].uses_horizon:
            return Derotation(width, height, working.factor, 0.0), None
        if self._finder is None:
            self._finder = HorizonFinder(height, width)
        near = None if self._frames % _AFRESH == 0 else self._horizon
        self._frames += 1
        horizon = self._finder.find(working.pixels, near)
        self._horizon = horizon if horizon.trusted else None
        level = Derotation(width, height, working.factor, horizon.slope if horizon.trusted else 0.0)
        return level, level.row_of(horizon.row) if horizon.trusted else None

    def _tracker_for(self, working: WorkingImage) -> Tracker:
        if self._tracker is None:
            height, width = working.pixels.shape[:2]
            self._tracker = Tracker(TARGETS[self._parameters.target], height, width)
        return self._tracker

    def _absent(
        self, image: Pixels, stamp_ns: int, horizon: tuple[Point, Point] | None, status: str
    ) -> ApproachResult:
        height, width = image.shape[:2]
        lines = self._correction.rows({}, {}, 0.0, (width, height))
        self._statistics.add(lines)
        guidance = None if self._usable_camera(image) is None else Guidance()
        return ApproachResult(
            stamp_ns, width, height, lines, _NOWHERE, horizon, None, 0.0, guidance, status, image
        )

    def _present(
        self,
        image: Pixels,
        stamp_ns: int,
        track: Track,
        level: Derotation,
        horizon: tuple[Point, Point] | None,
    ) -> ApproachResult:
        height, width = image.shape[:2]
        x, y, left, right = (float(v) for v in track.shape.as_array())
        near_left, near_right, far_right, far_left, near_middle, far_middle = (
            _point(level, x + slope * depth, y + depth)
            for slope, depth in (
                (left, track.near),
                (right, track.near),
                (right, track.far),
                (left, track.far),
                (0.5 * (left + right), track.near),
                (0.5 * (left + right), track.far),
            )
        )
        segments: dict[LineRole, Segment] = {
            LineRole.LEFT_EDGE: (far_left, near_left),
            LineRole.RIGHT_EDGE: (far_right, near_right),
            LineRole.CENTRELINE: (far_middle, near_middle),
        }
        if TARGETS[self._parameters.target].has_ends:
            segments[LineRole.FAR_END] = (far_left, far_right)
            if not track.open_end:
                segments[LineRole.NEAR_END] = (near_left, near_right)
        votes = {}
        if track.points is not None:
            left_points, right_points = track.points
            votes[LineRole.LEFT_EDGE] = float(np.count_nonzero(left_points.weights))
            votes[LineRole.RIGHT_EDGE] = float(np.count_nonzero(right_points.weights))
        confidence = track.confidence
        lines = self._correction.rows(segments, votes, confidence, (width, height))
        self._statistics.add(lines)
        return ApproachResult(
            stamp_ns,
            width,
            height,
            lines,
            _point(level, x, y),
            horizon,
            (near_left, near_right, far_right, far_left),
            confidence,
            self._guidance(image, track, level),
            '' if track.points is not None else f'{self._parameters.target} not seen: predicted',
            image,
        )

    def _usable_camera(self, image: Pixels) -> CameraModel | None:
        if self._camera is None or not self._parameters.runway_width > 0:
            return None
        try:
            self._camera.check(image.shape[1], image.shape[0])
        except CalibrationError:
            return None
        return self._camera

    def _guidance(self, image: Pixels, track: Track, level: Derotation) -> Guidance | None:
        camera = self._usable_camera(image)
        if camera is None:
            return None
        if track.points is None:
            return Guidance()
        left, right = (fit_edge(points, level.factor) for points in track.points)
        if left is None or right is None:
            return Guidance()
        _, y = track.shape.vanishing_point
        near_row = None if track.open_end else y + track.near_seen
        return locate(left, right, near_row, level, camera, self._parameters.runway_width)


def _point(level: Derotation, x: float, y: float) -> Point:
    on_x, on_y = level.to_frame(x, y)
    return float(on_x), float(on_y)


def _across(level: Derotation, row: float) -> tuple[Point, Point]:
    """Where a level row crosses the sides of the frame."""
    (x1, y1), (x2, y2) = _point(level, 0.0, row), _point(level, 1.0, row)
    down = (y2 - y1) / (x2 - x1)
    right = level.width * level.factor - 1.0
    return (0.0, y1 - down * x1), (right, y1 + down * (right - x1))
