"""Image messages: decoding them, judging them, and choosing their topic."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from rosbags.serde import SerdeError

from mvuav_ros.recordings.errors import MalformedMessageError, RecordingError
from mvuav_ros.recordings.reading import Recording
from mvuav_ros.recordings.recording import TopicInfo, normalised_type
from mvuav_ros.recordings.schemas import typestore
from mvuav_ros.recordings.serialization.serialized_image import view_compressed_image
from mvuav_ros.recordings.serialization.video_packet import (
    COMPRESSED_VIDEO,
    FFMPEG_PACKET,
    VideoPacket,
    codec_of,
    view_compressed_video,
    view_ffmpeg_packet,
)
from mvuav_ros.vision.image import ImageError

IMAGE = 'sensor_msgs/msg/Image'
COMPRESSED_IMAGE = 'sensor_msgs/msg/CompressedImage'
_VIDEO = {FFMPEG_PACKET: view_ffmpeg_packet, COMPRESSED_VIDEO: view_compressed_video}
CAMERA_INFO = 'sensor_msgs/msg/CameraInfo'
IMU = 'sensor_msgs/msg/Imu'
_MOST_NAMES = 20


def is_image_type(type_name: str) -> bool:
    """Whether messages of that type are images, compressed or not, or packets of a video."""
    return normalised_type(type_name) in (IMAGE, COMPRESSED_IMAGE, *_VIDEO)


def video_packet(type_name: str, data: bytes | memoryview) -> VideoPacket | None:
    """The packet of a video that a message carries; None of one with an image of its own.

    Raises:
        MalformedMessageError: the bytes are not a message of that type.
    """
    kind = normalised_type(type_name)
    try:
        if kind in _VIDEO:
            return _VIDEO[kind](data)
        if kind == COMPRESSED_IMAGE:
            coded = view_compressed_image(data)
            if codec_of(coded.format):
                return VideoPacket(coded.stamp_ns, coded.frame_id, coded.format, coded.data)
    except ImageError as error:
        raise MalformedMessageError(str(error)) from None
    return None


def decode_message(type_name: str, data: bytes | memoryview) -> Any:
    """Decode a message that Jazzy knows, such as Image, CompressedImage or CameraInfo.

    The object has the message's ROS field names; sequences of numbers are read-only NumPy arrays
    that look into ``data``.

    Raises:
        MalformedMessageError: the bytes are not a message of that type.
    """
    try:
        # rosbags takes slices, which copies bytes but not a view: 5 instead of 11
        # microseconds for a 640x480 mono8 image: a parser of our own would gain nothing.
        return typestore().deserialize_cdr(memoryview(data), normalised_type(type_name))
    except SerdeError as error:
        reason = str(error).rstrip('.')
        raise MalformedMessageError(f'it is no {type_name}: {reason}') from None
    except KeyError:
        raise MalformedMessageError(f'the type {type_name} is not known') from None


def choose_image_topic(recording: Recording, wanted: str | None = None) -> TopicInfo:
    """The image topic to read.

    Args:
        recording: an open recording.
        wanted: the topic's name, with or without its leading slash; if None, the only one there
            is (topics known to be empty do not count where another one is not).

    Raises:
        RecordingError: none fits, or several do and none is named; says which there are.
    """
    images = [topic for topic in recording.topics if is_image_type(topic.type)]
    choices = _listed(f'{topic.name} ({_described(topic)})' for topic in images)
    if not images:
        if not recording.topics and not recording.skipped:
            raise RecordingError(f'{recording.path} is empty: nothing was recorded in it')
        names = _listed(topic.name for topic in recording.topics) or 'nothing readable'
        skipped = _listed(f'{name} ({encoding})' for name, encoding in recording.skipped)
        raise RecordingError(
            f'{recording.path} has no image topic; it holds {names}'
            + (f'; skipped, as not CDR: {skipped}' if skipped else '')
        )
    if wanted is None:
        filled = [topic for topic in images if topic.message_count != 0] or images
        if len(filled) > 1:
            raise RecordingError(
                f'{recording.path} has several image topics, choose one of them: {choices}'
            )
        return filled[0]
    for topic in images:
        if topic.name.lstrip('/') == wanted.lstrip('/'):
            return topic
    raise RecordingError(f'{recording.path} has no image topic {wanted}; choose one of: {choices}')


def _listed(names: Iterable[str]) -> str:
    shown = list(names)
    more = f' and {len(shown) - _MOST_NAMES} more' if len(shown) > _MOST_NAMES else ''
    return ', '.join(shown[:_MOST_NAMES]) + more


def _described(topic: TopicInfo) -> str:
    kind = topic.type.rsplit('/', 1)[-1]
    return kind if topic.message_count is None else f'{kind}, {topic.message_count} messages'
