"""The shell that both detectors share: states, services, parameters, diagnostics."""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import Any

import cv2
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, Imu
from std_srvs.srv import SetBool, Trigger

from mvuav_ros.messages.cdr import cdr_header
from mvuav_ros.messages.images import Frame
from mvuav_ros.messages.poses import TF_STATIC_TOPIC, TF_TOPIC, TF_TYPE
from mvuav_ros.messages.sensors import topic_beside
from mvuav_ros.nodes.diagnostics import (
    WINDOW,
    DetectorStatus,
    every_second,
    explain_no_images,
    publish_status,
    status,
)
from mvuav_ros.nodes.image_input import (
    FrameInput,
    ImageInput,
    InputState,
    IntraProcessInput,
    SynchronizedTopic,
    camera_info_topic,
    image_topic,
    published_topics,
)
from mvuav_ros.nodes.live_parameters import LiveParameters, parameter_files
from mvuav_ros.nodes.managed_node import ManagedNode
from mvuav_ros.nodes.publishing import FrameAnswerer, ResultPublishers
from mvuav_ros.parameters.common_parameters import DetectorParameters
from mvuav_ros.parameters.declaration import condition_text
from mvuav_ros.processing.processor import Processor


class VisionNode(ManagedNode):
    """Answers the images of ``image_raw`` with a processor's messages, while it is active.

    Images are processed in the thread of their input; all else in that of the executor.
    """

    def __init__(self, processor: Processor, *, handed_over: bool = False) -> None:
        """Make the node; it answers once it is configured and activated.

        ``handed_over``: frames come by `take` from a source in this process, not by ``image_raw``.
        """
        super().__init__(processor.name)
        self._processor = processor
        self._handed_over = handed_over
        self._results: ResultPublishers | None = None
        self._input: FrameInput | None = None
        self._answerer = FrameAnswerer(self, processor)
        self._status = DetectorStatus(self._answerer.statistics, processor)
        self._reported_silence = False
        self._live = LiveParameters(self, processor.parameters_type, self._apply)
        publish_status(self, self._report)
        every_second(self, self._publish_periodic)
        self.create_service(SetBool, '~/enable', self._on_enable)
        self._add_trigger('reset', processor.reset, 'all earlier frames are forgotten')
        for name, said in processor.triggers.items():
            self._add_trigger(name, getattr(processor, name), said)
        if TF_TYPE is not None:
            qos = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
            self.create_subscription(TF_TYPE, TF_STATIC_TOPIC, self._take_static_transforms, qos)

    def open(self) -> None:
        """Open the rig's file and the topics."""
        with self._answerer.lock:
            self._processor.open(self._live.current)
        self._results = ResultPublishers(self, self._processor)
        self._apply(self._live.current)

    def begin(self) -> None:
        """Subscribe; images before this moment are not answered."""
        assert self._results is not None
        self._status = DetectorStatus(self._answerer.statistics, self._processor)
        answer = self._answerer.answer
        transport = 'raw' if self._handed_over else self.get_parameter('image_transport').value
        name, kind = image_topic(transport, self.resolve_topic_name('image_raw'))
        self._answerer.restart(self._results, transport)
        # Before the images, so that a source that sees that one subscription has seen these.
        synchronized = self._synchronized_topics()
        if self._handed_over:
            self._input = IntraProcessInput(self, name, answer, synchronized)
        else:
            self._input = ImageInput(self, name, answer, synchronized, kind=kind)
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

    def _synchronized_topics(self) -> list[SynchronizedTopic]:
        processor, made = self._processor, []
        # A source in this process hands a frame over with its calibration.
        if processor.uses_camera_info and not self._handed_over:
            topic = camera_info_topic(self)
            made.append(
                SynchronizedTopic(self, CameraInfo, topic, lambda: processor.awaits_camera_info)
            )
        if processor.uses_attitude:
            made.append(SynchronizedTopic(self, Imu, 'imu', lambda: processor.awaits_attitude))
        return made

    def _take_static_transforms(self, message: Any) -> None:
        with self._answerer.lock:
            self._processor.static_transforms.add(message)

    def _announce(self, topic: str) -> None:
        values = self._live.current.as_dict()
        files = ', '.join(parameter_files(self)[0]) or 'none'
        mode = f'mode {values["mode"]}, ' if 'mode' in values else ''
        words = f'{mode}images from {topic}, parameter files: {files}'
        if values.get('publish_tf', 'off') != 'off' and TF_TOPIC not in self._processor.topics:
            words += '; no /tf, as tf2_msgs is not installed'
        self.get_logger().info(words)

    def _apply(self, parameters: DetectorParameters) -> None:
        if self._results is None:
            # `open` does it, and names what it cannot use.
            return
        with self._answerer.lock:
            self._processor.configure(parameters)
        # OpenCV takes a negative number for its own choice.
        cv2.setNumThreads(parameters.opencv_threads or -1)

    def _add_trigger(self, name: str, action: Callable[[], None], said: str) -> None:
        def call(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
            with self._answerer.lock:
                action()
            response.success, response.message = True, said
            return response

        self.create_service(Trigger, f'~/{name}', call)

    def _on_enable(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        with self._answerer.lock:
            if request.data and not self._answerer.statistics.enabled:
                self._processor.reset()
            self._answerer.statistics.enabled = request.data
        response.success, response.message = True, self._status.state
        if self._input is None:
            response.message = f'the node is {self.lifecycle_state}'
        return response

    def _report(self) -> DiagnosticStatus:
        name = self.get_fully_qualified_name()
        if self._input is None:
            state = self.lifecycle_state
            return status(DiagnosticStatus.OK, name, state, {'state': state})
        images, mistakes = self._input.poll(), self._mistakes()
        with self._answerer.lock:
            said = self._status.report(name, images, [*mistakes, *self._notes()])
        if said.level == DiagnosticStatus.OK and mistakes:
            said.level = DiagnosticStatus.WARN
        self._report_silence(images)
        return said

    def _mistakes(self) -> list[str]:
        """How the node was surely not meant to be started."""
        name, there = self.get_fully_qualified_name(), self.get_node_names_and_namespaces()
        count = there.count((self.get_name(), self.get_namespace()))
        same = f'{count} nodes are named {name}: while they run, their results are mixed'
        return [*filter(None, (self.overrides_problem, same if count > 1 else ''))]

    def _notes(self) -> list[str]:
        """What a user may have meant otherwise."""
        notes = []
        if self._answerer.statistics.received and self._processor.lacks_camera_info:
            topic = camera_info_topic(self)
            infos = self.get_publishers_info_by_topic(topic)
            kinds = {info.qos_profile.durability for info in infos}
            if kinds:
                why = f'no camera_info has come on {topic}'
            else:
                images = published_topics(self, Image, CompressedImage)
                others = {topic_beside(name, 'camera_info') for name, _ in images}
                elsewhere = self._elsewhere('camera_info', CameraInfo, others)
                why = f'nothing publishes {topic}{elsewhere}'
            if kinds == {DurabilityPolicy.TRANSIENT_LOCAL}:
                why += f'; as it is latched, set qos_overrides.{topic}.subscription.durability to '
                why += 'transient_local, and .reliability to reliable'
            notes.append(f'no pose: {why}')
        topic = self.resolve_topic_name('imu')
        if self._processor.awaits_attitude and self.count_publishers(topic) == 0:
            elsewhere = self._elsewhere('imu', Imu)
            notes += [f'no attitude: nothing publishes {topic}{elsewhere}'] if elsewhere else []
        for name, conditions in self._live.current.without_effect().items():
            when = '; or '.join(map(condition_text, conditions))
            notes.append(f'{name} has no effect: it counts with {when}')
        return notes

    def _elsewhere(self, name: str, kind: type, of_others: Collection[str] = ()) -> str:
        """Where what is expected on a topic may be, in words; empty where it is nowhere."""
        there = (each for each, _ in published_topics(self, kind) if each not in of_others)
        names = ', '.join(there)
        return f'; there is {names}: remap {name}' if names else ''

    def _publish_periodic(self) -> None:
        if self._input is not None and self._results is not None:
            header = cdr_header(self.get_clock().now().nanoseconds, '')
            with self._answerer.lock:
                outputs = self._processor.periodic(header)
            self._results.publish(outputs)

    def _report_silence(self, images: InputState) -> None:
        """Warn once when no images have come for a while."""
        statistics = self._answerer.statistics
        quiet = statistics.enabled and statistics.quiet_for >= WINDOW
        if quiet and not self._reported_silence:
            why = explain_no_images(images, self._status.lost)
            self.get_logger().warning(f'no images for {WINDOW:.0f} s: {why}')
        self._reported_silence = quiet
