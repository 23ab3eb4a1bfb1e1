"""Mode approach behind one call per frame: the horizon, what lies below it, and its lines."""

from __future__ import annotations

import math
import operator
from dataclasses import dataclass, replace
from functools import lru_cache
from types import NoneType

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.parameters.runway_detector import RunwayDetectorParameters
from mvuav_ros.vision.approach.approach_results import ROLES, ApproachResult, Guidance, Point
from mvuav_ros.vision.approach.attitude import (
    Derotation,
    HorizonFinder,
    HorizonLine,
    horizon_from,
    is_mounted_upside_down,
    is_upside_down,
    line_through,
    mount_matrix,
)
from mvuav_ros.vision.approach.evidence import GreyLevels, as_grey, shrink_levels
from mvuav_ros.vision.approach.guidance import locate
from mvuav_ros.vision.approach.haze import Haze
from mvuav_ros.vision.approach.road import TARGETS, RoadTracker
from mvuav_ros.vision.approach.sight import Sight
from mvuav_ros.vision.approach.strip_edges import Edges, LevelledFrame
from mvuav_ros.vision.approach.strip_tracker import RunwayTracker
from mvuav_ros.vision.approach.strips import FollowedStrip
from mvuav_ros.vision.approach.tuning import DETECTOR, GUIDANCE, MOTION, SEARCH
from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.frame_clock import FrameClock
from mvuav_ros.vision.frames import Attitude, given_rotation
from mvuav_ros.vision.image import Image, as_pixels
from mvuav_ros.vision.point_operations import Pixels
from mvuav_ros.vision.runway.correction import jumps
from mvuav_ros.vision.runway.normal_form import NO_ENDS, NormalForm, clip_segment
from mvuav_ros.vision.runway.results import LineRole, RunwayLine

Segment = tuple[Point, Point]
_UPSIDE_DOWN = 'the attitude says that the camera is upside down: see camera_mount_rpy_deg'


class ApproachDetector:
    """Finds the runway (or road, or pipeline) in one frame after the other.

    It is what the node runway_detector runs in mode approach. Not safe for calls from several
    threads at once.

    Examples:
        >>> import numpy as np
        >>> from mvuav_ros import ApproachDetector
        >>> sky = np.full((240, 320, 3), (230, 180, 140), np.uint8)
        >>> result = ApproachDetector().process(sky, stamp_ns=0)
        >>> result.status, [line.found for line in result.lines]
        ('no runway: the picture is all alike', [False, False, False, False, False])

    Attributes:
        attitude_problem: why the newest frame's attitude was not used; empty if it was or there is
            none.
    """

    def __init__(self, parameters: RunwayDetectorParameters | None = None) -> None:
        self._parameters = RunwayDetectorParameters.given(parameters)
        self._mount = mount_matrix(self._parameters.camera_mount_rpy_deg)
        self.attitude_problem = ''
        self._camera: CameraModel | None = None
        self.reset()

    def configure(self, parameters: RunwayDetectorParameters) -> None:
        """Use other parameters from the next frame on; another target is searched afresh."""
        parameters = RunwayDetectorParameters.given(parameters)
        before, self._parameters = self._parameters, parameters
        if parameters.target != before.target:
            self.reset()
        if parameters.camera_mount_rpy_deg != before.camera_mount_rpy_deg:
            self.set_mount(mount_matrix(parameters.camera_mount_rpy_deg))

    def set_camera(self, camera: CameraModel) -> None:
        """Use a calibration from the next frame on; it may be an unusable one.

        Raises:
            TypeError: it is no `CameraModel`.
        """
        self._camera = CameraModel.given(camera)

    def set_mount(self, mount: NDArray[np.float64]) -> None:
        """Use another mount of the camera from the next frame on than ``camera_mount_rpy_deg``.

        It is (3, 3), the camera's axes (x forward, y left, z up) in those of the body, which are
        named likewise. After one that turns the images upside down it is searched afresh.

        Raises:
            ValueError: it is no rotation.
        """
        mount = given_rotation(mount)
        turned = is_mounted_upside_down(mount) != is_mounted_upside_down(self._mount)
        self._mount = mount
        if turned:
            self.reset()

    def reset(self) -> None:
        """Forget earlier frames; the calibration and the mount stay."""
        self._size: tuple[int, int] | None = None
        self._clock = FrameClock()
        upside_down = is_mounted_upside_down(self._mount)
        self._finder = Finder(self._parameters.target, upside_down=upside_down)
        self._had_attitude = False
        self._shown: FollowedStrip | None = None
        self._last: dict[LineRole, NormalForm] = {}

    def process(
        self,
        image: Image | Pixels,
        stamp_ns: int,
        attitude: Attitude | HorizonLine | None = None,
    ) -> ApproachResult:
        """Find the shape in the next frame.

        A frame of another size than the last one starts afresh.

        Args:
            image: an `Image`, or (height, width) or (height, width, 3), blue first, uint8 or
                uint16; any size, also none. It is neither changed nor copied.
            stamp_ns: its time, whole ns; not before the last frame's (see `reset`). The status says
                if it is less than 1 µs after it, as numbers of frames, s and ms are.
            attitude: of the body at that time, or where the horizon is on the frame, if known.

        Raises:
            ImageError: the image has another shape or type.
            TypeError: the stamp is no whole number, or the attitude neither of both.
            ValueError: the stamp is before the last one.
        """
        image = as_pixels(image, all_bits=True)
        stamp_ns = operator.index(stamp_ns)  # Before another size makes it forget anything
        if not isinstance(attitude, (Attitude, HorizonLine, NoneType)):
            kind = type(attitude).__name__
            raise TypeError(f'attitude must be an Attitude or a HorizonLine, not {kind}')
        size = image.shape[0], image.shape[1]
        if self._size != size:
            self.reset()
            self._size = size
        result = self._find(image, self._clock.take(stamp_ns), attitude)
        return replace(result, status=self._clock.remarked(result.status))

    def _find(
        self, image: Pixels, stamp_ns: int, attitude: Attitude | HorizonLine | None
    ) -> ApproachResult:
        height, width = image.shape[:2]
        empty = ApproachResult(
            stamp_ns, width, height, (), guidance=self._guidance(None), status='', image=image
        )
        if min(height, width) < DETECTOR.min_side:
            status = f'the frame is too small ({width} x {height})'
            return replace(empty, lines=self._rows({}, None), status=status)
        horizon, self.attitude_problem = self._horizon_of(attitude)
        veto = _UPSIDE_DOWN if self.attitude_problem == _UPSIDE_DOWN else ''
        found = self._finder.step(image, horizon, veto, self._checked_camera())
        if found.track is not self._shown:
            # Another shape's lines are not jumps of this one's.
            self._last = {}
            self._shown = found.track
        empty = replace(empty, horizon=_across(found), confidence=found.confidence)
        status = self._doubt(found)
        if found.track is None or status:
            return replace(empty, lines=self._rows({}, None), status=status)
        return self._with_shape(empty, found.track, found)

    def _horizon_of(
        self, attitude: Attitude | HorizonLine | None
    ) -> tuple[HorizonLine | None, str]:
        """Where attitude says that the horizon is, or why the image must say it."""
        source = self._parameters.horizon_source
        if source == 'image':
            return None, ''
        if attitude is None or (isinstance(attitude, Attitude) and not attitude.valid):
            missed = source == 'imu' or self._had_attitude or attitude is not None
            return None, "no attitude for this image: the horizon is the image's" if missed else ''
        self._had_attitude = True
        if isinstance(attitude, HorizonLine):
            if math.isfinite(attitude.row) and abs(attitude.slope) <= math.pi:
                return attitude, ''
            return None, "the horizon given is none: the horizon is the image's"
        camera = self._checked_camera()
        if camera is None:
            return None, 'attitude is of no use without a calibrated camera_info'
        if is_upside_down(attitude, self._mount):
            return None, _UPSIDE_DOWN
        horizon = horizon_from(attitude, camera, self._mount)
        if horizon is None:
            return None, "the attitude shows no horizon: the horizon is the image's"
        return horizon, ''

    def _doubt(self, found: Found) -> str:
        """Why nothing is reported; empty if the track is."""
        target = self._parameters.target
        if found.veto:
            return f'no {target}: {found.veto}'
        status = f'no {target}'
        if found.track is not None:
            # Only a runway's confidence is a probability.
            if target != 'runway' or found.confidence >= self._parameters.min_confidence:
                return ''
            status += f': the likeliest has confidence {found.confidence:.2f}'
        # A road is looked for without a horizon.
        if found.horizon_row is None and target != 'road':
            status += ': no horizon in view: give attitude'
        return status

    def _with_shape(
        self, empty: ApproachResult, track: FollowedStrip, found: Found
    ) -> ApproachResult:
        level = found.level
        x, y, left, right, far, near = (float(v) for v in track.strip())
        (far_left, near_left), (far_right, near_right), along_middle = (
            (level.to_frame(x + slope * far, y + far), level.to_frame(x + slope * near, y + near))
            for slope in (left, right, 0.5 * (left + right))
        )
        segments: dict[LineRole, Segment] = {
            LineRole.LEFT_EDGE: (far_left, near_left),
            LineRole.RIGHT_EDGE: (far_right, near_right),
            LineRole.CENTRELINE: along_middle,
        }
        sees_far, sees_near = track.ends_in_view(level)
        seen = track.points is not None and not track.predicted
        # Only a runway ends within sight.
        if self._parameters.target == 'runway':
            if sees_far:
                segments[LineRole.FAR_END] = (far_left, far_right)
            if sees_near:
                segments[LineRole.NEAR_END] = (near_left, near_right)
        return replace(
            empty,
            lines=self._rows(segments, track.points, found.confidence),
            vanishing_point=level.to_frame(x, y),
            corners=(near_left, near_right, far_right, far_left),
            guidance=self._guidance(found, sees_near=sees_near),
            status='' if seen else f'{self._parameters.target} not seen: predicted',
        )

    def _rows(
        self,
        segments: dict[LineRole, Segment],
        edges: Edges | None,
        confidence: float = 0.0,
    ) -> tuple[RunwayLine, ...]:
        """The result's rows, one for each of `ROLES`; points of both edges vote for the first two.

        A flagged line is reported as it is: the shape was followed as a whole, and an older line
        would no longer be one of its edges.
        """
        assert self._size is not None
        height, width = self._size
        votes = [float(np.count_nonzero(edge.weights)) for edge in edges or ()]
        rows, old, self._last = [], self._last, {}
        for index, role in enumerate(ROLES):
            segment = segments.get(role)
            if segment is None:
                rows.append(RunwayLine(role=role))
                continue
            line = self._last[role] = line_through(*segment[0], *segment[1])
            flags = jumps(line, old.get(role, line), self._parameters)
            upper, lower = sorted(segment, key=lambda point: point[1])
            ends = clip_segment(*upper, *lower, width - 1.0, height - 1.0) or NO_ENDS
            number = votes[index] if index < len(votes) else math.nan
            rows.append(RunwayLine(index, *line, number, *line, *flags, *ends, role, confidence))
        return tuple(rows)

    def _checked_camera(self) -> CameraModel | None:
        """The calibration, if it is of frames of this size."""
        if self._camera is None or self._size is None:
            return None
        height, width = self._size
        return None if self._camera.objection(width, height) else self._camera

    def _guidance(self, found: Found | None, *, sees_near: bool = False) -> Guidance | None:
        """From what was found; None where nobody asked for it or the camera is not known."""
        camera = self._checked_camera()
        width = self._parameters.runway_width
        if camera is None or not width > 0:
            return None
        track = None if found is None else found.track
        if found is None or track is None or track.points is None:
            return Guidance()
        _, y = track.shape.vanishing_point
        near_row = y + track.near_seen if sees_near else None
        sigma = _slope_sigma(y, found)
        return locate(track.points, near_row, found.level, sigma, camera, width)


def _slope_sigma(meeting: float, found: Found) -> float:
    """How well the horizon's slope is known, rad, by how far from it the edges meet."""
    if found.horizon_row is None:
        return GUIDANCE.bank_sigma
    away = abs(meeting - found.horizon_row) / (0.5 * found.level.width)
    share = GUIDANCE.slope_share if found.stated_sigma is None else GUIDANCE.stated_slope_share
    sigmas = GUIDANCE.slope_sigma, share * max(0.0, away - GUIDANCE.max_usual_away)
    # In this order one of NaN is that of no horizon.
    return min(GUIDANCE.bank_sigma, math.hypot(*sigmas, found.stated_sigma or 0.0))


def _across(found: Found) -> tuple[Point, Point] | None:
    """Where the horizon crosses the sides of the frame, if it is known and does."""
    level, row = found.level, found.horizon_row
    if row is None:
        return None
    (x1, y1), (x2, y2) = level.to_frame(0.0, row), level.to_frame(1.0, row)
    if x1 == x2:  # Upright, as where an attitude is in the optical axes
        return None
    down = (y2 - y1) / (x2 - x1)
    right = found.width - 1.0
    return (0.0, y1 - down * x1), (right, y1 + down * (right - x1))


@lru_cache(maxsize=1)
def _bent_lens(camera: CameraModel, factor: int) -> CameraModel | None:
    """The calibration of working images, of a lens that bends lines.

    One for all frames: what a camera works out of itself is kept with it.
    """
    return None if camera.is_straight else camera.binned(factor, factor)


@dataclass(frozen=True)
class Found:
    """What a frame shows."""

    track: FollowedStrip | None  # of the target, if there is one
    confidence: float  # of the track
    level: Derotation  # of the frame
    horizon_row: float | None  # on the levelled working image, if it is known
    width: int  # of the frame, px
    veto: str = ''  # why no track is reported, however confident; empty if nothing forbids it
    stated_sigma: float | None = None  # rad, of the horizon's slope; None without attitude


class Finder:
    """From a frame to the track of the target in it: the horizon first, then what lies below it."""

    def __init__(self, target: str, *, upside_down: bool = False) -> None:
        self._upside_down = upside_down
        self.tracker: RunwayTracker | RoadTracker
        self.tracker = RunwayTracker() if target == 'runway' else RoadTracker(TARGETS[target])
        self._horizon: HorizonFinder | None = None
        self._seen = 0  # frames in which the image has shown a horizon
        self._levels = GreyLevels()
        self._haze = Haze()

    def step(
        self, image: Pixels, known: HorizonLine | None, veto: str, camera: CameraModel | None
    ) -> Found:
        """Take in the next frame, of which the horizon may be known, or why it shows nothing."""
        image = as_grey(self._levels.levels(image))
        pixels, factor = shrink_levels(image)
        height, width = pixels.shape[:2]
        level = Derotation(width, height, factor, math.pi if self._upside_down else 0.0)
        sight = Sight.unknown(height, level.slope)
        if self.tracker.below_horizon:
            upside_down = self._upside_down
            self._horizon = self._horizon or HorizonFinder(height, width, upside_down=upside_down)
            lens = None if camera is None else _bent_lens(camera, factor)
            horizon = known or self._horizon.find(pixels, lens)
            if horizon is not None:
                level = Derotation(width, height, factor, horizon.slope)
                row, seen = horizon.row, math.inf
                if known is None:
                    self._seen = seen = self._seen + 1
                else:
                    # In the middle of all columns, of which the working image has left out a few.
                    row += math.tan(horizon.slope) * 0.5 * (factor * width - image.shape[1])
                    row = (row + 0.5) / factor - 0.5
                row = level.row_of(row)
                sight = Sight.about(row, level.slope, sight, seen)
                if known is not None:
                    cleared = self._haze.cleared(image, pixels, level, row)
                    if cleared is not image:
                        image, pixels = cleared, shrink_levels(cleared)[0]
        track = self.tracker.step(LevelledFrame(image, level), pixels, sight)
        # Without a calibration a field of view of 53 degrees is assumed.
        focal = float(width) if camera is None else float(camera.matrix[0, 0]) / factor
        veto = veto or self._veto(track, sight, level, focal)
        confidence = 0.0 if veto else self.tracker.confidence
        stated_sigma = known.sigma if known else None
        return Found(track, confidence, level, sight.row, image.shape[1], veto, stated_sigma)

    def _veto(
        self, track: FollowedStrip | None, sight: Sight, level: Derotation, focal: float
    ) -> str:
        """Why nothing is reported: the picture is frozen, or the track can be none."""
        registration = self.tracker.registration
        if registration.unchanged > (0 if track is None else DETECTOR.frozen_frames):
            return f'the picture has not changed for {registration.unchanged} frames'
        if registration.is_plain:
            return 'the picture is all alike'
        if track is None:
            return ''
        if registration.alike < MOTION.min_alike:
            return 'the picture shows nothing of what the last one did'
        if track.length(focal) < track.min_length and all(track.ends_in_view(level)):
            return 'the likeliest is too short'
        if sight.row is None or sight.meeting is None:
            return ''
        if track.lies_above(sight.row):
            return 'the likeliest lies above the horizon'
        _, meeting = track.shape.vanishing_point
        if abs(meeting - sight.row) > DETECTOR.max_off_attitude * SEARCH.attitude_sigma:
            return "the edges of the likeliest do not meet at the attitude's horizon"
        return ''
