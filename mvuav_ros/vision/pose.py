"""Where a body is before a calibrated camera, from the places of its lights."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.frames import OPTICAL_FROM_BODY, quaternion
from mvuav_ros.vision.rig import MarkerRig

Array = NDArray[np.float64]

FEWEST = 3
"""Lights for a pose: with three there may be four solutions, all of which fit."""
LAST_POSE_HOLDS = 1.0
"""Seconds for which the last pose tells which of several solutions is the right one."""
MOST_MISFIT = 4.0
"""px, root mean square per axis: above that the names or the calibration must be wrong."""
_UNUSUAL = 4.0
_ALIKE = 4.0
_SAME = 1.0 + 2.0 * math.cos(math.radians(5.0))
_FIRST_NOISE, _FIRST_WEIGHT, _FIRST_MEMORY = 0.3, 4.0, 0.9
_NOISE_MEMORY = 0.999
_STEADY_ERROR = 0.015
"""px, of a centroid, the same from frame to frame: the residuals do not show all of it."""
_TILTS = tuple(math.radians(angle) for angle in (-40.0, 0.0, 40.0))
_REFINEMENT = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 20, 1e-10)


@dataclass(frozen=True, eq=False)
class Pose:
    """A body in the camera's optical frame (x right, y down, z ahead).

    Attributes:
        rotation: (3, 3), optical frame from the body's (x forward, y left, z up).
        translation: (3,), m, of the body's origin.
        covariance: (6, 6), of x, y, z (m) and of small turns about the optical frame's x, y and
            z axes (rad), in geometry_msgs/PoseWithCovariance's order.
        reprojections: (n, 2), px, where all of the rig's lights should be seen.
        misfit: root mean square of the residuals per axis, px.
    """

    rotation: Array
    translation: Array
    covariance: Array
    reprojections: Array
    misfit: float

    @property
    def rpy(self) -> tuple[float, float, float]:
        """Roll, pitch and yaw of the body against one that flies straight ahead (rad).

        REP-103's fixed-axis angles: right wing down, nose down and nose left are positive.
        """
        r = OPTICAL_FROM_BODY.T @ self.rotation
        pitch = math.asin(min(1.0, max(-1.0, -float(r[2, 0]))))
        roll = math.atan2(float(r[2, 1]), float(r[2, 2]))
        return roll, pitch, math.atan2(float(r[1, 0]), float(r[0, 0]))

    @property
    def quaternion(self) -> tuple[float, float, float, float]:
        """The rotation as x, y, z, w."""
        return quaternion(self.rotation)


class PoseEstimator:
    """Poses of one body, frame after frame.

    OpenCV's perspective-n-point solvers give the first pose, its Levenberg-Marquardt refinement
    of the reprojection error every pose; the last pose is where it starts, and decides where two
    solutions fit. The covariance is noise² (JᵀJ)⁻¹, with J the reprojection's derivative and the
    noise from the residuals of this and earlier frames (one frame of five lights leaves four
    degrees of freedom, far too few to tell) and a small steady error.

    GLSDC and LHM, which the thesis names, minimise the same image error by Gauss-Newton steps and
    the error in object space by orthogonal iteration; at the solution they agree with this one
    to within the noise.

    Example:
        >>> import cv2, numpy as np
        >>> from mvuav_ros import CameraModel, PoseEstimator
        >>> from mvuav_ros.vision.rig import TANKER_747
        >>> camera = CameraModel(640, 480, k=(600, 0, 320, 0, 600, 240, 0, 0, 1))
        >>> ahead = cv2.Rodrigues(OPTICAL_FROM_BODY)[0], np.array([2.0, -1.0, 120.0])
        >>> pixels = cv2.projectPoints(TANKER_747.positions, *ahead, camera.matrix, None)[0]
        >>> estimator = PoseEstimator(TANKER_747)
        >>> pose = estimator.estimate(camera, range(5), pixels.reshape(-1, 2), time=0.0)
        >>> [round(float(metres), 3) for metres in pose.translation]
        [2.0, -1.0, 120.0]
    """

    def __init__(self, rig: MarkerRig) -> None:
        self._points = np.ascontiguousarray(rig.positions)
        self.reset()

    def reset(self) -> None:
        """Forget earlier frames."""
        self._last: tuple[Array, Array] | None = None
        self._last_time = -math.inf
        self._squares = self._freedom = 0.0
        self._doubt = _FIRST_WEIGHT

    @property
    def noise(self) -> float:
        """Deviation of a light's place per axis, as the residuals show it, px."""
        squares = self._squares + self._doubt * _FIRST_NOISE**2
        return math.hypot(math.sqrt(squares / (self._freedom + self._doubt)), _STEADY_ERROR)

    def estimate(
        self, camera: CameraModel, labels: Sequence[int], pixels: Array, time: float
    ) -> Pose | None:
        """The pose in one frame.

        Args:
            camera: calibrated (see `CameraModel.check`).
            labels: of the markers seen, by their place in the rig.
            pixels: (n, 2), where, px.
            time: s, later than the last frame's.

        Returns:
            The pose, or None where the labels are too few or do not fit.
        """
        if len(labels) < FEWEST:
            return None
        points = self._points[list(labels)]
        image = np.ascontiguousarray(pixels, np.float64)
        view = _Lens(camera, points, image)
        solution = self._follow(view, time) or self._find(view, time)
        if solution is None:
            return None
        rvec, tvec, squares = solution
        freedom = 2 * len(labels) - 6
        if freedom > 0:
            self._squares = _NOISE_MEMORY * self._squares + squares
            self._freedom = _NOISE_MEMORY * self._freedom + freedom
            self._doubt *= _FIRST_MEMORY
        self._last, self._last_time = (rvec, tvec), time
        jacobian = view.jacobian(rvec, tvec)
        try:
            spread = np.linalg.inv(jacobian.T @ jacobian)
        except np.linalg.LinAlgError:
            return None
        seen = cv2.projectPoints(self._points, rvec, tvec, camera.matrix, camera.distortion)[0]
        return Pose(
            _rotation(rvec),
            tvec.reshape(3),
            np.asarray(self.noise**2 * spread, np.float64),
            np.asarray(seen, np.float64).reshape(-1, 2),
            math.sqrt(squares / (2 * len(labels))),
        )

    def _follow(self, view: _Lens, time: float) -> _Solution | None:
        """From the last pose, if that is fresh and nothing looks odd."""
        if self._last is None or time - self._last_time > LAST_POSE_HOLDS:
            return None
        solution = view.refine(*self._last)
        usual = _UNUSUAL * self.noise
        if solution is None or solution[2] > 2 * len(view.image) * usual * usual:
            return None
        return solution

    def _find(self, view: _Lens, time: float) -> _Solution | None:
        """From nothing: all solutions, and the likeliest of those that fit."""
        solutions = view.solve()
        if self._last is not None and time - self._last_time <= LAST_POSE_HOLDS:
            again = view.refine(*self._last)
            solutions += [again] if again is not None else []
        if not solutions:
            return None
        least = min(squares for _, _, squares in solutions)
        count = 2 * len(view.image)
        if least > count * MOST_MISFIT**2:
            return None
        limit = _ALIKE * least + count * self.noise**2
        fitting = [solution for solution in solutions if solution[2] <= limit]
        if self._last is None or time - self._last_time > LAST_POSE_HOLDS:
            expected = OPTICAL_FROM_BODY
        else:
            expected = _rotation(self._last[0])
        chosen = max(fitting, key=lambda solution: _likeness(expected, solution[0]))
        # Some starts come to a halt before the minimum that they share with others.
        same = [s for s in fitting if _likeness(_rotation(chosen[0]), s[0]) > _SAME]
        return min(same, key=lambda solution: solution[2])


_Solution = tuple[Array, Array, float]
"""Rotation vector and translation, each (3, 1), and the sum of the squared residuals, px²."""


class _Lens:
    """Some lights of a body in one image."""

    def __init__(self, camera: CameraModel, points: Array, image: Array) -> None:
        self.image = image
        self._points = points
        self._matrix, self._distortion = camera.matrix, camera.distortion

    def refine(self, rvec: Array, tvec: Array) -> _Solution | None:
        """The nearest minimum of the reprojection error; None behind the camera."""
        try:
            refined = cv2.solvePnPRefineLM(
                self._points,
                self.image,
                self._matrix,
                self._distortion,
                rvec.copy(),
                tvec.copy(),
                _REFINEMENT,
            )
        except cv2.error:
            return None
        rvec, tvec = (np.asarray(vector, np.float64) for vector in refined)
        if not (np.isfinite(rvec).all() and np.isfinite(tvec).all()):
            return None
        in_front = (self._points @ _rotation(rvec).T)[:, 2] + tvec[2] > 0.0
        if not in_front.all():
            return None
        seen, _ = cv2.projectPoints(self._points, rvec, tvec, self._matrix, self._distortion)
        residual = self.image - seen.reshape(-1, 2)
        return rvec, tvec, float((residual * residual).sum())

    def solve(self) -> list[_Solution]:
        """All solutions that OpenCV's solvers and a few tilted starts lead to."""
        starts = self._closed_forms()
        middle = self._points.mean(axis=0)
        for rvec, tvec in starts[:1]:
            centre = _rotation(rvec) @ middle + tvec.reshape(3)
            for pitch, yaw in product(_TILTS, _TILTS):
                rotation = _rotation(np.array((pitch, yaw, 0.0))) @ OPTICAL_FROM_BODY
                turned = np.asarray(cv2.Rodrigues(rotation)[0], np.float64)
                starts.append((turned, (centre - rotation @ middle).reshape(3, 1)))
        refined = [self.refine(rvec, tvec) for rvec, tvec in starts]
        return [solution for solution in refined if solution is not None]

    def _closed_forms(self) -> list[tuple[Array, Array]]:
        methods = [cv2.SOLVEPNP_SQPNP]
        if len(self._points) == FEWEST:
            methods = [cv2.SOLVEPNP_P3P, cv2.SOLVEPNP_SQPNP]
        found: list[tuple[Array, Array]] = []
        for method in methods:
            try:
                _, rvecs, tvecs, _ = cv2.solvePnPGeneric(
                    self._points, self.image, self._matrix, self._distortion, flags=method
                )
            except cv2.error:
                continue
            found += [
                (np.asarray(rvec, np.float64), np.asarray(tvec, np.float64))
                for rvec, tvec in zip(rvecs, tvecs, strict=True)
            ]
        return found

    def jacobian(self, rvec: Array, tvec: Array) -> Array:
        """(2n, 6), of the pixels by translation (m) and small turns about the fixed axes (rad)."""
        derivatives = cv2.projectPoints(self._points, rvec, tvec, self._matrix, self._distortion)[1]
        # A step of the rotation vector is a turn by this matrix times the step.
        by_turn = derivatives[:, :3] @ np.linalg.inv(_left_jacobian(rvec.reshape(3)))
        return np.hstack((derivatives[:, 3:6], by_turn))


def _likeness(rotation: Array, rvec: Array) -> float:
    """1 + 2 cos of the angle between two rotations."""
    return float(np.sum(rotation * _rotation(rvec)))


def _rotation(rvec: Array) -> Array:
    return np.asarray(cv2.Rodrigues(rvec)[0], np.float64)


def _left_jacobian(rvec: Array) -> Array:
    """Turn about the fixed axes per step of a rotation vector, (3, 3)."""
    angle = float(np.linalg.norm(rvec))
    x, y, z = rvec.tolist()
    cross = np.array([(0.0, -z, y), (z, 0.0, -x), (-y, x, 0.0)])
    if angle < 1e-6:
        return np.asarray(np.eye(3) + 0.5 * cross)
    first = (1.0 - math.cos(angle)) / angle**2
    second = (angle - math.sin(angle)) / angle**3
    return np.asarray(np.eye(3) + first * cross + second * cross @ cross)
