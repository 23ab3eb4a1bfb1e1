"""An image on its way to a node, and what became of those that never got there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

from mvuav_ros.recordings.serialization.serialized_image import stamp_ns_in
from mvuav_ros.recordings.sources.frame import Frame
from mvuav_ros.vision.approach.attitude import Attitude
from mvuav_ros.vision.image import ImageError

_CALM = 5
"""Wakes with a single image after which a node that was too slow counts as fast enough again."""
_PATIENCE = 3
"""Backlogs in a row, none smaller than the one before it, after which the node is too slow."""


class ReceivedImage(NamedTuple):
    """An image, and when it came.

    Attributes:
        data: a message in CDR, or the frame itself where source and node share a process.
        transport: seconds since it was sent, by the system clocks; NaN if unknown.
        taken: `time.perf_counter` when it was taken.
        info: the CameraInfo that holds for it, if there is one (see `StampPairing`).
        attitude: of the body at its stamp, if that is known (see `AttitudePairing`).
        is_skipped: newer ones lay waiting; only what comes after it may need it to be decoded.
    """

    data: bytes | Frame
    transport: float
    taken: float
    info: Any = None
    attitude: Attitude | None = None
    is_skipped: bool = False

    @property
    def stamp_ns(self) -> int:
        """The image's own; 0 of a message that whoever decodes it will refuse, and count."""
        if isinstance(self.data, Frame):
            return self.data.stamp_ns
        try:
            return stamp_ns_in(self.data)
        except ImageError:
            return 0


@dataclass
class InputEvents:
    """What became of images before the callback; counts since the start.

    Lost ones never arrived, as the middleware says; missing ones are left out in the publisher's
    own count, for whatever reason; skipped ones were taken, and left out as newer ones lay waiting.
    Incompatible are publishers whose QoS does not fit ours, and where the last of them differs.
    """

    lost: int = 0
    missing: int = 0
    skipped: int = 0
    incompatible: int = 0
    incompatible_policy: str = ''
    errors: int = 0
    last_error: str = ''


class InputState(NamedTuple):
    """The image topic at this moment: resolved, with the nodes that publish it."""

    topic: str
    publishers: list[str]
    events: InputEvents


class Backlog:
    """Tells a hiccup, after which every image is still answered, from being too slow."""

    def __init__(self) -> None:
        self._previous = 0
        self._not_smaller = 0
        self._too_slow = False
        self._calm = 0

    def skips(self, waiting: int) -> bool:
        """Whether all but the newest of the images that lie waiting are to be left out."""
        if waiting == 1:
            self._calm += 1
            self._not_smaller = 0
            if self._calm >= _CALM:
                self._too_slow = False
        elif waiting >= self._previous:
            self._not_smaller += 1
            if self._not_smaller >= _PATIENCE:
                self._too_slow, self._calm = True, 0
        self._previous = waiting
        return waiting > 1 and self._too_slow
