"""Objects with large arrays for other processes: copied once into memory that all of them see."""

from __future__ import annotations

import mmap
import os
import pickle
from itertools import accumulate
from typing import Any

Sizes = tuple[int, ...]
"""Bytes of an object's description and of each of its arrays; what `SharedBuffer.get` needs."""


class SharedBuffer:
    """Room for one object, shared with the processes that are forked after it is made.

    It grows to the largest object, and is given back when all of the processes have ended.
    """

    def __init__(self) -> None:
        self._file = os.memfd_create('mvuav_frame')
        self._memory: mmap.mmap | None = None

    def put(self, value: Any, data: bytes = b'') -> Sizes:
        """Take an object, instead of the one before.

        Args:
            value: anything that can be pickled; arrays are copied as they are.
            data: bytes that are large as well.
        """
        arrays: list[pickle.PickleBuffer] = []
        description = pickle.dumps(value, 5, buffer_callback=arrays.append)
        parts: list[bytes | memoryview] = [description, *(array.raw() for array in arrays), data]
        sizes = tuple(len(part) for part in parts)
        for part, place in zip(parts, self._places(sizes), strict=True):
            place[:] = part
        return sizes

    def get(self, sizes: Sizes) -> tuple[Any, bytearray]:
        """A copy of the object, as a node may keep an image, and of the bytes beside it."""
        description, *arrays, data = map(bytearray, self._places(sizes))
        return pickle.loads(description, buffers=arrays), data

    def close(self) -> None:
        """Let go of the memory in this process."""
        self._memory = None
        os.close(self._file)

    def _places(self, sizes: Sizes) -> list[memoryview]:
        """Where parts of these sizes lie, one after the other."""
        starts = [0, *accumulate(sizes)]
        total = starts[-1]
        if self._memory is None or len(self._memory) < total:
            if os.fstat(self._file).st_size < total:
                os.ftruncate(self._file, total)
            self._memory = mmap.mmap(self._file, max(total, os.fstat(self._file).st_size))
        memory = memoryview(self._memory)
        return [memory[start : start + size] for start, size in zip(starts, sizes, strict=False)]
