"""The work of ``marker_tracker``."""

from __future__ import annotations

import re
from collections.abc import Collection
from functools import partial

import numpy as np
from geometry_msgs.msg import PointStamped, PoseWithCovarianceStamped, Vector3Stamped
from sensor_msgs.msg import PointCloud2

from mvuav_ros.parameters.declaration import ParameterError
from mvuav_ros.parameters.marker_tracker import MarkerTrackerParameters
from mvuav_ros.processing.messages.markers import encode_marker, encode_markers, encode_rpy
from mvuav_ros.processing.messages.pose import TF_TYPE, encode_pose, encode_transform
from mvuav_ros.processing.processor import Output, Processor
from mvuav_ros.recordings.serialization.serialized_image import serialize_image
from mvuav_ros.recordings.sources.frame import Frame
from mvuav_ros.vision.camera import CalibrationError, CameraModel
from mvuav_ros.vision.image import Image
from mvuav_ros.vision.markers.drawing import draw_markers
from mvuav_ros.vision.markers.results import TANKER_NAMES, Label, MarkerResult, MarkerState
from mvuav_ros.vision.markers.tracker import MarkerTracker
from mvuav_ros.vision.pose import FEWEST, Pose, PoseEstimator
from mvuav_ros.vision.pose_drawing import draw_pose
from mvuav_ros.vision.rig import TANKER_747, MarkerRig, RigError, load_rig
from mvuav_ros.vision.rig_examination import examine

TF_TOPIC = '/tf'
_TOPIC_WORD = re.compile(r'[A-Za-z]\w*', re.ASCII)


class MarkerTrackerProcessor(Processor):
    """Frames to labelled points, roll and pose.

    Attributes:
        topics: with one for each marker of the layout; they are those of the parameters given at
            the construction or by the first `configure`.
    """

    name = 'marker_tracker'
    parameters_type = MarkerTrackerParameters
    topics = {
        'markers': PointCloud2,
        'rpy': Vector3Stamped,
        'pose': PoseWithCovarianceStamped,
        **dict.fromkeys((f'marker/{name}' for name in TANKER_NAMES), PointStamped),
    }
    debug_topics = ('debug_image',)
    uses_camera_info = True

    def __init__(self, parameters: MarkerTrackerParameters | None = None) -> None:
        super().__init__()
        self._parameters = parameters or MarkerTrackerParameters()
        self._camera: CameraModel | None = None
        self._newest: tuple[Image, MarkerResult, Pose | None, bytes] | None = None
        self._checked: tuple[CameraModel, int, int] | None = None
        self._refusal = ''
        self._remarks: list[str] = []
        self._set_rig(self._parameters)

    def _set_rig(self, parameters: MarkerTrackerParameters) -> None:
        self._rig = _open_rig(parameters.layout)
        self._doubts = [f'rig: {doubt}' for doubt in examine(self._rig)]
        if self._doubts and not parameters.allow_ambiguous:
            raise ParameterError(
                'layout', f'{parameters.layout}: {self._doubts[0]} (see allow_ambiguous)'
            )
        self._marker_topics = [f'marker/{name}' for name in self._rig.names]
        topics: dict[str, type] = {
            'markers': PointCloud2,
            'rpy': Vector3Stamped,
            'pose': PoseWithCovarianceStamped,
            **dict.fromkeys(self._marker_topics, PointStamped),
        }
        if parameters.publish_tf and TF_TYPE is not None:
            topics[TF_TOPIC] = TF_TYPE
        # The layout is known from the start on, so this stands before anybody asks.
        self.topics = topics  # type: ignore[misc]
        self._pipeline = MarkerTracker(parameters, self._rig)
        self._poses = PoseEstimator(self._rig)

    def configure(self, parameters: MarkerTrackerParameters) -> None:
        """See `Processor.configure`.

        Raises:
            ParameterError: the layout's file cannot be used.
        """
        before, self._parameters = self._parameters, parameters
        if _setup(parameters) != _setup(before):
            self._set_rig(parameters)
        else:
            self._pipeline.configure(parameters)

    @property
    def awaits_camera_info(self) -> bool:
        """See `Processor.awaits_camera_info`."""
        return self._parameters.pose

    def set_camera(self, camera: CameraModel) -> None:
        """See `Processor.set_camera`."""
        if camera != self._camera:
            self._camera = camera
            self._poses.reset()

    def _forget(self) -> None:
        self._newest = None
        self._pipeline.reset()
        self._poses.reset()

    def _process(self, frame: Frame, header: bytes) -> list[Output]:
        result = self._pipeline.process(frame.image, frame.stamp_ns)
        pose = self._estimate(frame, result)
        self.status = '; '.join(filter(None, (result.status, *self._remarks, *self._doubts)))
        numbered = self._parameters.mode == 'track_any'
        outputs = [
            Output('markers', partial(encode_markers, result, header, numbered=numbered)),
            Output('rpy', partial(encode_rpy, result, header, pose)),
            Output('pose', partial(encode_pose, pose, header)),
        ]
        outputs += [
            Output(self._marker_topics[marker.label], partial(encode_marker, marker, header))
            for marker in result.markers
            if marker.label != Label.UNLABELLED and marker.state is not MarkerState.LOST
        ]
        if pose is not None and TF_TOPIC in self.topics:
            outputs.append(
                Output(TF_TOPIC, partial(encode_transform, pose, header, self._rig.name))
            )
        self._newest = (frame.image, result, pose, header)
        return outputs

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
        self._remarks = []
        parameters = self._parameters
        if parameters.publish_tf and TF_TYPE is None:
            self._remarks.append('no /tf: tf2_msgs is not installed')
        if self._camera is None or not parameters.pose:
            return None
        self._check(self._camera, frame.image)
        if self._refusal:
            self._remarks.append(self._refusal)
            return None
        seen = [
            marker
            for marker in result.markers
            if marker.state is MarkerState.DETECTED and marker.label != Label.UNLABELLED
        ]
        if len(seen) < FEWEST:
            return None
        lights = [int(marker.label) for marker in seen]
        pixels = np.array([(marker.x, marker.y) for marker in seen])
        pose = self._poses.estimate(self._camera, lights, pixels, frame.stamp_ns * 1e-9)
        if pose is None:
            self._remarks.append('no pose: none fits the markers')
        return pose

    def _check(self, camera: CameraModel, image: Image) -> None:
        """Find out whether the calibration is one of such images, if that is not known yet."""
        checked = (camera, image.width, image.height)
        if checked == self._checked:
            return
        self._checked = checked
        self._refusal = ''
        try:
            camera.check(image.width, image.height)
        except CalibrationError as error:
            self._refusal = f'no pose: {error}'


def _setup(parameters: MarkerTrackerParameters) -> tuple[str, bool, bool]:
    return parameters.layout, parameters.allow_ambiguous, parameters.publish_tf


def _open_rig(path: str) -> MarkerRig:
    if not path:
        return TANKER_747
    try:
        rig = load_rig(path)
    except RigError as error:
        raise ParameterError('layout', str(error)) from error
    for name in rig.names:
        if not _TOPIC_WORD.fullmatch(name):
            raise ParameterError('layout', f'{path}: {name!r} cannot be part of a topic')
    if not 2 <= len(rig.names) <= Label.UNLABELLED:
        raise ParameterError('layout', f'{path}: tracking needs 2 to 255 markers')
    return rig
