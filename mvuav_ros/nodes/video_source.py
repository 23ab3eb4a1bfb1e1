"""``video_source``: cameras, videos, image folders and bags as ``image_raw``."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from threading import Event, Thread
from typing import Any

import cv2
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.clock import Clock, ClockType
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.qos_overriding_options import QoSOverridingOptions
from sensor_msgs.msg import CameraInfo, CompressedImage
from sensor_msgs.msg import Image as RosImage
from std_msgs.msg import Header
from std_srvs.srv import SetBool, Trigger

from mvuav_ros.nodes.live_parameters import LiveParameters
from mvuav_ros.nodes.playback import Pace
from mvuav_ros.nodes.running import run_node
from mvuav_ros.nodes.source_status import SourceStatus
from mvuav_ros.nodes.subscribers import is_heard
from mvuav_ros.parameters.video_source import VideoSourceParameters
from mvuav_ros.processing.messages.camera_info_encoding import encode_camera_info
from mvuav_ros.processing.messages.header import make_header
from mvuav_ros.recordings.serialization.camera_info import decode_camera_info
from mvuav_ros.recordings.serialization.cdr import cdr_header
from mvuav_ros.recordings.serialization.serialized_image import (
    serialize_compressed_image,
    serialize_image,
)
from mvuav_ros.recordings.sources.calibration import Calibration, load_calibration
from mvuav_ros.recordings.sources.frame import BadFrame, Frame, FrameSource, SourceError
from mvuav_ros.recordings.sources.opening import open_source
from mvuav_ros.vision.image import Image, ImageError

RETRY_INTERVAL = 1.0
"""Seconds between two attempts to open a camera."""
LOG_INTERVAL = 5.0
SETTLING_TIME = 0.3
"""Seconds from the moment that we see a subscriber until it surely sees us."""


class VideoSource(Node):
    """Publishes a source's frames from a thread of its own, so that services stay responsive."""

    def __init__(self, listeners: Sequence[Callable[[Frame], None]] = ()) -> None:
        """Open the source and begin to publish.

        Args:
            listeners: of this process, called with each frame as it is published.
        """
        super().__init__('video_source', start_parameter_services=False)
        self._listeners = listeners
        self._live = LiveParameters(self, VideoSourceParameters, lambda _: None)
        given = self._live.current
        self._source: FrameSource = open_source(given.source, topic=given.bag_topic or None)
        self._calibration = (
            load_calibration(given.camera_info_url) if given.camera_info_url else None
        )
        # Before the images, so that whoever sees those has seen these.
        self._infos = self._publisher(CameraInfo, 'camera_info')
        self._images = self._publisher(RosImage, 'image_raw')
        # Resolved first, so that a remapping of image_raw moves the compressed topic along.
        compressed = self.resolve_topic_name('image_raw') + '/compressed'
        self._compressed = self._publisher(CompressedImage, compressed)
        self._status = SourceStatus(self._source.name)
        self._diagnostics = self.create_publisher(DiagnosticArray, '/diagnostics', 10)
        self.create_timer(1.0, self._once_a_second, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self.create_service(SetBool, '~/pause', self._on_pause)
        self.create_service(Trigger, '~/restart', self._on_restart)
        self._stop, self._interrupt, self._running = Event(), Event(), Event()
        self._running.set()
        self._rewind = False
        self.failed = False
        """Whether the source broke in a way that nothing here is made for."""
        self._thread = Thread(target=self._run, daemon=True)
        self._thread.start()

    def _publisher(self, kind: type, topic: str) -> Any:
        # Reliable, so that any subscriber matches, best effort or reliable. One QoS for each
        # publisher: rclpy writes the user's overrides into it.
        overrides = QoSOverridingOptions.with_default_policies()
        return self.create_publisher(
            kind, topic, QoSProfile(depth=10), qos_overriding_options=overrides
        )

    def destroy_node(self) -> None:
        """End the thread, then the node."""
        self._stop.set()
        self._interrupt.set()
        self._running.set()
        self._thread.join(timeout=5.0)
        self._source.close()
        super().destroy_node()

    def _on_pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        if request.data:
            self._running.clear()
        else:
            self._running.set()
        response.success, response.message = True, 'paused' if request.data else 'playing'
        return response

    def _on_restart(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._rewind = True
        self._interrupt.set()
        self._running.set()
        response.success, response.message = True, f'{self._source.name} from the start'
        return response

    def _run(self) -> None:
        try:
            self._wait_for_subscribers()
            while not self._stop.is_set():
                self._interrupt.clear()
                self._rewind = False
                self._status.state = 'playing'
                self._play()
        except ExternalShutdownException:
            pass
        except Exception as error:
            if self._stop.is_set() or not self.context.ok():
                return
            self.failed = True
            self.get_logger().fatal(f'{self._source.name}: {type(error).__name__}: {error}')
            self.context.try_shutdown()

    def _wait_for_subscribers(self) -> None:
        wanted = self._live.current.wait_for_subscribers
        if self._source.live or wanted == 0:
            return
        if self._subscribers < wanted:
            self.get_logger().info(
                f'{self._source.name}: waiting for {wanted} subscriber(s) of image_raw '
                '(wait_for_subscribers:=0 starts at once)'
            )
        while not self._stop.is_set() and self._subscribers < wanted:
            self._stop.wait(0.05)
        self._stop.wait(SETTLING_TIME)

    @property
    def _subscribers(self) -> int:
        topics = (self._images, self._compressed)
        return sum(int(each.get_subscription_count()) for each in topics) + len(self._listeners)

    def _play(self) -> None:
        """The source once from the start, then wait for a restart unless it loops."""
        pace, count, bad = Pace(), 0, 0
        try:
            for frame in self._source.frames():
                self._running.wait()
                if self._stop.is_set() or self._rewind:
                    return
                if isinstance(frame, BadFrame):
                    bad += 1
                    self._warn(f'frame skipped: {frame.reason}')
                    continue
                if not self._source.live:
                    pace.wait(frame.stamp_ns, self._live.current.rate, self._interrupt)
                    if self._rewind:
                        return
                try:
                    self._publish(frame)
                    count += 1
                except ImageError as error:
                    bad += 1
                    self._warn(f'frame skipped: {error}')
        except SourceError as error:
            self._warn(f'{error}; trying again')
            self._status.state = 'retrying'
            self._stop.wait(RETRY_INTERVAL)
            return
        self._at_end(count, bad)

    def _at_end(self, count: int, bad: int) -> None:
        for loss in self._source.losses:
            self._warn(loss)
        self._source.losses.clear()
        if self._live.current.loop and count:
            return
        self._status.state = 'ended'
        skipped = f', {bad} unusable' if bad else ''
        self.get_logger().info(
            f'end of {self._source.name} after {count} frames{skipped}; call ~/restart to play it '
            'again, or set loop'
        )
        while not (self._stop.is_set() or self._rewind or self._live.current.loop):
            self._interrupt.wait(0.2)

    def _warn(self, text: str) -> None:
        self._status.trouble(text)
        self.get_logger().warning(text, throttle_duration_sec=LOG_INTERVAL)

    def _publish(self, frame: Frame) -> None:
        given = self._live.current
        image = _as_encoding(frame.image, given.encoding).gamma_corrected(given.gamma)
        stamp_ns = frame.stamp_ns
        if given.stamp == 'now':
            stamp_ns = self.get_clock().now().nanoseconds
        frame_id = given.frame_id or frame.frame_id
        info_heard = is_heard(self._infos)
        if info_heard or self._listeners:
            info = self._camera_info(frame, image, make_header(stamp_ns, frame_id))
            for listener in self._listeners:
                listener(Frame(stamp_ns, frame_id, image, decode_camera_info(info)))
            # First, so that no image has to wait for it.
            if info_heard:
                self._infos.publish(info)
        header = cdr_header(stamp_ns, frame_id)
        if is_heard(self._images):
            self._images.publish(serialize_image(image, header))
        if is_heard(self._compressed):
            self._compressed.publish(_jpeg(image, header, given.jpeg_quality))
        self._status.published(image)

    def _camera_info(self, frame: Frame, image: Image, header: Header) -> CameraInfo:
        if self._calibration is None and frame.camera is not None:
            return encode_camera_info(frame.camera, header)
        return _camera_info(self._calibration, image, header)

    def _once_a_second(self) -> None:
        paused = not self._running.is_set()
        message = DiagnosticArray()
        message.header.stamp = self.get_clock().now().to_msg()
        name = self.get_fully_qualified_name()
        message.status.append(self._status.report(name, paused, self._subscribers))
        self._diagnostics.publish(message)


def _as_encoding(image: Image, encoding: str) -> Image:
    if encoding in ('source', image.encoding):
        return image
    if encoding == 'mono8':
        gray = image.gray()
        return Image(gray if gray.dtype == 'uint8' else (gray >> 8).astype('uint8'), 'mono8')
    bgr = image.bgr()
    return Image(bgr if encoding == 'bgr8' else bgr[:, :, ::-1], encoding)


def _jpeg(image: Image, header: bytes, quality: int) -> bytes:
    gray = image.encoding in ('mono8', '8UC1')
    pixels = image.pixels if gray else image.bgr()
    _, data = cv2.imencode('.jpg', pixels, [cv2.IMWRITE_JPEG_QUALITY, quality])
    return serialize_compressed_image('jpeg', data.tobytes(), header)


def _camera_info(calibration: Calibration | None, image: Image, header: Header) -> CameraInfo:
    """All-zero matrices say that the camera is not calibrated."""
    info = CameraInfo(header=header, width=image.width, height=image.height)
    if calibration is not None:
        info.width, info.height = calibration.width, calibration.height
        info.distortion_model = calibration.distortion_model
        info.d, info.k, info.r, info.p = (
            list(calibration.d),
            list(calibration.k),
            list(calibration.r),
            list(calibration.p),
        )
    return info


def main() -> None:
    """Run the node."""
    sys.exit(run_node(VideoSource, camera_images=True))


if __name__ == '__main__':
    main()
