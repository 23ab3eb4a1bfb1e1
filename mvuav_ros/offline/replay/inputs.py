"""Everything that a replay takes from its input, in one order."""

from __future__ import annotations

from collections.abc import Generator, Iterator
from dataclasses import replace

from mvuav_ros.messages.cdr import cdr_header
from mvuav_ros.messages.frame import BadFrame, Frame
from mvuav_ros.messages.images import IMAGE, serialize_image
from mvuav_ros.messages.sensors import is_rectified_topic
from mvuav_ros.recordings.account import Account
from mvuav_ros.recordings.recording import RecordedMessage
from mvuav_ros.recordings.writing import RELIABLE_QOS
from mvuav_ros.sources.bag import BagImages
from mvuav_ros.sources.opening import open_source
from mvuav_ros.sources.source import EncodedFrame, Selection, SourceError
from mvuav_ros.vision.camera import CalibrationError, CameraModel

Item = Frame | BadFrame | EncodedFrame | RecordedMessage
IMAGE_TOPIC = '/image_raw'
"""Of the frames of a video or of image files."""


class ReplayInput:
    """A bag, a video, or images, or the part of it that a selection names."""

    def __init__(
        self,
        text: str,
        topic: str | None,
        fps: float | None,
        selection: Selection,
        camera: CameraModel | None = None,
    ) -> None:
        """Open it; ``camera`` holds for all of its images, whatever they bring along.

        Raises:
            SourceError: there is no such thing, nothing in it can be read, or the calibration is
                not one of its images.
        """
        self._source = open_source(text, topic=topic, rate=fps, cameras=False)
        self._selection = selection
        self._camera = camera
        self.name = self._source.name
        if camera is not None:
            if isinstance(self._source, BagImages) and is_rectified_topic(self._source.topic):
                self._camera = camera.rectified()
            self._check(self._camera or camera)

    def _check(self, camera: CameraModel) -> None:
        """Whether the calibration is one of the first image."""
        first = next((each for each in self._source.frames() if isinstance(each, Frame)), None)
        if first is None:
            return
        try:
            camera.check(first.image.width, first.image.height)
        except CalibrationError as error:
            self.close()
            raise SourceError(f'{self.name}: {error}') from error

    @property
    def count(self) -> int | None:
        """Number of frames as far as it is known."""
        if isinstance(self._source, BagImages):
            return self._source.count
        return self._selection.count(self._source.count, self._source.rate)

    @property
    def account(self) -> Account:
        """What cannot be read."""
        return self._source.account

    def items(self, *, keep: bool, camera: bool, attitude: bool) -> Generator[Item, None, None]:
        """Frames, and the messages to be copied (``keep``).

        Those of a bag have their calibrations and the body's attitude, if asked for.
        """
        for item in self._items(keep, camera and self._camera is None, attitude):
            if self._camera is None or isinstance(item, RecordedMessage | BadFrame):
                yield item
            else:
                yield replace(item, camera=self._camera)

    def _items(self, keep: bool, camera: bool, attitude: bool) -> Iterator[Item]:
        if isinstance(self._source, BagImages):
            yield from self._source.items(
                self._selection, others=keep, camera=camera, attitude=attitude
            )
            return
        for index, frame in enumerate(self._selection.stretch(self._source.frames())):
            if keep and isinstance(frame, Frame):
                yield _message(frame)
            if index % self._selection.every == 0:
                yield frame

    def close(self) -> None:
        """Let go of it."""
        self._source.close()


def _message(frame: Frame) -> RecordedMessage:
    data = serialize_image(frame.image, cdr_header(frame.stamp_ns, frame.frame_id))
    return RecordedMessage(IMAGE_TOPIC, IMAGE, frame.stamp_ns, data, None, RELIABLE_QOS)
