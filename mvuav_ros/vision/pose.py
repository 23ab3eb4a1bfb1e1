"""Where a body is before a calibrated camera, from the places of its lights."""

from __future__ import annotations

import math
import operator
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.frames import OPTICAL_FROM_BODY, quaternion, rpy
from mvuav_ros.vision.reprojection import MIN_MARKERS, Reprojection, Solution
from mvuav_ros.vision.rig import MarkerRig, RigOrFile

Array = NDArray[np.float64]


# When a pose is believed, which of several is taken, and how the noise follows the residuals.
# Chosen on the simulator's docking approaches with 0.02 to 0.6 px of noise, and on flights on
# which other lights take the markers' names; what concerns several solutions of three lights on
# seeds 0 to 29 of flights of random rigs.

# s, for which the last pose decides which of several solutions is right, and for which three of
# four lights or more continue their pose: later, another light in the place of one of them may
# have bent it, which none of them shows. Seeds 27607 to 27630 of hard kinds of flights.
HOLDS = 0.7
# px, root mean square per axis, above which the names or the calibration must be wrong; and the
# same over the image's span of the markers, for large images.
MAX_RESIDUAL = 1.0
MAX_RELATIVE_RESIDUAL = 0.004
UNUSUAL = 4.0  # times the usual noise: a residual from there on is looked into
MAX_DISTANCE_ERROR = 0.015  # of the distance (1 sigma), above which a pose is kept back
MAX_TURN_ERROR = math.radians(1.5)  # rad (1 sigma), likewise
# Part of both from which on a pose of three lights is kept back: two solutions are about to
# meet, and the errors are no longer those of the one.
OF_THREE = 0.4
# Solutions: ratio of two ones' squared residuals up to which both fit, and their difference
# over the noise's variance from which on the less one is right.
ALIKE = 4.0
DECISIVE = 12.0
SAME_ROTATION = math.radians(5.0)  # rad, up to which two rotations are one solution
NEARER = math.radians(3.0)  # rad, by which the one nearest to the last pose must be so
SAME_OF_THREE = math.radians(0.5)  # rad, up to which two solutions of three lights are the same
MEETING = math.radians(8.0)  # rad, up to which two of them may be taken for each other
# Noise: px, assumed before there are residuals.
FIRST_NOISE = 0.3
FIRST_WEIGHT = 4.0  # degrees of freedom that this assumption is worth
FIRST_MEMORY = 0.9  # of that, per frame
MEMORY = 0.999  # of the residuals, per frame
RECENT_MEMORY = 0.6  # of those that show a sudden rise: back to normal in 15 frames
RISE = 2.5  # ratio of the recent noise to the usual one from which on it counts
MAX_RISE = 60  # frames after which it is the usual noise that has changed for good
STEADY_ERROR = 0.015  # px, of a centroid in all frames: residuals do not show all of it
_PLACE_FIRST = np.roll(np.arange(36).reshape(6, 6), (3, 3), axis=(0, 1))
"""Where the elements of `Pose.covariance` are among those by turns and places."""


@dataclass(frozen=True, eq=False)
class Pose:
    """A body in the camera's optical frame (x right, y down, z ahead).

    Attributes:
        rotation: (3, 3), optical frame from the body's (x forward, y left, z up).
        translation: (3,), m, of the body's origin.
        covariance: (6, 6), of x, y, z (m) and of small turns about the optical frame's x, y and
            z axes (rad), in geometry_msgs/PoseWithCovariance's order.
        reprojections: (n, 2), px, where all of the rig's lights should be seen; NaN for those
            that the camera cannot see.
        residual: root mean square of the residuals per axis, px.
    """

    rotation: Array
    translation: Array
    covariance: Array
    reprojections: Array
    residual: float

    @property
    def rpy(self) -> tuple[float, float, float]:
        """Roll, pitch and yaw of the body against one that flies straight ahead (rad).

        REP-103's fixed-axis angles: right wing down, nose down and nose left are positive.
        """
        return rpy(OPTICAL_FROM_BODY.T @ self.rotation)

    @property
    def quaternion(self) -> tuple[float, float, float, float]:
        """The rotation as x, y, z, w."""
        return quaternion(self.rotation)


class PoseEstimator:
    """Poses of one rig, frame after frame; none where it cannot be vouched for.

    OpenCV's perspective-n-point solvers give the first pose, Gauss-Newton steps on the
    reprojection error every pose; the last pose is where it starts, and decides where two
    solutions fit. A marker that the others contradict is left out where it is clear which one
    that is. Of four or three it is not: there is no pose while these fit worse than before. The
    covariance is noise² (JᵀJ)⁻¹, with J the reprojection's derivative. The noise comes from the
    residuals of this and earlier frames, as one frame of five markers leaves only four degrees of
    freedom, and from a small steady error.

    Examples:
        >>> import cv2, numpy as np
        >>> from mvuav_ros import CameraModel, PoseEstimator
        >>> from mvuav_ros.vision.frames import OPTICAL_FROM_BODY
        >>> from mvuav_ros.vision.rig import TANKER_747
        >>> camera = CameraModel(640, 480, k=(600, 0, 320, 0, 600, 240, 0, 0, 1))
        >>> ahead = cv2.Rodrigues(OPTICAL_FROM_BODY)[0], np.array([2.0, -1.0, 120.0])
        >>> pixels = cv2.projectPoints(TANKER_747.positions, *ahead, camera.matrix, None)[0]
        >>> estimator = PoseEstimator(TANKER_747)
        >>> pose = estimator.estimate(camera, range(5), pixels.reshape(-1, 2), stamp_ns=0)
        >>> [round(float(metres), 3) for metres in pose.translation]
        [2.0, -1.0, 120.0]

    Attributes:
        reason: why the newest frame has no pose; empty if it has.
    """

    def __init__(self, rig: RigOrFile) -> None:
        """Prepare for the first frame of a rig, or of the one in a YAML file."""
        self._rig = MarkerRig.given(rig)
        self._points = np.ascontiguousarray(self._rig.positions)
        self._all = list(range(len(self._points)))
        self.reset()

    def reset(self) -> None:
        """Forget earlier frames."""
        self.reason = ''
        self._last: Solution | None = None
        self._last_seen: tuple[CameraModel, list[int]] | None = None
        self._last_time = -math.inf
        # Markers of a pose of more than three that have been seen since, and when it was.
        self._vouched: frozenset[int] = frozenset()
        self._vouched_time = -math.inf
        self._residuals = _ResidualNoise()

    @property
    def noise(self) -> float:
        """Deviation of a marker's place per axis, as the residuals show it, px."""
        return self._residuals.noise

    def estimate(
        self, camera: CameraModel, labels: Sequence[int], pixels: Array, stamp_ns: int
    ) -> Pose | None:
        """The pose in one frame.

        Args:
            camera: calibrated (see `CameraModel.check`).
            labels: of the markers seen, by their place in the rig.
            pixels: (n, 2), where, px.
            stamp_ns: the frame's time, ns. One that jumps back continues no pose.

        Returns:
            The pose, or None where the markers are too few, do not fit or do not determine it well
            enough; `reason` says which.

        Raises:
            TypeError: the camera is no `CameraModel`, or the stamp no whole number.
            ValueError: the rig has no such label, one is there twice, or there are more or fewer
                places than labels.
        """
        CameraModel.given(camera)
        if np.size(pixels) != 2 * len(labels):
            raise ValueError(f'{len(labels)} labels need as many places, not {np.shape(pixels)}')
        if len(labels) != len({*labels} & {*self._all}):
            raise ValueError(f'labels {list(labels)} of a rig of {len(self._points)}, each once')
        # A float would be seconds, of which a caller would never hear.
        time = operator.index(stamp_ns) * 1e-9
        image = np.ascontiguousarray(pixels, np.float64).reshape(-1, 2)
        self._vouched &= frozenset(labels)
        self.reason = _why_none(image)
        if self.reason:
            return None
        self._forget(time)
        # Three lights fit a pose wherever they are, so that another light in the place of one of
        # them would not show: they only continue a pose of more.
        if len(labels) == MIN_MARKERS and not (self._last and self._vouched.issuperset(labels)):
            self.reason = f'{MIN_MARKERS} markers that no other one confirms'
            return None
        chosen, solution = self._solve(camera, list(labels), image)
        if solution is None:
            return None
        if len(labels) < MIN_MARKERS + 2 and self._residuals.has_risen:
            self.reason = 'the markers fit worse than before: one may be another light'
            return None
        if len(chosen) > MIN_MARKERS:
            self._vouched, self._vouched_time = frozenset(chosen), time
        pose = self._pose(camera, chosen, solution)
        if pose is not None:
            self._last, self._last_seen, self._last_time = solution, (camera, chosen), time
        elif len(chosen) == MIN_MARKERS:
            # Where two solutions of three lights meet, nothing says which one goes on.
            self._last = None
        return pose

    def _forget(self, time: float) -> None:
        """What is too old to be continued at a time, s."""
        if not 0.0 <= time - self._last_time <= HOLDS:
            self._last = None
        if time - self._vouched_time > HOLDS:
            self._vouched = frozenset()

    def _solve(
        self, camera: CameraModel, markers: list[int], image: Array
    ) -> tuple[list[int], Solution | None]:
        """The pose's solution, and the markers that it is from."""
        self.reason = ''
        count = 2 * len(markers)
        solution = self._fit(camera, markers, image)
        usual = (UNUSUAL * self._residuals.usual) ** 2
        is_odd = solution is None or solution.squares > count * usual
        if is_odd and len(markers) >= MIN_MARKERS + 2:
            # Without the one marker that the others contradict, if it is clear which one that is.
            reason, fitting = self.reason, []
            for index in range(len(markers)):
                rest = markers[:index] + markers[index + 1 :]
                fit = self._fit(camera, rest, np.delete(image, index, axis=0), is_whole=False)
                if fit is not None and fit.squares <= (count - 2) * usual:
                    fitting.append((rest, fit))
            if len(fitting) == 1:
                self.reason = ''
                return fitting[0]
            # Not what the fits of fewer markers have said.
            self.reason = reason
        if solution is not None:
            self._residuals.learn(solution.squares, count - 6)
        return markers, solution

    def _fit(
        self, camera: CameraModel, markers: list[int], image: Array, *, is_whole: bool = True
    ) -> Solution | None:
        """From the last pose, if that is fresh and nothing looks odd; else the right one of all.

        Only a whole frame says anything of the noise, and only once.
        """
        points = self._points if markers == self._all else self._points[markers]
        view, count = Reprojection(camera, points, image), 2 * len(image)
        last = self._last
        known = last if self._last_seen == (camera, markers) else None
        followed = view.refine(last.rotation, last.translation, known) if last else None
        most = UNUSUAL * self.noise
        if most > MAX_RESIDUAL:
            most = min(most, _max_residual(image))
        if followed is not None and followed.squares <= count * most**2:
            # Another solution of three lights may be so near that either is the right one.
            others = [] if count > 2 * MIN_MARKERS else view.closed_forms()
            angles = [_angle(followed.rotation, rotation) for rotation, _ in others]
            if not any(SAME_OF_THREE < angle < MEETING for angle in angles):
                return followed
            self._last = None
            self.reason = 'more than one pose fits the markers'
            return None
        solutions = view.solve() + ([followed] if followed else [])
        least = min((solution.squares for solution in solutions), default=math.inf)
        if math.sqrt(least / count) > _max_residual(image):
            self.reason = 'no pose fits the markers'
            return None
        chosen = _choose(solutions, self.noise, count, last and last.rotation)
        if chosen is None:
            self.reason = 'more than one pose fits the markers'
            if last is None and is_whole:
                self._residuals.learn(least, count - 6)
        return chosen

    def _pose(self, camera: CameraModel, labels: list[int], solution: Solution) -> Pose | None:
        """What is published of a solution, if it is known well enough."""
        rotation, translation, squares, seen, slopes, spread = solution
        count = len(slopes)
        if spread is not None:
            noise = self.noise
            shown = math.sqrt(squares / (count - 6)) if count > 6 else 0.0
            spread = spread * max(noise, shown if shown > UNUSUAL * noise else 0.0) ** 2
        share = OF_THREE if count == 2 * MIN_MARKERS else 1.0
        distance = self._rig.distance(rotation, translation)
        if spread is None or not _is_known(spread, distance, share):
            self.reason = 'the pose is too uncertain'
            return None
        if labels != self._all:
            places = self._points.dot(rotation.T) + translation
            seen = camera.project(places)
            seen[~camera.shows(places)] = math.nan
        residual = math.sqrt(squares / count)
        # Copies, as the next pose begins with the solution's own.
        own = rotation.copy(), translation.copy(), spread.take(_PLACE_FIRST), seen.copy()
        return Pose(*own, residual)


def _why_none(image: Array) -> str:
    """Why markers' places, px, can have no pose whatever they are of; empty if they can."""
    if len(image) < MIN_MARKERS:
        return f'{len(image)} markers; a pose needs {MIN_MARKERS}'
    if not math.isfinite(sum(map(sum, image.tolist()))):
        return 'the positions of the markers are not finite'
    return ''


def _max_residual(image: Array) -> float:
    """px, root mean square per axis."""
    span = float((image.max(axis=0) - image.min(axis=0)).max())
    return max(MAX_RESIDUAL, MAX_RELATIVE_RESIDUAL * span)


def _is_known(spread: Array, distance: float, share: float) -> bool:
    """Whether turns and places are known well enough to publish, in a share of the limits."""
    variances: list[float] = spread.diagonal().tolist()
    if not math.isfinite(sum(variances)):
        return False
    turned = math.sqrt(max(*variances[:3], 0.0))
    moved = math.sqrt(max(*variances[3:], 0.0))
    known = moved <= share * MAX_DISTANCE_ERROR * distance
    return known and turned <= share * MAX_TURN_ERROR


def _choose(
    solutions: Sequence[Solution], noise: float, count: int, last: Array | None
) -> Solution | None:
    """The right one of all solutions for so many coordinates; None if it is not clear."""
    best = min(solutions, key=lambda solution: solution.squares)
    limit = ALIKE * best.squares + count * noise**2
    fitting = [solution for solution in solutions if solution.squares <= limit]
    if last is not None:
        return _nearest(last, fitting)
    limit = best.squares + DECISIVE * noise**2
    others = [s for s in fitting if s.squares < limit and not _are_alike(best, s)]
    return None if others else best


def _nearest(last: Array, fitting: Sequence[Solution]) -> Solution | None:
    """The solution that goes on from the last pose."""
    angles = [_angle(last, solution.rotation) for solution in fitting]
    chosen = fitting[int(np.argmin(angles))]
    same = [solution for solution in fitting if _are_alike(chosen, solution)]
    others = [a for a, s in zip(angles, fitting, strict=True) if not _are_alike(chosen, s)]
    if min(others, default=math.inf) < min(angles) + NEARER:
        return None
    # Some starts come to a halt before the minimum that they share with others.
    return min(same, key=lambda solution: solution.squares)


def _are_alike(a: Solution, b: Solution) -> bool:
    return _angle(a.rotation, b.rotation) < SAME_ROTATION


def _angle(first: Array, second: Array) -> float:
    trace = float(np.sum(first * second))
    return math.acos(min(1.0, max(-1.0, 0.5 * (trace - 1.0))))


class _ResidualNoise:
    """Deviation of a marker's place per axis, px, from the residuals of poses that fit."""

    def __init__(self) -> None:
        self._squares = self._freedom = self._recent = 0.0
        self._doubt = FIRST_WEIGHT
        self._risen_for = 0
        self._note()

    def _note(self) -> None:
        squares = self._squares + self._doubt * FIRST_NOISE**2
        self._variance = squares / (self._freedom + self._doubt)
        newest = self._recent if self.has_risen else self._variance
        # Where there is no sudden rise, and in the newest frame.
        self.usual = math.hypot(math.sqrt(self._variance), STEADY_ERROR)
        self.noise = math.hypot(math.sqrt(newest), STEADY_ERROR)

    @property
    def has_risen(self) -> bool:
        """Whether the newest frames' are far above the usual ones."""
        return self._recent > RISE**2 * self._variance

    def learn(self, squares: float, freedom: int) -> None:
        """Take a frame's squared residuals, px², and their degrees of freedom."""
        if freedom <= 0:
            return
        self._recent += (1 - RECENT_MEMORY) * (squares / freedom - self._recent)
        self._risen_for = self._risen_for + 1 if self.has_risen else 0
        if self._risen_for == MAX_RISE:
            self._squares, self._freedom = FIRST_WEIGHT * self._recent, FIRST_WEIGHT
            self._risen_for = 0
        elif self._risen_for:
            # A sudden rise counts while it lasts, and is soon forgotten.
            squares = min(squares, self._variance * freedom)
        self._squares = MEMORY * self._squares + squares
        self._freedom = MEMORY * self._freedom + freedom
        self._doubt *= FIRST_MEMORY
        self._note()
