"""What a source yields, and what a source is."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

from mvuav_ros.recordings.account import Account
from mvuav_ros.recordings.foreign import LONGEST_LINE, words
from mvuav_ros.vision.approach.attitude import Attitude
from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.image import Image

OPTICAL_FRAME = 'camera_optical_frame'
"""Frame of images whose source names none (REP-103: x right, y down, z ahead)."""


class SourceError(Exception):
    """A source that cannot be opened or read, with what the user can do about it; one line."""

    def __init__(self, text: object) -> None:
        super().__init__(words(text, LONGEST_LINE))


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
        object.__setattr__(self, 'reason', words(self.reason, LONGEST_LINE))


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
