"""Markers and the pose of their rig, the same for nodes, replay and programs; no ROS."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.parameters.marker_tracker import MarkerTrackerParameters
from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.image import Image
from mvuav_ros.vision.markers.marker_results import MarkerResult, named_places
from mvuav_ros.vision.markers.tracker import MarkerTracker
from mvuav_ros.vision.pose import Pose, PoseEstimator
from mvuav_ros.vision.reprojection import MIN_MARKERS
from mvuav_ros.vision.rig import RigOrFile


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
