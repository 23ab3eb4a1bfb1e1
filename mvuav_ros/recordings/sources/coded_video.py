"""Frames of topics that carry a video's packets instead of images."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from mvuav_ros.recordings.serialization.image_decoding import MAX_PIXELS
from mvuav_ros.recordings.serialization.video_packet import VideoPacket, codec_of
from mvuav_ros.recordings.sources.frame import BadFrame, Frame
from mvuav_ros.recordings.sources.video import upright

# A frame may come out behind so many others, by the standards of H.264 and H.265.
_MOST_WAITING = 32
_NOT_DECODED = (
    'its packet does not decode: the frames before it that it needs are missing, or it is damaged '
    'or too large'
)


class VideoTopic:
    """Decodes packet by packet; every packet becomes one frame, or one that cannot be used."""

    def __init__(self, *, low_delay: bool = False) -> None:
        """Begin a topic.

        With low delay the frames come in the order of their packets, as live encoders send them:
        none is held back to see whether one from before it will yet come.
        """
        self._low_delay = low_delay
        self._codec = ''
        self._decoder: Any = None
        self._number = 0
        self._waiting: dict[int, tuple[VideoPacket, bool]] = {}

    def frames(self, packet: VideoPacket, wanted: bool) -> Iterator[Frame | BadFrame]:
        """Decode a packet; frames that are not wanted are only needed for those after them."""
        codec = codec_of(packet.format)
        if not codec:
            yield BadFrame(packet.stamp_ns, f'video of format {packet.format[:40]!r} is not known')
            return
        if codec != self._codec:
            yield from self.end()
            self._codec, self._decoder = codec, None
        self._number += 1
        self._waiting[self._number] = packet, wanted
        data = bytes(packet.data)
        if data:
            yield from self._decode(data)
        else:
            # The decoder would take it for the end of the video.
            yield from self._unusable(self._number, 'its packet is empty')
        for number in [key for key in self._waiting if key <= self._number - _MOST_WAITING]:
            yield from self._unusable(number)

    def end(self) -> Iterator[Frame | BadFrame]:
        """What the decoder still holds back."""
        if self._decoder is not None:
            yield from self._decode(None)
        for number in list(self._waiting):
            yield from self._unusable(number)
        self._decoder = None

    def _decode(self, data: bytes | None) -> Iterator[Frame | BadFrame]:
        try:
            import av
        except ImportError:
            packet, _ = self._waiting.pop(self._number)
            yield BadFrame(packet.stamp_ns, f'{self._codec} needs PyAV: pip install av')
            return
        if self._decoder is None:
            self._decoder = av.CodecContext.create(self._codec, 'r')
            self._decoder.options = {
                'max_pixels': str(MAX_PIXELS),
                **({'flags': 'low_delay'} if self._low_delay else {}),
            }
        coded = None if data is None else av.Packet(data)
        if coded is not None:
            coded.pts = self._number
        try:
            decoded = self._decoder.decode(coded)
        except (av.error.FFmpegError, ValueError, MemoryError):
            if data is not None:
                yield from self._unusable(self._number)
            return
        for frame in decoded:
            waiting = self._waiting.pop(frame.pts or 0, None)
            if waiting is not None and waiting[1]:
                yield _frame(waiting[0], frame)

    def _unusable(self, number: int, reason: str = _NOT_DECODED) -> Iterator[BadFrame]:
        packet, wanted = self._waiting.pop(number)
        if wanted:
            yield BadFrame(packet.stamp_ns, reason)


def _frame(packet: VideoPacket, decoded: Any) -> Frame | BadFrame:
    try:
        return Frame(packet.stamp_ns, packet.frame_id, upright(decoded))
    except (OSError, ValueError, MemoryError) as error:
        return BadFrame(packet.stamp_ns, f'{decoded.width} x {decoded.height} pixels: {error}')
