"""Changes of parameters that can be undone and done again."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping

from mvuav_ros.parameters.declaration import Value

_ONE_MOVEMENT = 1.0
"""Seconds; quicker changes of one parameter are one movement of a hand."""
_MOST = 200

Values = Mapping[str, Value]


class History:
    """What a user has done to one node: the values before and after each change."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._done: list[tuple[Values, Values]] = []
        self._undone: list[tuple[Values, Values]] = []
        self._changed_at = 0.0

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
        quick = self._clock() - self._changed_at < _ONE_MOVEMENT
        if quick and not self._undone and self._done and self._done[-1][1].keys() == after.keys():
            before = self._done.pop()[0]
        self._done.append((before, after))
        del self._done[:-_MOST]
        self._undone.clear()
        self._changed_at = self._clock()

    def undo(self) -> Values:
        """The values to set to take back the last change; none where there is none."""
        if not self._done:
            return {}
        self._undone.append(self._done.pop())
        return self._undone[-1][0]

    def redo(self) -> Values:
        """The values to set to do again what was undone last."""
        if not self._undone:
            return {}
        self._done.append(self._undone.pop())
        return self._done[-1][1]
