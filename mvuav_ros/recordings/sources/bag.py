"""The images of one topic of a bag."""

from __future__ import annotations

from collections.abc import Generator, Iterator
from pathlib import Path

from mvuav_ros.recordings.errors import MalformedMessageError, RecordingError
from mvuav_ros.recordings.foreign import words
from mvuav_ros.recordings.images import choose_image_topic, is_image_type, video_packet
from mvuav_ros.recordings.reading import open_recording
from mvuav_ros.recordings.recording import RecordedMessage
from mvuav_ros.recordings.sources.coded_video import VideoTopic
from mvuav_ros.recordings.sources.companions import Companions, camera_topic_of, imu_topic_of
from mvuav_ros.recordings.sources.encoded_frame import EncodedFrame, stamp_ns_of_image
from mvuav_ros.recordings.sources.frame import BadFrame, Frame, FrameSource, SourceError
from mvuav_ros.recordings.sources.selection import EVERYTHING, Selection

_NS = 1_000_000_000


class BagImages(FrameSource):
    """Image or CompressedImage messages with their own stamps and frames.

    Attributes:
        topic: the image topic.
        topics: every topic that can be read.
        camera_topic: that of the CameraInfo beside the image topic, None if there is none.
        imu_topic: that of the body's attitude: ``imu`` beside the image topic or ``/imu``; None if
            there is none.
        count: number of the images read by the newest pass; an estimate until it ends.
    """

    rate: float | None = None

    def __init__(self, path: Path, topic: str | None = None) -> None:
        """Find the image topic.

        Args:
            path: the bag.
            topic: needed where the bag has several image topics.

        Raises:
            SourceError: it is not a bag, or the topic cannot be chosen.
        """
        try:
            self._recording = open_recording(path)
        except RecordingError as error:
            raise SourceError(str(error)) from error
        try:
            chosen = choose_image_topic(self._recording, topic)
        except RecordingError as error:
            self._recording.close()
            raise SourceError(str(error)) from error
        self.account = self._recording.account
        for name, encoding in self._recording.skipped:
            said = f'{words(name)} is {words(encoding) or "without encoding"}, not CDR: skipped'
            self.account.note(('skipped', name), said)
        self.topic = chosen.name
        self.topics = tuple(topic.name for topic in self._recording.topics)
        self.camera_topic = camera_topic_of(self._recording, chosen.name)
        self.imu_topic = imu_topic_of(self._recording, chosen.name)
        self._message_count = chosen.message_count
        self.count: int | None = chosen.message_count
        self.name = f'bag {words(path.name)} {words(self.topic)}'

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
            wanted = self.camera_topic if camera else None, self.imu_topic if attitude else None
            yield from self._items(selection, others, Companions(self.topic, *wanted))
        except RecordingError as error:
            raise SourceError(str(error)) from error

    def _items(
        self, selection: Selection, others: bool, companions: Companions
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
        topics = None if others else {self.topic, *companions.topics}
        for message in recording.messages(topics, *window):
            if others:
                yield message
            companions.take(message)
            if message.topic == self.topic and is_image_type(message.type):
                wanted = images % selection.every == 0
                yield from companions.add(_frames(message, video, wanted))
                images += 1
                elapsed_ns = message.stamp_ns - (window[0] or origin_ns)
                self.count = self._estimate(selection, images, elapsed_ns)
            yield from companions.ready(wait=True)
        yield from companions.add(video.end())
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
        stamp_ns = stamp_ns_of_image(recorded)
        yield EncodedFrame(recorded, stamp_ns)
