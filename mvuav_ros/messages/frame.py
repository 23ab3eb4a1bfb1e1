"""One image with its time, and how a message becomes one, live and in replay."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.messages.image_files import MAX_PIXELS
from mvuav_ros.messages.images import (
    IMAGE,
    CodedImage,
    codec_of,
    decode_compressed_image,
    decode_image,
    view_coded_image,
    view_image,
)
from mvuav_ros.messages.sensors import normalised_type
from mvuav_ros.messages.untrusted import MAX_LINE, words
from mvuav_ros.vision.approach.attitude import Attitude
from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.image import Image

OPTICAL_FRAME = 'camera_optical_frame'
"""Frame of images whose source names none (REP-103: x right, y down, z ahead)."""

_STAMP = struct.Struct('<iI')
_STAMP_START, _STAMP_END = 4, 12
_NS = 1_000_000_000
# A frame may come out behind so many others, by the standards of H.264 and H.265.
_MAX_WAITING = 32
_NOT_DECODED = (
    'its packet does not decode: the frames before it that it needs are missing, or it is damaged '
    'or too large'
)


@dataclass(frozen=True, eq=False)
class Frame:
    """One image with its time (ns) and the name of its coordinate frame.

    Attributes:
        camera: the calibration, usable or not, that holds for it; None where there is none.
        attitude: of the body that carries the camera, at that time; None where it is not known.
    """

    stamp_ns: int
    frame_id: str
    image: Image
    camera: CameraModel | None = None
    attitude: Attitude | None = None


@dataclass(frozen=True)
class BadFrame:
    """An image that was there but cannot be used, with the reason in one visible line."""

    stamp_ns: int
    reason: str

    def __post_init__(self) -> None:
        object.__setattr__(self, 'reason', words(self.reason, MAX_LINE))


class _Layout(NamedTuple):
    """What the Image messages of a camera have in common.

    ``fields`` stand between the stamp and the pixels.
    """

    size: int
    encapsulation: bytes
    fields: bytes
    frame_id: str
    encoding: str
    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    start: int
    strides: tuple[int, ...]


class ImageDecoder:
    """Decodes Image and CompressedImage messages; the same for live nodes and recordings.

    What stands before the pixels of an Image is read and judged only where the last message had it
    otherwise: the messages of one camera differ in stamp and pixels alone.
    """

    def __init__(self) -> None:
        self._layout: _Layout | None = None

    def decode(self, type_name: str, message: bytes | memoryview) -> Frame:
        """The frame in a message in CDR; the pixels of an Image are not copied.

        Raises:
            ImageError: the message is damaged, or its image cannot be used.
        """
        if type_name != IMAGE and normalised_type(type_name) != IMAGE:
            coded = view_coded_image(type_name, message)
            return Frame(coded.stamp_ns, coded.frame_id, decode_compressed_image(coded))
        known = self._layout
        if (
            known is not None
            and len(message) == known.size
            and message[:_STAMP_START] == known.encapsulation
            and message[_STAMP_END : known.start] == known.fields
        ):
            seconds, nanoseconds = _STAMP.unpack_from(message, _STAMP_START)
            if nanoseconds < _NS:
                pixels: Any = np.ndarray(
                    known.shape, known.dtype, message, known.start, known.strides
                )
                image = Image(pixels, known.encoding)
                return Frame(seconds * _NS + nanoseconds, known.frame_id, image)
        return self._read(message)

    def _read(self, message: bytes | memoryview) -> Frame:
        view = view_image(message)
        image = decode_image(view)
        octets, pixels = np.frombuffer(message, np.uint8), image.pixels
        is_little_endian = message[1] & 1
        if is_little_endian and np.may_share_memory(octets, pixels):
            start = pixels.ctypes.data - octets.ctypes.data
            self._layout = _Layout(
                size=len(message),
                encapsulation=bytes(message[:_STAMP_START]),
                fields=bytes(message[_STAMP_END:start]),
                frame_id=view.frame_id,
                encoding=image.encoding,
                shape=pixels.shape,
                dtype=pixels.dtype,
                start=start,
                strides=pixels.strides,
            )
        return Frame(view.stamp_ns, view.frame_id, image)


class VideoDecoder:
    """Decodes a video packet by packet; each becomes one frame, or one that cannot be used."""

    def __init__(self, *, low_delay: bool = False) -> None:
        """Begin a topic.

        With low delay the frames come in the order of their packets, as live encoders send them:
        none is held back to see whether one from before it will yet come.
        """
        self._low_delay = low_delay
        self._codec = ''
        self._decoder: Any = None
        self._number = 0
        self._waiting: dict[int, tuple[CodedImage, bool]] = {}

    def frames(self, packet: CodedImage, wanted: bool) -> Iterator[Frame | BadFrame]:
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
        for number in [key for key in self._waiting if key <= self._number - _MAX_WAITING]:
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


def _frame(packet: CodedImage, decoded: Any) -> Frame | BadFrame:
    try:
        return Frame(packet.stamp_ns, packet.frame_id, upright(decoded))
    except (OSError, ValueError, MemoryError) as error:
        return BadFrame(packet.stamp_ns, f'{decoded.width} x {decoded.height} pixels: {error}')


def upright(frame: Any) -> Image:
    """A decoded frame in colour, turned (and mirrored) as the camera was held."""
    pixels = frame.to_ndarray(format='bgr24')
    matrix = _display_matrix(frame)
    if matrix is None:
        turns = round(getattr(frame, 'rotation', 0) / 90) % 4
        return Image(np.ascontiguousarray(np.rot90(pixels, turns)) if turns else pixels, 'bgr8')
    # x' = a x + c y, y' = b x + d y: with a quarter turn the larger terms are b and c.
    (a, b), (c, d) = matrix
    if abs(b) + abs(c) > abs(a) + abs(d):
        pixels, a, d = pixels.swapaxes(0, 1), c, b
    pixels = pixels[:: -1 if d < 0 else 1, :: -1 if a < 0 else 1]
    return Image(np.ascontiguousarray(pixels), 'bgr8')


def _display_matrix(frame: Any) -> NDArray[np.int32] | None:
    """The upper left of the matrix by which the frame is to be shown; None without any."""
    try:
        data = frame.side_data.get('DISPLAYMATRIX')
    except (AttributeError, KeyError):  # of older versions of PyAV
        return None
    if data is None:
        return None
    return np.frombuffer(bytes(data), np.int32)[:9].reshape(3, 3)[:2, :2]
