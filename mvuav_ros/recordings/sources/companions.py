"""What belongs to a bag's images: calibrations and attitudes, which frames wait for."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

from mvuav_ros.recordings.errors import MalformedMessageError
from mvuav_ros.recordings.images import CAMERA_INFO, IMU, decode_message
from mvuav_ros.recordings.reading import Recording
from mvuav_ros.recordings.recording import RecordedMessage
from mvuav_ros.recordings.serialization.messages import decode_camera_info, decode_imu, stamp_ns_of
from mvuav_ros.recordings.sources.encoded_frame import EncodedFrame
from mvuav_ros.recordings.sources.frame import BadFrame, Frame
from mvuav_ros.recordings.sources.pairing import AttitudePairing, StampPairing
from mvuav_ros.vision.camera import CameraModel

AnyFrame = EncodedFrame | Frame


def camera_topic_of(recording: Recording, image_topic: str) -> str | None:
    """The name that camera drivers give, beside the image topic or, if compressed, its parent."""
    base = image_topic.removesuffix('/compressed').rpartition('/')[0]
    for topic in recording.topics:
        if topic.type == CAMERA_INFO and topic.name == f'{base}/camera_info':
            return topic.name if topic.message_count != 0 else None
    return None


def imu_topic_of(recording: Recording, image_topic: str) -> str | None:
    """The name of the body's attitude: ``imu`` beside the image topic, or ``/imu``."""
    base = image_topic.removesuffix('/compressed').rpartition('/')[0]
    names = {topic.name for topic in recording.topics if topic.type == IMU and topic.message_count}
    return next((name for name in (f'{base}/imu', '/imu') if name in names), None)


class Companions:
    """The messages of a calibration's topic and of an attitude's, None where there is none."""

    def __init__(self, image_topic: str, camera_topic: str | None, imu_topic: str | None) -> None:
        self._image_topic = image_topic
        self._camera_topic = camera_topic
        self._imu_topic = imu_topic
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
            self._attitudes.add_info(stamp_ns_of(decoded.header), decode_imu(decoded))

    def add(self, frames: Iterable[AnyFrame | BadFrame]) -> Iterator[BadFrame]:
        """Frames that may have to wait; gives those that cannot be used."""
        for frame in frames:
            if isinstance(frame, BadFrame):
                yield frame
            else:
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
        camera = decode_camera_info(message, self._image_topic)
        self._cameras.add_info(stamp_ns_of(message.header), camera)
        return True
