"""The work of ``runway_detector``."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from dataclasses import replace
from functools import partial
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PointStamped, PoseWithCovarianceStamped
from sensor_msgs.msg import PointCloud2
from visualization_msgs.msg import Marker

from mvuav_ros.messages import detections, poses
from mvuav_ros.messages.cdr import cdr_header
from mvuav_ros.messages.images import Frame, serialize_image
from mvuav_ros.messages.poses import encode_integrity
from mvuav_ros.messages.runway_messages import (
    encode_corrections,
    encode_line_params,
    encode_lines,
    encode_pose,
    encode_statistics,
    encode_vanishing_point,
)
from mvuav_ros.messages.sensors import UNKNOWN_ATTITUDE
from mvuav_ros.parameters.runway_detector import RunwayDetectorParameters
from mvuav_ros.processing.processor import Chart, Output, PanelPage, Processor
from mvuav_ros.vision.approach.approach_detector import ApproachDetector
from mvuav_ros.vision.approach.approach_results import ApproachResult, Guidance
from mvuav_ros.vision.approach.overlay import draw_approach
from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.frames import OPTICAL_FROM_BODY, Attitude, from_quaternion, quaternion
from mvuav_ros.vision.image import Image
from mvuav_ros.vision.integrity import RunwayLevels, runway_levels
from mvuav_ros.vision.runway.debug_images import draw_confined, draw_edges, draw_hough, draw_overlay
from mvuav_ros.vision.runway.detector import RunwayDetector
from mvuav_ros.vision.runway.results import RunwayResult
from mvuav_ros.vision.runway.statistics import RunwayStatistics

# The thesis's video windows two to five.
_Drawings = dict[str, tuple[Callable[[Any], Any], str]]
_THESIS_IMAGES: _Drawings = {
    'debug/confined': (draw_confined, 'mono8'),
    'debug/edges': (draw_edges, 'mono8'),
    'debug/hough': (draw_hough, 'bgr8'),
    'debug/overlay': (draw_overlay, 'bgr8'),
}
_APPROACH_IMAGES: _Drawings = {'debug/overlay': (draw_approach, 'bgr8')}

_DETECTIONS = {name: kind for name, kind in detections.TYPES.items() if name == 'detections'}


class RunwayDetectorProcessor(Processor):
    """Frames to lines with their correction flags, and to guidance in mode ``approach``."""

    name = 'runway_detector'
    parameters_type = RunwayDetectorParameters
    topics = {
        'line_params': PointCloud2,
        'lines': Marker,
        'corrections': DiagnosticArray,
        'vanishing_point': PointStamped,
        'pose': PoseWithCovarianceStamped,
        'vision_pose': PoseWithCovarianceStamped,
        'integrity': DiagnosticArray,
    }
    debug_topics = tuple(_THESIS_IMAGES)
    descriptions = {
        'line_params': 'Lines, a row for each; see the fields below.',
        'lines': (
            'The segments. On a plane 1 m ahead of the camera with a calibrated camera_info, '
            'else in pixels.'
        ),
        'corrections': 'The error flags of each line, as text for `ros2 topic echo`.',
        'statistics': 'Once a second: flag counts, means and deviations of each line.',
        'vanishing_point': 'Mode `approach`: where the edges meet (px); NaN while not known.',
        'pose': (
            'Mode `approach`: the camera in frame `runway` (m), with a calibrated camera_info '
            'and `runway_width`. What was not observed is NaN with variance 1e12.'
        ),
        'vision_pose': (
            'The same, or the vehicle (`base_frame`), for estimators, only while all six numbers '
            'are known.'
        ),
        'detections': (
            'Where vision_msgs is installed: in mode `approach` the target in its box, with its '
            'confidence.'
        ),
        'integrity': (
            'One status: protection levels of offset, height (m) and heading (degrees) in mode '
            '`approach`; see [Protection levels](../integrity.md).'
        ),
        'debug/confined': 'The rows that are searched.',
        'debug/edges': 'Edges after thinning and opening.',
        'debug/hough': 'The accumulator with its peaks.',
        'debug/overlay': 'The frame with the lines found.',
    }
    panel = PanelPage(
        known_by='line_params',
        image='debug/overlay',
        images=('debug/confined', 'debug/edges', 'debug/overlay', 'debug/hough'),
        charts={
            'rho': Chart('line_params', 'rho', 'Line rho', 'px', 'line'),
            'theta': Chart('line_params', 'theta', 'Line theta', '°', 'line'),
        },
    )
    periodic_topics = {'statistics': DiagnosticArray}
    uses_camera_info = True
    uses_attitude = True
    triggers = {'reset_statistics': 'the statistics begin at zero'}
    _parameters: RunwayDetectorParameters

    def __init__(self, parameters: RunwayDetectorParameters | None = None) -> None:
        super().__init__(parameters)
        self._thesis = RunwayDetector(replace(self._parameters, mode='thesis'))
        self._approach = ApproachDetector(parameters)
        self._statistics = RunwayStatistics()
        self._newest: tuple[RunwayResult | ApproachResult, bytes] | None = None
        self._set_topics({**type(self).topics, **_DETECTIONS})

    @property
    def awaits_attitude(self) -> bool:
        """See `Processor.awaits_attitude`."""
        given = self._parameters
        return given.mode == 'approach' and given.horizon_source != 'image'

    @property
    def awaits_camera_info(self) -> bool:
        """See `Processor.awaits_camera_info`; lines are drawn with the last one known."""
        return self._parameters.mode == 'approach' or self._camera is None

    @property
    def lacks_camera_info(self) -> bool:
        """See `Processor.lacks_camera_info`."""
        given = self._parameters
        return given.mode == 'approach' and given.runway_width > 0 and self._camera is None

    def configure(self, parameters: RunwayDetectorParameters) -> None:
        """See `Processor.configure`; another mode starts afresh, statistics included."""
        before, self._parameters = self._parameters, parameters
        self._set_topics({**type(self).topics, **_DETECTIONS})
        self._thesis.configure(replace(parameters, mode='thesis'))
        self._approach.configure(parameters)
        if parameters.mode != before.mode:
            self._forget()
            self.reset_statistics()

    def set_camera(self, camera: CameraModel) -> None:
        """See `Processor.set_camera`."""
        super().set_camera(camera)
        assert self._camera is not None
        self._approach.set_camera(self._camera)

    def reset_statistics(self) -> None:
        """Begin the statistics at zero."""
        self._statistics.reset()

    def periodic(self, header: bytes) -> list[Output]:
        """See `Processor.periodic`."""
        summary = self._statistics.summary()
        return [Output('statistics', partial(encode_statistics, summary, header))]

    def _forget(self) -> None:
        self._newest = None
        self._thesis.reset()
        self._approach.reset()

    def _process(self, frame: Frame, header: bytes) -> Iterator[Output]:
        result: RunwayResult | ApproachResult
        camera, image = self._camera, frame.image
        unusable = '' if camera is None else camera.objection(image.width, image.height)
        if self._parameters.mode == 'approach':
            result = self._approach.process(image, frame.stamp_ns, self._attitude(frame))
            wants_pose = self._parameters.runway_width > 0
            no_pose = f'no pose: {unusable}' if unusable and wants_pose else ''
            problem = self._approach.attitude_problem
            said = (result.status, '' if problem in result.status else problem, no_pose)
            self.status = '; '.join(filter(None, said))
        else:
            result = self._thesis.process(image, frame.stamp_ns)
            self.status = result.status
        self._newest = (result, header)
        yield Output('line_params', partial(encode_line_params, result, header))
        yield Output('lines', partial(encode_lines, result, header, None if unusable else camera))
        yield Output('corrections', partial(encode_corrections, result, header))
        yield Output('vanishing_point', partial(encode_vanishing_point, result, header))
        yield Output('integrity', partial(self._encode_integrity, result, header))
        if detections.TYPES:
            make = partial(detections.encode_runway, result, self._parameters.target, header)
            yield Output('detections', make)
        if isinstance(result, ApproachResult) and result.guidance is not None:
            yield from self._poses(result.guidance, frame)
        # Last, so that no result waits for it.
        self._statistics.add(result.lines)

    def _attitude(self, frame: Frame) -> Attitude | None:
        """The vehicle's, on which the camera's mount must be known; the sensor's without a base."""
        attitude, base = frame.attitude, self._parameters.base_frame
        if base:
            if (mount := self._mount(frame)) is not None:
                self._approach.set_mount(mount.rotation)
            elif attitude is not None:
                return UNKNOWN_ATTITUDE
        if attitude is None or not (base and attitude.valid):
            return attitude
        sensor = self.static_transforms.find(attitude.sensor, base)
        if sensor is None:
            return attitude
        body = from_quaternion(attitude.x, attitude.y, attitude.z, attitude.w)
        return Attitude(*quaternion(body @ sensor.rotation.T), attitude.sigma)

    def _encode_integrity(self, result: RunwayResult | ApproachResult, header: bytes) -> bytes:
        """How wrong the newest guidance may be; computed only where somebody listens."""
        given = self._parameters
        if not isinstance(result, ApproachResult):
            levels = RunwayLevels(reason='only mode approach has levels')
        elif result.guidance is None:
            reason = 'guidance needs a runway_width and a calibrated camera_info'
            levels = RunwayLevels(reason=reason)
        elif not result.guidance.known:
            levels = RunwayLevels(reason=result.status or 'the edges are not known')
        else:
            covariance = result.guidance.covariance
            levels = runway_levels(covariance, result.confidence, given.integrity_risk)
        return encode_integrity(levels, given.alert_limit, given.integrity_risk, header)

    def _poses(self, guidance: Guidance, frame: Frame) -> Iterator[Output]:
        """The camera in the runway's frame; as others take it only where all of it is known."""
        name = self._parameters.runway_frame
        runway_header = cdr_header(frame.stamp_ns, name)
        yield Output('pose', partial(encode_pose, guidance, runway_header))
        camera = poses.camera_in_runway(guidance)
        if camera.known:
            runway = replace(camera, rotation=camera.rotation @ OPTICAL_FROM_BODY.T).inverse
            yield from self._placements(camera, runway, name, frame)

    def draw(self, debug: Collection[str]) -> list[Output]:
        """See `Processor.draw`."""
        if self._newest is None:
            return []
        result, header = self._newest
        drawings = _APPROACH_IMAGES if isinstance(result, ApproachResult) else _THESIS_IMAGES
        outputs = []
        for topic, (draw, encoding) in drawings.items():
            if topic in debug and (drawn := draw(result)).size:
                image = Image(drawn, encoding)
                outputs.append(Output(topic, partial(serialize_image, image, header)))
        return outputs
