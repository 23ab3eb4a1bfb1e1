"""The work of ``marker_tracker``."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from functools import lru_cache, partial

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PointStamped, PoseWithCovarianceStamped, Vector3Stamped
from numpy.typing import NDArray
from sensor_msgs.msg import PointCloud2

from mvuav_ros.messages import detections, poses
from mvuav_ros.messages.images import Frame, serialize_image
from mvuav_ros.messages.marker_messages import (
    encode_marker,
    encode_markers,
    encode_rpy,
    refused_names,
)
from mvuav_ros.messages.poses import encode_integrity
from mvuav_ros.parameters.declaration import ParameterError
from mvuav_ros.parameters.marker_tracker import MarkerTrackerParameters
from mvuav_ros.processing.processor import Chart, Output, PanelPage, Processor
from mvuav_ros.vision.camera import CalibrationError, CameraModel
from mvuav_ros.vision.image import Image
from mvuav_ros.vision.integrity import IntegrityBudget, ProtectionLevels, protection_levels
from mvuav_ros.vision.markers.drawing import draw_markers, draw_pose
from mvuav_ros.vision.markers.marker_results import (
    TANKER_NAMES,
    Label,
    MarkerResult,
    MarkerState,
    named_places,
)
from mvuav_ros.vision.markers.tracker import MarkerTracker, rig_of
from mvuav_ros.vision.pose import Pose, PoseEstimator
from mvuav_ros.vision.reprojection import MIN_MARKERS
from mvuav_ros.vision.rig import MarkerRig

_TOPICS = {
    'markers': PointCloud2,
    'rpy': Vector3Stamped,
    'pose': PoseWithCovarianceStamped,
    'vision_pose': PoseWithCovarianceStamped,
    'integrity': DiagnosticArray,
}


class MarkerTrackerProcessor(Processor):
    """Frames to labelled points, roll and pose.

    Attributes:
        topics: with one for each marker of the rig; they are those of the parameters given at
            the construction or by the first `configure`.
    """

    name = 'marker_tracker'
    parameters_type = MarkerTrackerParameters
    topics = {
        **_TOPICS,
        **dict.fromkeys((f'marker/{name}' for name in TANKER_NAMES), PointStamped),
    }
    debug_topics = ('debug_image',)
    descriptions = {
        'markers': 'All markers, a row for each; see the fields below.',
        'rpy': (
            'x: roll (rad), right wing down positive; NaN while a wing is lost. y, z: pitch and '
            'yaw of the pose (rad), nose down and nose left positive; NaN without a pose.'
        ),
        'pose': (
            'The body in the optical frame of the camera (m), with covariance. NaN where there '
            'is no pose; /diagnostics says why.'
        ),
        'vision_pose': (
            'The camera, or the vehicle (`base_frame`), in the frame of the body, only while the '
            'pose is known.'
        ),
        'detections': (
            'Where vision_msgs is installed: the markers of this image, score 1, as names in doubt '
            'are withheld.'
        ),
        'detections_3d': 'The same of the body, with its pose; empty while that is not known.',
        'integrity': (
            'One status: protection levels of the pose (m, degrees), OK available, WARN alert, '
            'ERROR not available with the reason; see [Protection levels](../integrity.md).'
        ),
        'marker/*': 'One marker (px), while it is detected or predicted: `~/marker/left_wing` …',
        'debug_image': 'The frame with markers, windows and the axes of the pose.',
    }
    panel = PanelPage(
        known_by='markers',
        image='debug_image',
        images=('debug_image',),
        charts={
            'roll': Chart('rpy', 'vector.x', 'Roll', '°'),
            'x': Chart('markers', 'x', 'Marker x', 'px', 'marker'),
            'y': Chart('markers', 'y', 'Marker y', 'px', 'marker'),
        },
    )
    uses_camera_info = True

    def __init__(self, parameters: MarkerTrackerParameters | None = None) -> None:
        super().__init__()
        self._parameters = parameters or MarkerTrackerParameters()
        self._newest: tuple[Image, MarkerResult, Pose | None, bytes] | None = None
        self._checked: tuple[CameraModel, int, int] | None = None
        self._rejection = ''
        self._seen: tuple[list[int], NDArray[np.float64]] = [], np.empty((0, 2))
        self._warnings: list[str] = []
        self._set_rig(self._parameters)

    def _set_rig(self, parameters: MarkerTrackerParameters) -> None:
        self._rig = _rig_of_topics(parameters)
        self._tracker = MarkerTracker(parameters, self._rig)
        self._doubts = [f'rig: {doubt}' for doubt in self._tracker.doubts]
        self._marker_topics = [f'marker/{name}' for name in self._rig.names]
        markers = dict.fromkeys(self._marker_topics, PointStamped)
        topics = {**_TOPICS, **detections.TYPES, **markers}
        self._set_topics(topics, parameters.publish_tf)
        self._poses = PoseEstimator(self._rig)

    def configure(self, parameters: MarkerTrackerParameters) -> None:
        """See `Processor.configure`.

        Raises:
            ParameterError: the rig's file cannot be used.
        """
        if _setup(parameters) != _setup(self._parameters):
            self.open(parameters)
            return
        self._tracker.configure(parameters)
        self._parameters = parameters
        self._share_camera()

    def open(self, parameters: MarkerTrackerParameters) -> None:
        """See `Processor.open`.

        Raises:
            ParameterError: the rig's file cannot be used.
        """
        self._set_rig(parameters)
        self._parameters = parameters
        self._share_camera()

    @property
    def awaits_camera_info(self) -> bool:
        """See `Processor.awaits_camera_info`."""
        return self._parameters.has_pose

    @property
    def lacks_camera_info(self) -> bool:
        """See `Processor.lacks_camera_info`."""
        return self._parameters.has_pose and self._camera is None

    def set_camera(self, camera: CameraModel) -> None:
        """See `Processor.set_camera`."""
        if self._parameters.image_is_rectified:
            camera = camera.rectified()
        if camera is not self._camera and camera != self._camera:
            self._camera = camera
            self._poses.reset()
            self._share_camera()

    def _share_camera(self) -> None:
        # Without a pose nobody waits for a calibration, so names must not depend on one.
        self._tracker.set_camera(self._camera if self._parameters.has_pose else None)

    def _forget(self) -> None:
        self._newest = None
        self._tracker.reset()
        self._poses.reset()

    def _process(self, frame: Frame, header: bytes) -> Iterator[Output]:
        result = self._tracker.process(frame.image, frame.stamp_ns)
        numbered = self._parameters.mode == 'track_any'
        yield Output('markers', partial(encode_markers, result, header, numbered=numbered))
        pose = self._estimate(frame, result)
        self.status = '; '.join(filter(None, (result.status, *self._warnings, *self._doubts)))
        self._newest = (frame.image, result, pose, header)
        yield Output('rpy', partial(encode_rpy, result, header, pose))
        yield Output('pose', partial(poses.encode_pose, pose, header))
        if pose is not None:
            camera, body = poses.camera_in_body(pose), poses.body_in_camera(pose)
            name = self._parameters.body_frame or self._rig.name
            yield from self._placements(camera, body, name, frame, self._parameters)
        for marker in result.markers:
            if marker.label != Label.UNLABELLED and marker.state is not MarkerState.LOST:
                topic = self._marker_topics[marker.label]
                yield Output(topic, partial(encode_marker, marker, header))
        if detections.TYPES:
            make = partial(detections.encode_markers, result, self._rig.names, header)
            yield Output('detections', make)
            yield Output('detections_3d', partial(detections.encode_body, self._rig, pose, header))
        yield Output('integrity', partial(self._encode_integrity, pose, header))

    def draw(self, debug: Collection[str]) -> list[Output]:
        """See `Processor.draw`."""
        if self._newest is None or 'debug_image' not in debug:
            return []
        image, result, pose, header = self._newest
        canvas = draw_markers(image, result)
        if pose is not None and self._camera is not None:
            draw_pose(canvas, pose, self._camera, self._rig)
        return [Output('debug_image', partial(serialize_image, Image(canvas, 'bgr8'), header))]

    def _estimate(self, frame: Frame, result: MarkerResult) -> Pose | None:
        self._warnings = []
        if self._camera is None or not self._parameters.has_pose:
            return None
        self._check(self._camera, frame.image)
        if self._rejection:
            self._warnings.append(self._rejection)
            return None
        if result.camera_doubt:
            self._warnings.append(f'no pose: {result.camera_doubt}')
            return None
        self._seen = named_places(result, (frame.image.width, frame.image.height))
        pose = self._poses.estimate(self._camera, *self._seen, frame.stamp_ns)
        if pose is None and len(self._seen[0]) >= MIN_MARKERS:
            self._warnings.append(f'no pose: {self._poses.reason}')
        return pose

    def _encode_integrity(self, pose: Pose | None, header: bytes) -> bytes:
        """How wrong the newest frame's pose may be; computed only where somebody listens."""
        given, camera = self._parameters, self._camera
        if pose is not None and camera is not None:
            levels = protection_levels(
                camera,
                self._rig,
                *self._seen,
                pose.rotation,
                pose.translation,
                self._poses.noise,
                _budget(given),
            )
        elif camera is None or not given.pose:
            reason = 'no calibration' if camera is None else 'the parameter pose is off'
            levels = ProtectionLevels(reason=reason)
        else:
            reason = '; '.join(self._warnings) or f'{len(self._seen[0])} lights have a name'
            levels = ProtectionLevels(reason=reason)
        return encode_integrity(levels, given.alert_limit, given.integrity_risk, header)

    def _check(self, camera: CameraModel, image: Image) -> None:
        """Find out whether the calibration is one of such images, if that is not known yet."""
        checked = (camera, image.width, image.height)
        if checked != self._checked:
            self._checked, self._rejection = checked, ''
            try:
                camera.check(image.width, image.height)
            except CalibrationError as error:
                self._rejection = f'no pose: {error}'


@lru_cache(maxsize=4)
def _budget(given: MarkerTrackerParameters) -> IntegrityBudget:
    return IntegrityBudget(
        given.integrity_risk,
        given.light_fault_prior,
        given.focal_length_error / 100.0,
        given.principal_point_error,
    )


def _setup(parameters: MarkerTrackerParameters) -> tuple[str, bool, str]:
    return parameters.layout, parameters.allow_ambiguous, parameters.publish_tf


def _rig_of_topics(parameters: MarkerTrackerParameters) -> MarkerRig:
    rig = rig_of(parameters)
    for reason in refused_names(rig):
        raise ParameterError('layout', f'{parameters.layout}: {reason}')
    return rig
