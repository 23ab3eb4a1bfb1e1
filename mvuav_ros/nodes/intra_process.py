"""Frames from a source to a detector of the same process, without DDS in between."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable
from threading import Condition, Thread

from mvuav_ros.messages.frame import Frame
from mvuav_ros.nodes.image_input import InputEvents, InputState, ReceivedImage

_DEPTH = 5
"""Frames that wait at most, as many as in the queue of a sensor subscription."""


class IntraProcessInput:
    """Takes frames from the source's thread and hands them on in a thread of its own.

    Nothing is copied: source and detectors look at the same pixels, which none of them writes to.
    A detector that is too slow loses the oldest frames, and the source never waits for it.
    """

    def __init__(self, topic: str, on_frame: Callable[[ReceivedImage], None]) -> None:
        self.topic = topic
        self._events = InputEvents()
        self._on_frame = on_frame
        self._waiting: deque[tuple[Frame, float]] = deque()
        self._changed = Condition()
        self._stopping = False
        self._thread = Thread(target=self._run, name='frames', daemon=True)

    def put(self, frame: Frame) -> None:
        """Give the next frame."""
        with self._changed:
            if len(self._waiting) == _DEPTH:
                self._waiting.popleft()
                self._events.skipped += 1
            self._waiting.append((frame, time.perf_counter()))
            self._changed.notify()

    def start(self) -> None:
        """Begin to hand on frames."""
        self._thread.start()

    def close(self) -> None:
        """End the thread."""
        with self._changed:
            self._stopping = True
            self._changed.notify()
        if self._thread.is_alive():
            self._thread.join(timeout=5.0)

    def poll(self) -> InputState:
        """What became of frames so far."""
        return InputState(self.topic, ['this process'], self._events)

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._waiting or self._stopping)
                if self._stopping:
                    return
                frame, put = self._waiting.popleft()
            self._on_frame(ReceivedImage(frame, math.nan, put))
