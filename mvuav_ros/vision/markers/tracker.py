"""The marker programs behind one call per frame, and the pose that follows from what they find."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.parameters.declaration import ParameterError
from mvuav_ros.parameters.marker_tracker import MarkerTrackerParameters
from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.frame_clock import FrameClock
from mvuav_ros.vision.frames import given_rotation, rpy
from mvuav_ros.vision.image import Image, as_image
from mvuav_ros.vision.markers.calibrated_tracker import CalibratedTracker
from mvuav_ros.vision.markers.lights import brightness_problem
from mvuav_ros.vision.markers.marker_results import (
    TANKER_NAMES,
    Label,
    MarkerResult,
    MarkerState,
    is_cut,
    named_places,
)
from mvuav_ros.vision.markers.thesis_tracker import ThesisTracker, detect, detect_any
from mvuav_ros.vision.point_operations import Pixels, full_scale, threshold
from mvuav_ros.vision.pose import Pose, PoseEstimator
from mvuav_ros.vision.reprojection import MIN_MARKERS
from mvuav_ros.vision.rig import TANKER_747, MarkerRig, RigError, RigOrFile, load_rig
from mvuav_ros.vision.rig_examination import examine

if TYPE_CHECKING:
    from mvuav_ros.vision.markers.multi_object import MultiObjectTracker

    Tracker = ThesisTracker | CalibratedTracker | MultiObjectTracker

AUTO, INTENSITY, BRIGHTEST = 'auto', 'intensity', 'brightest'  # Channels of a colour image
WITHOUT_MEMORY = ('detect', 'detect_any')  # Modes that take each frame by itself
_SAME_ROLL = 1e-6  # rad, by which a mount may differ by rounding
_LONGEST_GAP_NS = 3600 * 10**9  # From one frame to the next, after which a flight begins anew


class MarkerTracker:
    """Finds the markers in one frame after the other, in the mode that the parameters name.

    It is what the node marker_tracker runs. Positions are px on the frame, (0, 0) the centre of
    the top-left pixel; roll is in radians, right wing down positive. Not safe for calls from
    several threads at once.

    Examples:
        >>> import cv2, numpy as np
        >>> from mvuav_ros import Image, MarkerTracker
        >>> lights = [(200, 240), (280, 260), (320, 200), (360, 260), (440, 240)]
        >>> frame = np.zeros((480, 640), np.uint8)
        >>> for light in lights:
        ...     _ = cv2.circle(frame, light, 4, 255, -1)
        >>> tracker = MarkerTracker()
        >>> for number in range(3):
        ...     result = tracker.process(Image(frame, 'mono8'), stamp_ns=number * 33_000_000)
        >>> [(round(marker.x), round(marker.y)) for marker in result.markers] == lights
        True
        >>> f'{result.roll:.3f} rad'
        '0.000 rad'
    """

    def __init__(
        self, parameters: MarkerTrackerParameters | None = None, rig: RigOrFile | None = None
    ) -> None:
        """Prepare for the first frame.

        Args:
            parameters: the defaults if None.
            rig: the body, or its YAML file; if None that of the parameter ``layout``.

        Raises:
            RigError: the file of ``rig`` cannot be used.
            ParameterError: that of ``layout`` cannot be used, there are too few or too many
                markers, or names or pose are ambiguous and ``allow_ambiguous`` is not set.
        """
        self.parameters = MarkerTrackerParameters.given(parameters)
        self.rig = rig_of(self.parameters) if rig is None else MarkerRig.given(rig)
        name = self.parameters.layout or self.rig.name
        if not 2 <= len(self.rig.names) <= Label.UNLABELLED:
            raise ParameterError('layout', f'{name}: tracking needs 2 to 255 markers')
        self.doubts = examine(self.rig)
        if self.doubts and not self.parameters.allow_ambiguous:
            raise ParameterError('layout', f'{name}: {self.doubts[0]} (see allow_ambiguous)')
        self._camera: CameraModel | None = None
        self._upright = _upright(self.parameters)
        self.reset()

    def set_camera(self, camera: CameraModel | None) -> None:
        """Name markers by the undistorted points of a calibrated camera; None: by the pixels.

        What was known of the markers under another calibration is forgotten. A calibration of
        another image size is not used.

        Raises:
            TypeError: it is no `CameraModel`.
        """
        self._camera = None if camera is None else CameraModel.given(camera)
        for tracker in (self._tracker, self._brighter):
            if isinstance(tracker, CalibratedTracker):
                tracker.set_camera(camera)

    def configure(self, parameters: MarkerTrackerParameters) -> None:
        """Use other parameters from the next frame on.

        A change of mode starts afresh, and so does one between the thesis's tracking and ours, and
        another mount of the camera.

        Raises:
            ParameterError: ``layout`` is another one; that takes another tracker.
        """
        parameters = MarkerTrackerParameters.given(parameters)
        if parameters.layout != self.parameters.layout:
            raise ParameterError('layout', 'cannot be changed; make another MarkerTracker')
        both = self.parameters, parameters
        before, after = ((p.mode, p.prediction == 'kalman', _upright(p)) for p in both)
        self.parameters = parameters
        if before[2] != after[2]:
            self._upright = after[2]
        if before != after:
            self.reset()

    def set_mount(self, mount: NDArray[np.float64]) -> None:
        """Use another mount of the camera from the next frame on than ``camera_mount_rpy_deg``.

        It is (3, 3), the camera's axes (x forward, y left, z up) in those of the vehicle, which are
        named likewise. After one of another roll all earlier frames are forgotten.

        Raises:
            ValueError: it is no rotation.
        """
        upright = -rpy(given_rotation(mount))[0]
        if abs(upright - self._upright) > _SAME_ROLL:
            self._upright = upright
            self.reset()

    def reset(self) -> None:
        """Forget all earlier frames."""
        self._channel = INTENSITY
        self._has_found = False
        self._tracker = self._make_tracker()
        # For the brightest channel of coloured lights, until either has found anything.
        self._brighter: Tracker | None = None
        self._clock = FrameClock()

    def _make_tracker(self) -> Tracker:
        if self.parameters.mode == 'track_any':
            # It imports SciPy's optimizers, which took more than half of a node's start.
            from mvuav_ros.vision.markers.multi_object import MultiObjectTracker

            return MultiObjectTracker()
        if self.parameters.prediction == 'kalman':
            tracker = CalibratedTracker(self.rig, self._upright)
            tracker.set_camera(self._camera)
            return tracker
        return ThesisTracker()

    def process(self, image: Image | Pixels, stamp_ns: int) -> MarkerResult:
        """Find the markers in the next frame.

        Args:
            image: the frame: an `Image`, or (height, width) grey or (height, width, 3) colour,
                blue first, uint8 or uint16.
            stamp_ns: its time, whole ns. The status says if it is less than 1 µs after the last
                frame's, as numbers of frames, s and ms are.

        Raises:
            TypeError: in ``track`` and ``track_any``, the stamp is no whole number.
            ValueError: in these modes, the stamp is not later than the last one (see `reset`).
            ImageError: it is no such image, or does not convert to grey.
        """
        image = as_image(image)
        time = 0.0 if self.parameters.mode in WITHOUT_MEMORY else self._time_of(stamp_ns)
        return self._explained(image, self._result(image, time)).remarked(self._clock.remark)

    def _result(self, image: Image, time: float) -> MarkerResult:
        if self.parameters.channel != AUTO:
            return self._find(image.seen_in(self.parameters.channel), time, self._tracker)
        has_memory = self.parameters.mode not in WITHOUT_MEMORY
        result = self._find(image.seen_in(self._channel), time, self._tracker)
        if image.is_gray or self._has_found or _finds(result):
            self._has_found = has_memory and (self._has_found or _finds(result))
            return result
        # Only before the first marker is found: a tracker that has lost its markers knows more of
        # them than a new one, and lights do not change their colour.
        if self._brighter is None:
            self._brighter = self._make_tracker()
        other = self._find(image.seen_in(BRIGHTEST), time, self._brighter)
        if not _finds(other):
            return result
        if has_memory:
            self._tracker, self._channel, self._has_found = self._brighter, BRIGHTEST, True
        return other

    def _find(self, image: Image, time: float, tracker: Tracker) -> MarkerResult:
        if self.parameters.mode == 'detect':
            return self._of_rig(detect(image, self.parameters))
        if self.parameters.mode == 'detect_any':
            return detect_any(image, self.parameters)
        found = tracker.track(image, time, self.parameters)
        return self._of_rig(found) if isinstance(tracker, ThesisTracker) else found

    def _of_rig(self, result: MarkerResult) -> MarkerResult:
        """What the thesis's programs have found, who name the tanker's markers alone."""
        if self.rig.names == TANKER_NAMES:
            return result
        markers = tuple(each._replace(label=Label.UNLABELLED) for each in result.markers)
        remark = f'the markers of {self.rig.name} have no names: mode track with kalman gives them'
        nameless = replace(result, markers=markers, roll=math.nan, has_wings=False)
        return nameless.remarked(remark)

    def _explained(self, image: Image, result: MarkerResult) -> MarkerResult:
        """With a remark on lights cut off, on glare, and on the dark, as of 12 bits in 16."""
        size = image.width, image.height
        cut = [self.rig.names[each.label] for each in result.named if is_cut(each, size)]
        if cut:
            return result.remarked(f'cut off by the border of the image: {", ".join(cut)}')
        if any(marker.state is not MarkerState.LOST for marker in result.markers):
            return result
        channel = self.parameters.channel
        gray = image.seen_in(self._channel if channel == AUTO else channel).gray()
        brightest = int(gray.max(initial=0)) / full_scale(gray)
        if brightest > self.parameters.threshold:
            mask = threshold(gray, self.parameters.threshold)
            return result.remarked(brightness_problem(mask))
        # In two parts, as replay repeats those alone that are the same in every frame.
        return result.remarked(f'no pixel is above the threshold; the brightest is {brightest:.2g}')

    def _time_of(self, stamp_ns: int) -> float:
        """Seconds since the first frame."""
        stamp_ns = self._clock.take(stamp_ns)
        if self._clock.gap_ns == 0:
            raise ValueError(f'stamp {stamp_ns} ns is not later than the last one')
        if (self._clock.gap_ns or 0) > _LONGEST_GAP_NS:
            # Nothing that was known holds, and seconds since then would be too coarse.
            self.reset()
            self._clock.take(stamp_ns)
        return self._clock.elapsed


class PosedTracker:
    """A `MarkerTracker`, and the pose that follows from its results by a calibration."""

    def __init__(
        self, parameters: MarkerTrackerParameters | None = None, rig: RigOrFile | None = None
    ) -> None:
        self.tracker = MarkerTracker(parameters, rig)
        self.poses = PoseEstimator(self.tracker.rig)
        self.camera: CameraModel | None = None
        # Why the newest pose is none although there is a calibration and enough markers are seen.
        self.problem = ''
        # Labels and places (n, 2), px, of the markers that the newest pose is of.
        self.seen: tuple[list[int], NDArray[np.float64]] = [], np.empty((0, 2))

    def configure(self, parameters: MarkerTrackerParameters) -> None:
        """See `MarkerTracker.configure`."""
        self.tracker.configure(parameters)
        self._share_camera()

    def set_camera(self, camera: CameraModel | None) -> None:
        """Use another calibration from the next frame on; it may be an unusable one."""
        if camera is not self.camera and camera != self.camera:
            self.camera = camera
            self.poses.reset()
            self._share_camera()

    def _share_camera(self) -> None:
        # Without a pose nobody waits for a calibration, so names must not depend on one.
        self.tracker.set_camera(self.camera if self.tracker.parameters.has_pose else None)

    def reset(self) -> None:
        """Forget all earlier frames."""
        self.tracker.reset()
        self.poses.reset()

    def pose(self, image: Image, result: MarkerResult, stamp_ns: int) -> Pose | None:
        """The pose in the frame that the tracker has just processed, if there is one."""
        self.problem = ''
        self.seen = [], np.empty((0, 2))
        if self.camera is None or not self.tracker.parameters.has_pose:
            return None
        size = image.width, image.height
        doubt = self.camera.objection(*size) or result.camera_doubt
        if not doubt:
            self.seen = named_places(result, size)
            pose = self.poses.estimate(self.camera, *self.seen, stamp_ns)
            if pose is not None or len(self.seen[0]) < MIN_MARKERS:
                return pose
            doubt = self.poses.reason
        self.problem = f'no pose: {doubt}'
        return None


def rig_of(parameters: MarkerTrackerParameters) -> MarkerRig:
    """The rig that the parameter ``layout`` names.

    Raises:
        ParameterError: its file cannot be used.
    """
    if not parameters.layout:
        return TANKER_747
    try:
        return load_rig(parameters.layout)
    except RigError as error:
        raise ParameterError('layout', str(error)) from error


def _upright(parameters: MarkerTrackerParameters) -> float:
    """The roll of a level body before the camera as it is mounted, rad."""
    return -math.radians(parameters.camera_mount_rpy_deg[0])


def _finds(result: MarkerResult) -> bool:
    return any(marker.state is MarkerState.DETECTED for marker in result.markers)
