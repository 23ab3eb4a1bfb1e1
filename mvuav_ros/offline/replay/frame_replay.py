"""One frame after the other through the nodes' code, without a ROS graph."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Generator, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

from mvuav_ros.messages.cdr import cdr_header
from mvuav_ros.messages.frame import BadFrame, Frame
from mvuav_ros.messages.images import IMAGE, serialize_image
from mvuav_ros.messages.sensors import is_rectified_topic, type_name
from mvuav_ros.processing.processor import DuplicateStampError, Output, Processor, resolve
from mvuav_ros.processing.registry import PROCESSORS
from mvuav_ros.recordings.account import Account
from mvuav_ros.recordings.recording import RecordedMessage
from mvuav_ros.recordings.writing import RELIABLE_QOS
from mvuav_ros.sources.bag import BagImages
from mvuav_ros.sources.opening import open_source
from mvuav_ros.sources.source import EncodedFrame, Selection, SourceError
from mvuav_ros.vision.camera import CalibrationError, CameraModel
from mvuav_ros.vision.image import ImageError

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


_MAX_UNDER_WAY, _MIN_UNDER_WAY = 16, 3
"""Frames that are decoded ahead of the one that is written."""
_MAX_BYTES = 48 << 20
"""Of their messages and images, once there are `_MIN_UNDER_WAY`."""
DEFECT = 'internal error of'
"""What the reason begins with where the fault is ours."""


class ResultMessage(NamedTuple):
    """A node's result: its topic's full name, 'pkg/msg/Type', and CDR bytes."""

    topic: str
    type: str
    data: bytes


@dataclass(slots=True)
class FrameResults:
    """What the nodes made of one frame.

    Attributes:
        stamp_ns: the frame's, ns.
        messages: the results, node after node.
        reasons: why a node has none; empty where every node could use the frame.
        seconds: that the nodes took for it.
        is_frame: False for what nodes say once, at the end.
    """

    stamp_ns: int
    messages: list[ResultMessage] = field(default_factory=list)
    reasons: list[str] = field(default_factory=list)
    seconds: float = 0.0
    is_frame: bool = True


_UnderWay = RecordedMessage | list[Future[FrameResults]]


def make_processors(parameters: Mapping[str, Mapping[str, Any]]) -> list[Processor]:
    """The nodes' work, by their names, with the parameters that differ from the defaults.

    Raises:
        ParameterError: a parameter is unknown, or its value not valid.
    """
    processors = []
    for name, values in parameters.items():
        processor = PROCESSORS[name]()
        processor.configure(processor.parameters_type.from_mapping(values))
        processors.append(processor)
    return processors


def replay(
    items: Iterable[Frame | BadFrame | EncodedFrame | RecordedMessage],
    processors: Sequence[Processor],
    *,
    debug: bool = False,
) -> Generator[FrameResults | RecordedMessage, None, None]:
    """The nodes' results for every frame of an input, under the topics of the live nodes.

    Yields:
        The frames' results in their order, messages as they are, and last what the nodes say at
        the end.
    """
    last: Frame | None = None
    for item in items:
        if isinstance(item, EncodedFrame):
            item = item.decoded()
        if isinstance(item, RecordedMessage):
            yield item
        elif isinstance(item, BadFrame):
            yield FrameResults(item.stamp_ns, reasons=[item.reason])
        else:
            last = item
            yield merged(item.stamp_ns, [process(item, p, debug) for p in processors])
    if last is not None:
        yield merged(last.stamp_ns, [conclude(last, p) for p in processors], is_frame=False)


def replay_in_threads(
    items: Iterable[Frame | BadFrame | EncodedFrame | RecordedMessage],
    processors: Sequence[Processor],
    threads: int,
    *,
    debug: bool = False,
) -> Generator[FrameResults | RecordedMessage, None, None]:
    """As `replay`, with the same results in the same order, while other frames are decoded.

    What depends on earlier frames stays in order, in one thread for each node; what does not, the
    decoding, is done by ``threads`` more. OpenCV lets go of Python's lock for nearly all of it.
    """
    lanes = [ThreadPoolExecutor(1, f'{processor.name} ') for processor in processors]
    decoders = ThreadPoolExecutor(threads, 'decoding ')
    last: list[Frame] = []

    def work(processor: Processor, decoded: Future[Frame | BadFrame]) -> FrameResults:
        frame = decoded.result()
        if isinstance(frame, BadFrame):
            return FrameResults(frame.stamp_ns, reasons=[frame.reason])
        last[:] = [frame]
        return process(frame, processor, debug)

    def begin(item: Frame | BadFrame | EncodedFrame | RecordedMessage) -> _UnderWay:
        if isinstance(item, RecordedMessage):
            return item
        decoded = decoders.submit(item.decoded if isinstance(item, EncodedFrame) else lambda: item)
        return [
            lane.submit(work, processor, decoded)
            for lane, processor in zip(lanes, processors, strict=True)
        ]

    def size(item: Frame | BadFrame | EncodedFrame | RecordedMessage) -> int:
        """Bytes; of what is not decoded yet as many as the frame before had."""
        if isinstance(item, Frame):
            return item.image.pixels.nbytes
        if isinstance(item, EncodedFrame):
            return len(item.recorded.data) + (last[0].image.pixels.nbytes if last else 0)
        return len(item.data) if isinstance(item, RecordedMessage) else 0

    under_way: deque[tuple[_UnderWay, int]] = deque()
    bytes_under_way = 0
    try:
        for item in items:
            under_way.append((begin(item), size(item)))
            bytes_under_way += under_way[-1][1]
            while under_way and (
                _is_done(under_way[0][0])
                or len(under_way) >= _MAX_UNDER_WAY
                or (bytes_under_way > _MAX_BYTES and len(under_way) >= _MIN_UNDER_WAY)
            ):
                entry, held = under_way.popleft()
                bytes_under_way -= held
                yield _ended(entry)
        for entry, _ in under_way:
            yield _ended(entry)
        if last:
            parts = [conclude(last[0], processor) for processor in processors]
            yield merged(last[0].stamp_ns, parts, is_frame=False)
    finally:
        for executor in (*lanes, decoders):
            executor.shutdown(cancel_futures=True)


def _is_done(entry: _UnderWay) -> bool:
    return isinstance(entry, RecordedMessage) or all(part.done() for part in entry)


def _ended(entry: _UnderWay) -> FrameResults | RecordedMessage:
    if isinstance(entry, RecordedMessage):
        return entry
    parts = [part.result() for part in entry]
    return merged(parts[0].stamp_ns, parts)


def process(frame: Frame, processor: Processor, debug: bool) -> FrameResults:
    """One node's results for one frame."""
    results = FrameResults(frame.stamp_ns)
    start = time.perf_counter()
    try:
        outputs = processor.process(frame, processor.debug_topics if debug else ())
    except DuplicateStampError:
        results.reasons.append('the stamp of the frame before')
    except ImageError as error:
        results.reasons.append(str(error))
    except Exception as error:
        # As in a live node, a defect of ours costs a frame and not the flight.
        results.reasons.append(f'{DEFECT} {processor.name}: {type(error).__name__}: {error}')
    else:
        results.messages += _messages(processor, outputs)
    results.seconds = time.perf_counter() - start
    return results


def conclude(frame: Frame, processor: Processor) -> FrameResults:
    """What a node says at the end, in the name of the last frame that could be read."""
    outputs = processor.periodic(cdr_header(frame.stamp_ns, frame.frame_id))
    return FrameResults(frame.stamp_ns, _messages(processor, outputs))


def merged(stamp_ns: int, parts: Sequence[FrameResults], *, is_frame: bool = True) -> FrameResults:
    """The results of all nodes, in their order."""
    return FrameResults(
        stamp_ns,
        [message for part in parts for message in part.messages],
        list(dict.fromkeys(reason for part in parts for reason in part.reasons)),
        sum(part.seconds for part in parts),
        is_frame,
    )


def _messages(processor: Processor, outputs: Iterable[Output]) -> list[ResultMessage]:
    return [
        ResultMessage(
            resolve(topic, f'/{processor.name}'), type_name(processor.type_of(topic)), make()
        )
        for topic, make in outputs
    ]
