"""Messages that carry one packet of a coded video."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from mvuav_ros.recordings.serialization.cdr import CdrReader

FFMPEG_PACKET = 'ffmpeg_image_transport_msgs/msg/FFMPEGPacket'
COMPRESSED_VIDEO = 'foxglove_msgs/msg/CompressedVideo'

_CODECS = ('h264', 'hevc', 'vp8', 'vp9', 'av1', 'mpeg4', 'mjpeg')
_OTHER_NAMES = {'h265': 'hevc', 'libx264': 'h264', 'libx265': 'hevc', 'x264': 'h264'}


@dataclass(slots=True)
class VideoPacket:
    """One frame's bytes; ``format`` names the codec in the message's own way."""

    stamp_ns: int
    frame_id: str
    format: str
    data: Any


def codec_of(name: str) -> str:
    """FFmpeg's name of a codec that a message names in one way or another; '' if unknown."""
    name = name.lower().split(';')[0].strip()
    name = _OTHER_NAMES.get(name, name)
    # Encoders' names begin with the codec's: h264_nvenc.
    return next((codec for codec in _CODECS if name.split('_')[0] == codec), '')


def view_ffmpeg_packet(message: bytes | memoryview) -> VideoPacket:
    """Read an FFMPEGPacket of ffmpeg_image_transport.

    Raises:
        ImageError: the bytes are no such message.
    """
    reader = CdrReader(message)
    stamp_ns, frame_id = reader.header()
    _width, _height = reader.numbers('ii')
    encoding = reader.text('encoding')
    _pts = reader.numbers('Q')
    _flags, _is_bigendian = reader.numbers('BB')
    return VideoPacket(stamp_ns, frame_id, encoding, reader.octets())


def view_compressed_video(message: bytes | memoryview) -> VideoPacket:
    """Read a CompressedVideo of Foxglove.

    Raises:
        ImageError: the bytes are no such message.
    """
    reader = CdrReader(message)
    stamp_ns, frame_id = reader.header()
    data = reader.octets()
    return VideoPacket(stamp_ns, frame_id, reader.text('format'), data)
