"""Frames through the nodes: their results in order, by one thread or by several."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

from mvuav_ros.messages.cdr import cdr_header
from mvuav_ros.messages.images import BadFrame, Frame
from mvuav_ros.messages.sensors import type_name
from mvuav_ros.processing.processor import DuplicateStampError, Output, Processor, resolve
from mvuav_ros.processing.registry import PROCESSORS
from mvuav_ros.recordings.stored_file import RecordedMessage
from mvuav_ros.sources.bag import EncodedFrame
from mvuav_ros.vision.image import ImageError

Item = Frame | BadFrame | EncodedFrame | RecordedMessage
_MAX_UNDER_WAY, _MIN_UNDER_WAY = 16, 3
"""Frames that are decoded ahead of the one that is written."""
_MAX_BYTES = 48 << 20
"""Of their messages and images, once there are `_MIN_UNDER_WAY`."""
_NO_CAMERA = 'no pose: no calibration comes with the images, and --camera-info names none'
DEFECT = 'internal error of'
"""What the reason begins with where the fault is ours."""


class ResultMessage(NamedTuple):
    """A node's result: its topic's full name, 'pkg/msg/Type', and CDR bytes."""

    topic: str
    type: str
    data: bytes


@dataclass(slots=True)
class FrameResults:
    """What the nodes made of one frame."""

    stamp_ns: int
    messages: list[ResultMessage] = field(default_factory=list)  # node after node
    reasons: list[str] = field(default_factory=list)  # why a node could not use the frame
    statuses: dict[str, str] = field(default_factory=dict)  # of those that could: what was missing
    seconds: float = 0.0  # that the nodes took for it
    is_frame: bool = True  # False for what nodes say once, at the end


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
    items: Iterable[Item],
    processors: Sequence[Processor],
    *,
    threads: int = 1,
    debug: bool = False,
    gamma: float = 1.0,
) -> Generator[FrameResults | RecordedMessage, None, None]:
    """The nodes' results for every frame of an input, under the topics of the live nodes.

    One thread does all of it itself. Of several, one reads and hands on, the others decode, and
    each node has another one, as it depends on earlier frames; the results are the same. OpenCV
    lets go of Python's lock for nearly all of the work.

    Yields:
        The frames' results in their order, messages as they are, and last what the nodes say at
        the end.
    """
    under_way: deque[_UnderWay] = deque()
    held = 0
    with closing(_Lanes(processors, threads, debug, gamma)) as lanes:
        for item in items:
            under_way.append(lanes.begin(item))
            held += under_way[-1].size
            while under_way and (
                under_way[0].is_done
                or len(under_way) >= _MAX_UNDER_WAY
                or (held > _MAX_BYTES and len(under_way) >= _MIN_UNDER_WAY)
            ):
                held -= under_way[0].size
                yield under_way.popleft().result()
        for entry in under_way:
            yield entry.result()
        if lanes.last is not None:
            yield merged([conclude(lanes.last, processor) for processor in processors])


class _Finished:
    """What was done at once, in the place of a future."""

    def __init__(self, function: Callable[..., Any], *given: Any) -> None:
        self._result = function(*given)

    def done(self) -> bool:
        return True

    def result(self) -> Any:
        return self._result


_Part = Future[Any] | _Finished


class _UnderWay(NamedTuple):
    """A message, or the parts of a frame's results, and how much it holds, bytes."""

    message: RecordedMessage | None
    parts: list[_Part]
    size: int

    @property
    def is_done(self) -> bool:
        return all(part.done() for part in self.parts)

    def result(self) -> FrameResults | RecordedMessage:
        return self.message or merged([part.result() for part in self.parts])


class _Lanes:
    """The threads of a replay: some decode, each node has one; ``last`` is the newest frame."""

    def __init__(
        self, processors: Sequence[Processor], threads: int, debug: bool, gamma: float
    ) -> None:
        self.last: Frame | None = None
        self._debug, self._gamma = debug, gamma
        self._pools: list[ThreadPoolExecutor] = []
        self._decode = self._lane('decoding', threads - 1)
        self._nodes = [(each, self._lane(each.name, min(threads - 1, 1))) for each in processors]

    def _lane(self, name: str, size: int) -> Callable[..., _Part]:
        if size == 0:
            return _Finished
        self._pools.append(ThreadPoolExecutor(size, f'{name} '))
        return self._pools[-1].submit

    def begin(self, item: Item) -> _UnderWay:
        if isinstance(item, RecordedMessage):
            return _UnderWay(item, [], len(item.data))
        decoded = self._decode(_decoded, item, self._gamma)
        parts = [submit(self._work, processor, decoded) for processor, submit in self._nodes]
        return _UnderWay(None, parts, self._size(item))

    def close(self) -> None:
        for pool in self._pools:
            pool.shutdown(cancel_futures=True)

    def _work(self, processor: Processor, decoded: _Part) -> FrameResults:
        frame = decoded.result()
        if isinstance(frame, BadFrame):
            return FrameResults(frame.stamp_ns, reasons=[frame.reason])
        self.last = frame
        return process(frame, processor, self._debug)

    def _size(self, item: Frame | BadFrame | EncodedFrame) -> int:
        """Bytes; of what is not decoded yet as many as the frame before had."""
        if isinstance(item, Frame):
            return item.image.pixels.nbytes
        before = 0 if self.last is None else self.last.image.pixels.nbytes
        return len(item.recorded.data) + before if isinstance(item, EncodedFrame) else 0


def _decoded(item: Frame | BadFrame | EncodedFrame, gamma: float) -> Frame | BadFrame:
    frame = item.decoded() if isinstance(item, EncodedFrame) else item
    if gamma != 1.0 and isinstance(frame, Frame):
        return replace(frame, image=frame.image.gamma_corrected(gamma))
    return frame


def process(frame: Frame, processor: Processor, debug: bool) -> FrameResults:
    """One node's results for one frame."""
    results = FrameResults(frame.stamp_ns)
    start = time.perf_counter()
    try:
        results.messages += _messages(processor, processor.process(frame))
        camera = _NO_CAMERA if processor.lacks_camera_info else ''
        said = processor.status, processor.frames_problem, camera
        results.statuses[processor.name] = '; '.join(filter(None, said))
        if debug:
            results.messages += _messages(processor, processor.draw(processor.debug_topics))
    except DuplicateStampError:
        results.reasons.append('the stamp of the frame before')
    except ImageError as error:
        results.reasons.append(str(error))
    except Exception as error:
        # As in a live node, a defect of ours costs a frame and not the flight, and what it may have
        # left half done is forgotten.
        processor.reset()
        results.reasons.append(f'{DEFECT} {processor.name}: {type(error).__name__}: {error}')
    results.seconds = time.perf_counter() - start
    return results


def conclude(frame: Frame, processor: Processor) -> FrameResults:
    """What a node says at the end, in the name of the last frame that could be read."""
    outputs = processor.periodic(cdr_header(frame.stamp_ns, frame.frame_id))
    return FrameResults(frame.stamp_ns, _messages(processor, outputs), is_frame=False)


def merged(parts: Sequence[FrameResults]) -> FrameResults:
    """The results of all nodes, in their order."""
    return FrameResults(
        parts[0].stamp_ns,
        [message for part in parts for message in part.messages],
        list(dict.fromkeys(reason for part in parts for reason in part.reasons)),
        {name: status for part in parts for name, status in part.statuses.items()},
        sum(part.seconds for part in parts),
        parts[0].is_frame,
    )


def _messages(processor: Processor, outputs: Iterable[Output]) -> list[ResultMessage]:
    node, types = f'/{processor.name}', processor.message_types
    return [
        ResultMessage(resolve(topic, node), type_name(types[topic]), make())
        for topic, make in outputs
    ]
