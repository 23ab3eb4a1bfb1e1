"""Names that do not hang on the calibration: where the lights contradict it, theirs is used.

A bundle adjustment of a few frames gives the focal length that a rig's lights show. The frames
share the markers' offsets as well: a badly measured rig is no wrong calibration.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.parameters.marker_tracker import MarkerTrackerParameters
from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.image import Image
from mvuav_ros.vision.markers.identity_tracker import IdentityTracker
from mvuav_ros.vision.markers.lights import Lens
from mvuav_ros.vision.markers.marker_results import MarkerResult
from mvuav_ros.vision.reprojection import Reprojection, rotation_of
from mvuav_ros.vision.rig import MarkerRig

Array = NDArray[np.float64]

# How well rigs and lights are measured, and what contradicts a calibration. Chosen on seeds 100 to
# 105 and 20000 to 20008 of `test/support/marker_flights.py`.

MIN_LIGHTS = 4  # markers of a frame that says anything: it has eight numbers, a pose six
NOISE = 0.15  # px (1 sigma), of a light's place per axis
# Of a marker's place on the rig per axis, in parts of the rig's size (1 sigma): as a rig is
# measured well, and, where the lights do not fit that, badly.
RIG_ERRORS = (0.002, 0.006)
# Of the focal length's logarithm before anything was seen (1 sigma).
FOCAL_ERROR = 0.5
CONTRADICTION = 3.0  # deviations from the calibration, and
MIN_CONTRADICTION = 0.04  # part of it, from which on the lights contradict it
# Of the squared residuals over their variances, per degree of freedom: with more, the names
# are wrong or the camera is another one altogether.
MAX_REDUCED_CHI2 = 6.0
MAX_FRAMES = 12  # that are kept
# Frames by which rig and camera are known well enough to see that a further one does not fit
# them: its squared residuals are above `MAX_ODD` and by a factor above those before.
KNOWN_BY = 3
MAX_ODD = 2.0
ODD = 4.0
# Such frames in a row, after which it was not one of the lights but what was known.
MAX_REFUSED = 8
SETTLED = 1e-4  # of the logarithm, after which the next one would change nothing
_MAX_ITERATIONS = 12
_MAX_STEP, _FARTHEST = 0.25, 3.0
_NOWHERE: Array = np.zeros(3)


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
    """Of frames, over the noise; zero for markers not seen."""

    residual: Array  # (f, 2 n)
    common: Array  # (f, 2 n, s), derivatives by what is shared
    inverse: Array  # (f, 6, 2 n), of the derivatives by the poses
    left: Array  # what the poses leave of the residuals
    rest: Array  # and of the derivatives

    def steps(self, step: Array) -> Array:
        """Of the poses, (f, 6), with a step of what is shared (s,)."""
        return np.asarray((self.inverse @ (self.residual - self.common @ step)[..., None])[..., 0])


@dataclass(frozen=True, eq=False)
class Estimate:
    """What lights say of the focal length."""

    shift: float  # logarithm of the focal length over that of the calibration
    deviation: float  # of it (1 sigma)
    offsets: Array  # (n, 3), of the markers from where the rig's file puts them, m
    reduced_chi2: float  # squared residuals over their variances per degree of freedom: about 1

    @property
    def fits(self) -> bool:
        """Whether some focal length explains the lights."""
        return self.reduced_chi2 <= MAX_REDUCED_CHI2

    @property
    def contradicts(self) -> bool:
        """Whether it is another one than that of the calibration."""
        limit = max(CONTRADICTION * self.deviation, MIN_CONTRADICTION)
        return self.fits and abs(self.shift) > limit

    def of_camera(self, camera: CameraModel) -> CameraModel:
        """The calibration with the focal length that the lights show."""
        return _with_focal(camera, self.shift)

    def of_rig(self, rig: MarkerRig) -> MarkerRig:
        """The rig with its markers where the lights show them."""
        return rig.moved(rig.positions + self.offsets)


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
        self._middle = self._points.mean(axis=0)
        self._size = float(np.linalg.norm(self._points - self._middle, axis=1).max()) or 1.0
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

        Of many frames the newest are kept. Not taken (False) are frames with too few lights, and
        such as do not fit the others, unless they keep coming: a light may be another one.
        """
        if len(labels) < MIN_LIGHTS:
            return False
        seen = np.array(pixels, np.float64).reshape(-1, 2)
        frame = _Frame(np.array(labels, np.intp), seen, np.eye(3), np.zeros(3))
        model = self._model(self._value)
        poses = frame.view(*model).closed_forms()
        if not poses:
            return False
        frame = frame._replace(rotation=poses[0][0], translation=poses[0][1])
        if not frame.rotation[2].dot(self._middle) + frame.translation[2] > 0.0:
            return False
        if self._is_odd(frame, model) and self._refused < MAX_REFUSED:
            self._refused += 1
            return False
        self._refused = 0
        self._frames = [*self._frames[1 - MAX_FRAMES :], frame]
        self._estimate = None
        return True

    def typical_chi2(self, estimate: Estimate) -> float:
        """The frames' squared residuals over their variances per degree of freedom, the median."""
        model = self._model(np.concatenate(([estimate.shift], np.ravel(estimate.offsets))))
        found = []
        for frame in self._frames:
            solution = frame.view(*model).refine(frame.rotation, frame.translation)
            squares = math.inf if solution is None else solution.squares
            found.append(squares / NOISE**2 / (2 * len(frame.labels) - 6))
        return float(np.median(found))

    def _is_odd(self, frame: _Frame, model: tuple[CameraModel, Array]) -> bool:
        estimated = self.estimate()
        if len(self._frames) < KNOWN_BY or estimated is None or not estimated.fits:
            return False
        try:
            first = self._linearize([frame], *model)
            moved = frame.moved(first.steps(np.zeros(len(self._value)))[0])
            equations = self._linearize([moved], *model)
        except np.linalg.LinAlgError:
            return False
        left, rest = equations.left[0], equations.rest[0]
        # What no pose explains, over what camera and rig may still turn out to be.
        spread = np.eye(len(left)) + rest @ self._covariance @ rest.T
        freedom = max(2 * len(frame.labels) - 6, 1)
        reduced_chi2 = float(left @ np.linalg.solve(spread, left)) / freedom
        return reduced_chi2 > max(MAX_ODD, ODD * estimated.reduced_chi2)

    def estimate(self) -> Estimate | None:
        """What the frames say; None where there are none, or nothing follows from them."""
        if self._estimate is None and self._frames:
            try:
                for rig_error in RIG_ERRORS:
                    self._estimate = self._adjust(rig_error)
                    if self._estimate.fits:
                        break
            except np.linalg.LinAlgError:
                self._estimate = None
        return self._estimate

    def _model(self, value: Array) -> tuple[CameraModel, Array]:
        """Camera and markers by what is shared."""
        return _with_focal(self._camera, float(value[0])), self._points + value[1:].reshape(-1, 3)

    def _adjust(self, rig_error: float) -> Estimate:
        """Gauss-Newton steps in which the poses are eliminated; a LinAlgError where that fails."""
        deviations = np.full(len(self._value), rig_error * self._size)
        deviations[0] = FOCAL_ERROR
        weight = deviations**-2
        value, frames = self._value, self._frames
        for _ in range(_MAX_ITERATIONS):
            equations = self._linearize(frames, *self._model(value))
            rest, left = equations.rest.reshape(-1, len(value)), equations.left.ravel()
            normal: Array = np.diag(weight) + rest.T @ rest
            towards = rest.T @ left - weight * value
            squares = float(np.square(equations.residual).sum())
            squares += float((weight * value**2)[1:].sum())
            covariance = np.asarray(np.linalg.inv(normal), np.float64)
            step = covariance @ towards
            step *= min(1.0, _MAX_STEP / max(abs(float(step[0])), 1e-9))
            value = value + step
            steps = equations.steps(step)
            frames = [frame.moved(own) for frame, own in zip(frames, steps, strict=True)]
            if abs(float(step[0])) < SETTLED:
                break
        if not covariance[0, 0] > 0:
            raise np.linalg.LinAlgError('nothing follows for the focal length')
        freedom = sum(2 * len(frame.labels) - 6 for frame in frames) - 1
        reduced_chi2 = squares / max(freedom, 1)
        deviation = math.sqrt(float(covariance[0, 0])) * max(1.0, math.sqrt(reduced_chi2))
        offsets = value[1:].reshape(-1, 3)
        estimated = Estimate(float(value[0]), deviation, offsets, reduced_chi2)
        if estimated.fits:
            # The next frames begin here.
            self._value, self._covariance, self._frames = value, covariance, frames
        return estimated

    def _linearize(
        self, frames: Sequence[_Frame], camera: CameraModel, points: Array
    ) -> _Equations:
        """All frames at once; a LinAlgError where nothing follows from them."""
        count, markers = len(frames), np.arange(len(points))
        pixels = np.zeros((count, len(points), 2))
        is_seen = np.zeros((count, len(points)), np.bool_)
        for row, frame in enumerate(frames):
            pixels[row, frame.labels], is_seen[row, frame.labels] = frame.pixels, True
        rotations = np.array([frame.rotation for frame in frames])
        arms = points @ rotations.transpose(0, 2, 1)
        places = arms + np.array([frame.translation for frame in frames])[:, None]
        around = places.reshape(-1, 3), _NOWHERE, _NOWHERE
        seen, slopes, _ = camera.project_with_jacobians(*around)
        seen, by_place = seen.reshape(pixels.shape), slopes[:, 3:].reshape(*pixels.shape, 3)
        # By small turns about the optical axes, and by the translation.
        x, y, z = arms[..., None].transpose(2, 0, 1, 3)
        dx, dy, dz = np.moveaxis(by_place, -1, 0)
        own = np.stack((y * dz - z * dy, z * dx - x * dz, x * dy - y * dx, dx, dy, dz), axis=-1)
        common = np.zeros((*pixels.shape, 1 + points.size))
        # A pixel lies as far from the principal point as the focal length is long.
        common[..., 0] = seen - camera.matrix[:2, 2]
        by_points = common[..., 1:].reshape(*pixels.shape, len(points), 3)
        by_points[:, markers, :, markers] = (by_place @ rotations[:, None]).transpose(1, 0, 2, 3)

        def rows(one: Array) -> Array:
            seen_ones = np.where(is_seen[(..., *[None] * (one.ndim - 2))], one / NOISE, 0.0)
            return seen_ones.reshape(count, 2 * len(points), *one.shape[3:])

        residual, own, common = rows(pixels - seen), rows(own), rows(common)
        if not (np.isfinite(common).all() and np.isfinite(own).all()):
            raise np.linalg.LinAlgError('a light is seen nowhere')
        transposed = own.transpose(0, 2, 1)
        inverse = np.asarray(np.linalg.solve(transposed @ own, transposed), np.float64)
        left = residual - (own @ (inverse @ residual[..., None]))[..., 0]
        return _Equations(residual, common, inverse, left, common - own @ (inverse @ common))


Frame = tuple[Image, float, MarkerTrackerParameters]

AGREED = 3  # Frames that must give another focal length before names are given by it
ANOTHER = 0.006  # Part by which it must differ from the one in use, or half a deviation; and
ANOTHER_RIG = 0.001  # in parts of its size what the rig is taken for (root mean square)
SAME_LIGHT = 1.0  # px, between the places of a light as two trackers place it
NEEDED = 0.25
"""Squared residuals over their variances per degree of freedom up to which those given will do."""
FIRST_STEP, MAX_STEP = 0.1, 8.0
"""s between two frames that are taken for the estimate: while it is young, and when settled."""
MIN_MARKERS = 5
"""Markers of a rig that can be named without a calibration, and then give one; four fit any."""
MAX_OTHERS = 3
"""Lights beside the rig's with which they are tried without the calibration, which takes time."""
TRIED, RESTED = 30, 5
"""Frames at the start in each of which the lights are named without the calibration as well;
afterwards in one of so many, as they may not be the rig's."""
UNEXPLAINED = 10
"""Frames in which all lights have names without the calibration, and no focal length explains them,
after which a plain lens is tried: the calibration may be of other images, as of larger ones."""


class CalibratedTracker:
    """Follows a rig before a calibrated camera, even if the calibration is wrong.

    Lights with names determine the focal length (see `SelfCalibration`). Where that contradicts
    the calibration, the names go on with what the lights show, and every result says so. Where the
    calibration is so wrong that no names are found, they are looked for without it, and with a
    plain lens instead.
    """

    def __init__(self, rig: MarkerRig, upright: float = 0.0) -> None:
        """Prepare for the first frame; a level body has the roll ``upright`` (rad)."""
        self._rig, self._upright = rig, upright
        self._extent = float(np.linalg.norm(rig.positions - rig.middle, axis=1).max())
        self._camera: CameraModel | None = None
        self._begin((0, 0))

    def set_camera(self, camera: CameraModel | None) -> None:
        """Take a calibration, or that there is none; what was known under another one is lost."""
        if camera != self._camera:
            self._camera = camera
            self._begin((0, 0))

    def _begin(self, size: tuple[int, int]) -> None:
        self._size = size
        self._tracker = IdentityTracker(self._rig, self._camera, upright=self._upright)
        # Whose focal length the lights may show to be another one: that given, or a plain one.
        self._lens = self._camera
        self._check: SelfCalibration | None = None
        if self._camera is not None and Lens(size, self._camera).focal is not None:
            self._check = SelfCalibration(self._rig.positions, self._camera)
        # One without the calibration, while nothing has been named with it.
        self._trial: IdentityTracker | None = None
        self._has_named = False
        self._frames = self._differing = self._named_without = 0
        # What is in use; at first camera and rig as they are given.
        self._used = self._given = Estimate(0.0, 0.0, np.zeros((len(self._rig.names), 3)), 0.0)
        self._doubt = ''
        self._step, self._next = FIRST_STEP, -math.inf

    def track(self, image: Image, time: float, parameters: MarkerTrackerParameters) -> MarkerResult:
        """Find the body's markers in the next frame, of a later time (s) than the last one."""
        size = image.width, image.height
        if size != self._size:
            self._begin(size)
        frame = image, time, parameters
        result = self._tracker.track(*frame)
        if self._check is None:
            return result
        if result.named:
            self._has_named, self._trial = True, None
            if time >= self._next:
                result = self._learn(self._check, result, frame)
        elif not self._has_named:
            result = self._name_without(self._check, result, frame)
        return replace(result, camera_doubt=self._doubt) if self._doubt else result

    def _learn(self, check: SelfCalibration, result: MarkerResult, frame: Frame) -> MarkerResult:
        """Hold a frame's named lights against the calibration."""
        time, count = frame[1], len(result.markers)
        seen = [int(marker.label) for marker in result.named]
        taken = check.add(seen, _places(result)[seen])
        estimate = check.estimate()
        if not taken or estimate is None or not estimate.fits:
            self._next = time + 2.0 * FIRST_STEP
            return result
        self._report(estimate)
        differing = self._differs(check, estimate)
        self._differing = self._differing + 1 if differing else 0
        self._step = FIRST_STEP if differing else min(2.0 * self._step, MAX_STEP)
        self._next = time + self._step
        # What one frame alone shows may be another light.
        if self._differing < 2 or len(check) < AGREED or len(seen) < count:
            return result
        again = self._with_learnt(estimate, frame, _places(result))
        return again or result

    def _differs(self, check: SelfCalibration, estimate: Estimate) -> bool:
        """Whether camera and rig are others than those in use."""
        used = self._used
        apart = float(np.sqrt(np.square(estimate.offsets - used.offsets).sum(axis=-1).mean()))
        alike = abs(used.shift - estimate.shift) <= max(ANOTHER, 0.5 * estimate.deviation)
        if alike and apart <= ANOTHER_RIG * self._extent:
            return False
        if used is not self._given:
            return True
        # Most frames must show that they are not what they are said to be: in a few a light may be
        # another one.
        return check.typical_chi2(used) > max(NEEDED, 2.0 * check.typical_chi2(estimate))

    def _name_without(
        self, check: SelfCalibration, result: MarkerResult, frame: Frame
    ) -> MarkerResult:
        """Name the lights without the calibration where nothing was found with it."""
        self._frames += 1
        count = len(self._rig.names)
        if count < MIN_MARKERS or not count <= self._tracker.lights <= count + MAX_OTHERS:
            return result
        if self._frames > TRIED and self._frames % RESTED:
            return result
        self._trial = self._trial or IdentityTracker(self._rig, upright=self._upright)
        named = self._trial.track(*frame)
        if len(named.named) < count:
            return result
        self._named_without += 1
        check.add(range(count), _places(named))
        estimate = check.estimate()
        if estimate is not None and estimate.fits and len(check) >= AGREED:
            again = self._with_learnt(estimate, frame)
            if again is not None:
                self._has_named, self._trial = True, None
                self._report(estimate)
                self._next = frame[1] + FIRST_STEP
                return again
        if self._named_without == UNEXPLAINED:
            (width, height), focal = self._size, float(self._size[0])
            k = focal, 0.0, 0.5 * (width - 1), 0.0, focal, 0.5 * (height - 1), 0.0, 0.0, 1.0
            self._lens = CameraModel(width, height, k)
            self._check = SelfCalibration(self._rig.positions, self._lens)
        return result

    def _with_learnt(
        self, estimate: Estimate, frame: Frame, places: Array | None = None
    ) -> MarkerResult | None:
        """Go on with what the lights show, if all get names by it, in the same places (n, 2) px."""
        assert self._lens is not None
        rig, camera = estimate.of_rig(self._rig), estimate.of_camera(self._lens)
        tracker = IdentityTracker(rig, camera, self._tracker.lamps, self._upright)
        again = tracker.track(*frame)
        if len(again.named) < len(again.markers):
            return None
        if places is not None and (np.hypot(*(_places(again) - places).T) >= SAME_LIGHT).any():
            return None
        self._tracker, self._used, self._differing = tracker, estimate, 0
        return again

    def _report(self, estimate: Estimate) -> None:
        """Say what contradicts the calibration."""
        self._doubt = ''
        assert self._lens is not None
        ours = math.sqrt(self._lens.matrix[0, 0] * self._lens.matrix[1, 1])
        shown = math.exp(estimate.shift) * ours
        if self._lens is not self._camera:
            self._doubt = (
                f'camera_info is not of these images, of which the lights show a focal length of '
                f'{shown:.0f} px: is its K of another size?'
            )
        elif estimate.contradicts:
            self._doubt = (
                f'camera_info says a focal length of {ours:.0f} px, the lights show {shown:.0f} px '
                '(if the rig is measured right)'
            )


def _places(result: MarkerResult) -> Array:
    """(n, 2), px."""
    return np.array([(marker.x, marker.y) for marker in result.markers])
