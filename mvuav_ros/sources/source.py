"""What a source is, what it yields, and which part of it is wanted."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

from mvuav_ros.messages.images import BadFrame, Frame
from mvuav_ros.recordings.account import Account
from mvuav_ros.recordings.account import SourceError as SourceError


class FrameSource(Protocol):
    """A stream of frames."""

    name: str  # what it is, for people: ``video flight.avi``
    rate: float | None  # frames per second, as far as it is known beforehand
    count: int | None  # number of frames, likewise
    live: bool = False  # a camera, which cannot be read faster or slower than it comes
    account: Account  # what could not be read; more may come while frames are read
    is_rectified: bool = False  # whether its images are, as their topic's name says
    start_s: float = 0.0  # after the first frame; those between need not be read

    def frames(self) -> Iterator[Frame | BadFrame]:
        """Read from the start; may be called again after the end."""
        ...

    def close(self) -> None:
        """Let go of the device or file, if one is held open."""
        return


BEGINNING_NS = 1
"""Stamp of the first frame where none has a stamp of its own: in ROS, 0 says that there is none."""


def nothing_to_read(source: FrameSource) -> SourceError:
    """The error of a source none of whose images could be read, with what was noted of them."""
    words = f'{source.name}: there is no image to read'
    return SourceError('; '.join((words, *source.account.warnings)))


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

    def stretch(self, source: FrameSource) -> Iterator[Frame | BadFrame]:
        """The frames in it, of a source whose stamps rise; a SourceError as of `begin_within`."""
        origin_ns = last_ns = 0
        start = end = None
        for number, frame in enumerate(source.frames()):
            last_ns = frame.stamp_ns
            if number == 0:
                origin_ns = last_ns - BEGINNING_NS
                start, end = self.window_ns(origin_ns)
            if end is not None and last_ns >= end:
                return
            if start is None or last_ns >= start:
                yield frame
        if last_ns:
            self.begin_within(source.name, last_ns - origin_ns)

    def begin_within(self, name: str, length_ns: int) -> None:
        """Raise a SourceError where the start lies beyond the last image of a source."""
        if length_ns < round(self.start_s * _NS):
            said = f'the start at {self.start_s:g} s lies beyond its end'
            raise SourceError(f'{name} is {length_ns / _NS:.2f} s long: {said}')

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
