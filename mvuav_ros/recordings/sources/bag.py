"""The images of one topic of a bag."""

from __future__ import annotations

import struct
from collections.abc import Generator, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from mvuav_ros.recordings.errors import MalformedMessageError, RecordingError
from mvuav_ros.recordings.images import (
    CAMERA_INFO,
    IMU,
    choose_image_topic,
    decode_message,
    is_image_type,
    video_packet,
)
from mvuav_ros.recordings.reading import Recording, open_recording
from mvuav_ros.recordings.recording import RecordedMessage
from mvuav_ros.recordings.serialization.camera_info import decode_camera_info
from mvuav_ros.recordings.serialization.image_decoding import decode_compressed_image, decode_image
from mvuav_ros.recordings.serialization.imu import decode_imu
from mvuav_ros.recordings.serialization.stamp import stamp_ns_of
from mvuav_ros.recordings.sources.attitude_pairing import AttitudePairing
from mvuav_ros.recordings.sources.coded_video import VideoTopic
from mvuav_ros.recordings.sources.frame import BadFrame, Frame, SourceError
from mvuav_ros.recordings.sources.selection import EVERYTHING, Selection
from mvuav_ros.recordings.sources.stamp_pairing import StampPairing
from mvuav_ros.vision.approach.attitude import Attitude
from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.image import ImageError

_NS = 1_000_000_000
_STAMP_END = 12
_END_OF_TIME = 1 << 31
"""Seconds: a stamp has 32 bits for them."""


@dataclass(frozen=True)
class EncodedFrame:
    """A frame whose image is still the message that was recorded.

    Attributes:
        recorded: the message.
        stamp_ns: the image's own, or the recording's where the driver set none.
        camera: as in `Frame`.
        attitude: as in `Frame`.
    """

    recorded: RecordedMessage
    stamp_ns: int
    camera: CameraModel | None = None
    attitude: Attitude | None = None

    @property
    def is_compressed(self) -> bool:
        """Whether decoding takes its time."""
        return self.recorded.type.endswith('CompressedImage')

    def decoded(self) -> Frame | BadFrame:
        """The frame, or why there is none."""
        frame = _frame(self.recorded)
        if isinstance(frame, BadFrame):
            return frame
        return replace(frame, camera=self.camera, attitude=self.attitude)

    def without_data(self) -> EncodedFrame:
        """All but the message's bytes."""
        return self.with_data(b'')

    def with_data(self, data: bytes | memoryview) -> EncodedFrame:
        """With the message's bytes."""
        recorded = self.recorded
        bare = RecordedMessage(recorded.topic, recorded.type, recorded.stamp_ns, data)
        return replace(self, recorded=bare)


AnyFrame = EncodedFrame | Frame


class BagImages:
    """Image or CompressedImage messages with their own stamps and frames.

    Attributes:
        topic: the image topic.
        topics: every topic that can be read.
        camera_topic: that of the CameraInfo beside the image topic, None if there is none.
        imu_topic: that of the body's attitude: ``imu`` beside the image topic or ``/imu``; None if
            there is none.
        count: number of the images read by the newest pass; an estimate until it ends.
    """

    live = False
    rate: float | None = None

    def __init__(self, path: Path, topic: str | None = None) -> None:
        """Find the image topic.

        Args:
            path: the bag.
            topic: needed where the bag has several image topics.

        Raises:
            SourceError: it is not a bag, or the topic cannot be chosen.
        """
        self.errors: list[str] = []
        try:
            self._recording = open_recording(path)
        except RecordingError as error:
            raise SourceError(str(error)) from error
        try:
            chosen = choose_image_topic(self._recording, topic)
        except RecordingError as error:
            self._recording.close()
            raise SourceError(str(error)) from error
        self.topic = chosen.name
        self.topics = tuple(topic.name for topic in self._recording.topics)
        self.camera_topic = _camera_topic(self._recording, chosen.name)
        self.imu_topic = _imu_topic(self._recording, chosen.name)
        self._message_count = chosen.message_count
        self.count: int | None = chosen.message_count
        self.name = f'bag {path.name} {self.topic}'

    @property
    def warnings(self) -> list[str]:
        """What is unusual about the bag, though nothing of it is lost."""
        skipped = [
            f'{name} is {encoding or "of no encoding"}, not CDR: skipped'
            for name, encoding in self._recording.skipped
        ]
        return [*self._recording.warnings, *skipped]

    def frames(self) -> Iterator[Frame | BadFrame]:
        """Read from the start; a message that does not decode is a `BadFrame`.

        A stamp of zero means that the driver did not set one: the time of recording is used.

        Raises:
            SourceError: the bag cannot be read any more.
        """
        for item in self.items(camera=True, attitude=True):
            if isinstance(item, EncodedFrame):
                yield item.decoded()
            elif not isinstance(item, RecordedMessage):
                yield item

    def items(
        self,
        selection: Selection = EVERYTHING,
        *,
        others: bool = False,
        camera: bool = False,
        attitude: bool = False,
    ) -> Generator[EncodedFrame | Frame | BadFrame | RecordedMessage, None, None]:
        """Read a part of the bag in the order in which it was recorded.

        Args:
            selection: the part, by the times of recording.
            others: also give every message as it is, an image's own before its frame.
            camera: give each frame its calibration of `camera_topic` (see `StampPairing`).
            attitude: give each frame the attitude of `imu_topic` (see `AttitudePairing`).

        Yields:
            Frames that are not decoded yet, as that can be done apart (those of a video cannot,
            and are), and messages.

        Raises:
            SourceError: the bag cannot be read any more.
        """
        try:
            yield from self._items(selection, others, _Companions(self, camera, attitude))
        except RecordingError as error:
            raise SourceError(str(error)) from error
        self.errors += self._recording.errors

    def _items(
        self, selection: Selection, others: bool, companions: _Companions
    ) -> Iterator[EncodedFrame | Frame | BadFrame | RecordedMessage]:
        recording = self._recording
        origin_ns = 0
        if selection.is_part:
            companions.look_ahead(recording)
            origin_ns = next((m.stamp_ns for m in recording.messages()), 0)
        images = 0
        video = VideoTopic()
        self.count = self._estimate(selection, 0, 0)
        window = selection.window_ns(origin_ns)
        wanted = {self.topic, *companions.topics}
        for message in recording.messages(None if others else wanted, *window):
            if others:
                yield message
            companions.take(message)
            if message.topic == self.topic and is_image_type(message.type):
                for frame in _frames(message, video, images % selection.every == 0):
                    if isinstance(frame, BadFrame):
                        yield frame
                    else:
                        companions.add(frame)
                images += 1
                elapsed_ns = message.stamp_ns - (window[0] or origin_ns)
                self.count = self._estimate(selection, images, elapsed_ns)
            yield from companions.ready(wait=True)
        for frame in video.end():
            if isinstance(frame, BadFrame):
                yield frame
            else:
                companions.add(frame)
        yield from companions.ready(wait=False)

    def _estimate(self, selection: Selection, images: int, elapsed_ns: int) -> int | None:
        """The number of frames that a pass gives, from the rate so far."""
        total = self._message_count
        if selection.is_part:
            if elapsed_ns <= 0:
                return None
            rate = images / elapsed_ns * _NS
            limits = [] if total is None else [total - selection.start_s * rate]
            if selection.duration_s is not None:
                limits.append(selection.duration_s * rate)
            total = max(round(min(limits)), images) if limits else None
        return None if total is None else -(-total // selection.every)

    def close(self) -> None:
        """Remove what was unpacked for reading."""
        self._recording.close()


def _camera_topic(recording: Recording, image_topic: str) -> str | None:
    """The name that camera drivers give, beside the image topic or, if compressed, its parent."""
    base = image_topic.removesuffix('/compressed').rpartition('/')[0]
    for topic in recording.topics:
        if topic.type == CAMERA_INFO and topic.name == f'{base}/camera_info':
            return topic.name if topic.message_count != 0 else None
    return None


def _imu_topic(recording: Recording, image_topic: str) -> str | None:
    base = image_topic.removesuffix('/compressed').rpartition('/')[0]
    names = {topic.name for topic in recording.topics if topic.type == IMU and topic.message_count}
    return next((name for name in (f'{base}/imu', '/imu') if name in names), None)


class _Companions:
    """Calibrations and attitudes, which frames wait for."""

    def __init__(self, bag: BagImages, camera: bool, attitude: bool) -> None:
        self._camera_topic = bag.camera_topic if camera else None
        self._imu_topic = bag.imu_topic if attitude else None
        self.topics = {topic for topic in (self._camera_topic, self._imu_topic) if topic}
        self._cameras = StampPairing[CameraModel, AnyFrame]()
        self._attitudes = AttitudePairing[AnyFrame]()

    def look_ahead(self, recording: Recording) -> None:
        """The calibration of a part may have been published once, before the part begins."""
        if self._camera_topic is None:
            return
        for message in recording.messages({self._camera_topic}):
            if self._add_camera(message):
                return

    def take(self, message: RecordedMessage) -> None:
        """Look at a message of any topic."""
        if message.topic == self._camera_topic:
            self._add_camera(message)
        elif message.topic == self._imu_topic:
            try:
                decoded = decode_message(message.type, message.data)
            except MalformedMessageError:
                return
            self._attitudes.add_attitude(stamp_ns_of(decoded.header), decode_imu(decoded))

    def add(self, frame: AnyFrame) -> None:
        """A frame that may have to wait."""
        self._cameras.add_image(frame.stamp_ns, frame)

    def ready(self, *, wait: bool) -> Iterator[AnyFrame]:
        """Frames that need not wait any more."""
        for_camera = wait and self._camera_topic is not None
        while (pair := self._cameras.take(wait=for_camera)) is not None:
            camera, frame = pair
            whole = frame if camera is None else replace(frame, camera=camera)
            self._attitudes.add_image(frame.stamp_ns, whole)
        for_imu = wait and self._imu_topic is not None
        while (found := self._attitudes.take(wait=for_imu)) is not None:
            attitude, frame = found
            yield frame if attitude is None else replace(frame, attitude=attitude)

    def _add_camera(self, recorded: RecordedMessage) -> bool:
        """Whether the message could be read."""
        try:
            message = decode_message(recorded.type, recorded.data)
        except MalformedMessageError:
            return False
        self._cameras.add_info(stamp_ns_of(message.header), decode_camera_info(message))
        return True


def _frames(
    recorded: RecordedMessage, video: VideoTopic, wanted: bool
) -> Iterator[EncodedFrame | Frame | BadFrame]:
    """What becomes of an image's message, or of a packet of a video."""
    try:
        packet = video_packet(recorded.type, recorded.data)
    except MalformedMessageError as error:
        yield BadFrame(recorded.stamp_ns, str(error))
        return
    if packet is not None:
        packet.stamp_ns = packet.stamp_ns or recorded.stamp_ns
        yield from video.frames(packet, wanted)
    elif wanted:
        stamp_ns = _stamp_ns(recorded)
        yield EncodedFrame(recorded, stamp_ns)


def _stamp_ns(recorded: RecordedMessage) -> int:
    """What the message's header says, which stands at its beginning whatever its type."""
    if len(recorded.data) < _STAMP_END:
        return recorded.stamp_ns
    order = '<' if recorded.data[1] & 1 else '>'
    seconds, nanoseconds = struct.unpack_from(f'{order}iI', recorded.data, 4)
    return int(seconds * _NS + nanoseconds) or recorded.stamp_ns


def _frame(recorded: RecordedMessage) -> Frame | BadFrame:
    stamp_ns = recorded.stamp_ns
    try:
        message = decode_message(recorded.type, recorded.data)
        header = message.header
        stamp_ns = int(header.stamp.sec) * _NS + int(header.stamp.nanosec) or stamp_ns
        if not -_END_OF_TIME <= stamp_ns // _NS < _END_OF_TIME:
            raise ImageError('it has no stamp, and was recorded beyond the end of ROS time')
        compressed = recorded.type.endswith('CompressedImage')
        image = (decode_compressed_image if compressed else decode_image)(message)
    except (ImageError, MalformedMessageError) as error:
        return BadFrame(stamp_ns, str(error))
    return Frame(stamp_ns, header.frame_id, image)
