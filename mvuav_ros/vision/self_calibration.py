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

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.reprojection import Reprojection, rotation_of
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


class _Frame(NamedTuple):
    """Named lights (n,), where they are seen (n, 2), px, and the body's pose."""

    labels: NDArray[np.intp]
    pixels: Array
    rotation: Array
    translation: Array

    def view(self, camera: CameraModel, points: Array) -> Reprojection:
        """The lights as what such a camera sees of such a rig."""
        return Reprojection(camera, np.ascontiguousarray(points[self.labels]), self.pixels)

    def moved(self, step: Array) -> _Frame:
        """By a small turn about the optical axes (rad) and a shift (m)."""
        turned = rotation_of(step[:3]).dot(self.rotation)
        return self._replace(rotation=turned, translation=self.translation + step[3:])


class _Equations(NamedTuple):
    """A frame's residuals (2 n,), and their derivatives by its pose and by what is shared.

    All over the noise; and what the pose leaves of the residuals and the last ones.
    """

    residual: Array
    common: Array
    inverse: Array  # of the derivatives by the pose
    left: Array
    rest: Array


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
        >>> seen = (TANKER_747.positions @ OPTICAL_FROM_BODY.T + (2.0, -1.0, 120.0)) @ true.T
        >>> check = SelfCalibration(TANKER_747.positions, given)
        >>> _ = check.add(range(5), seen[:, :2] / seen[:, 2:])
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
        self._frames: list[_Frame] = []
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
        found = np.array(labels, np.intp), np.array(pixels, np.float64).reshape(-1, 2)
        frame = _Frame(*found, np.eye(3), np.zeros(3))
        model = self._model(self._value)
        poses = frame.view(*model).closed_forms()
        if not poses or not np.isfinite(poses[0][0]).all() or poses[0][1][2] <= 0.0:
            return False
        frame = _Frame(*found, *poses[0])
        if self._is_odd(frame, model) and self._refused < TUNING.max_refused:
            self._refused += 1
            return False
        self._refused = 0
        self._frames = [*self._frames[1 - TUNING.frames :], frame]
        self._estimate = None
        return True

    def misfits(self, shift: float, offsets: Array) -> Array:
        """Each frame's squared residuals over their variances per degree of freedom, (frames,).

        For a focal length, as the logarithm of its ratio to the calibration's, and offsets of the
        markers from the rig's file (n, 3), m.
        """
        model = self._model(np.concatenate(([shift], np.ravel(offsets))))
        found = []
        for frame in self._frames:
            solution = frame.view(*model).refine(frame.rotation, frame.translation)
            squares = math.inf if solution is None else solution.squares
            found.append(squares / TUNING.noise**2 / (2 * len(frame.labels) - 6))
        return np.array(found)

    def _is_odd(self, frame: _Frame, model: tuple[CameraModel, Array]) -> bool:
        estimated = self.estimate()
        if len(self._frames) < TUNING.known or estimated is None or not estimated.fits:
            return False
        first = self._linearize(frame, *model)
        own = self._linearize(frame.moved(first.inverse @ first.residual), *model)
        # What no pose explains, over what camera and rig may still turn out to be.
        spread = np.eye(len(own.left)) + own.rest @ self._covariance @ own.rest.T
        misfit = float(own.left @ np.linalg.solve(spread, own.left)) / max(len(own.left) - 6, 1)
        return misfit > max(TUNING.max_odd, TUNING.odd * estimated.misfit)

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
        value, frames = self._value, self._frames
        for _ in range(_MAX_ITERATIONS):
            model = self._model(value)
            equations = [self._linearize(frame, *model) for frame in frames]
            if not all(np.isfinite(own.common).all() for own in equations):
                return None
            normal: Array = np.diag(weight) + sum(own.rest.T @ own.rest for own in equations)
            towards = sum(own.rest.T @ own.left for own in equations) - weight * value
            squares = sum(float(own.residual @ own.residual) for own in equations)
            squares += float((weight * value**2)[1:].sum())
            try:
                covariance = np.asarray(np.linalg.inv(normal), np.float64)
            except np.linalg.LinAlgError:
                return None
            step = covariance @ towards
            step *= min(1.0, _MAX_STEP / max(abs(float(step[0])), 1e-9))
            value = value + step
            frames = [
                frame.moved(own.inverse @ (own.residual - own.common @ step))
                for frame, own in zip(frames, equations, strict=True)
            ]
            if abs(float(step[0])) < TUNING.step:
                break
        freedom = sum(2 * len(frame.labels) - 6 for frame in frames) - 1
        misfit = squares / max(freedom, 1)
        deviation = math.sqrt(float(covariance[0, 0])) * max(1.0, math.sqrt(misfit))
        offsets = value[1:].reshape(-1, 3)
        estimated = Estimate(float(value[0]), deviation, offsets, misfit)
        if estimated.fits:
            # The next frames begin here.
            self._value, self._covariance, self._frames = value, covariance, frames
        return estimated

    def _linearize(self, frame: _Frame, camera: CameraModel, points: Array) -> _Equations:
        labels, noise = frame.labels, TUNING.noise
        seen, own = frame.view(camera, points).look(frame.rotation, frame.translation)
        common = np.zeros((2 * len(labels), 1 + points.size))
        # A pixel lies as far from the principal point as the focal length is long.
        common[:, 0] = (seen - camera.matrix[:2, 2]).ravel()
        by_point = (own[:, 3:] @ frame.rotation).reshape(-1, 2, 3)
        by_points = common[:, 1:].reshape(len(labels), 2, len(points), 3)
        by_points[np.arange(len(labels)), :, labels] = by_point
        residual, own, common = (frame.pixels - seen).ravel() / noise, own / noise, common / noise
        # What is not finite is in what is shared as well.
        inverse: Array = np.zeros((6, len(own)))
        if np.isfinite(own).all():
            inverse = np.asarray(np.linalg.pinv(own), np.float64)
        left = residual - own @ (inverse @ residual)
        return _Equations(residual, common, inverse, left, common - own @ (inverse @ common))
