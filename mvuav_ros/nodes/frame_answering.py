"""One received image in, one set of messages out, and the account of it."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace
from threading import Lock

from rclpy.node import Node

from mvuav_ros.messages.frame import BadFrame, Frame, ImageDecoder, VideoDecoder
from mvuav_ros.messages.images import (
    COMPRESSED_IMAGE,
    COMPRESSED_VIDEO,
    FFMPEG_PACKET,
    IMAGE,
    CodedImage,
    view_coded_image,
)
from mvuav_ros.messages.sensors import decode_camera_info
from mvuav_ros.nodes.diagnostics import FrameStatistics, FrameTimes, StampMonitor
from mvuav_ros.nodes.image_input import ReceivedImage
from mvuav_ros.nodes.publishing import ResultPublishers
from mvuav_ros.processing.processor import DuplicateStampError, Processor
from mvuav_ros.vision.image import ImageError

_MOST_REMEMBERED = 64
_TYPES = {
    'raw': IMAGE,
    'compressed': COMPRESSED_IMAGE,
    'ffmpeg': FFMPEG_PACKET,
    'foxglove': COMPRESSED_VIDEO,
}
"""Of the messages of a transport."""


class FrameDecoder:
    """Decodes what comes on one topic, in its order."""

    def __init__(self, transport: str, image_topic: str = '') -> None:
        """Begin a topic of a transport; see the parameter ``image_transport``."""
        self._type = _TYPES[transport]
        self._topic = image_topic
        self._images = ImageDecoder()
        self._video = VideoDecoder(low_delay=True)
        self._received: dict[int, ReceivedImage] = {}

    def frames(self, received: ReceivedImage) -> Iterator[Frame | BadFrame]:
        """The frames that this one completes: one as a rule, none of an image that was skipped.

        Raises:
            ImageError: the message is damaged, or its image cannot be used.
        """
        data = received.data
        if isinstance(data, Frame):
            yield data
        elif self._type != IMAGE and (coded := view_coded_image(self._type, data)).is_video:
            yield from self._of_video(coded, received)
        elif not received.is_skipped:
            yield self._completed(self._images.decode(self._type, data), received)

    def _of_video(self, packet: CodedImage, received: ReceivedImage) -> Iterator[Frame | BadFrame]:
        self._received[packet.stamp_ns] = received
        while len(self._received) > _MOST_REMEMBERED:
            del self._received[next(iter(self._received))]
        for frame in self._video.frames(packet, not received.is_skipped):
            known = self._received.pop(frame.stamp_ns, None)
            if isinstance(frame, Frame) and known is not None:
                frame = self._completed(frame, known)
            yield frame

    def _completed(self, frame: Frame, received: ReceivedImage) -> Frame:
        """With the calibration and attitude that came with it."""
        if received.info is None and received.attitude is None:
            return frame
        camera = None if received.info is None else decode_camera_info(received.info, self._topic)
        return replace(frame, camera=camera, attitude=received.attitude)


_LOOK_INTERVAL = 0.05
"""Seconds between two looks at who subscribes to results."""
LOG_INTERVAL = 5.0
"""Seconds between two log lines of the same kind."""


class FrameAnswerer:
    """Feeds a processor with images and publishes what it returns.

    A frame that cannot be used is counted, logged and dropped. Called in the thread of the images;
    ``lock`` guards the processor and the statistics, which the executor's thread touches as well.
    ``stamps`` are those since the last `restart`, ``statistics`` those since the node was made;
    where it is not ``enabled``, images are counted only.
    """

    def __init__(self, node: Node, processor: Processor) -> None:
        self.lock = Lock()
        self.statistics = FrameStatistics()
        self.stamps = StampMonitor()
        self.enabled = True
        self.image_format = ''
        self._node = node
        self._processor = processor
        self._publishers: ResultPublishers | None = None
        self._decoder = FrameDecoder('raw')
        self._awaits_first = True
        self._logged: dict[str, float] = {}

    def restart(self, publishers: ResultPublishers, transport: str, topic: str) -> None:
        """Forget all from before.

        Images come as the parameter ``image_transport`` says, and belong to a topic.
        """
        with self.lock:
            self._processor.reset()
            self._publishers, self._decoder = publishers, FrameDecoder(transport, topic)
            self.stamps = StampMonitor()
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
            if not self.enabled:
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
            outputs = self._processor.process(frame)
        processed = time.perf_counter()
        publishers.publish(outputs)
        published = time.perf_counter()
        times = FrameTimes(
            transport=received.transport,
            decode=decoded - start,
            process=processed - decoded,
            publish=published - processed,
            total=published - received.taken,
        )
        publishers.look(_LOOK_INTERVAL)
        debug = publishers.debug_wanted()
        with self.lock:
            self.image_format = f'{frame.image.width}x{frame.image.height} {frame.image.encoding}'
            self.statistics.processed_one(times)
            self.stamps.follow(frame.stamp_ns)
            images = self._processor.draw(debug) if debug else []
        publishers.publish(images)
        if self._awaits_first:
            self._awaits_first = False
            self._node.get_logger().info(
                f'first image: {self.image_format}, frame {frame.frame_id!r}'
            )

    def _reject(self, kind: str, reason: str) -> None:
        with self.lock:
            self.statistics.reject(kind, reason)
        # rclpy's own throttle goes by the line of code: one kind would silence the others.
        now = time.monotonic()
        if now - self._logged.get(kind, -LOG_INTERVAL) >= LOG_INTERVAL:
            self._logged[kind] = now
            self._node.get_logger().warning(f'frame dropped, {kind}: {reason}')
