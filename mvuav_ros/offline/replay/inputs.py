"""Everything that a replay takes from its input, in one order."""

from __future__ import annotations

from collections.abc import Generator
from typing import Protocol

from mvuav_ros.recordings.images import IMAGE
from mvuav_ros.recordings.recording import RecordedMessage
from mvuav_ros.recordings.serialization.cdr import cdr_header
from mvuav_ros.recordings.serialization.serialized_image import serialize_image
from mvuav_ros.recordings.sources.bag import BagImages
from mvuav_ros.recordings.sources.encoded_frame import EncodedFrame
from mvuav_ros.recordings.sources.frame import BadFrame, Frame, FrameSource
from mvuav_ros.recordings.sources.opening import open_source
from mvuav_ros.recordings.sources.selection import Selection
from mvuav_ros.recordings.writing import RELIABLE_QOS

Item = Frame | BadFrame | EncodedFrame | RecordedMessage
IMAGE_TOPIC = '/image_raw'
"""Of the frames of a video or of image files."""


class Input(Protocol):
    """An input; ``errors`` are what cannot be read, ``warnings`` what is unusual without a loss."""

    @property
    def name(self) -> str: ...  # noqa: D102

    @property
    def count(self) -> int | None: ...  # noqa: D102

    @property
    def errors(self) -> list[str]: ...  # noqa: D102

    @property
    def warnings(self) -> list[str]: ...  # noqa: D102

    def items(
        self, keep: bool, camera: bool, attitude: bool = False
    ) -> Generator[Item, None, None]:
        """Frames, and what goes with them.

        Args:
            keep: the messages to be copied come as well.
            camera: the frames have their calibrations.
            attitude: the frames have the body's attitude.
        """
        ...

    def close(self) -> None: ...  # noqa: D102


def open_input(text: str, topic: str | None, fps: float | None, selection: Selection) -> Input:
    """Open a bag, a video, or images.

    Raises:
        SourceError: there is no such thing, or nothing in it can be read.
    """
    source = open_source(text, topic=topic, rate=fps, cameras=False)
    if isinstance(source, BagImages):
        return _Bag(source, selection)
    return _Images(source, selection)


class _Bag:
    def __init__(self, bag: BagImages, selection: Selection) -> None:
        self._bag = bag
        self._selection = selection
        self.name = bag.name

    @property
    def count(self) -> int | None:
        return self._bag.count

    @property
    def errors(self) -> list[str]:
        return self._bag.errors

    @property
    def warnings(self) -> list[str]:
        return self._bag.warnings

    def items(
        self, keep: bool, camera: bool, attitude: bool = False
    ) -> Generator[Item, None, None]:
        return self._bag.items(self._selection, others=keep, camera=camera, attitude=attitude)

    def close(self) -> None:
        self._bag.close()


class _Images:
    def __init__(self, source: FrameSource, selection: Selection) -> None:
        self._source = source
        self._selection = selection
        self.name = source.name
        self.count = selection.count(source.count, source.rate)
        self.warnings: list[str] = []

    @property
    def errors(self) -> list[str]:
        return self._source.errors

    def items(
        self, keep: bool, camera: bool, attitude: bool = False
    ) -> Generator[Item, None, None]:
        for index, frame in enumerate(self._selection.stretch(self._source.frames())):
            if keep and isinstance(frame, Frame):
                yield _message(frame)
            if index % self._selection.every == 0:
                yield frame

    def close(self) -> None:
        self._source.close()


def _message(frame: Frame) -> RecordedMessage:
    data = serialize_image(frame.image, cdr_header(frame.stamp_ns, frame.frame_id))
    return RecordedMessage(IMAGE_TOPIC, IMAGE, frame.stamp_ns, data, None, RELIABLE_QOS)
