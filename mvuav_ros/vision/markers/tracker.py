"""The marker programs behind one call per frame."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mvuav_ros.parameters.marker_tracker import MarkerTrackerParameters
from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.image import Image
from mvuav_ros.vision.markers.detection import detect, detect_any
from mvuav_ros.vision.markers.identity import IdentityTracker
from mvuav_ros.vision.markers.results import MarkerResult
from mvuav_ros.vision.markers.thesis_tracker import ThesisTracker
from mvuav_ros.vision.rig import TANKER_747, MarkerRig

if TYPE_CHECKING:
    from mvuav_ros.vision.markers.multi_object import MultiObjectTracker


class MarkerTracker:
    """Finds the markers in one frame after the other, in the mode that the parameters name."""

    def __init__(
        self,
        parameters: MarkerTrackerParameters | None = None,
        rig: MarkerRig = TANKER_747,
    ) -> None:
        """Prepare for the first frame.

        Args:
            parameters: the defaults if None.
            rig: the body whose markers are named.
        """
        self.parameters = parameters or MarkerTrackerParameters()
        self.rig = rig
        self._camera: CameraModel | None = None
        self.reset()

    def set_camera(self, camera: CameraModel | None) -> None:
        """Name markers by the undistorted points of a calibrated camera; None: by the pixels."""
        self._camera = camera
        if isinstance(self._tracker, IdentityTracker):
            self._tracker.set_camera(camera)

    def configure(self, parameters: MarkerTrackerParameters) -> None:
        """Use other parameters from the next frame on.

        A change of mode starts afresh, and so does one between the thesis's tracking and ours.
        """
        before, self.parameters = self.parameters, parameters
        if _program(parameters) != _program(before):
            self.reset()

    def reset(self) -> None:
        """Forget all earlier frames."""
        self._tracker = self._make_tracker()
        self._first_stamp_ns: int | None = None
        self._last_stamp_ns: int | None = None

    def _make_tracker(self) -> ThesisTracker | IdentityTracker | MultiObjectTracker:
        if self.parameters.mode == 'track_any':
            # It imports SciPy's optimizers, which took more than half of a node's start.
            from mvuav_ros.vision.markers.multi_object import MultiObjectTracker

            return MultiObjectTracker()
        if self.parameters.prediction == 'kalman':
            tracker = IdentityTracker(self.rig)
            tracker.set_camera(self._camera)
            return tracker
        return ThesisTracker()

    def process(self, image: Image, stamp_ns: int) -> MarkerResult:
        """Find the markers in the next frame.

        Args:
            image: the frame.
            stamp_ns: its time, ns.

        Raises:
            ValueError: in ``track`` and ``track_any``, the stamp is not later than the last one
                (see `reset`).
            ImageError: the image does not convert to grey.
        """
        if self.parameters.mode == 'detect':
            return detect(image, self.parameters)
        if self.parameters.mode == 'detect_any':
            return detect_any(image, self.parameters)
        if self._last_stamp_ns is not None and stamp_ns <= self._last_stamp_ns:
            raise ValueError(f'stamp {stamp_ns} ns is not later than {self._last_stamp_ns} ns')
        self._last_stamp_ns = stamp_ns
        if self._first_stamp_ns is None:
            self._first_stamp_ns = stamp_ns
        # Since the first frame, because seconds since 1970 leave a float 0.2 µs of resolution.
        time = (stamp_ns - self._first_stamp_ns) * 1e-9
        return self._tracker.track(image, time, self.parameters)


def _program(parameters: MarkerTrackerParameters) -> tuple[str, bool]:
    return parameters.mode, parameters.prediction == 'kalman'
