"""Changes of parameters that can be undone and done again."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from mvuav_ros.parameters.declaration import Value

_ONE_MOVEMENT = 1.0
"""Seconds; quicker changes of one parameter are one movement of a hand."""
_MOST = 200

Values = Mapping[str, Value]


@dataclass(frozen=True)
class Change:
    """Values before and after, and when."""

    before: Values
    after: Values
    at: float


class History:
    """What a user has done to one node."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._done: list[Change] = []
        self._undone: list[Change] = []

    @property
    def can_undo(self) -> bool:
        """Whether there is anything to undo."""
        return bool(self._done)

    @property
    def can_redo(self) -> bool:
        """Whether anything was undone since the last change."""
        return bool(self._undone)

    def record(self, before: Values, after: Values) -> None:
        """Keep a change that the node has taken."""
        if dict(before) == dict(after):
            return
        self._undone.clear()
        now = self._clock()
        last = self._done[-1] if self._done else None
        if last and last.after.keys() == after.keys() and now - last.at < _ONE_MOVEMENT:
            before = self._done.pop().before
        self._done.append(Change(before, after, now))
        del self._done[:-_MOST]

    def undo(self) -> Values:
        """The values to set to take back the last change; none where there is none."""
        if not self._done:
            return {}
        self._undone.append(self._done.pop())
        return self._undone[-1].before

    def redo(self) -> Values:
        """The values to set to do again what was undone last."""
        if not self._undone:
            return {}
        self._done.append(self._undone.pop())
        return self._done[-1].after
