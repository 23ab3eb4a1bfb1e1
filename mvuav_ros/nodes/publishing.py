"""What a node answers to a frame: its publishers, and the one message for each listener."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from threading import Lock
from typing import Any

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import CameraInfo, CompressedImage
from sensor_msgs.msg import Image as RosImage

from mvuav_ros.messages.cdr import cdr_header
from mvuav_ros.messages.images import (
    IMAGE,
    BadFrame,
    Frame,
    ImageDecoder,
    VideoDecoder,
    serialize_image,
    serialize_jpeg,
    view_coded_image,
)
from mvuav_ros.messages.sensors import CameraInfoDecoder, encode_camera_info
from mvuav_ros.nodes.diagnostics import FrameStatistics, FrameTimes
from mvuav_ros.nodes.image_input import TRANSPORT_TYPES, ReceivedImage, camera_info_topic
from mvuav_ros.nodes.live_parameters import OVERRIDABLE
from mvuav_ros.parameters.video_source import VideoSourceParameters
from mvuav_ros.processing.processor import DuplicateStampError, Output, Processor, resolve
from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.image import Image, ImageError


def create_result_publisher(node: Node, kind: type, topic: str) -> Any:
    """A reliable publisher, which any subscriber matches, with ``qos_overrides``."""
    return node.create_publisher(
        kind,
        topic,
        # One for each: rclpy writes the user's overrides into it.
        QoSProfile(depth=10),
        qos_overriding_options=OVERRIDABLE,
    )


def is_heard(publisher: Any) -> bool:
    """Whether a message would reach a subscriber, now or, transient local, as a late joiner."""
    return bool(
        publisher.get_subscription_count() > 0
        or publisher.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
    )


_STALE = 0.1
"""Seconds from which on it is looked again before results go out."""


class ResultPublishers:
    """Publishes a processor's outputs, on the topics that it has now, where somebody listens.

    To ask for all subscribers takes 0.1 ms, so that a stream of images is asked for now and then,
    by `look` after its results are out. Whoever subscribes is found that much later at most.
    """

    def __init__(self, node: Node, processor: Processor) -> None:
        self._node = node
        self._debug_topics = processor.debug_topics
        self._publishers = {
            topic: create_result_publisher(node, kind, resolve(topic))
            for topic, kind in processor.message_types.items()
        }
        self._looked, self._heard = -math.inf, set[str]()

    def publish(self, outputs: Iterable[Output]) -> float:
        """Make and send the messages that anybody would get; how long that took of it all, s."""
        self.look(_STALE)
        seconds = 0.0
        for topic, make in outputs:
            if topic in self._heard:
                start = time.perf_counter()
                self._publishers[topic].publish(make())
                seconds += time.perf_counter() - start
        return seconds

    def look(self, at_most_every: float) -> None:
        """See which topics are heard, unless that was done so many seconds ago."""
        now = time.monotonic()
        if now - self._looked >= at_most_every:
            # In this order: results of a frame and those once a second come from two threads.
            self._heard = {topic for topic, each in self._publishers.items() if is_heard(each)}
            self._looked = now

    def debug_wanted(self) -> list[str]:
        """The debug topics that somebody looks at."""
        return [topic for topic in self._debug_topics if topic in self._heard]

    def destroy(self) -> None:
        """Take the topics off the graph."""
        for publisher in self._publishers.values():
            self._node.destroy_publisher(publisher)


_NO_CALIBRATION: tuple[Any, ...] = ((0.0,) * 9, (), '', (0.0,) * 9, (0.0,) * 12)
"""K, d, its model, R and P."""


@dataclass(eq=False)
class FramePublisher:
    """Publishes frames where somebody listens, and hands them to detectors of this process."""

    node: Node
    calibration: CameraModel | None  # None: frames keep their own, if they have one
    listeners: Sequence[Callable[[Frame], None]]

    def __post_init__(self) -> None:
        """Make the topics."""
        # Before the images, so that whoever sees those has seen these.
        self._infos = create_result_publisher(self.node, CameraInfo, camera_info_topic(self.node))
        self._images = create_result_publisher(self.node, RosImage, 'image_raw')
        # Resolved first, so that a remapping of image_raw moves the compressed topic along.
        compressed = self.node.resolve_topic_name('image_raw') + '/compressed'
        self._compressed = create_result_publisher(self.node, CompressedImage, compressed)
        self._decoder = CameraInfoDecoder(str(self._images.topic_name))

    @property
    def subscribers(self) -> int:
        """Subscriptions of the images in other processes."""
        return sum(int(p.get_subscription_count()) for p in (self._images, self._compressed))

    def destroy(self) -> None:
        """Take the topics off the graph."""
        for publisher in (self._infos, self._images, self._compressed):
            self.node.destroy_publisher(publisher)

    def publish(self, frame: Frame, given: VideoSourceParameters) -> Image:
        """Send a frame as the parameters have it; returns its image, or raises an `ImageError`."""
        image = as_encoding(frame.image, given.encoding).gamma_corrected(given.gamma)
        stamp_ns = frame.stamp_ns
        if given.stamp == 'now':
            stamp_ns = self.node.get_clock().now().nanoseconds
        frame_id = given.frame_id or frame.frame_id
        # First, so that no image has to wait for it.
        self._publish_info(frame, image, stamp_ns, frame_id)
        header = cdr_header(stamp_ns, frame_id)
        if is_heard(self._images):
            self._images.publish(serialize_image(image, header))
        if is_heard(self._compressed):
            self._compressed.publish(serialize_jpeg(image, header, given.jpeg_quality))
        return image

    def _publish_info(self, frame: Frame, image: Image, stamp_ns: int, frame_id: str) -> None:
        heard = is_heard(self._infos)
        if not heard and not self.listeners:
            return
        camera = self.calibration or frame.camera
        if camera is None:
            # All-zero matrices say that the camera is not calibrated.
            camera = CameraModel(image.width, image.height, *_NO_CALIBRATION)
        info = encode_camera_info(camera, cdr_header(stamp_ns, frame_id))
        beside = self._decoder.decode(info)[1], frame.attitude, frame.static_transforms
        for listener in self.listeners:
            listener(Frame(stamp_ns, frame_id, image, *beside))
        if heard:
            self._infos.publish(info)


def as_encoding(image: Image, encoding: str) -> Image:
    """The image in another encoding; ``source`` leaves it as it is."""
    if encoding in ('source', image.encoding):
        return image
    if encoding == 'mono8':
        gray = image.gray()
        return Image(gray if gray.dtype == 'uint8' else (gray >> 8).astype('uint8'), 'mono8')
    bgr = image.bgr()
    return Image(bgr if encoding == 'bgr8' else bgr[:, :, ::-1], encoding)


class FrameDecoder:
    """Decodes what comes on one topic, in its order."""

    def __init__(self, transport: str) -> None:
        """Begin a topic of a transport; see the parameter ``image_transport``."""
        self._type = TRANSPORT_TYPES[transport]
        self._images = ImageDecoder()
        self.forget()

    def forget(self) -> None:
        """Of a video, begin with the next key frame: packets before it are left out."""
        self._video = VideoDecoder(low_delay=True)

    def frames(self, received: ReceivedImage) -> Iterator[Frame | BadFrame]:
        """The frames that this one completes: one as a rule, none of an image that was skipped.

        Raises:
            ImageError: the message is damaged, or its image cannot be used.
        """
        data, stamp_ns = received.data, received.stamp_ns
        camera, attitude = received.camera, received.attitude
        if isinstance(data, Frame):
            camera, attitude = camera or data.camera, data.attitude or attitude
            yield replace(data, stamp_ns=stamp_ns, camera=camera, attitude=attitude)
        elif self._type != IMAGE and (coded := view_coded_image(self._type, data)).is_video:
            if received.follows_loss:
                # Most codecs would make a false image of what needs it, without a word.
                yield from self._video.end()
            coded.stamp_ns, coded.camera, coded.attitude = stamp_ns, camera, attitude
            yield from self._video.frames(coded, not received.is_skipped)
        elif not received.is_skipped:
            frame_id, image = self._images.decode(self._type, data)
            yield Frame(stamp_ns, frame_id, image, camera, attitude)


_LOOK_INTERVAL = 0.05
"""Seconds between two looks at who subscribes to results."""
LOG_INTERVAL = 5.0
"""Seconds between two log lines of the same kind."""


class FrameAnswerer:
    """Feeds a processor with images and publishes what it returns.

    A frame that cannot be used is counted, logged and dropped. Called in the thread of the images;
    ``lock`` guards the processor and the statistics, which the executor's thread touches as well.
    """

    def __init__(self, node: Node, processor: Processor) -> None:
        self.lock = Lock()
        self.statistics = FrameStatistics()
        self._node = node
        self._processor = processor
        self._publishers: ResultPublishers | None = None
        self._decoder = FrameDecoder('raw')
        self._awaits_first = True
        self._logged: dict[str, float] = {}

    def restart(self, publishers: ResultPublishers, transport: str) -> None:
        """Forget all from before; images come as the parameter ``image_transport`` says."""
        with self.lock:
            self._processor.reset()
            self._publishers, self._decoder = publishers, FrameDecoder(transport)
            self.statistics.restart()
            self._awaits_first = True

    def answer(self, received: ReceivedImage) -> None:
        """Process an image and publish its results; never raises."""
        try:
            self._answer(received)
        except (DuplicateStampError, ImageError) as error:
            kind = 'bad image' if isinstance(error, ImageError) else 'duplicate stamp'
            self._reject(kind, str(error))
        except Exception as error:
            if not self._node.context.ok():
                # The process ends; nothing can be published any more.
                return
            # A defect of ours must not end the flight: it is counted and shown like a bad frame,
            # and what it may have left half done is forgotten.
            with self.lock:
                self._processor.reset()
            self._reject('internal error', f'{type(error).__name__}: {error}')

    def _answer(self, received: ReceivedImage) -> None:
        start = time.perf_counter()
        with self.lock:
            if not received.is_skipped:
                self.statistics.arrived()
            if not self.statistics.enabled:
                self.statistics.stamps.interrupt()
                self._decoder.forget()
                return
        for frame in self._decoder.frames(received):
            if isinstance(frame, BadFrame):
                self._reject('bad image', frame.reason)
            else:
                self._process(frame, received, start)
            start = time.perf_counter()

    def _process(self, frame: Frame, received: ReceivedImage, start: float) -> None:
        publishers = self._publishers
        assert publishers is not None
        decoded = time.perf_counter()
        with self.lock:
            publish = publishers.publish(self._processor.process(frame))
        published = time.perf_counter()
        times = FrameTimes(
            transport=received.transport,
            decode=decoded - start,
            process=published - decoded - publish,
            publish=publish,
            total=published - received.taken,
        )
        publishers.look(_LOOK_INTERVAL)
        debug = publishers.debug_wanted()
        with self.lock:
            self.statistics.processed_one(frame, times)
            images = self._processor.draw(debug) if debug else []
        publishers.publish(images)
        if self._awaits_first:
            self._awaits_first = False
            self._node.get_logger().info(
                f'first image: {self.statistics.image_format}, frame {frame.frame_id!r}'
            )

    def _reject(self, kind: str, reason: str) -> None:
        with self.lock:
            self.statistics.reject(kind, reason)
        # rclpy's own throttle goes by the line of code: one kind would silence the others.
        now = time.monotonic()
        if now - self._logged.get(kind, -LOG_INTERVAL) >= LOG_INTERVAL:
            self._logged[kind] = now
            self._node.get_logger().warning(f'frame dropped, {kind}: {reason}')
