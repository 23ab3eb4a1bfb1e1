"""Frames of a recording, one by one, through a node's code with any values, in a process apart."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from rclpy.serialization import deserialize_message

from mvuav_ros.messages.images import BadFrame, Frame, decode_image, view_image
from mvuav_ros.offline.replay.pipeline import make_processors, process
from mvuav_ros.offline.stopping import Stop
from mvuav_ros.offline.tasks import ProcessDiedError, Report, Worker
from mvuav_ros.panel.image_feed import encode_jpeg
from mvuav_ros.panel.live_results import TOPICS, Figures
from mvuav_ros.parameters.declaration import ParameterError, Value
from mvuav_ros.processing.registry import PROCESSORS
from mvuav_ros.recordings.stored_file import RecordedMessage
from mvuav_ros.sources.bag import BagImages, EncodedFrame
from mvuav_ros.sources.source import Selection, SourceError

MAX_BYTES = 256_000_000
"""Of the frames kept in memory; of a longer recording a stretch is shown."""
_WARM_UP = 30
"""Frames before the one asked for, from which a tracker gets into its state."""


@dataclass(frozen=True)
class Wanted:
    """A frame of a recording from ``start_s`` on, for a kind of node with each set of values.

    ``topics`` are those of images, calibration and attitude, see `BagImages` with ``or_first``.
    """

    source: str
    start_s: float
    kind: str
    index: int
    values: tuple[Mapping[str, Value], ...]
    topics: tuple[str, str, str] = ('', '', '')


class Result(NamedTuple):
    """What a node made of a frame: an image as JPEG and `Figures.said`, or why there are none."""

    jpeg: bytes
    said: dict[str, Any]
    reason: str


@dataclass(frozen=True)
class Shown:
    """A frame that was asked for: its place, the stretch's frames, and when it was recorded.

    ``seconds`` count from the recording's first message, as ``start_s`` of what is wanted does.
    ``topics`` are those of images, calibration and attitude: the one in use, or empty, and those
    that the node could use. ``lost`` says what could not be read.
    """

    index: int
    count: int
    seconds: float
    is_whole: bool
    results: tuple[Result, ...]
    topics: tuple[tuple[str, tuple[str, ...]], ...]
    lost: str


class ReelFailedError(RuntimeError):
    """The recording cannot be shown, with the reason."""


class ReelProcess:
    """The process of one page, begun by the first frame and ended by `end`."""

    def __init__(self) -> None:
        self._worker: Worker | None = None
        # All that is done with the process, one after the other.
        self._thread = ThreadPoolExecutor(1)

    async def show(self, wanted: Wanted) -> Shown:
        """Process a frame; ReelFailedError where that is not possible."""
        return await asyncio.get_running_loop().run_in_executor(self._thread, self._show, wanted)

    def end(self) -> None:
        """End the process, once the frame that it is at is done."""
        self._thread.submit(self._drop)
        self._thread.shutdown(wait=False)

    def _show(self, wanted: Wanted) -> Shown:
        try:
            self._worker = self._worker or Worker(Reel())
            self._worker.send(0, wanted)
            done: Any = self._worker.receive()
        except ProcessDiedError as error:
            self._drop()
            raise ReelFailedError(str(error)) from None
        if done.error is not None:
            raise ReelFailedError(str(done.error))
        shown: Shown = done.result
        return shown

    def _drop(self) -> None:
        if self._worker is not None:
            self._worker.end()
            self._worker = None


class Reel:
    """The work of the process: keeps a stretch of a recording, and each set's node in its state."""

    def __init__(self) -> None:
        self._opened: tuple[str, float] = ('', 0.0)
        self._images: BagImages | None = None
        self._items: list[EncodedFrame | Frame | BadFrame] = []
        self._is_whole, self._zero_ns = True, 0
        self._lanes: dict[int, _Lane] = {}

    def __call__(self, wanted: Wanted, report: Report, stop: Stop) -> Shown:
        """Process a frame."""
        images = self._images
        is_same = (wanted.source, wanted.start_s) == self._opened
        if images is None or not is_same or _has_others(images, wanted.topics):
            images = self._open(wanted)
        index = min(max(wanted.index, 0), len(self._items) - 1)
        results = [
            self._process(number, wanted.kind, dict(values), index)
            for number, values in enumerate(wanted.values)
        ]
        item = self._items[index]
        stamp_ns = item.recorded.stamp_ns if isinstance(item, EncodedFrame) else item.stamp_ns
        seconds = 1e-9 * (stamp_ns - self._zero_ns)
        topics = _offered(images)[: 3 if PROCESSORS[wanted.kind].uses_attitude else 2]
        given = topics, '; '.join(images.account.errors)
        return Shown(index, len(self._items), seconds, self._is_whole, tuple(results), *given)

    def _open(self, wanted: Wanted) -> BagImages:
        self._opened, self._items, self._lanes = ('', 0.0), [], {}
        source, start_s, (topic, camera, imu) = wanted.source, wanted.start_s, wanted.topics
        images, size = BagImages(Path(source), topic, imu, camera, or_first=True), 0
        try:
            origin_ns = images.origin_ns
            for item in images.items(Selection(start_s), camera=True, attitude=True):
                if not isinstance(item, RecordedMessage):
                    self._items.append(item)
                    size += _size(item)
                if size > MAX_BYTES:
                    break
        finally:
            images.close()
        if not self._items:
            raise SourceError('there are no images')
        # A video's frames have no time of recording.
        first = self._items[0]
        is_known = isinstance(first, EncodedFrame)
        self._zero_ns = origin_ns if is_known else first.stamp_ns - round(1e9 * start_s)
        self._is_whole = size <= MAX_BYTES and start_s == 0
        self._opened, self._images = (source, start_s), images
        return images

    def _process(self, number: int, kind: str, values: dict[str, Value], index: int) -> Result:
        lane = self._lanes.get(number)
        is_same = lane is not None and (lane.kind, lane.values) == (kind, values)
        if lane is None or not is_same or not lane.index <= index <= lane.index + _WARM_UP:
            try:
                lane = self._lanes[number] = _Lane(kind, values, index - _WARM_UP - 1)
            except ParameterError as error:
                return Result(b'', {}, str(error))
        for at in range(max(lane.index + 1, 0), index + 1):
            lane.result = lane.take(self._items[at], draw=at == index)
        lane.index = index
        return lane.result


class _Lane:
    """A node in its state behind the frame ``index``."""

    def __init__(self, kind: str, values: dict[str, Value], index: int) -> None:
        self.kind, self.values, self.index = kind, values, index
        self.result = Result(b'', {}, '')
        (self._processor,) = make_processors({kind: values})
        known = self._processor.parameters_type.from_mapping(values).as_dict()
        self._figures = Figures(kind, lambda: known)

    def take(self, item: EncodedFrame | Frame | BadFrame, *, draw: bool) -> Result:
        frame = item.decoded() if isinstance(item, EncodedFrame) else item
        if isinstance(frame, BadFrame):
            return Result(b'', {}, frame.reason)
        jpeg, below = b'', f'/{self.kind}/'
        results = process(frame, self._processor, draw)
        for topic, _, data in results.messages:
            name = topic.removeprefix(below)
            if name in TOPICS[self.kind]:
                self._figures.take(name, deserialize_message(data, TOPICS[self.kind][name]))
            elif name == self._processor.panel.image:
                jpeg = encode_jpeg(decode_image(view_image(data)))
        return Result(jpeg, self._figures.said(), '; '.join(results.reasons))


def _offered(images: BagImages) -> tuple[tuple[str, tuple[str, ...]], ...]:
    """The topics of images, calibration and attitude, see `Shown`."""
    used = images.topic, images.camera_topic or '', images.imu_topic or ''
    there = images.image_topics, images.camera_topics, images.imu_topics
    return tuple(zip(used, there, strict=True))


def _has_others(images: BagImages, wanted: Sequence[str]) -> bool:
    """Whether a recording has wanted topics in place of those that it is read by."""
    pairs = zip(wanted, _offered(images), strict=True)
    return any(topic != used and topic in there for topic, (used, there) in pairs)


def _size(item: EncodedFrame | Frame | BadFrame) -> int:
    """Bytes in memory, with what belongs to the objects."""
    if isinstance(item, EncodedFrame):
        return 1000 + len(item.recorded.data)
    return 1000 + (item.image.pixels.nbytes if isinstance(item, Frame) else 0)


def settable(kind: str, values: Mapping[str, Value]) -> dict[str, Value]:
    """Of a node's values those that its code takes."""
    return {n: values[n] for n in PROCESSORS[kind].parameters_type.names() if n in values}
