"""Received images as frames; a video's packets need those before them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from mvuav_ros.nodes.received_image import ReceivedImage
from mvuav_ros.recordings.serialization.image_decoding import decode_compressed_image
from mvuav_ros.recordings.serialization.messages import decode_camera_info
from mvuav_ros.recordings.serialization.raw_image import RawImageDecoder
from mvuav_ros.recordings.serialization.serialized_image import view_compressed_image
from mvuav_ros.recordings.serialization.video_packet import (
    VideoPacket,
    codec_of,
    view_compressed_video,
    view_ffmpeg_packet,
)
from mvuav_ros.recordings.sources.coded_video import VideoTopic
from mvuav_ros.recordings.sources.frame import BadFrame, Frame

_MOST_REMEMBERED = 64


class FrameDecoder:
    """Decodes what comes on one topic, in its order."""

    def __init__(self, transport: str, image_topic: str = '') -> None:
        """Begin a topic of a transport; see the parameter ``image_transport``."""
        self._transport = transport
        self._topic = image_topic
        self._raw = RawImageDecoder()
        self._video = VideoTopic(low_delay=True)
        self._received: dict[int, ReceivedImage] = {}

    def frames(self, received: ReceivedImage) -> Iterator[Frame | BadFrame]:
        """The frames that this one completes: one as a rule, none of an image that was skipped.

        Raises:
            ImageError: the message is damaged, or its image cannot be used.
        """
        data = received.data
        if isinstance(data, Frame):
            yield data
        elif self._transport == 'raw':
            yield self._completed(Frame(*self._raw.decode(data)), received)
        elif (packet := self._packet(data)) is not None:
            yield from self._of_video(packet, received)
        elif not received.is_skipped:
            coded = view_compressed_image(data)
            frame = Frame(coded.stamp_ns, coded.frame_id, decode_compressed_image(coded))
            yield self._completed(frame, received)

    def _packet(self, data: bytes) -> VideoPacket | None:
        if self._transport == 'ffmpeg':
            return view_ffmpeg_packet(data)
        if self._transport == 'foxglove':
            return view_compressed_video(data)
        coded = view_compressed_image(data)
        if not codec_of(coded.format):
            return None
        return VideoPacket(coded.stamp_ns, coded.frame_id, coded.format, coded.data)

    def _of_video(self, packet: VideoPacket, received: ReceivedImage) -> Iterator[Frame | BadFrame]:
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
