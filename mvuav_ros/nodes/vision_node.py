"""The shell that both detectors share: states, services, parameters, diagnostics."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from itertools import pairwise

import cv2
from diagnostic_msgs.msg import DiagnosticStatus
from sensor_msgs.msg import CameraInfo, Imu
from std_srvs.srv import SetBool, Trigger

from mvuav_ros.nodes.companions import Companion
from mvuav_ros.nodes.detector_status import DetectorStatus
from mvuav_ros.nodes.diagnostics import every_second, publish_status, status
from mvuav_ros.nodes.frame_answering import FrameAnswerer
from mvuav_ros.nodes.frame_statistics import WINDOW
from mvuav_ros.nodes.image_input import ImageInput
from mvuav_ros.nodes.image_transport import image_topic
from mvuav_ros.nodes.input_monitor import explain_no_images
from mvuav_ros.nodes.intra_process import IntraProcessInput
from mvuav_ros.nodes.live_parameters import LiveParameters
from mvuav_ros.nodes.managed_node import ManagedNode
from mvuav_ros.nodes.received_image import InputState
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

        ``handed_over``: frames come by `take` from a source in this process, not by ``image_raw``.
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
        publish_status(self, self._report)
        every_second(self, self._publish_periodic)
        self.create_service(SetBool, '~/enable', self._on_enable)
        self._add_trigger('reset', processor.reset, 'all earlier frames are forgotten')
        for name in processor.triggers:
            self._add_trigger(name, getattr(processor, name))

    def open(self) -> None:
        """Open the rig's file and the topics."""
        self._apply(self._live.current)
        self._results = ResultPublishers(self, self._processor)

    def begin(self) -> None:
        """Subscribe; images before this moment are not answered."""
        assert self._results is not None
        self._status = DetectorStatus(self._answerer, self._processor)
        self._told_silence = False
        images, answer = self.resolve_topic_name('image_raw'), self._answerer.answer
        transport = 'raw' if self._handed_over else self.get_parameter('image_transport').value
        self._answerer.restart(self._results, transport, images)
        if self._handed_over:
            self._input = IntraProcessInput(images, answer)
        else:
            topic = image_topic(transport, images)
            # Before the images, so that a source that sees that one subscription has seen these.
            companions = self._companions(images)
            self._input = ImageInput(self, topic, answer, companions)
        self._input.start()
        self._announce(self._input.topic)

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

    def _companions(self, images: str) -> list[Companion]:
        processor, made = self._processor, []
        if processor.uses_camera_info:
            # In the namespace of the images, as camera drivers and image_transport do.
            topic = images.rsplit('/', 1)[0] + '/camera_info'
            made.append(Companion(self, CameraInfo, topic, lambda: processor.awaits_camera_info))
        if processor.uses_attitude:
            made.append(Companion(self, Imu, 'imu', lambda: processor.awaits_attitude))
        return made

    def _announce(self, topic: str) -> None:
        values = self._live.current.as_dict()
        files = ', '.join(parameter_files(sys.argv)) or 'none'
        words = f'mode {values["mode"]}, images from {topic}, parameter files: {files}'
        if values['publish_tf'] and TF_TOPIC not in self._processor.topics:
            words += '; no /tf, as tf2_msgs is not installed'
        self.get_logger().info(words)

    def _apply(self, parameters: ParameterSet) -> None:
        with self._answerer.lock:
            self._processor.configure(parameters)
        threads = int(getattr(parameters, 'opencv_threads'))  # noqa: B009 - both detectors' have it
        # OpenCV takes a negative number for its own choice.
        cv2.setNumThreads(threads if threads > 0 else -1)

    def _add_trigger(self, name: str, action: Callable[[], None], said: str = '') -> None:
        def call(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
            with self._answerer.lock:
                action()
            response.success, response.message = True, said
            return response

        self.create_service(Trigger, f'~/{name}', call)

    def _on_enable(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        with self._answerer.lock:
            if request.data and not self._answerer.enabled:
                self._processor.reset()
            self._answerer.enabled = request.data
        response.success, response.message = True, self._status.state
        return response

    def _report(self) -> DiagnosticStatus:
        name = self.get_fully_qualified_name()
        if self._input is None:
            state = self.lifecycle_state
            return status(DiagnosticStatus.OK, name, state, {'state': state})
        images = self._input.poll()
        with self._answerer.lock:
            said = self._status.report(name, images)
        self._tell_silence(images)
        return said

    def _publish_periodic(self) -> None:
        if self._input is not None and self._results is not None:
            header = cdr_header(self.get_clock().now().nanoseconds, '')
            with self._answerer.lock:
                outputs = self._processor.periodic(header)
            self._results.publish_periodic(outputs)

    def _tell_silence(self, images: InputState) -> None:
        """Warn once when no images have come for a while."""
        quiet = self._answerer.enabled and self._answerer.statistics.quiet_for >= WINDOW
        if quiet and not self._told_silence:
            self.get_logger().warning(f'no images for {WINDOW:.0f} s: {explain_no_images(images)}')
        self._told_silence = quiet


def parameter_files(arguments: Sequence[str]) -> list[str]:
    """The ``--params-file`` arguments of a command line."""
    return [value for option, value in pairwise(arguments) if option == '--params-file']
