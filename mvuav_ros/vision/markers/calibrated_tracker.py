"""Names that do not hang on the calibration: where the lights contradict it, theirs is used."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.parameters.marker_tracker import MarkerTrackerParameters
from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.image import Image
from mvuav_ros.vision.markers.identity_tracker import IdentityTracker
from mvuav_ros.vision.markers.lights import Lens
from mvuav_ros.vision.markers.marker_results import MarkerResult
from mvuav_ros.vision.rig import MarkerRig
from mvuav_ros.vision.self_calibration import Estimate, SelfCalibration

Array = NDArray[np.float64]
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


class CalibratedTracker:
    """Follows a rig before a calibrated camera, even if the calibration is wrong.

    Lights with names determine the focal length (see `SelfCalibration`). Where that contradicts
    the calibration, the names go on with what the lights show, and every result says so. Where the
    calibration is so wrong that no names are found, they are looked for without it.
    """

    def __init__(self, rig: MarkerRig) -> None:
        self._rig = rig
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
        self._tracker = IdentityTracker(self._rig, self._camera)
        self._check: SelfCalibration | None = None
        if self._camera is not None and Lens(size, self._camera).focal is not None:
            self._check = SelfCalibration(self._rig.positions, self._camera)
        # One without the calibration, while nothing has been named with it.
        self._trial: IdentityTracker | None = None
        self._has_named = False
        self._frames = self._differing = 0
        # Logarithm of the focal length in use over the calibration's, and the markers' offsets, m.
        self._learnt: tuple[float, Array] = 0.0, np.zeros((len(self._rig.names), 3))
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
        shift, offsets = self._learnt
        apart = float(np.sqrt(np.square(estimate.offsets - offsets).sum(axis=-1).mean()))
        alike = abs(shift - estimate.shift) <= max(ANOTHER, 0.5 * estimate.deviation)
        if alike and apart <= ANOTHER_RIG * self._extent:
            return False
        if shift or offsets.any():
            return True
        # Most frames must show that they are not what they are said to be: in a few a light may be
        # another one.
        usual = float(np.median(check.reduced_chi2s(shift, offsets)))
        better = float(np.median(check.reduced_chi2s(estimate.shift, estimate.offsets)))
        return usual > max(NEEDED, 2.0 * better)

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
        self._trial = self._trial or IdentityTracker(self._rig)
        named = self._trial.track(*frame)
        if len(named.named) < count:
            return result
        check.add(range(count), _places(named))
        estimate = check.estimate()
        if estimate is None or not estimate.fits or len(check) < AGREED:
            return result
        again = self._with_learnt(estimate, frame)
        if again is None:
            return result
        self._has_named, self._trial = True, None
        self._report(estimate)
        self._next = frame[1] + FIRST_STEP
        return again

    def _with_learnt(
        self, estimate: Estimate, frame: Frame, places: Array | None = None
    ) -> MarkerResult | None:
        """Go on with what the lights show, if all get names by it, in the same places (n, 2) px."""
        assert self._camera is not None
        rig, camera = estimate.of_rig(self._rig), estimate.of_camera(self._camera)
        tracker = IdentityTracker(rig, camera, self._tracker.lamps)
        again = tracker.track(*frame)
        if len(again.named) < len(again.markers):
            return None
        if places is not None and (np.hypot(*(_places(again) - places).T) >= SAME_LIGHT).any():
            return None
        self._tracker, self._learnt = tracker, (estimate.shift, estimate.offsets)
        self._differing = 0
        return again

    def _report(self, estimate: Estimate) -> None:
        """Say what contradicts the calibration."""
        self._doubt = ''
        if estimate.contradicts and self._camera is not None:
            ours = math.sqrt(self._camera.matrix[0, 0] * self._camera.matrix[1, 1])
            shown = math.exp(estimate.shift) * ours
            self._doubt = (
                f'camera_info says a focal length of {ours:.0f} px, the lights show {shown:.0f} px '
                '(if the rig is measured right)'
            )


def _places(result: MarkerResult) -> Array:
    """(n, 2), px."""
    return np.array([(marker.x, marker.y) for marker in result.markers])
