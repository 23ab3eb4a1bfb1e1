"""Video files through PyAV, and folders and globs of image files."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import suppress
from fractions import Fraction
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from mvuav_ros.messages.h264_gaps import PictureNumbers
from mvuav_ros.messages.image_files import MAX_PIXELS, decode_image_file, tiff_images
from mvuav_ros.messages.images import OPTICAL_FRAME, BadFrame, Frame, upright
from mvuav_ros.messages.untrusted import words
from mvuav_ros.recordings.account import Account, counted, needed_for
from mvuav_ros.recordings.layout import IMAGE_SUFFIXES, is_image_start, natural_key, start_of
from mvuav_ros.sources.source import BEGINNING_NS, FrameSource, SourceError
from mvuav_ros.vision.image import Image, ImageError

# Of the most pixels, four channels of 16 bits.
_MAX_FILE = MAX_PIXELS * 8 + (1 << 20)


class ImageFolder(FrameSource):
    """Image files in the order of the numbers in their paths; file k has the stamp k / rate."""

    def __init__(self, name: str, files: Sequence[Path], rate: float | None = None) -> None:
        """Take the files (in any order) that are images; the name is for people, the rate in Hz.

        Raises:
            SourceError: none is an image.
        """
        self.name = f'images {words(name)}'
        self.rate: float | None = rate or DEFAULT_RATE
        self.account = Account(f'images {name}')
        self._files = sorted((file for file in files if is_image_file(file)), key=natural_key)
        if not self._files:
            raise SourceError(
                f'{name}: no images and no bag there (images end in '
                f'{", ".join(sorted(IMAGE_SUFFIXES))}; a bag in .mcap, .db3 or .bag)'
            )
        self.count: int | None = len(self._files)

    def frames(self) -> Iterator[Frame | BadFrame]:
        """Read from the start; a file that does not decode is a `BadFrame`."""
        assert self.rate is not None
        self.account.kept = 0
        for index, file in enumerate(self._files):
            stamp_ns = round(index * 1e9 / self.rate) or BEGINNING_NS
            # The first and the last one say how long it is.
            if 0 < index < len(self._files) - 1 and stamp_ns < round(self.start_s * 1e9):
                continue
            try:
                if file.stat().st_size > _MAX_FILE:
                    raise ImageError(f'the file is larger than {_MAX_FILE >> 20} MB')
                data = np.fromfile(file, np.uint8)
                image = decode_image_file(data)
            except (ImageError, OSError) as error:
                yield BadFrame(stamp_ns, f'{file.name}: {error}')
            else:
                if (more := tiff_images(data) - 1) > 0:
                    said = f'{file.name}: only the first of its {more + 1} images is read'
                    self.account.lose('', file, said, more)
                self.account.kept += 1
                yield Frame(stamp_ns, OPTICAL_FRAME, image)


def is_image_file(file: Path) -> bool:
    """Whether a file is an image by its name or, where that says nothing, by its content."""
    suffix = file.suffix.lower()
    if suffix in IMAGE_SUFFIXES:
        return file.is_file()
    # Not by cv2.haveImageReader, which a name that is not UTF-8 crashes.
    return not suffix and is_image_start(start_of(file))


DEFAULT_RATE = 30.0
_MIN_LOSS_S = 0.5
_INDEXED = ('mov,mp4,m4a,3gp,3g2,mj2', 'matroska,webm')  # they say where their key frames are
_LEAD_IN_S = 1.0  # before a part: a key frame may be found by its time of decoding


class VideoFile(FrameSource):
    """A video file; frames carry their own times, counted from the first, and stand upright."""

    def __init__(self, path: Path, rate: float | None = None) -> None:
        """Open anything that FFmpeg reads; a ``rate``, Hz, counts instead of the file's own times.

        Raises:
            SourceError: it is not a video.
        """
        self.name = f'video {words(path.name)}'
        self.account = Account(f'video {path}')
        self._path = path
        self._given_rate = rate
        with self._open() as container:
            stream = container.streams.video[0]
            aspect = stream.sample_aspect_ratio or 1
            if aspect != 1:  # as of analogue cameras
                said = f'its pixels are {aspect.numerator}:{aspect.denominator}, not square: roll '
                said += 'and other angles in the image are wrong; convert it, for example with '
                self.account.note('aspect', f'{said}ffmpeg -i FILE -vf scale=iw*sar:ih,setsar=1')
            size = stream.codec_context.width * stream.codec_context.height
            if size > MAX_PIXELS:
                raise SourceError(f'{path}: frames of {size} pixels are too large')
            own_rate = float(stream.average_rate or 0)
            self._tick = Fraction(stream.time_base or 0)
            self._promised: int = stream.frames
            # FFmpeg has the duration of an AVI that is cut off shorter; its ticks are its frames.
            in_frames = self._tick == Fraction(1, stream.average_rate or 1)
            ticks: int = max(stream.duration or 1, self._promised if in_frames else 0)
            self._end: int = (stream.start_time or 0) + ticks
            duration_s = (container.duration or 0) / 1e6
            self._duration_s = duration_s if len(container.streams) == 1 else 0.0
        own_rate = own_rate if 0 < own_rate <= 10_000 else DEFAULT_RATE
        self.rate: float | None = rate or own_rate
        self.count: int | None = self._promised or round(duration_s * own_rate) or None

    def _open(self) -> Any:
        with needed_for(f'video {self._path}'):
            import av
        try:
            # A playlist must not lead to other machines, nor a frame be larger than it says.
            limits = {'protocol_whitelist': 'file', 'max_pixels': str(MAX_PIXELS)}
            container = av.open(_place(self._path), options=limits)
        except (av.error.FFmpegError, ValueError):
            container = None
        if container is not None and container.format.name == 'tty':  # FFmpeg draws any text
            container = None
        # Of a codec that FFmpeg does not know there is no context.
        if container is None or not any(s.codec_context for s in container.streams.video[:1]):
            said = 'is not a video that FFmpeg can read; convert it, for example with '
            said += 'ffmpeg -i FILE flight.mp4'
            if container is None and start_of(self._path)[4:8] == b'ftyp':
                said = 'lacks the index at its end, as when its recording was cut off; the program '
                said += 'untrunc may restore it, by a whole file of the same camera'
            raise SourceError(f'{self._path} {said}')
        return container

    def frames(self) -> Iterator[Frame | BadFrame]:
        """Read from the start."""
        stamps = _Stamps(self.rate or DEFAULT_RATE, 0 if self._given_rate else self._tick)
        self.account.kept = 0
        with self._open() as container:
            # AVI has no times of showing: FFmpeg's are in the order of decoding.
            by_decoding = container.format.name == 'avi'
            first = self._leave_out(container)
            if first is not None:
                yield Frame(stamps.of(first.pts), OPTICAL_FRAME, upright(first))
            reading = _Reading(container, self.account, is_part=first is not None)
            for frame, image in reading.frames():
                if first is None or (frame.pts or 0) > first.pts:  # else it is the first again
                    stamp_ns = stamps.of(frame.dts if by_decoding else frame.pts)
                    yield Frame(stamp_ns, OPTICAL_FRAME, image)
        self._note_end(None if first is not None else reading.packets, reading.end)

    def _leave_out(self, container: Any) -> Any:
        """Go to a key frame before `start_s`; gives the first frame, or None where all is read."""
        if self._given_rate or self.start_s <= _LEAD_IN_S or container.format.name not in _INDEXED:
            return None
        with self._open() as before:
            video = before.streams.video[0]
            try:
                first = next(before.decode(video))
                start = first.pts + int((self.start_s - _LEAD_IN_S) / self._tick)
                before.seek(start, stream=video)
            except (StopIteration, TypeError, ValueError, OSError):
                return None
        container.seek(start, stream=container.streams.video[0])
        return first

    def _note_end(self, packets: int | None, end: int) -> None:
        """Say what is missing behind the last of so many packets, None if not all were read."""
        end_s = float(end * self._tick)
        # AVI counts the ticks without a frame, too; Matroska counts no frames.
        if packets is not None and packets < self._promised and end < self._end:
            said = f'the video ended after {packets} of {self._promised} frames'
            self.account.lose('', 'end', said, self._promised - packets)
        elif (packets is None or self._promised == 0) and end_s < self._duration_s - _MIN_LOSS_S:
            said = f'the video ended at {end_s:.2f} s of {self._duration_s:.2f} s'
            self.account.lose('', 'end', said)


class _Reading:
    """A pass through a video's packets, which says what is lost while they are decoded.

    Attributes:
        packets: those so far that hold a frame which is to be shown.
        end: of the last packet, in the file's ticks.
    """

    def __init__(self, container: Any, account: Account, *, is_part: bool) -> None:
        self.packets = self.end = 0
        self._container, self._account, self._is_part = container, account, is_part
        self._stream = container.streams.video[0]
        self._stream.thread_type = 'AUTO'
        self._decoder = self._stream.codec_context
        is_numbered = self._decoder.name == 'h264'
        self._numbers = PictureNumbers(self._decoder.extradata or b'') if is_numbered else None
        self._said_corrupt = False  # of the packet before
        self._damaged = self._incomplete = self._gaps = 0
        self._times: list[int] = []  # of the packets by now, until there is a frame
        self._early = 0  # frames before the first
        # What others need may be lost: the decoder would make false images of them.
        self._awaits_key = False
        self._shown_from = -math.inf  # in the file's ticks

    def frames(self) -> Iterator[tuple[Any, Image]]:
        """The frames that decode, each with its image upright."""
        with suppress(ValueError, OSError):  # it cannot be read any more
            for packet in self._container.demux(self._stream):
                yield from self._read(packet)
        unread = self.packets - self._damaged - self._account.kept - self._early
        # Of other codecs not every packet is a picture.
        is_known = self._account.is_lossy or self._decoder.name == 'hevc'
        if unread > 0 and is_known and not self._is_part:
            said = f'{counted(unread, "frame")} not read, as others that they need are missing'
            self._account.lose('', 'unread', said, unread)

    def _read(self, packet: Any) -> Iterator[tuple[Any, Image]]:
        if self._numbers is not None and self._numbers.follows_loss(bytes(packet)):
            self._gaps += 1
            self._account.lose('', 'gaps', f'images are missing at {counted(self._gaps, "place")}')
            yield from self._break_off()
        if packet.size and (packet.pts or 0) >= 0:  # an edit list leaves out what is below 0
            self.packets += 1
            if self._account.kept == 0:
                self._times.append(packet.pts or 0)
        self.end = max(self.end, (packet.pts or 0) + (packet.duration or 1))
        # FFmpeg says of MPEG-TS one packet early that a part is missing.
        is_early = self._container.format.name == 'mpegts'
        is_whole = not (self._said_corrupt if is_early else packet.is_corrupt)
        self._said_corrupt = packet.is_corrupt
        if not is_whole:
            self._incomplete += 1
            said = f'parts of {counted(self._incomplete, "packet")} of the video are missing'
            self._account.lose('', 'parts', said, 0)
            yield from self._break_off()
        elif packet.is_keyframe or not self._awaits_key:
            yield from self._decoded(packet)

    def _break_off(self) -> Iterator[tuple[Any, Image]]:
        """What the decoder holds back from before a loss; the next key frame begins anew."""
        if not self._awaits_key:
            yield from self._decoded(None)
            self._decoder.flush_buffers()
            self._awaits_key, self._shown_from = True, math.inf

    def _decoded(self, packet: Any) -> Iterator[tuple[Any, Image]]:
        if self._awaits_key:
            # With open groups of pictures, frames before a key frame may come behind it.
            self._awaits_key, self._shown_from = False, packet.pts or 0
        try:
            for frame in self._decoder.decode(packet):
                if self._is_sound(frame):
                    if self._account.kept == 0:
                        self._note_start(frame.pts or 0)
                    self._account.kept += 1
                    yield frame, upright(frame)
        except (ValueError, MemoryError):  # FFmpeg's errors of invalid data are such
            self._note_damage()

    def _is_sound(self, frame: Any) -> bool:
        if frame.is_corrupt:
            self._note_damage()
        elif frame.key_frame:
            self._shown_from = min(self._shown_from, frame.pts or 0)
        return (frame.pts or 0) >= self._shown_from

    def _note_damage(self) -> None:
        self._damaged += 1
        self._shown_from = math.inf
        said = f'{self._damaged} packets of the video do not decode'
        self._account.lose('', 'packets', said, self._damaged)

    def _note_start(self, first: int) -> None:
        """Say how many frames there are before the first one, of that time, that decodes."""
        self._early = sum(pts < first for pts in self._times) - self._damaged
        if self._early > 0 and not self._is_part:
            said = f'{counted(self._early, "frame")} before the first key frame of the video'
            self._account.lose('', 'start', f'{said} not read', self._early)


class _Stamps:
    """From a video's time stamps to ns; those of a steady rate without the file's rounding."""

    def __init__(self, rate: float, tick: Fraction | int) -> None:
        self._rate, self._tick_s = rate, float(tick)  # 0: the file's times do not count
        self._first: int | None = None
        self._index = 0
        self._previous_ns = -1

    def of(self, pts: int | None) -> int:
        """The next frame's stamp, ns; ``pts`` in the file's ticks."""
        own_s = None
        if pts is not None and self._tick_s > 0:
            self._first = pts if self._first is None else self._first
            own_s = (pts - self._first) * self._tick_s
            self._index = round(own_s * self._rate)
        stamp_ns = round(self._index * 1e9 / self._rate)
        self._index += 1
        if own_s is not None and abs(own_s - stamp_ns * 1e-9) > 0.5 * self._tick_s + 1e-9:
            stamp_ns = round(own_s * 1e9)
        if stamp_ns <= self._previous_ns:  # a broken file; time goes on
            stamp_ns = self._previous_ns + round(1e9 / self._rate)
        self._previous_ns = stamp_ns
        return stamp_ns or BEGINNING_NS


def _place(path: Path) -> str | BinaryIO:
    """What FFmpeg opens: a name before a colon would be a protocol, and names must be UTF-8."""
    try:
        str(path).encode()
    except UnicodeEncodeError:
        return path.open('rb')
    return f'file:{path}'
