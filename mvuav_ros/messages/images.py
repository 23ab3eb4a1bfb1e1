"""One image with its time, and how a message becomes one, live and in replay, without cv_bridge.

The pixels stay where rclpy put a message's bytes; all else is looked at before it is believed.
"""

from __future__ import annotations

import struct
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.messages.cdr import STAMP_END, STAMP_START, CdrReader, CdrWriter, stamp_ns_in
from mvuav_ros.messages.h264_gaps import PictureNumbers
from mvuav_ros.messages.image_files import (
    MAX_PIXELS,
    check_size,
    compressed_size,
    decode_file_bytes,
)
from mvuav_ros.messages.sensors import normalised_type
from mvuav_ros.messages.untrusted import MAX_LINE, words
from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.frames import Attitude
from mvuav_ros.vision.image import ENCODINGS, Image, ImageError

if TYPE_CHECKING:
    from mvuav_ros.messages.poses import TransformTree
    from mvuav_ros.simulation.runway_flight import RunwayTruth
    from mvuav_ros.simulation.tanker_flight import TankerTruth

IMAGE = 'sensor_msgs/msg/Image'
COMPRESSED_IMAGE = 'sensor_msgs/msg/CompressedImage'
FFMPEG_PACKET = 'ffmpeg_image_transport_msgs/msg/FFMPEGPacket'
COMPRESSED_VIDEO = 'foxglove_msgs/msg/CompressedVideo'

_TYPES = (IMAGE, COMPRESSED_IMAGE, FFMPEG_PACKET, COMPRESSED_VIDEO)
_CODECS = ('h264', 'hevc', 'vp8', 'vp9', 'av1', 'mpeg4', 'mjpeg')
_OTHER_NAMES = {'h265': 'hevc', 'libx264': 'h264', 'libx265': 'hevc', 'x264': 'h264'}
_OTHER_NAMES |= {'libvpx': 'vp8', 'libvpx-vp9': 'vp9', 'libaom-av1': 'av1', 'libsvtav1': 'av1'}
_MEASURED = ('32FC', '64FC', '32SC', '16SC', '8SC')


@dataclass(slots=True)
class RawImage:
    """The fields of a sensor_msgs/Image, ``data`` being a view."""

    stamp_ns: int
    frame_id: str
    height: int
    width: int
    encoding: str
    is_bigendian: int
    step: int
    data: Any


@dataclass(slots=True)
class CodedImage:
    """A sensor_msgs/CompressedImage, or a packet of a video; ``data`` is a view.

    ``format`` names the codec in the message's own way; ``camera`` and ``attitude`` are those of
    the `Frame` that a packet becomes.
    """

    stamp_ns: int
    frame_id: str
    format: str
    data: Any
    is_video: bool
    camera: CameraModel | None = None
    attitude: Attitude | None = None


def is_image_type(type_name: str) -> bool:
    """Whether messages of that type are images, compressed or not, or packets of a video."""
    return normalised_type(type_name) in _TYPES


def codec_of(name: str) -> str:
    """FFmpeg's name of a codec that a message names in one way or another; '' if unknown."""
    name = name.lower().split(';')[0].strip()
    name = _OTHER_NAMES.get(name, name)
    # Encoders' names begin with the codec's: h264_nvenc.
    return next((codec for codec in _CODECS if name.split('_')[0] == codec), '')


class StampReader:
    """When the images of a topic were taken, whose publisher may set no stamp, which is then 0.

    Such an image counts from when it was sent, live, or recorded. ``missing`` is how many there
    were, ``WHY`` says what to look at.
    """

    WHY = 'have no stamp, as their publisher sets none or waits for /clock (use_sim_time)'

    def __init__(self) -> None:
        self.missing = 0

    def read(self, message: bytes | memoryview, sent_ns: int) -> int:
        """The time (ns) of a message, also of one that whoever decodes it will refuse."""
        try:
            stamp_ns = stamp_ns_in(message)
        except ImageError:
            return sent_ns
        self.missing += stamp_ns == 0
        return stamp_ns or sent_ns


def view_image(message: bytes | memoryview) -> RawImage:
    """Read a serialized sensor_msgs/Image without copying its pixels.

    Raises:
        ImageError: the bytes are no such message.
    """
    reader = CdrReader(message)
    stamp_ns, frame_id = reader.header()
    height, width = reader.numbers('II')
    encoding = reader.text('encoding')
    (is_bigendian,) = reader.numbers('B')
    (step,) = reader.numbers('I')
    return RawImage(
        stamp_ns, frame_id, height, width, encoding, is_bigendian, step, reader.octets()
    )


def view_coded_image(type_name: str, message: bytes | memoryview) -> CodedImage:
    """Read a serialized CompressedImage, FFMPEGPacket or CompressedVideo, its data not copied.

    Raises:
        ImageError: the bytes are no such message.
    """
    reader = CdrReader(message)
    stamp_ns, frame_id = reader.header()
    kind = normalised_type(type_name)
    if kind == COMPRESSED_VIDEO:
        data = reader.octets()
        return CodedImage(stamp_ns, frame_id, reader.text('format'), data, True)
    if kind == FFMPEG_PACKET:
        _width, _height = reader.numbers('ii')
        encoding = reader.text('encoding')
        _pts = reader.numbers('Q')
        _flags, _is_bigendian = reader.numbers('BB')
        return CodedImage(stamp_ns, frame_id, encoding, reader.octets(), True)
    name = reader.text('format')
    return CodedImage(stamp_ns, frame_id, name, reader.octets(), bool(codec_of(name)))


def decode_image(message: RawImage) -> Image:
    """View a message's pixels; copied only where 16 bits are not as this machine has them.

    The message may as well be a sensor_msgs/Image. The image shares memory with ``message.data``
    and is not to be written to.

    Raises:
        ImageError: the fields contradict each other, or the encoding is not known.
    """
    height, width, step = int(message.height), int(message.width), int(message.step)
    layout = ENCODINGS.get(message.encoding)
    if layout is None:
        what = f'unknown encoding {message.encoding[:40]!r}'
        if message.encoding.startswith(_MEASURED):
            what = f'{message.encoding[:40]} holds measured values without a full scale, such as '
            what += 'distances'
        raise ImageError(what)
    check_size(width, height)
    if step < width * layout.pixel_bytes:
        raise ImageError(
            f'step {step} is too short for {width} px of {message.encoding} '
            f'({width * layout.pixel_bytes} bytes)'
        )
    data = _bytes_of(message.data)
    rows = height * 3 // 2 if layout.chroma_below else height
    if len(data) != step * rows:
        raise ImageError(
            f'{width} x {height} {message.encoding} with step {step} needs {step * rows} '
            f'bytes, the message has {len(data)}'
        )
    dtype = np.dtype(layout.dtype)
    strides: tuple[int, ...] = (step, layout.pixel_bytes)
    shape: tuple[int, ...] = (rows, width)
    if layout.channels > 1:
        strides, shape = (*strides, dtype.itemsize), (*shape, layout.channels)
    pixels: NDArray[Any] = np.ndarray(shape, dtype, data.data, strides=strides)
    if dtype.itemsize > 1 and bool(message.is_bigendian) != (sys.byteorder == 'big'):
        pixels = pixels.byteswap()
    elif step % dtype.itemsize:
        pixels = pixels.copy()  # OpenCV wants every number at its own multiple
    return Image(pixels, message.encoding)


def decode_compressed_image(message: CodedImage) -> Image:
    """Decompress a JPEG, PNG, WebP or TIFF message, whichever its ``format`` says that it is.

    Grey stays ``mono8`` or ``mono16``, unless ``format`` says as image_transport does that it is
    the mosaic of a Bayer pattern; colour becomes ``bgr8``, ``bgra8`` or the same of 16 bits.

    Raises:
        ImageError: it is something else, or the data does not decode.
    """
    check_compressed_image(message)
    image = decode_file_bytes(_bytes_of(message.data))
    original = message.format.split(';')[0].strip()
    if image.is_gray and original.startswith('bayer_') and original in ENCODINGS:
        bits = 8 * image.pixels.itemsize
        image = replace(image, encoding=f'{original.rstrip("0123456789")}{bits}')
    return image


def check_compressed_image(message: CodedImage) -> tuple[int, int]:
    """The width and height (px) in a compressed image's header, before it is decompressed.

    Raises:
        ImageError: it is no JPEG, PNG, WebP or TIFF, or too large.
    """
    if 'compresseddepth' in message.format.lower():
        raise ImageError('compressedDepth holds distances, not light')
    data = _bytes_of(message.data)
    size = compressed_size(data)
    if size is None:
        raise ImageError(
            f'{len(data)} bytes of compressed data do not decode: no JPEG, PNG, WebP or TIFF '
            f'(format {message.format[:40]!r})'
        )
    check_size(*size)
    return size


def _bytes_of(data: Any) -> NDArray[np.uint8]:
    """``data`` (array.array, bytes or uint8 array) as a flat uint8 array, not copied."""
    return np.frombuffer(data, np.uint8) if len(data) else np.empty(0, np.uint8)


def serialize_image(image: Image, header: bytes) -> bytes:
    """An image as a serialized sensor_msgs/Image behind a `cdr_header`, its pixels copied once.

    They are little endian and without row padding.
    """
    pixels = np.ascontiguousarray(image.pixels)
    data = pixels.data.cast('B')
    writer = CdrWriter(header)
    writer.numbers('II', image.height, image.width)
    writer.text(image.encoding)
    is_bigendian = False
    writer.numbers('B', is_bigendian)
    writer.numbers('II', pixels.strides[0], len(data))
    start = writer.beginning()
    return b''.join((start, data, bytes(-(len(start) + len(data)) % 4)))


def serialize_compressed_image(kind: str, data: bytes, header: bytes) -> bytes:
    """A serialized sensor_msgs/CompressedImage of a kind such as ``jpeg`` behind a `cdr_header`."""
    writer = CdrWriter(header)
    writer.text(kind)
    writer.octets(data)
    return writer.message()


def serialize_jpeg(image: Image, header: bytes, quality: int = 95) -> bytes:
    """An image as a JPEG in a serialized sensor_msgs/CompressedImage behind a `cdr_header`."""
    pixels = image.pixels if image.encoding in ('mono8', '8UC1') else image.bgr()
    _, data = cv2.imencode('.jpg', pixels, [cv2.IMWRITE_JPEG_QUALITY, quality])
    return serialize_compressed_image('jpeg', data.tobytes(), header)


OPTICAL_FRAME = 'camera_optical_frame'
"""Frame of images whose source names none (REP-103: x right, y down, z ahead)."""

_NANOSECONDS, _NANOSECONDS_START = struct.Struct('<I'), 8
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
        static_transforms: those of a recording's ``/tf_static``; None where it has none.
        truth: what a simulated flight knows of it; None of any other.
    """

    stamp_ns: int
    frame_id: str
    image: Image
    camera: CameraModel | None = None
    attitude: Attitude | None = None
    static_transforms: TransformTree | None = None
    truth: TankerTruth | RunwayTruth | None = None


@dataclass(frozen=True)
class BadFrame:
    """An image that was there but cannot be used, with the reason in one visible line."""

    stamp_ns: int
    reason: str

    def __post_init__(self) -> None:
        object.__setattr__(self, 'reason', words(self.reason, MAX_LINE))


class _Layout(NamedTuple):
    """What a camera's messages have in common; ``fields`` are between the stamp and the pixels."""

    size: int
    encapsulation: bytes
    fields: bytes
    frame_id: str
    image: Callable[[bytes | memoryview], Image]


class ImageDecoder:
    """Decodes Image and CompressedImage messages; the same for live nodes and recordings.

    What stands before the pixels of an Image is read and judged only where the last message had it
    otherwise: the messages of one camera differ in stamp and pixels alone.
    """

    def __init__(self) -> None:
        self._layout: _Layout | None = None

    def decode(self, type_name: str, message: bytes | memoryview) -> tuple[str, Image]:
        """The frame_id and the image of a message in CDR; pixels of an Image are not copied.

        Raises:
            ImageError: the message is damaged, or its image cannot be used.
        """
        if type_name != IMAGE and normalised_type(type_name) != IMAGE:
            coded = view_coded_image(type_name, message)
            return coded.frame_id, decode_compressed_image(coded)
        known = self._layout
        if (
            known is not None
            and len(message) == known.size
            and message[:STAMP_START] == known.encapsulation
            and message[STAMP_END : STAMP_END + len(known.fields)] == known.fields
            and _NANOSECONDS.unpack_from(message, _NANOSECONDS_START)[0] < _NS
        ):
            return known.frame_id, known.image(message)
        return self._read(message)

    def _read(self, message: bytes | memoryview) -> tuple[str, Image]:
        view = view_image(message)
        image = decode_image(view)
        octets, pixels = np.frombuffer(message, np.uint8), image.pixels
        is_little_endian = message[1] & 1
        if is_little_endian and np.may_share_memory(octets, pixels):
            shape, dtype, strides = pixels.shape, pixels.dtype, pixels.strides
            start = pixels.ctypes.data - octets.ctypes.data

            def image_in(message: bytes | memoryview) -> Image:
                return Image(np.ndarray(shape, dtype, message, start, strides), image.encoding)

            head = bytes(message[:start])
            known = len(message), head[:STAMP_START], head[STAMP_END:], view.frame_id
            self._layout = _Layout(*known, image_in)
        return view.frame_id, image


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
        self._h264 = PictureNumbers()

    def frames(self, packet: CodedImage, wanted: bool) -> Iterator[Frame | BadFrame]:
        """Decode a packet; frames that are not wanted are only needed for those after them."""
        codec = codec_of(packet.format)
        if not codec:
            yield BadFrame(packet.stamp_ns, f'video of format {packet.format[:40]!r} is not known')
            return
        if codec != self._codec:
            yield from self.end()
            self._codec, self._decoder = codec, None
        data = bytes(packet.data)
        if codec == 'h264' and self._h264.follows_loss(data):
            yield from self._break_off()
        self._number += 1
        self._waiting[self._number] = packet, wanted
        if data:
            yield from self._decode(data)
        else:
            # The decoder would take it for the end of the video.
            yield from self._unusable(self._number, 'its packet is empty')
        for number in [key for key in self._waiting if key <= self._number - _MAX_WAITING]:
            yield from self._unusable(number)

    def end(self) -> Iterator[Frame | BadFrame]:
        """What the decoder still holds back."""
        yield from self._break_off()
        self._decoder = None

    def _break_off(self) -> Iterator[Frame | BadFrame]:
        """What the decoder holds back from before a loss; the next key frame begins anew.

        It keeps the video's parameters, which some encoders send only once.
        """
        if self._decoder is not None:
            yield from self._decode(None)
            self._decoder.flush_buffers()
        for number in list(self._waiting):
            yield from self._unusable(number)

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
                yield from self._break_off()
            return
        for frame in decoded:
            if frame.is_corrupt:
                if data is not None:
                    yield from self._break_off()
                return
            yield from self._decoded(frame)

    def _decoded(self, frame: Any) -> Iterator[Frame | BadFrame]:
        """A frame that came out, if the one who gave its packet wants it."""
        number = frame.pts or 0
        packet, wanted = self._waiting.pop(number, (None, False))
        if self._low_delay:
            # They come in the order of their packets.
            for lost in [key for key in self._waiting if key < number]:
                yield from self._unusable(lost)
        if packet is None or not wanted:
            return
        try:
            beside = packet.camera, packet.attitude
            yield Frame(packet.stamp_ns, packet.frame_id, upright(frame), *beside)
        except (OSError, ValueError, MemoryError) as error:
            reason = f'{frame.width} x {frame.height} pixels: {error}'
            yield BadFrame(packet.stamp_ns, reason)

    def _unusable(self, number: int, reason: str = _NOT_DECODED) -> Iterator[BadFrame]:
        packet, wanted = self._waiting.pop(number)
        if wanted:
            yield BadFrame(packet.stamp_ns, reason)


def upright(frame: Any) -> Image:
    """A decoded frame as the camera was held; in colour, but for grey ones of more than 8 bits."""
    is_deep = frame.format.name.startswith('gray1')
    pixels = frame.to_ndarray(format='gray16le' if is_deep else 'bgr24')
    from av.sidedata.sidedata import SideDataContainer

    # Not by `frame.side_data`, which the frame keeps and which keeps it: hundreds would pile up.
    matrix = SideDataContainer(frame).get('DISPLAYMATRIX')  # type: ignore[call-arg]
    if matrix is not None:
        # x' = a x + c y, y' = b x + d y: with a quarter turn the larger terms are b and c.
        (a, b), (c, d) = np.frombuffer(bytes(matrix), np.int32)[:9].reshape(3, 3)[:2, :2]
        if abs(b) + abs(c) > abs(a) + abs(d):
            pixels, a, d = pixels.swapaxes(0, 1), c, b
        pixels = pixels[:: -1 if d < 0 else 1, :: -1 if a < 0 else 1]
    return Image(np.ascontiguousarray(pixels), 'mono16' if is_deep else 'bgr8')
