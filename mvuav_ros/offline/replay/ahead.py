"""One recording over several cores: frames are decoded ahead, and each node has a process.

This process reads and writes. What depends on earlier frames stays in order, in one process for
each node; what does not, the decoding, is done by whichever process has least to do.
"""

from __future__ import annotations

import selectors
from collections import deque
from collections.abc import Generator, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from mvuav_ros.messages.definitions import typestore
from mvuav_ros.messages.frame import BadFrame, Frame
from mvuav_ros.offline.processes import Done, Report, Worker
from mvuav_ros.offline.replay.frames import FrameResults, conclude, merged, process
from mvuav_ros.offline.replay.inputs import Item
from mvuav_ros.offline.replay.shared_buffer import SharedBuffer, Sizes
from mvuav_ros.offline.stopping import Stop
from mvuav_ros.processing.processor import Processor
from mvuav_ros.recordings.recording import RecordedMessage
from mvuav_ros.sources.source import EncodedFrame

_SLOTS = 16
"""Frames under way at a time."""
_AT_ONCE = 4
"""Frames of a task: a process that is told of each by itself sleeps and wakes as often."""
_MOST_BYTES = 48 << 20
"""Of the frames and messages under way, once there are `_FEWEST` of them."""
_FEWEST = 3
_LARGE = 64 << 20
"""Bytes of a message that is decoded before it is copied, as it may be no image at all."""
_MOST_ENTRIES = 256
_MOST_GIVEN = 2
"""Tasks that a process has at a time: one that it is at, and no pause after it."""


class _Slot(NamedTuple):
    """Where a frame lies: as it was read, and decoded."""

    read: SharedBuffer
    decoded: SharedBuffer


class _Given(NamedTuple):
    """A frame for a process: which entry, and where it lies."""

    number: int
    slot: int
    sizes: Sizes
    is_decoded: bool


class _Task(NamedTuple):
    """``decode`` or ``process`` frames, or ``conclude``."""

    kind: str
    frames: Sequence[_Given] = ()


@dataclass(slots=True)
class _Entry:
    """An item of the input that is under way.

    Attributes:
        direct: what it led to, if no process has to see it.
        slot: of a frame.
        sizes: of the frame in its slot.
        is_decoded: whether it lies there decoded.
        is_ready: whether the nodes can have it.
        parts: the nodes' results.
        missing: nodes that have not answered.
        size: bytes.
    """

    direct: FrameResults | RecordedMessage | None = None
    slot: int = -1
    sizes: Sizes = ()
    is_decoded: bool = False
    is_ready: bool = False
    parts: list[FrameResults | None] = field(default_factory=list)
    missing: int = 0
    size: int = 0


class ReplayAhead:
    """As `frames.replay`, with the same results in the same order, by several processes."""

    def __init__(
        self, processors: Sequence[Processor], processes: int, *, debug: bool = False
    ) -> None:
        """Start the processes; this one has to have no threads yet.

        Args:
            processors: the nodes.
            processes: number of processes that decode or run a node; at least one for each node.
            debug: also make the debug images.
        """
        # It takes half a second, and the processes inherit it.
        typestore()
        self._slots = [_Slot(SharedBuffer(), SharedBuffer()) for _ in range(_SLOTS)]
        spare = max(0, processes - len(processors))
        stages = [_Stage(processor, self._slots, debug) for processor in processors]
        stages += [_Stage(None, self._slots, debug) for _ in range(spare)]
        threads = max(1, processes // len(stages))
        self._nodes = range(len(processors))
        self._workers = [Worker(stage, 'fork', threads) for stage in stages]
        self._given = [0] * len(stages)
        self._spent = [0.0] * len(stages)
        self._next = [0] * len(processors)
        self._window: dict[int, _Entry] = {}
        self._first = self._count = 0
        self._free = set(range(_SLOTS))
        self._to_decode: deque[int] = deque()
        self._bytes = 0
        self._ended = False
        self._selector = selectors.DefaultSelector()
        for index, worker in enumerate(self._workers):
            self._selector.register(worker, selectors.EVENT_READ, index)

    def close(self) -> None:
        """End the processes, whatever they are at."""
        self._selector.close()
        for worker in self._workers:
            worker.end()
        for slot in self._slots:
            slot.read.close()
            slot.decoded.close()

    def replay(
        self, items: Iterable[Item]
    ) -> Generator[FrameResults | RecordedMessage, None, None]:
        """The results of every frame, and messages as they are; see `frames.replay`.

        Raises:
            ProcessDiedError: one of the processes has ended.
        """
        remaining = iter(items)
        while not self._ended or self._window:
            yield from self._finished()
            self._give()
            if self._goes_on:
                for _ in range(_AT_ONCE):
                    self._read(remaining)
                    if not self._goes_on:
                        break
                self._hear(0.0)
            elif self._window:
                self._hear(None)
        parts = self._concluded()
        if parts:
            yield merged(parts[0].stamp_ns, parts, is_frame=False)

    @property
    def _goes_on(self) -> bool:
        """Whether the input has more, and there is room for it."""
        full = self._bytes > _MOST_BYTES and len(self._window) >= _FEWEST
        has_room = bool(self._free) and len(self._window) < _MOST_ENTRIES and not full
        return has_room and not self._ended

    def _read(self, items: Iterator[Item]) -> None:
        """Take in the input's next item."""
        item = next(items, None)
        if item is None:
            self._ended = True
            return
        if isinstance(item, EncodedFrame) and len(item.recorded.data) > _LARGE:
            item = item.decoded()
        entry = _Entry()
        if isinstance(item, RecordedMessage):
            entry.direct = item
            entry.size = len(item.data)
        elif isinstance(item, BadFrame):
            entry.direct = FrameResults(item.stamp_ns, reasons=[item.reason])
        else:
            self._put(item, entry)
        self._window[self._count] = entry
        self._count += 1
        self._bytes += entry.size

    def _put(self, frame: Frame | EncodedFrame, entry: _Entry) -> None:
        entry.slot = min(self._free)
        self._free.discard(entry.slot)
        slot = self._slots[entry.slot]
        if isinstance(frame, EncodedFrame):
            entry.sizes = slot.read.put(frame.without_data(), bytes(frame.recorded.data))
        else:
            entry.sizes = slot.decoded.put(frame)
            entry.is_decoded = True
        entry.size = sum(entry.sizes)
        entry.parts = [None] * len(self._nodes)
        entry.missing = len(self._nodes)
        # What is merely wrapped, each node unwraps by itself.
        entry.is_ready = not (isinstance(frame, EncodedFrame) and frame.is_compressed)
        if not entry.is_ready:
            self._to_decode.append(self._count)

    def _give(self) -> None:
        """Keep the processes busy: the nodes with the next frames, whoever has time with others."""
        for node in self._nodes:
            while self._given[node] < _MOST_GIVEN and (numbers := self._next_of(node)):
                self._send(node, 'process', numbers)
        while self._to_decode:
            index = min(range(len(self._workers)), key=lambda i: (self._given[i], self._spent[i]))
            if self._given[index] >= _MOST_GIVEN:
                break
            self._send(index, 'decode', [self._to_decode.popleft()])

    def _next_of(self, node: int) -> list[int]:
        """The frames that a node can have now; none as long as there may soon be more."""
        numbers: list[int] = []
        for number in range(max(self._first, self._next[node]), self._count):
            entry = self._window.get(number)
            if entry is not None and entry.direct is None:
                if not entry.is_ready or len(numbers) == _AT_ONCE:
                    break
                numbers.append(number)
        if not numbers or (len(numbers) < _AT_ONCE and self._goes_on):
            return []
        self._next[node] = numbers[-1] + 1
        return numbers

    def _send(self, index: int, kind: str, numbers: list[int]) -> None:
        self._given[index] += 1
        entries = [(number, self._window[number]) for number in numbers]
        frames = [_Given(number, e.slot, e.sizes, e.is_decoded) for number, e in entries]
        self._workers[index].send(numbers[0], _Task(kind, frames))

    def _hear(self, timeout: float | None) -> None:
        """Take in what the processes say."""
        for key, _ in self._selector.select(timeout):
            self._given[key.data] -= 1
            done = self._workers[key.data].receive()
            assert isinstance(done, Done)
            if done.error is not None:
                raise done.error
            for number, result in done.result or ():
                self._take(key.data, self._window[number], result)

    def _take(self, index: int, entry: _Entry, result: Any) -> None:
        if isinstance(result, FrameResults):
            entry.parts[index] = result
            entry.missing -= 1
            self._spent[index] += result.seconds
        elif isinstance(result, BadFrame):
            entry.direct = FrameResults(result.stamp_ns, reasons=[result.reason])
        else:
            self._bytes += sum(result)
            entry.size += sum(result)
            entry.sizes, entry.is_decoded, entry.is_ready = result, True, True

    def _finished(self) -> Iterator[FrameResults | RecordedMessage]:
        """Whatever is ready to be written, in the input's order."""
        while (entry := self._window.get(self._first)) is not None:
            if entry.direct is None and entry.missing:
                return
            del self._window[self._first]
            self._first += 1
            self._bytes -= entry.size
            if entry.slot >= 0:
                self._free.add(entry.slot)
            parts = [part for part in entry.parts if part is not None]
            yield entry.direct or merged(parts[0].stamp_ns, parts)

    def _concluded(self) -> list[FrameResults]:
        for node in self._nodes:
            self._workers[node].send(0, _Task('conclude'))
        results = []
        for node in self._nodes:
            done = self._workers[node].receive()
            if isinstance(done, Done) and done.result is not None:
                results.append(done.result)
        return results


class _Stage:
    """In a process: decodes any frame, and runs a node if it has one."""

    def __init__(self, processor: Processor | None, slots: list[_Slot], debug: bool) -> None:
        self._processor = processor
        self._slots = slots
        self._debug = debug
        self._decoded: dict[int, Frame] = {}
        self._last: Frame | None = None

    def __call__(self, task: _Task, _report: Report, _stop: Stop) -> Any:
        if task.kind == 'conclude':
            return self._conclude()
        work = self._decode if task.kind == 'decode' else self._process
        return [(given.number, work(given)) for given in task.frames]

    def _decode(self, given: _Given) -> BadFrame | Sizes:
        frame = self._read(given)
        if isinstance(frame, BadFrame):
            return frame
        if self._processor is not None:
            self._decoded[given.number] = frame
        return self._slots[given.slot].decoded.put(frame)

    def _process(self, given: _Given) -> FrameResults:
        assert self._processor is not None
        frame = self._decoded.pop(given.number, None) or self._read(given)
        if isinstance(frame, BadFrame):
            return FrameResults(frame.stamp_ns, reasons=[frame.reason])
        self._last = frame
        return process(frame, self._processor, self._debug)

    def _read(self, given: _Given) -> Frame | BadFrame:
        slot = self._slots[given.slot]
        if given.is_decoded:
            frame: Frame = slot.decoded.get(given.sizes)[0]
            return frame
        encoded, data = slot.read.get(given.sizes)
        read: Frame | BadFrame = encoded.with_data(memoryview(data)).decoded()
        return read

    def _conclude(self) -> FrameResults | None:
        if self._last is None or self._processor is None:
            return None
        return conclude(self._last, self._processor)
