"""What an input may cost: how large it may become in memory and on the disk, and so how long.

A few hundred bytes can claim, or even hold, gigabytes. What a file becomes is therefore limited in
proportion to its size, by one `Limit` for all that is unpacked of it, whatever reads it.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

SIZE_LIMIT = 1 << 30
"""Bytes; a larger chunk or message is refused."""
VARIABLE = 'MVUAV_MAX_SIZE_MB'
"""The environment variable that ``--max-size`` sets, so that other processes know it too."""

_PROPORTION = 200
"""Images of a dark sky become 100 times as large."""
_MIN_ALLOWED = 1 << 29


class Limit:
    """How much may come of one file in a pass through it.

    Attributes:
        allowed: bytes.
        left: bytes, of them.
    """

    def __init__(self, size: int) -> None:
        """Take a file of so many bytes."""
        given = os.environ.get(VARIABLE, '')
        in_proportion = max(size * _PROPORTION, _MIN_ALLOWED)
        self.allowed = int(given) * 1_000_000 if given.isdigit() else in_proportion
        self.left = self.allowed

    def begin(self) -> None:
        """Begin a pass."""
        self.left = self.allowed

    def spend(self, size: int) -> None:
        """Note that so many bytes came of it."""
        self.left -= size

    @property
    def reason(self) -> str:
        """In words, what is wrong where nothing is left."""
        return f'it becomes larger than {self.allowed // 1_000_000} MB; --max-size allows more'


@contextmanager
def allowing(megabytes: int | None) -> Iterator[None]:
    """So many for each file meanwhile, as the user says."""
    before = os.environ.get(VARIABLE)
    if megabytes is not None:
        os.environ[VARIABLE] = str(megabytes)
    try:
        yield
    finally:
        if megabytes is not None:
            os.environ.pop(VARIABLE)
        if before is not None:
            os.environ[VARIABLE] = before
