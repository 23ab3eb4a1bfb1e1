"""A bag's image that is not decoded yet, so that another process can do it."""

from __future__ import annotations

import struct
from dataclasses import dataclass, replace

from mvuav_ros.recordings.errors import MalformedMessageError
from mvuav_ros.recordings.images import decode_message
from mvuav_ros.recordings.recording import RecordedMessage
from mvuav_ros.recordings.serialization.image_decoding import decode_compressed_image, decode_image
from mvuav_ros.recordings.sources.frame import BadFrame, Frame
from mvuav_ros.vision.approach.attitude import Attitude
from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.image import ImageError

_NS = 1_000_000_000
_STAMP_END = 12
_END_OF_TIME = 1 << 31
"""Seconds: a stamp has 32 bits for them."""


@dataclass(frozen=True)
class EncodedFrame:
    """A frame whose image is still the message that was recorded."""

    recorded: RecordedMessage  # the message
    stamp_ns: int  # the image's own, or the recording's where the driver set none
    camera: CameraModel | None = None  # as in `Frame`
    attitude: Attitude | None = None  # as in `Frame`

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


def stamp_ns_of_image(recorded: RecordedMessage) -> int:
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
