"""Reading ahead in a thread, so that reading and decoding overlap with processing."""

from __future__ import annotations

from collections.abc import Generator, Iterator
from contextlib import suppress
from queue import Empty, Full, Queue
from threading import Event, Thread
from typing import TypeVar

from mvuav_ros.recordings.sources.frame import Frame

_Item = TypeVar('_Item')
# Each holds at most one frame: more would cost memory and bring nothing.
_BATCHES_AHEAD = 4
_BATCH_ITEMS = 64


def prefetched(items: Iterator[_Item]) -> Generator[_Item, None, None]:
    """The items, made by a thread that is a few frames ahead.

    Decompression and image decoding let go of the interpreter. An error comes where its item
    would have come; closing the generator ends the thread.
    """
    queue: Queue[list[_Item] | BaseException] = Queue(_BATCHES_AHEAD)
    stop = Event()
    thread = Thread(target=_read, args=(items, queue, stop), name='reading', daemon=True)
    thread.start()
    try:
        while batch := queue.get():
            if isinstance(batch, BaseException):
                raise batch
            yield from batch
    finally:
        stop.set()
        with suppress(Empty):
            while True:
                queue.get_nowait()
        thread.join()


def _read(items: Iterator[_Item], queue: Queue[list[_Item] | BaseException], stop: Event) -> None:
    batch: list[_Item] = []
    try:
        for item in items:
            batch.append(item)
            if isinstance(item, Frame) or len(batch) == _BATCH_ITEMS:
                _put(batch, queue, stop)
                batch = []
            if stop.is_set():
                return
        if batch:
            _put(batch, queue, stop)
        # An empty batch is the end.
        _put([], queue, stop)
    except BaseException as error:
        _put(error, queue, stop)


def _put(
    batch: list[_Item] | BaseException,
    queue: Queue[list[_Item] | BaseException],
    stop: Event,
) -> None:
    while not stop.is_set():
        with suppress(Full):
            queue.put(batch, timeout=0.1)
            return
