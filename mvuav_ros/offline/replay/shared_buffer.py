"""Objects with large arrays for other processes: copied once into memory that all of them see."""

from __future__ import annotations

import mmap
import os
import pickle
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
        memory = self._mapped(sum(sizes))
        position = 0
        for part in parts:
            memory[position : position + len(part)] = part
            position += len(part)
        return sizes

    def get(self, sizes: Sizes) -> tuple[Any, bytearray]:
        """A copy of the object, and of the bytes beside it."""
        memory = self._mapped(sum(sizes))
        parts, position = [], 0
        for size in sizes:
            parts.append(bytearray(memory[position : position + size]))
            position += size
        description, *arrays, data = parts
        return pickle.loads(description, buffers=arrays), data

    def close(self) -> None:
        """Let go of the memory in this process."""
        self._memory = None
        os.close(self._file)

    def _mapped(self, size: int) -> memoryview:
        if self._memory is None or len(self._memory) < size:
            if os.fstat(self._file).st_size < size:
                os.ftruncate(self._file, size)
            self._memory = mmap.mmap(self._file, max(size, os.fstat(self._file).st_size))
        return memoryview(self._memory)
