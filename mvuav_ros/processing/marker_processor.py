"""The work of ``marker_tracker``."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from functools import partial
from operator import attrgetter

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PointStamped, PoseWithCovarianceStamped, Vector3Stamped
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
from mvuav_ros.processing.tracking import follow_mount
from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.image import Image
from mvuav_ros.vision.integrity import IntegrityBudget, ProtectionLevels, protection_levels
from mvuav_ros.vision.markers.drawing import draw_markers, draw_pose
from mvuav_ros.vision.markers.marker_results import (
    TANKER_NAMES,
    Label,
    MarkerResult,
    MarkerState,
)
from mvuav_ros.vision.markers.tracker import PosedTracker, rig_of
from mvuav_ros.vision.pose import Pose

_TOPICS = {
    'markers': PointCloud2,
    'rpy': Vector3Stamped,
    'pose': PoseWithCovarianceStamped,
    'vision_pose': PoseWithCovarianceStamped,
    'integrity': DiagnosticArray,
}


class MarkerTrackerProcessor(Processor):
    """Frames to labelled points, roll and pose; a topic for each marker of the rig."""

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
    _parameters: MarkerTrackerParameters

    def __init__(self, parameters: MarkerTrackerParameters | None = None) -> None:
        super().__init__(parameters)
        self._newest: tuple[Image, MarkerResult, Pose | None, bytes] | None = None
        self.open(self._parameters)

    def open(self, parameters: MarkerTrackerParameters) -> None:
        """See `Processor.open`; a `ParameterError` where the rig's file cannot be used."""
        rig = rig_of(parameters)
        for reason in refused_names(rig):
            raise ParameterError('layout', f'{parameters.layout}: {reason}')
        self._posed = PosedTracker(parameters, rig)
        self._posed.set_camera(self._camera)
        self._rig, self._parameters = rig, parameters
        self._marker_topics = [f'marker/{name}' for name in self._rig.names]
        markers = dict.fromkeys(self._marker_topics, PointStamped)
        self._set_topics({**_TOPICS, **detections.TYPES, **markers})

    def configure(self, parameters: MarkerTrackerParameters) -> None:
        """See `Processor.configure`; another rig's file is read as by `open`."""
        setup = attrgetter('layout', 'allow_ambiguous', 'publish_tf')
        if setup(parameters) != setup(self._parameters):
            self.open(parameters)
        else:
            self._posed.configure(parameters)
            self._parameters = parameters

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
        super().set_camera(camera)
        self._posed.set_camera(self._camera)

    def _forget(self) -> None:
        self._newest = None
        self._posed.reset()

    def _process(self, frame: Frame, header: bytes) -> Iterator[Output]:
        posed = self._posed
        follow_mount(posed.tracker, frame, self.static_transforms)
        result = posed.tracker.process(frame.image, frame.stamp_ns)
        numbered = self._parameters.mode == 'track_any'
        yield Output('markers', partial(encode_markers, result, header, numbered=numbered))
        pose = posed.pose(frame.image, result, frame.stamp_ns)
        doubts = (f'rig: {doubt}' for doubt in posed.tracker.doubts)
        self.status = '; '.join(filter(None, (result.status, posed.problem, *doubts)))
        self._newest = (frame.image, result, pose, header)
        yield Output('rpy', partial(encode_rpy, result, header, pose))
        yield Output('pose', partial(poses.encode_pose, pose, header))
        if pose is not None:
            camera, body = poses.camera_in_body(pose), poses.body_in_camera(pose)
            name = self._parameters.body_frame or self._rig.name
            yield from self._placements(camera, body, name, frame)
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
        canvas = draw_markers(image, result, self._rig.names)
        if pose is not None and self._camera is not None:
            draw_pose(canvas, pose, self._camera, self._rig)
        return [Output('debug_image', partial(serialize_image, Image(canvas, 'bgr8'), header))]

    def _encode_integrity(self, pose: Pose | None, header: bytes) -> bytes:
        """How wrong the newest frame's pose may be; computed only where somebody listens."""
        given, camera, posed = self._parameters, self._camera, self._posed
        if pose is not None and camera is not None:
            budget = IntegrityBudget(
                given.integrity_risk,
                given.light_fault_prior,
                given.focal_length_error / 100.0,
                given.principal_point_error,
            )
            levels = protection_levels(
                camera,
                self._rig,
                *posed.seen,
                pose.rotation,
                pose.translation,
                posed.poses.noise,
                budget,
            )
        else:
            reason = posed.problem or f'{len(posed.seen[0])} lights have a name'
            if camera is None or not given.pose:
                reason = 'no calibration' if camera is None else 'the parameter pose is off'
            levels = ProtectionLevels(reason=reason)
        return encode_integrity(levels, given.alert_limit, given.integrity_risk, header)
