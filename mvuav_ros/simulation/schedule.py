"""When which light is out or hidden: ``left_wing@2-4, all@6-7``, times in seconds."""

from __future__ import annotations

import re
from collections.abc import Collection
from itertools import pairwise
from typing import NamedTuple

ALL = 'all'
_NUMBER = r'\d+(?:\.\d*)?|\.\d+'
_ENTRY = re.compile(rf'\s*(\w+)\s*@\s*({_NUMBER})\s*-\s*({_NUMBER})\s*')


class ScheduleError(ValueError):
    """A schedule that cannot be read, with the reason."""


class Interval(NamedTuple):
    """Something happens to one marker (or ``all``) while start <= time < end, s."""

    marker: str
    start: float
    end: float


def parse_schedule(text: str) -> tuple[Interval, ...]:
    """Read a schedule; nothing is an empty one.

    Raises:
        ScheduleError: an entry is not NAME@START-END, or ends before it starts.
    """
    if not text.strip():
        return ()
    return tuple(_parse_entry(entry) for entry in text.split(','))


def affected(schedule: tuple[Interval, ...], marker: str, time: float) -> bool:
    """Whether the schedule names the marker at that time (s)."""
    return any(name in (marker, ALL) and start <= time < end for name, start, end in schedule)


def refuse_unknown(schedule: tuple[Interval, ...], markers: Collection[str]) -> None:
    """Check a schedule's names.

    Raises:
        ScheduleError: one of them is no marker.
    """
    for interval in schedule:
        if interval.marker not in markers:
            raise ScheduleError(f'{interval.marker!r} is not one of {", ".join(markers)}')


def refuse_overlap(schedule: tuple[Interval, ...]) -> None:
    """Check that no two entries are under way at once.

    Raises:
        ScheduleError: two are.
    """
    for before, after in pairwise(sorted(schedule, key=lambda interval: interval.start)):
        if after.start < before.end:
            raise ScheduleError(
                f'{before.marker} and {after.marker} at {after.start:g} s: there is one boom'
            )


def _parse_entry(entry: str) -> Interval:
    match = _ENTRY.fullmatch(entry)
    if match is None:
        raise ScheduleError(f'takes NAME@START-END in seconds, not {entry.strip()!r}')
    name, start, end = match[1], float(match[2]), float(match[3])
    if end <= start:
        raise ScheduleError(f'{entry.strip()}: must end after it starts')
    return Interval(name, start, end)
