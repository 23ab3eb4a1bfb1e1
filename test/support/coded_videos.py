"""Videos and their packets, made for the tests."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fractions import Fraction
from pathlib import Path
from types import MappingProxyType

import av
import numpy as np

from mvuav_ros.messages.cdr import CdrWriter, cdr_header

WIDTH, HEIGHT = 64, 48
UPRIGHT = b'\0\1\0\0' + bytes(12) + b'\0\1\0\0'
TURNED = bytes(4) + b'\0\1\0\0' + bytes(4) + b'\xff\xff\0\0' + bytes(4)

MIRRORED = b'\xff\xff\0\0' + bytes(12) + b'\0\1\0\0'
FLIPPED = b'\0\1\0\0' + bytes(12) + b'\xff\xff\0\0'
HALF_TURNED = b'\xff\xff\0\0' + bytes(12) + b'\xff\xff\0\0'
TRANSPOSED = bytes(4) + b'\0\1\0\0' + bytes(4) + b'\0\1\0\0' + bytes(4)


def image(number: int) -> np.ndarray:
    """Its brightness tells its number; its left half is dark."""
    pixels = np.full((HEIGHT, WIDTH, 3), 60 + 8 * number, np.uint8)
    pixels[:, : WIDTH // 2] = 16
    return pixels


def number_in(pixels: np.ndarray) -> int:
    """The number of the `image` that came out of a lossy codec."""
    return round((float(pixels[10:-10, WIDTH // 2 + 8 : -8].mean()) - 60) / 8)


def write_video(path: Path, times_ms: Sequence[int], codec: str = 'mpeg4') -> Path:
    """A video whose frames have those times."""
    with av.open(str(path), 'w') as container:
        stream = container.add_stream(codec, rate=1000)
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, 'yuv420p'
        stream.time_base = stream.codec_context.time_base = Fraction(1, 1000)
        stream.codec_context.qmax = 2
        for number, time_ms in enumerate(times_ms):
            frame = av.VideoFrame.from_ndarray(image(number % 20), format='bgr24')
            frame.pts, frame.time_base = time_ms, Fraction(1, 1000)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return path


def turn(path: Path, matrix: bytes = TURNED) -> None:
    """Have the video say that the camera was held upright, or otherwise."""
    content = path.read_bytes()
    at = content.index(UPRIGHT, content.index(b'tkhd'))
    path.write_bytes(content[:at] + matrix + content[at + len(matrix) :])


def packets(
    codec: str, count: int, b_frames: int = 0, options: Mapping[str, str] = MappingProxyType({})
) -> list[bytes]:
    """Each frame's bytes, in the order of decoding."""
    context = av.CodecContext.create(codec, 'w')
    context.width, context.height, context.pix_fmt = WIDTH, HEIGHT, 'yuv420p'
    context.time_base = Fraction(1, 20)
    context.gop_size, context.max_b_frames = 5, b_frames
    if codec.startswith('libx26'):
        options = {'tune': 'zerolatency', 'crf': '5', 'preset': 'ultrafast', **options}
    context.options = dict(options)
    made = []
    for number in range(count):
        frame = av.VideoFrame.from_ndarray(image(number), format='bgr24')
        frame.pts, frame.time_base = number, Fraction(1, 20)
        made += [bytes(packet) for packet in context.encode(frame)]
    return made + [bytes(packet) for packet in context.encode(None)]


def compressed_image(data: bytes, kind: str, stamp_ns: int) -> bytes:
    """A sensor_msgs/CompressedImage."""
    writer = CdrWriter(cdr_header(stamp_ns, 'camera'))
    writer.text(kind)
    writer.octets(data)
    return writer.message()


def ffmpeg_packet(data: bytes, kind: str, stamp_ns: int) -> bytes:
    """A ffmpeg_image_transport_msgs/FFMPEGPacket."""
    writer = CdrWriter(cdr_header(stamp_ns, 'camera'))
    writer.numbers('2i', WIDTH, HEIGHT)
    writer.text(kind)
    writer.numbers('Q', 7)
    writer.numbers('2B', 1, 0)
    writer.octets(data)
    return writer.message()


def compressed_video(data: bytes, kind: str, stamp_ns: int) -> bytes:
    """A foxglove_msgs/CompressedVideo."""
    writer = CdrWriter(cdr_header(stamp_ns, 'camera'))
    writer.octets(data)
    writer.text(kind)
    return writer.message()
