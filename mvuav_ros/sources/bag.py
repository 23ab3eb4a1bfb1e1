"""The images of one topic of a bag."""

from __future__ import annotations

from collections.abc import Generator, Iterator
from pathlib import Path

from mvuav_ros.messages.camera_info import decode_camera_info
from mvuav_ros.messages.image_decoding import decode_compressed_image, decode_image
from mvuav_ros.recording.errors import MalformedMessageError, RecordingError
from mvuav_ros.recording.images import (
    CAMERA_INFO,
    choose_image_topic,
    decode_message,
    is_image_type,
)
from mvuav_ros.recording.model import RecordedMessage
from mvuav_ros.recording.reading import Recording, open_recording
from mvuav_ros.sources.frame import BadFrame, Frame, SourceError
from mvuav_ros.sources.selection import EVERYTHING, Selection
from mvuav_ros.vision.camera_model import CameraModel
from mvuav_ros.vision.picture import ImageError

_NS = 1_000_000_000


class BagImages:
    """Image or CompressedImage messages with their own stamps and frames.

    Attributes:
        topic: the image topic.
        topics: every topic that can be read.
        camera_topic: that of the CameraInfo beside the image topic, None if there is none.
        camera: the first calibration there.
        count: number of the images read by the newest pass; an estimate until it ends.
    """

    live = False
    camera: CameraModel | None = None
    rate: float | None = None

    def __init__(self, path: Path, topic: str | None = None) -> None:
        """Find the image topic.

        Args:
            path: the bag.
            topic: needed where the bag has several image topics.

        Raises:
            SourceError: it is not a bag, or the topic cannot be chosen.
        """
        self.losses: list[str] = []
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
        self.camera = self._first_camera()
        self._message_count = chosen.message_count
        self.count: int | None = chosen.message_count
        self.name = f'bag {path.name} {self.topic}'

    @property
    def remarks(self) -> list[str]:
        """What is unusual about the bag, though nothing of it is lost."""
        skipped = [
            f'{name} is {encoding or "of no encoding"}, not CDR: skipped'
            for name, encoding in self._recording.skipped
        ]
        return [*self._recording.remarks, *skipped]

    def frames(self) -> Iterator[Frame | BadFrame]:
        """Read from the start; a message that does not decode is a `BadFrame`.

        A stamp of zero means that the driver did not set one: the time of recording is used.

        Raises:
            SourceError: the bag cannot be read any more.
        """
        for item in self.items():
            if isinstance(item, Frame | BadFrame):
                yield item

    def items(
        self, selection: Selection = EVERYTHING, *, others: bool = False, camera: bool = False
    ) -> Generator[Frame | BadFrame | CameraModel | RecordedMessage, None, None]:
        """Read a part of the bag in the order in which it was recorded.

        Args:
            selection: the part, by the times of recording.
            others: also give every message as it is, an image's own just before its frame.
            camera: also give the calibrations of `camera_topic`, the first one at once.

        Raises:
            SourceError: the bag cannot be read any more.
        """
        try:
            yield from self._items(selection, others, camera)
        except RecordingError as error:
            raise SourceError(str(error)) from error
        self.losses += self._recording.losses

    def _items(
        self, selection: Selection, others: bool, camera: bool
    ) -> Iterator[Frame | BadFrame | CameraModel | RecordedMessage]:
        recording = self._recording
        wanted = {self.topic}
        if camera and self.camera_topic is not None:
            wanted.add(self.camera_topic)
            if self.camera is not None:
                yield self.camera
        origin_ns = 0
        if selection.is_part:
            origin_ns = next((m.stamp_ns for m in recording.messages()), 0)
        images = 0
        self.count = self._estimate(selection, 0, 0)
        window = selection.window_ns(origin_ns)
        for message in recording.messages(None if others else wanted, *window):
            if others:
                yield message
            if message.topic in wanted and message.topic == self.camera_topic:
                yield from _camera(message)
            if message.topic == self.topic and is_image_type(message.type):
                if images % selection.every == 0:
                    yield _frame(message)
                images += 1
                elapsed_ns = message.stamp_ns - (window[0] or origin_ns)
                self.count = self._estimate(selection, images, elapsed_ns)

    def _first_camera(self) -> CameraModel | None:
        if self.camera_topic is None:
            return None
        messages = self._recording.messages({self.camera_topic})
        return next((camera for message in messages for camera in _camera(message)), None)

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


def _camera(message: RecordedMessage) -> Iterator[CameraModel]:
    try:
        yield decode_camera_info(decode_message(message.type, message.data))
    except MalformedMessageError:
        return


def _frame(recorded: RecordedMessage) -> Frame | BadFrame:
    stamp_ns = recorded.stamp_ns
    try:
        message = decode_message(recorded.type, recorded.data)
        header = message.header
        stamp_ns = int(header.stamp.sec) * _NS + int(header.stamp.nanosec) or stamp_ns
        compressed = recorded.type.endswith('CompressedImage')
        picture = (decode_compressed_image if compressed else decode_image)(message)
    except (ImageError, MalformedMessageError) as error:
        return BadFrame(stamp_ns, str(error))
    return Frame(stamp_ns, header.frame_id, picture)
