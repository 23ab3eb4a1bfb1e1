"""The focal length that a rig's lights show, beside what the calibration says.

A bundle adjustment of a few frames: each has a pose of its own, all share the focal length and how
far the rig's markers are from where its file puts them. Without the latter a rig measured badly
would pass for a wrong calibration.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.reprojection import rotation_of
from mvuav_ros.vision.rig import MarkerRig

Array = NDArray[np.float64]


@dataclass(frozen=True)
class CalibrationTuning:
    """How well rigs and lights are measured, and what contradicts a calibration.

    Chosen on seeds 100 to 105 and 20000 to 20008 of `test/support/marker_flights.py`.
    """

    fewest: int = 4  # markers of a frame that says anything: it has eight numbers, a pose six
    noise: float = 0.15  # px (1 sigma), of a light's place per axis
    # Of a marker's place on the rig per axis, in parts of the rig's size (1 sigma): as a rig is
    # measured well, and, where the lights do not fit that, badly.
    rig_errors: tuple[float, ...] = (0.002, 0.006)
    # Of the focal length's logarithm before anything was seen (1 sigma).
    focal_error: float = 0.5
    contradiction: float = 3.0  # deviations from the calibration, and
    min_contradiction: float = 0.04  # part of it, from which on the lights contradict it
    # Of the squared residuals over their variances, per degree of freedom: with more, the names
    # are wrong or the camera is another one altogether.
    max_misfit: float = 6.0
    frames: int = 12  # that are kept
    # Frames by which rig and camera are known well enough to see that a further one does not fit
    # them: its squared residuals are above `max_odd` and by a factor above those before.
    known: int = 3
    max_odd: float = 2.0
    odd: float = 4.0
    # Such frames in a row, after which it was not one of the lights but what was known.
    max_refused: int = 8
    step: float = 1e-4  # of the logarithm, after which the next one would change nothing


TUNING = CalibrationTuning()
_MAX_ITERATIONS = 12
_MAX_STEP, _FARTHEST = 0.25, 3.0
_PINHOLE: Array = np.eye(3)


class Keyframe(NamedTuple):
    """Named lights of a frame.

    Attributes:
        labels: (n,), of the markers.
        pixels: (n, 2), where they are seen, px.
    """

    labels: NDArray[np.intp]
    pixels: Array


@dataclass(frozen=True, eq=False)
class Estimate:
    """What lights say of the focal length.

    Attributes:
        shift: logarithm of the focal length over that of the calibration.
        deviation: of it (1 sigma).
        offsets: (n, 3), of the markers from where the rig's file puts them, m.
        misfit: squared residuals over their variances per degree of freedom: about 1.
    """

    shift: float
    deviation: float
    offsets: Array
    misfit: float

    @property
    def fits(self) -> bool:
        """Whether some focal length explains the lights."""
        return self.misfit <= TUNING.max_misfit

    @property
    def contradicts(self) -> bool:
        """Whether it is another one than that of the calibration."""
        limit = max(TUNING.contradiction * self.deviation, TUNING.min_contradiction)
        return self.fits and abs(self.shift) > limit

    def of_camera(self, camera: CameraModel) -> CameraModel:
        """The calibration with the focal length that the lights show."""
        return _with_focal(camera, self.shift)

    def of_rig(self, rig: MarkerRig) -> MarkerRig:
        """The rig with its markers where the lights show them."""
        places = (rig.positions + self.offsets).tolist()
        markers = tuple(
            (name, (x, y, z)) for name, (x, y, z) in zip(rig.names, places, strict=True)
        )
        return replace(rig, markers=markers)


def _with_focal(camera: CameraModel, shift: float) -> CameraModel:
    """The calibration with a focal length whose logarithm is greater by so much."""
    by = math.exp(min(max(shift, -_FARTHEST), _FARTHEST))
    k, p = list(camera.k), list(camera.p)
    k[0], k[4] = by * k[0], by * k[4]
    if p:
        p[0], p[5] = by * p[0], by * p[5]
    return replace(camera, k=tuple(k), p=tuple(p))


class SelfCalibration:
    """Collects frames of one rig before one camera, and estimates the focal length by them.

    Examples:
        >>> from mvuav_ros.vision.frames import OPTICAL_FROM_BODY
        >>> from mvuav_ros.vision.rig import TANKER_747
        >>> given = CameraModel(640, 480, (700.0, 0.0, 320.0, 0.0, 700.0, 240.0, 0.0, 0.0, 1.0))
        >>> true = np.array([(600.0, 0.0, 320.0), (0.0, 600.0, 240.0), (0.0, 0.0, 1.0)])
        >>> rvec, tvec = cv2.Rodrigues(OPTICAL_FROM_BODY)[0], np.array((2.0, -1.0, 120.0))
        >>> seen = cv2.projectPoints(TANKER_747.positions, rvec, tvec, true, None)[0]
        >>> check = SelfCalibration(TANKER_747.positions, given)
        >>> _ = check.add(range(5), seen.reshape(-1, 2))
        >>> estimate = check.estimate()
        >>> estimate.contradicts, round(estimate.of_camera(given).k[0])
        (True, 600)
    """

    def __init__(self, points: Array, camera: CameraModel) -> None:
        """Begin with a rig's markers (n, 3), m, and the calibration that is to be checked."""
        self._points = np.asarray(points, np.float64)
        middle = self._points.mean(axis=0)
        self._size = float(np.linalg.norm(self._points - middle, axis=1).max()) or 1.0
        self._camera = camera
        self._frames: list[tuple[Keyframe, Array, Array]] = []
        self._estimate: Estimate | None = None
        self._refused = 0
        # What the frames share: the logarithm of the focal length over the calibration's, and the
        # markers' offsets, m.
        self._value: Array = np.zeros(1 + self._points.size)
        self._covariance: Array = np.zeros((len(self._value), len(self._value)))

    def __len__(self) -> int:
        return len(self._frames)

    def add(self, labels: Sequence[int], pixels: Array) -> bool:
        """Take a frame's named lights: their places in the rig, and where they are seen, px.

        Of many frames the newest are kept. Not taken are frames with too few lights, and such as do
        not fit what the others say, unless they keep coming: a light may be another one.

        Returns:
            Whether it was taken.
        """
        if len(labels) < TUNING.fewest:
            return False
        frame = Keyframe(np.array(labels, np.intp), np.array(pixels, np.float64).reshape(-1, 2))
        pose = self._first_pose(frame)
        if pose is None:
            return False
        if self._is_odd(frame, pose) and self._refused < TUNING.max_refused:
            self._refused += 1
            return False
        self._refused = 0
        self._frames = [*self._frames[1 - TUNING.frames :], (frame, *pose)]
        self._estimate = None
        return True

    def misfits(self, shift: float, offsets: Array) -> Array:
        """Each frame's squared residuals over their variances per degree of freedom, (frames,).

        For a focal length, as the logarithm of its ratio to the calibration's, and offsets of the
        markers from the rig's file (n, 3), m.
        """
        model = self._model(np.concatenate(([shift], np.ravel(offsets))))
        found = []
        for frame, rvec, tvec in self._frames:
            for _ in range(2):
                residual, own, _ = self._linearize(frame, rvec, tvec, *model)
                step = np.linalg.lstsq(own, residual, rcond=None)[0]
                rvec, tvec = rvec + step[:3], tvec + step[3:]
            residual = self._linearize(frame, rvec, tvec, *model)[0]
            found.append(float(residual @ residual) / (len(residual) - 6))
        return np.array(found)

    def _is_odd(self, frame: Keyframe, pose: tuple[Array, Array]) -> bool:
        estimated = self.estimate()
        if len(self._frames) < TUNING.known or estimated is None or not estimated.fits:
            return False
        model = self._model(self._value)
        residual, own, common = self._linearize(frame, *pose, *model)
        step = np.linalg.lstsq(own, residual, rcond=None)[0]
        pose = pose[0] + step[:3], pose[1] + step[3:]
        # What no pose explains, over what camera and rig may still turn out to be.
        residual, own, common = self._linearize(frame, *pose, *model)
        back = np.linalg.pinv(own)
        rest, left = common - own @ (back @ common), residual - own @ (back @ residual)
        spread = np.eye(len(left)) + rest @ self._covariance @ rest.T
        misfit = float(left @ np.linalg.solve(spread, left)) / max(len(left) - 6, 1)
        return misfit > max(TUNING.max_odd, TUNING.odd * estimated.misfit)

    def _first_pose(self, frame: Keyframe) -> tuple[Array, Array] | None:
        camera, points = self._model(self._value)
        points = np.ascontiguousarray(points[frame.labels])
        try:
            found, rvec, tvec = cv2.solvePnP(
                points, camera.undistort(frame.pixels), _PINHOLE, None, flags=cv2.SOLVEPNP_SQPNP
            )
        except cv2.error:
            return None
        if not found or not (np.isfinite(rvec).all() and tvec[2, 0] > 0.0):
            return None
        return np.asarray(rvec, np.float64).reshape(3), np.asarray(tvec, np.float64).reshape(3)

    def estimate(self) -> Estimate | None:
        """What the frames say; None where there are none, or nothing follows from them."""
        if self._estimate is None and self._frames:
            for rig_error in TUNING.rig_errors:
                self._estimate = self._adjust(rig_error)
                if self._estimate is None or self._estimate.fits:
                    break
        return self._estimate

    def _model(self, value: Array) -> tuple[CameraModel, Array]:
        """Camera and markers by what is shared."""
        return _with_focal(self._camera, float(value[0])), self._points + value[1:].reshape(-1, 3)

    def _adjust(self, rig_error: float) -> Estimate | None:
        """Gauss-Newton steps in which the poses are eliminated."""
        deviations = np.full(len(self._value), rig_error * self._size)
        deviations[0] = TUNING.focal_error
        weight = deviations**-2
        value = self._value
        poses = [(rvec, tvec) for _, rvec, tvec in self._frames]
        for _ in range(_MAX_ITERATIONS):
            normal, towards = np.diag(weight), -weight * value
            squares, eliminated = float((weight * value**2)[1:].sum()), []
            model = self._model(value)
            for (frame, _, _), pose in zip(self._frames, poses, strict=True):
                residual, own, common = self._linearize(frame, *pose, *model)
                if not np.isfinite(common).all():
                    return None
                back = np.linalg.pinv(own)
                rest, left = common - own @ (back @ common), residual - own @ (back @ residual)
                normal += rest.T @ rest
                towards += rest.T @ left
                squares += float(residual @ residual)
                eliminated.append((back, common, residual))
            try:
                covariance = np.linalg.inv(normal)
            except np.linalg.LinAlgError:
                return None
            step = covariance @ towards
            step *= min(1.0, _MAX_STEP / max(abs(float(step[0])), 1e-9))
            value = value + step
            poses = [
                (rvec + change[:3], tvec + change[3:])
                for (rvec, tvec), change in zip(
                    poses,
                    (back @ (residual - common @ step) for back, common, residual in eliminated),
                    strict=True,
                )
            ]
            if abs(float(step[0])) < TUNING.step:
                break
        freedom = sum(2 * len(frame.labels) - 6 for frame, _, _ in self._frames) - 1
        misfit = squares / max(freedom, 1)
        deviation = math.sqrt(float(covariance[0, 0])) * max(1.0, math.sqrt(misfit))
        offsets = value[1:].reshape(-1, 3)
        estimated = Estimate(float(value[0]), deviation, offsets, misfit)
        if estimated.fits:
            # The next frames begin here.
            kept = zip(self._frames, poses, strict=True)
            self._covariance = covariance
            self._value, self._frames = value, [(frame, *pose) for (frame, _, _), pose in kept]
        return estimated

    def _linearize(
        self, frame: Keyframe, rvec: Array, tvec: Array, camera: CameraModel, points: Array
    ) -> tuple[Array, Array, Array]:
        """A frame's residuals (2 n,), and their derivatives by its pose and by what is shared.

        All over the noise.
        """
        labels, noise = frame.labels, TUNING.noise
        seen, own = camera.project_with_jacobian(points[labels], rvec, tvec)
        common = np.zeros((2 * len(labels), 1 + points.size))
        # A pixel lies as far from the principal point as the focal length is long.
        common[:, 0] = (seen - camera.matrix[:2, 2]).ravel()
        by_point = own[:, 3:6] @ rotation_of(rvec)
        for row, label in enumerate(labels.tolist()):
            place = slice(3 * label + 1, 3 * label + 4)
            common[2 * row : 2 * row + 2, place] = by_point[2 * row : 2 * row + 2]
        return (frame.pixels - seen).ravel() / noise, own / noise, common / noise
