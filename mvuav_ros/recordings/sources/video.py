"""Video files through PyAV."""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.recordings.account import Account
from mvuav_ros.recordings.foreign import words
from mvuav_ros.recordings.serialization.image_decoding import MAX_PIXELS
from mvuav_ros.recordings.sources.frame import (
    OPTICAL_FRAME,
    BadFrame,
    Frame,
    FrameSource,
    SourceError,
)
from mvuav_ros.vision.image import Image

DEFAULT_RATE = 30.0
_SHORTEST_LOSS_S = 0.5


class VideoFile(FrameSource):
    """A video file; frames carry their own times, counted from the first, and stand upright."""

    def __init__(self, path: Path, rate: float | None = None) -> None:
        """Open the file.

        Args:
            path: anything that FFmpeg reads.
            rate: frames per second, instead of the file's own times.

        Raises:
            SourceError: it is not a video.
        """
        self.name = f'video {words(path.name)}'
        self.account = Account(self.name)
        self._path = path
        self._given_rate = rate
        with self._open() as container:
            stream = container.streams.video[0]
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
        self._own_rate = own_rate if 0 < own_rate <= 10_000 else DEFAULT_RATE
        self.rate: float | None = rate or self._own_rate
        self.count: int | None = self._promised or round(duration_s * self._own_rate) or None

    def _open(self) -> Any:
        try:
            import av
        except ImportError as error:
            raise SourceError(
                f'{self._path}: reading videos needs PyAV: pip install av, or apt install '
                f'python3-av ({error})'
            ) from error
        try:
            # A playlist must not lead to other machines, nor a frame be larger than it says.
            limits = {'protocol_whitelist': 'file', 'max_pixels': str(MAX_PIXELS)}
            container = av.open(_place(self._path), options=limits)
        except (av.error.FFmpegError, ValueError):
            container = None
        # Of a codec that FFmpeg does not know there is no context.
        if container is None or not any(s.codec_context for s in container.streams.video[:1]):
            raise SourceError(
                f'{self._path} is not a video that FFmpeg can read; convert it, for example with '
                'ffmpeg -i FILE flight.mp4'
            )
        return container

    def frames(self) -> Iterator[Frame | BadFrame]:
        """Read from the start."""
        stamps = _Stamps(self._given_rate, self._own_rate, self._tick)
        packets = damaged = end = self.account.kept = 0
        with self._open() as container:
            stream = container.streams.video[0]
            stream.thread_type = 'AUTO'
            for packet in _packets(container, stream):
                packets += packet.size > 0
                end = max(end, (packet.pts or 0) + (packet.duration or 1))
                try:
                    for frame in packet.decode():
                        self.account.kept += 1
                        yield Frame(stamps.of(frame.pts), OPTICAL_FRAME, upright(frame))
                except (ValueError, MemoryError):  # FFmpeg's errors of invalid data are such
                    damaged += 1
        if damaged:
            said = f'{damaged} packets of the video do not decode'
            self.account.lose('', 'packets', said, damaged)
        self._note_end(packets, end)

    def _note_end(self, packets: int, end: int) -> None:
        """Say what is missing behind the last packet, which ends at that tick."""
        end_s = float(end * self._tick)
        # AVI counts the ticks without a frame, too; Matroska counts no frames.
        if packets < self._promised and end < self._end:
            said = f'the video ended after {packets} of {self._promised} frames'
            self.account.lose('', 'end', said, self._promised - packets)
        elif self._promised == 0 and end_s < self._duration_s - _SHORTEST_LOSS_S:
            said = f'the video ended at {end_s:.2f} s of {self._duration_s:.2f} s'
            self.account.lose('', 'end', said)


class _Stamps:
    """From a video's time stamps to ns; those of a steady rate without the file's rounding."""

    def __init__(self, given_rate: float | None, own_rate: float, tick: Fraction) -> None:
        self._given_rate = given_rate
        self._rate = given_rate or own_rate
        self._tick_s = float(tick)
        self._first: int | None = None
        self._index = 0
        self._previous_ns = -1

    def of(self, pts: int | None) -> int:
        """The next frame's stamp, ns; ``pts`` in the file's ticks."""
        stamp_ns = round(self._index * 1e9 / self._rate)
        self._index += 1
        if self._given_rate is None and pts is not None and self._tick_s > 0:
            self._first = pts if self._first is None else self._first
            own_s = (pts - self._first) * self._tick_s
            if abs(own_s - stamp_ns * 1e-9) > 0.5 * self._tick_s + 1e-9:
                stamp_ns = round(own_s * 1e9)
        if stamp_ns <= self._previous_ns:  # a broken file; time goes on
            stamp_ns = self._previous_ns + round(1e9 / self._rate)
        self._previous_ns = stamp_ns
        return stamp_ns


def _place(path: Path) -> str | BinaryIO:
    """What FFmpeg opens: a name before a colon would be a protocol, and names must be UTF-8."""
    try:
        str(path).encode()
    except UnicodeEncodeError:
        return path.open('rb')
    return f'file:{path}'


def _packets(container: Any, stream: Any) -> Iterator[Any]:
    """The packets up to the file's end or to where it cannot be read any more."""
    packets = container.demux(stream)
    while True:
        try:
            yield next(packets)
        except (StopIteration, ValueError, OSError):
            return


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
