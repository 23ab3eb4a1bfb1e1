"""What a source is, what it yields, and which part of it is wanted."""

from __future__ import annotations

from collections.abc import Generator, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Protocol, TypeVar

from mvuav_ros.messages.frame import BadFrame, Frame, ImageDecoder
from mvuav_ros.messages.images import stamp_ns_in
from mvuav_ros.messages.untrusted import MAX_LINE, words
from mvuav_ros.recordings.account import Account
from mvuav_ros.recordings.recording import RecordedMessage
from mvuav_ros.vision.approach.attitude import Attitude
from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.image import ImageError

_NS = 1_000_000_000
_END_OF_TIME = 1 << 31
"""Seconds: a stamp has 32 bits for them."""
_DECODER = ImageDecoder()
"""Of this process; what it remembers of the last message makes it faster, and nothing else."""


@dataclass(frozen=True)
class EncodedFrame:
    """A frame whose image is still the message that was recorded, for whoever decodes it."""

    recorded: RecordedMessage  # the message
    stamp_ns: int  # the image's own, or the recording's where the driver set none
    camera: CameraModel | None = None  # as in `Frame`
    attitude: Attitude | None = None  # as in `Frame`

    def decoded(self) -> Frame | BadFrame:
        """The frame, or why there is none."""
        try:
            if not -_END_OF_TIME <= self.stamp_ns // _NS < _END_OF_TIME:
                raise ImageError('it has no stamp, and was recorded beyond the end of ROS time')
            frame = _DECODER.decode(self.recorded.type, self.recorded.data)
        except ImageError as error:
            return BadFrame(self.stamp_ns, str(error))
        return Frame(self.stamp_ns, frame.frame_id, frame.image, self.camera, self.attitude)


def stamp_ns_of_image(recorded: RecordedMessage) -> int:
    """What the message's header says; when it was recorded, if the header is 0 or damaged."""
    try:
        return stamp_ns_in(recorded.data) or recorded.stamp_ns
    except ImageError:
        return recorded.stamp_ns


class SourceError(Exception):
    """A source that cannot be opened or read, with what the user can do about it; one line."""

    def __init__(self, text: object) -> None:
        super().__init__(words(text, MAX_LINE))


class FrameSource(Protocol):
    """A stream of frames.

    Attributes:
        name: what it is, for people: ``video flight.avi``.
        rate: frames per second as far as it is known beforehand.
        count: number of frames as far as it is known beforehand.
        live: True for a camera, which cannot be read faster or slower than it comes.
        account: what could not be read; more may come while frames are read.
    """

    name: str
    rate: float | None
    count: int | None
    live: bool = False
    account: Account

    def frames(self) -> Iterator[Frame | BadFrame]:
        """Read from the start; may be called again after the end."""
        ...

    def close(self) -> None:
        """Let go of the device or file, if one is held open."""
        return


_NS = 1_000_000_000


@dataclass(frozen=True)
class Selection:
    """A stretch of time, and every N-th frame of it."""

    start_s: float = 0.0  # seconds from the source's beginning; of a bag, from its first message
    duration_s: float | None = None  # seconds from there; None: to the end
    every: int = 1  # only every N-th frame of that part, beginning with the first

    @property
    def is_part(self) -> bool:
        """Whether it leaves out some stretch of time."""
        return self.start_s > 0 or self.duration_s is not None

    def window_ns(self, origin_ns: int) -> tuple[int | None, int | None]:
        """First stamp wanted and first one not wanted any more, None where there is no limit."""
        start = origin_ns + round(self.start_s * _NS)
        end = None if self.duration_s is None else start + round(self.duration_s * _NS)
        return start if self.start_s > 0 else None, end

    def stretch(self, frames: Iterable[Frame | BadFrame]) -> Iterator[Frame | BadFrame]:
        """The frames in the stretch of time, of a source whose stamps rise from zero."""
        start, end = self.window_ns(0)
        for frame in frames:
            if end is not None and frame.stamp_ns >= end:
                return
            if start is None or frame.stamp_ns >= start:
                yield frame

    def count(self, frames: int | None, rate: float | None) -> int | None:
        """The number of frames wanted of a source that has so many at a steady rate (Hz)."""
        if frames is None or (self.is_part and not rate):
            return None
        if rate:
            frames = max(0, frames - round(self.start_s * rate))
            if self.duration_s is not None:
                frames = min(frames, round(self.duration_s * rate))
        return -(-frames // self.every)


EVERYTHING = Selection()

ItemT = TypeVar('ItemT')


def gamma_corrected(
    items: Generator[ItemT, None, None], gamma: float
) -> Generator[ItemT | Frame | BadFrame, None, None]:
    """The items with the image of every frame corrected; whatever is no frame goes through.

    A gamma above 1 darkens, 1 changes nothing. The items are closed when this is.
    """
    try:
        for item in items:
            frame = item.decoded() if isinstance(item, EncodedFrame) and gamma != 1.0 else item
            if isinstance(frame, Frame) and gamma != 1.0:
                yield replace(frame, image=frame.image.gamma_corrected(gamma))
            else:
                yield frame
    finally:
        items.close()
