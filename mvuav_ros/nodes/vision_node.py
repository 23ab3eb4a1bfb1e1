"""The shell that both processing nodes share: images in, results out, services, diagnostics."""

from __future__ import annotations

import time
from collections.abc import Callable
from threading import Lock
from typing import Any

import cv2
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.qos_overriding_options import QoSOverridingOptions
from sensor_msgs.msg import CompressedImage, Image
from std_srvs.srv import SetBool, Trigger

from mvuav_ros.nodes.frame_statistics import WINDOW, FrameStatistics, FrameTimes
from mvuav_ros.nodes.image_input import ImageInput, ReceivedImage
from mvuav_ros.nodes.input_monitor import InputMonitor, StampMonitor, silence
from mvuav_ros.nodes.intra_process import IntraProcessInput
from mvuav_ros.nodes.live_parameters import LiveParameters
from mvuav_ros.nodes.subscribers import is_heard
from mvuav_ros.parameters.declaration import ParameterSet
from mvuav_ros.processing.processor import DuplicateStampError, Output, Processor
from mvuav_ros.recordings.serialization.camera_info import decode_camera_info
from mvuav_ros.recordings.serialization.cdr import cdr_header
from mvuav_ros.recordings.serialization.image_decoding import decode_compressed_image, decode_image
from mvuav_ros.recordings.serialization.serialized_image import view_compressed_image, view_image
from mvuav_ros.recordings.sources.frame import Frame
from mvuav_ros.vision.image import ImageError

LOG_INTERVAL = 5.0
"""Seconds between two log lines of the same kind."""


class VisionNode(Node):
    """Feeds a processor with the images of ``image_raw`` and publishes what it returns.

    A frame that cannot be used is counted, reported in ``/diagnostics`` and dropped. Images are
    processed in the thread of their `ImageInput`; parameters, services and diagnostics in that of
    the executor. What both touch is guarded by one lock.
    """

    def __init__(self, processor: Processor, *, handed_over: bool = False) -> None:
        """Make the node and begin to answer images.

        Args:
            processor: the work.
            handed_over: frames come by `take` from a source in this process, not by ``image_raw``.
        """
        super().__init__(processor.name, start_parameter_services=False)
        self._lock = Lock()
        self._processor = processor
        self._live = LiveParameters(self, processor.parameters_type, self._configure)
        self._configure(self._live.current)
        self._frames, self._stamps, self._watch = FrameStatistics(), StampMonitor(), InputMonitor()
        self._logged: dict[str, float] = {}
        self._enabled = True
        self._format = ''
        self._result_publishers = {
            topic: self._publisher(kind, topic) for topic, kind in processor.topics.items()
        }
        self._debug_publishers = {
            topic: self._publisher(Image, topic) for topic in processor.debug_topics
        }
        self._periodic_publishers = {
            topic: self.create_publisher(kind, f'~/{topic}', 10)
            for topic, kind in processor.periodic_topics.items()
        }
        self._diagnostics_publisher = self.create_publisher(DiagnosticArray, '/diagnostics', 10)
        self._compressed = self.get_parameter('image_transport').value == 'compressed'
        self._input = self._handover() if handed_over else self._subscription()
        self.create_service(Trigger, '~/reset', self._on_reset)
        self.create_service(SetBool, '~/enable', self._on_enable)
        for name in processor.triggers:
            self.create_service(Trigger, f'~/{name}', self._trigger(getattr(processor, name)))
        # Wall time even under use_sim_time: diagnostics must speak when the simulation stands.
        self.create_timer(1.0, self._once_a_second, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self._input.start()

    def destroy_node(self) -> None:
        """End the images' thread, then the node."""
        self._input.close()
        super().destroy_node()

    def _publisher(self, kind: type, topic: str) -> Any:
        return self.create_publisher(
            kind,
            # Its own topics but for those that belong to all, such as /tf.
            topic if topic.startswith('/') else f'~/{topic}',
            # One for each: rclpy writes the user's overrides into it.
            QoSProfile(depth=10),
            qos_overriding_options=QoSOverridingOptions.with_default_policies(),
        )

    def _handover(self) -> IntraProcessInput:
        return IntraProcessInput(self.resolve_topic_name('image_raw'), self._on_image)

    @property
    def _camera_info_topic(self) -> str:
        """In the namespace of the images, as camera drivers and image_transport do."""
        return self.resolve_topic_name('image_raw').rsplit('/', 1)[0] + '/camera_info'

    def take(self, frame: Frame) -> None:
        """Give a frame to a node that was made with ``handed_over``; returns at once."""
        assert isinstance(self._input, IntraProcessInput)
        self._input.put(frame)

    def _subscription(self) -> ImageInput:
        images = self.resolve_topic_name('image_raw')
        infos = self._camera_info_topic if self._processor.uses_camera_info else None
        kind: type
        if self._compressed:
            # Resolved first, so that a remapping of image_raw moves the compressed topic along.
            topic, kind = f'{images}/compressed', CompressedImage
        else:
            topic, kind = 'image_raw', Image
        return ImageInput(
            self,
            kind,
            topic,
            self._on_image,
            infos,
            self._awaits_info,
            'imu' if self._processor.uses_attitude else None,
            lambda: self._processor.awaits_attitude,
        )

    def _awaits_info(self) -> bool:
        return self._processor.awaits_camera_info

    def _configure(self, parameters: ParameterSet) -> None:
        with self._lock:
            self._processor.configure(parameters)
        threads = parameters.as_dict()['opencv_threads']
        assert isinstance(threads, int)
        # OpenCV takes a negative number for its own choice.
        cv2.setNumThreads(threads if threads > 0 else -1)

    def _on_image(self, received: ReceivedImage) -> None:
        try:
            self._answer(received)
        except DuplicateStampError as error:
            self._refuse('duplicate stamp', str(error))
        except ImageError as error:
            self._refuse('bad image', str(error))
        except Exception as error:
            if not self.context.ok():
                # The process ends; nothing can be published any more.
                return
            # A defect of ours must not end the flight: it is counted and shown like a bad frame,
            # and what it may have left half done is forgotten.
            with self._lock:
                self._processor.reset()
            self._refuse('internal error', f'{type(error).__name__}: {error}')

    def _answer(self, received: ReceivedImage) -> None:
        start = time.perf_counter()
        with self._lock:
            self._frames.arrived()
            if not self._enabled:
                return
        frame = self._decode(received)
        decoded = time.perf_counter()
        with self._lock:
            self._stamps.follow(frame.stamp_ns)
            self._format = f'{frame.image.width}x{frame.image.height} {frame.image.encoding}'
            outputs = self._processor.process(frame)
        processed = time.perf_counter()
        self._publish(outputs)
        published = time.perf_counter()
        times = FrameTimes(
            transport=received.transport,
            decode=decoded - start,
            process=processed - decoded,
            publish=published - processed,
            total=published - received.taken,
        )
        debug = self._debug_wanted()
        with self._lock:
            self._frames.answer(times)
            images = self._processor.draw(debug) if debug else []
        self._publish(images)

    def _decode(self, received: ReceivedImage) -> Frame:
        data, info = received.data, received.info
        if isinstance(data, Frame):
            return data
        if self._compressed:
            compressed = view_compressed_image(data)
            image = decode_compressed_image(compressed)
            stamp_ns, frame_id = compressed.stamp_ns, compressed.frame_id
        else:
            message = view_image(data)
            image = decode_image(message)
            stamp_ns, frame_id = message.stamp_ns, message.frame_id
        camera = None if info is None else decode_camera_info(info)
        return Frame(stamp_ns, frame_id, image, camera, received.attitude)

    def _publish(self, outputs: list[Output]) -> None:
        for topic, make in outputs:
            publisher = self._result_publishers.get(topic) or self._debug_publishers[topic]
            if is_heard(publisher):
                publisher.publish(make())

    def _debug_wanted(self) -> list[str]:
        return [topic for topic, each in self._debug_publishers.items() if is_heard(each)]

    def _refuse(self, kind: str, reason: str) -> None:
        with self._lock:
            self._frames.refuse(kind, reason)
        # rclpy's own throttle goes by the line of code: one kind would silence the others.
        now = time.monotonic()
        if now - self._logged.get(kind, -LOG_INTERVAL) >= LOG_INTERVAL:
            self._logged[kind] = now
            self.get_logger().warning(f'frame dropped, {kind}: {reason}')

    def _on_reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        with self._lock:
            self._processor.reset()
        response.success, response.message = True, 'the next frame is the first'
        return response

    def _trigger(self, action: Callable[[], None]) -> Callable[..., Trigger.Response]:
        def call(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
            with self._lock:
                action()
            response.success = True
            return response

        return call

    def _on_enable(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        with self._lock:
            if request.data and not self._enabled:
                self._processor.reset()
            self._enabled = request.data
        response.success, response.message = True, self._state
        return response

    @property
    def _state(self) -> str:
        return 'running' if self._enabled else 'disabled'

    def _once_a_second(self) -> None:
        message = DiagnosticArray()
        now = self.get_clock().now()
        message.header.stamp = now.to_msg()
        with self._lock:
            message.status.append(self._status())
            periodic = self._processor.periodic(cdr_header(now.nanoseconds, ''))
        self._diagnostics_publisher.publish(message)
        for topic, make in periodic:
            self._periodic_publishers[topic].publish(make())

    def _image_publishers(self) -> list[str]:
        if isinstance(self._input, IntraProcessInput):
            return ['this process']
        infos = self.get_publishers_info_by_topic(self._input.topic)
        return [f'{info.node_namespace.rstrip("/")}/{info.node_name}' for info in infos]

    def _status(self) -> DiagnosticStatus:
        events = self._input.poll()
        publishers = self._image_publishers()
        problems = self._watch.problems(events, self._stamps)
        level = DiagnosticStatus.OK
        if self._enabled and self._frames.silent:
            never = self._frames.received == 0
            level = DiagnosticStatus.STALE if never else DiagnosticStatus.WARN
            why = silence(self._input.topic, publishers, events)
            problems = [f'no images{"" if never else f" for {WINDOW:.0f} s"}: {why}']
        elif self._enabled:
            problems += self._frames.problems()
            if len(publishers) > 1:
                problems.append(f'{len(publishers)} publishers on {self._input.topic}, mixed')
            if self._processor.status:
                problems.append(self._processor.status)
        if problems and level == DiagnosticStatus.OK:
            level = DiagnosticStatus.WARN
        values = {
            'state': self._state,
            **self._frames.values(),
            'frames_skipped': str(events.skipped),
            'frames_lost_in_transport': str(events.lost),
            'frames_missing': str(events.missing),
            'frames_left_out_by_stamps': str(self._stamps.frames_left_out),
            'stamp_rate_hz': _rate(self._stamps.spacing_ns),
            'stamp_jumps_back': str(self._processor.resets),
            'stamp_jumps_forward': str(self._stamps.jumps_forward),
            'image': self._format,
            'image_topic': self._input.topic,
            'image_publishers': ' '.join(publishers),
            'incompatible_publishers': str(events.incompatible),
        }
        return DiagnosticStatus(
            level=level,
            name=self.get_fully_qualified_name(),
            message='; '.join(problems) or self._state,
            values=[KeyValue(key=key, value=value) for key, value in values.items()],
        )


def _rate(spacing_ns: int) -> str:
    return f'{1e9 / spacing_ns:.1f}' if spacing_ns else 'nan'
