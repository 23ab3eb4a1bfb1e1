"""The shell that both detectors share: states, services, parameters, diagnostics."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from itertools import pairwise

import cv2
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.clock import Clock, ClockType
from std_srvs.srv import SetBool, Trigger

from mvuav_ros.nodes.companion_input import Companion, CompanionInput
from mvuav_ros.nodes.detector_status import DetectorStatus, InputState, status, why_silent
from mvuav_ros.nodes.frame_answering import FrameAnswerer
from mvuav_ros.nodes.frame_statistics import WINDOW
from mvuav_ros.nodes.image_input import ImageInput
from mvuav_ros.nodes.image_transport import image_topic
from mvuav_ros.nodes.intra_process import IntraProcessInput
from mvuav_ros.nodes.live_parameters import LiveParameters
from mvuav_ros.nodes.managed_node import ManagedNode
from mvuav_ros.nodes.result_publishers import ResultPublishers
from mvuav_ros.parameters.declaration import ParameterSet
from mvuav_ros.processing.messages.transforms import TF_TOPIC
from mvuav_ros.processing.processor import Processor
from mvuav_ros.recordings.serialization.cdr import cdr_header
from mvuav_ros.recordings.sources.frame import Frame


class VisionNode(ManagedNode):
    """Answers the images of ``image_raw`` with a processor's messages, while it is active.

    Images are processed in the thread of their `ImageInput`; parameters, services, transitions
    and diagnostics in that of the executor.
    """

    def __init__(self, processor: Processor, *, handed_over: bool = False) -> None:
        """Make the node; it answers once it is configured and activated.

        Args:
            processor: the work.
            handed_over: frames come by `take` from a source in this process, not by ``image_raw``.
        """
        super().__init__(processor.name)
        self._processor = processor
        self._handed_over = handed_over
        self._results: ResultPublishers | None = None
        self._input: ImageInput | IntraProcessInput | None = None
        self._answerer = FrameAnswerer(self, processor)
        self._status = DetectorStatus(self._answerer, processor)
        self._told_silence = False
        self._live = LiveParameters(self, processor.parameters_type, self._apply)
        self._diagnostics = self.create_publisher(DiagnosticArray, '/diagnostics', 10)
        self.create_service(Trigger, '~/reset', self._on_reset)
        self.create_service(SetBool, '~/enable', self._on_enable)
        for name in processor.triggers:
            self.create_service(Trigger, f'~/{name}', self._trigger(getattr(processor, name)))
        # Wall time even under use_sim_time: diagnostics must speak when the simulation stands.
        self.create_timer(1.0, self._once_a_second, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def open(self) -> None:
        """Open the rig's file and the topics."""
        self._apply(self._live.current)
        self._results = ResultPublishers(self, self._processor)

    def begin(self) -> None:
        """Subscribe; images before this moment are not answered."""
        assert self._results is not None
        self._status = DetectorStatus(self._answerer, self._processor)
        self._told_silence = False
        self._answerer.restart(self._results, self._transport)
        self._input = self._handover() if self._handed_over else self._subscription()
        self._input.start()
        self._announce()

    def end(self) -> None:
        """Unsubscribe."""
        if self._input is not None:
            self._input.close()
            self._input = None

    def close(self) -> None:
        """Take the results' topics off the graph."""
        if self._results is not None:
            self._results.destroy()
            self._results = None

    def take(self, frame: Frame) -> None:
        """Give a frame to a node that was made with ``handed_over``; returns at once."""
        if isinstance(self._input, IntraProcessInput):
            self._input.put(frame)

    @property
    def listens(self) -> bool:
        """Whether frames given to `take` are answered."""
        return self._input is not None

    @property
    def _transport(self) -> str:
        return 'raw' if self._handed_over else str(self.get_parameter('image_transport').value)

    def _handover(self) -> IntraProcessInput:
        return IntraProcessInput(self.resolve_topic_name('image_raw'), self._answerer.answer)

    def _subscription(self) -> ImageInput:
        images = self.resolve_topic_name('image_raw')
        topic = image_topic(self._transport, images)
        processor = self._processor
        # In the namespace of the images, as camera drivers and image_transport do.
        infos = Companion(
            images.rsplit('/', 1)[0] + '/camera_info', lambda: processor.awaits_camera_info
        )
        imu = Companion('imu', lambda: processor.awaits_attitude)
        companions = CompanionInput(
            self,
            infos if processor.uses_camera_info else None,
            imu if processor.uses_attitude else None,
        )
        return ImageInput(self, topic, self._answerer.answer, companions)

    def _announce(self) -> None:
        assert self._input is not None
        values = self._live.current.as_dict()
        files = ', '.join(parameter_files(sys.argv)) or 'none'
        words = f'mode {values["mode"]}, images from {self._input.topic}, parameter files: {files}'
        if values['publish_tf'] and TF_TOPIC not in self._processor.topics:
            words += '; no /tf, as tf2_msgs is not installed'
        self.get_logger().info(words)

    def _apply(self, parameters: ParameterSet) -> None:
        with self._answerer.lock:
            self._processor.configure(parameters)
        threads = int(getattr(parameters, 'opencv_threads'))  # noqa: B009 - both detectors' have it
        # OpenCV takes a negative number for its own choice.
        cv2.setNumThreads(threads if threads > 0 else -1)

    def _on_reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        with self._answerer.lock:
            self._processor.reset()
        response.success, response.message = True, 'all earlier frames are forgotten'
        return response

    def _trigger(self, action: Callable[[], None]) -> Callable[..., Trigger.Response]:
        def call(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
            with self._answerer.lock:
                action()
            response.success = True
            return response

        return call

    def _on_enable(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        with self._answerer.lock:
            if request.data and not self._answerer.enabled:
                self._processor.reset()
            self._answerer.enabled = request.data
        response.success, response.message = True, self._status.state
        return response

    def _once_a_second(self) -> None:
        now = self.get_clock().now()
        message = DiagnosticArray()
        message.header.stamp = now.to_msg()
        periodic = []
        if self._input is None:
            state = self.lifecycle_state
            name = self.get_fully_qualified_name()
            message.status.append(status(DiagnosticStatus.OK, name, state, {'state': state}))
        else:
            images = InputState(self._input.topic, self._image_publishers(), self._input.poll())
            with self._answerer.lock:
                name = self.get_fully_qualified_name()
                message.status.append(self._status.report(name, images))
                periodic = self._processor.periodic(cdr_header(now.nanoseconds, ''))
            self._tell_silence(images)
        self._diagnostics.publish(message)
        if self._results is not None:
            self._results.publish_periodic(periodic)

    def _image_publishers(self) -> list[str]:
        if not isinstance(self._input, ImageInput):
            return ['this process']
        infos = self.get_publishers_info_by_topic(self._input.topic)
        return [f'{info.node_namespace.rstrip("/")}/{info.node_name}' for info in infos]

    def _tell_silence(self, images: InputState) -> None:
        """Warn once when no images have come for a while."""
        quiet = self._answerer.enabled and self._answerer.statistics.quiet_for >= WINDOW
        if quiet and not self._told_silence:
            self.get_logger().warning(f'no images for {WINDOW:.0f} s: {why_silent(images)}')
        self._told_silence = quiet


def parameter_files(arguments: Sequence[str]) -> list[str]:
    """The ``--params-file`` arguments of a command line."""
    return [value for option, value in pairwise(arguments) if option == '--params-file']
