"""What became of names and poses on a flight, held against the truth."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
TOLD_APART = 4.0
"""px from a marker's true place at which another light can be told apart."""
FEW = 3
"""Markers wholly in sight, with which all of those could have names; and frames of a wait that are
not counted."""


CONFIDENCES = 0.5, 0.9, 0.99, 0.999
"""Between these are the parts of the names by their confidence."""


@dataclass(eq=False)
class FlightScore:
    """One flight's figures.

    Attributes:
        frames: seen.
        wrong: lengths, frames, of the runs in which a name was on another light.
        whole: markers wholly in sight times frames, from the first frame in which all were.
        missed: of these, without a name.
        waits: lengths, frames, of the times in which three or more were wholly in sight and not
            all of those had names, after all had had them once.
        start: frames from the first in which all were wholly in sight to the first in which all had
            names; the flight's rest if they never had.
        recoveries: frames that it took each marker that came back wholly into sight to its name.
        rolls: frames from the same one on in which both wings were wholly in sight, and of these
            those with a roll within a degree.
        poses: (moved, share of the distance; turned, deg; both squared over their covariance).
        posable: frames with three whole markers and more, after the start.
        usual: CPU ms of frames in which nothing happens, now and in the last ten: all markers
            whole, no other light.
        search: CPU ms of the others.
        reliability: names by their confidence (see `CONFIDENCES`): all, the wrong ones, and the sum
            of the confidences.
    """

    frames: int = 0
    wrong: list[int] = field(default_factory=list)
    whole: int = 0
    missed: int = 0
    waits: list[int] = field(default_factory=list)
    start: int = 0
    recoveries: list[int] = field(default_factory=list)
    rolls: list[int] = field(default_factory=lambda: [0, 0])
    poses: list[tuple[float, float, float]] = field(default_factory=list)
    posable: int = 0
    usual: list[float] = field(default_factory=list)
    search: list[float] = field(default_factory=list)
    reliability: list[list[float]] = field(
        default_factory=lambda: [[0, 0, 0.0] for _ in range(len(CONFIDENCES) + 1)]
    )
    _running: dict[int, int] = field(default_factory=dict)
    _back: dict[int, int] = field(default_factory=dict)
    _gone: set[int] = field(default_factory=set)
    _wait: int = 0
    _could_start: bool = False
    _started: bool = False
    _calm: int = 0

    def add(
        self,
        named: NDArray[np.bool_],
        places: Array,
        pixels: Array,
        whole: NDArray[np.bool_],
        calm: bool,
        cpu_ms: float,
    ) -> None:
        """A frame: whether markers (n,) have names, where (n, 2), and where they are, px.

        Whole are those of which nothing hides any part; calm is a frame without other lights.
        """
        self.frames += 1
        self._calm = self._calm + 1 if calm and whole.all() else 0
        (self.usual if self._calm > 10 and named.all() else self.search).append(cpu_ms)
        away = np.hypot(*(places - pixels).T)
        for marker in range(len(named)):
            if named[marker] and away[marker] > TOLD_APART:
                self._running[marker] = self._running.get(marker, 0) + 1
            elif marker in self._running:
                self.wrong.append(self._running.pop(marker))
        self._could_start |= bool(whole.all())
        if self._could_start:
            self.whole += int(whole.sum())
            self.missed += int((whole & ~named).sum())
            self.start += not self._started and not named.all()
        self._recover(named, whole)
        waiting = bool(self._started and (whole & ~named).any() and whole.sum() >= FEW)
        if self._wait and not waiting:
            self.waits.append(self._wait)
        self._wait = self._wait + 1 if waiting else 0
        self._started |= bool(named.all())
        self.posable += bool(self._started and whole.sum() >= FEW)

    def _recover(self, named: NDArray[np.bool_], whole: NDArray[np.bool_]) -> None:
        if not self._started:
            return
        for marker in range(len(named)):
            if not whole[marker]:
                self._gone.add(marker)
                if marker in self._back:
                    self.recoveries.append(self._back.pop(marker))
                continue
            if marker in self._gone:
                self._gone.remove(marker)
                self._back[marker] = 0
            if marker in self._back:
                if named[marker]:
                    self.recoveries.append(self._back.pop(marker))
                else:
                    self._back[marker] += 1

    def add_confidences(
        self, named: NDArray[np.bool_], places: Array, pixels: Array, confidences: Array
    ) -> None:
        """How sure the names of a frame's markers are (n,); see `add`."""
        away = np.hypot(*(places - pixels).T)
        for marker in np.flatnonzero(named & np.isfinite(confidences)):
            part = self.reliability[int(np.searchsorted(CONFIDENCES, confidences[marker]))]
            part[0] += 1
            part[1] += bool(away[marker] > TOLD_APART)
            part[2] += float(confidences[marker])

    def add_roll(self, roll: float, left: Array, right: Array) -> None:
        """The roll told, rad or NaN, and where both wings are that are wholly in sight, px."""
        if not self._could_start:
            return
        self.rolls[0] += 1
        true = math.atan2(right[1] - left[1], right[0] - left[0])
        error = abs(math.remainder(roll - true, 2 * math.pi))
        self.rolls[1] += not math.isnan(roll) and error < math.radians(1.0)

    def add_pose(
        self,
        pose: tuple[Array, Array, Array],
        true: tuple[Array, Array],
    ) -> None:
        """A pose told (rotation, translation m, covariance) and the true rotation and translation.

        The covariance is of x, y, z and of small turns about the optical axes.
        """
        rotation, translation, covariance = pose
        turn = rotation @ true[0].T
        axis = np.array((turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]))
        sine, cosine = 0.5 * float(np.linalg.norm(axis)), 0.5 * (float(np.trace(turn)) - 1.0)
        angle = math.atan2(sine, cosine)
        small = axis * (0.5 if sine < 1e-9 else 0.5 * angle / sine)
        error = np.concatenate((translation - true[1], small))
        moved = float(np.linalg.norm(error[:3]) / np.linalg.norm(true[1]))
        square = float(error @ np.linalg.solve(covariance, error))
        self.poses.append((moved, math.degrees(angle), square))

    def figures(self) -> dict[str, Any]:
        """All that a summary needs."""
        wrong = [*self.wrong, *self._running.values()]
        waits = [*self.waits, *([self._wait] if self._wait else [])]
        poses = np.reshape(self.poses, (-1, 3))
        return {
            'frames': self.frames,
            'wrong': sum(wrong),
            'longest_wrong': max(wrong, default=0),
            'whole': self.whole,
            'missed': self.missed,
            'waits': [wait for wait in waits if wait > FEW],
            'start': self.start,
            'recoveries': [*self.recoveries, *self._back.values()],
            'rolls': self.rolls,
            'posable': self.posable,
            'poses': len(poses),
            'moved': float(poses[:, 0].max(initial=0.0)),
            'turned': float(poses[:, 1].max(initial=0.0)),
            'nees': float(poses[:, 2].mean()) if len(poses) else None,
            'usual_ms': float(np.median(self.usual)) if self.usual else None,
            'search_ms': float(np.mean(self.search)) if self.search else None,
            'worst_ms': max(self.search[3:], default=None),
            'reliability': self.reliability,
        }


def summary(flights: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Several flights' figures as one row."""

    def all_of(name: str) -> list[Any]:
        return [flight[name] for flight in flights if flight[name] is not None]

    def joined(name: str) -> list[Any]:
        return [value for flight in flights for value in flight[name]]

    def share(part: float, whole: float) -> float | None:
        return round(100.0 * part / whole, 2) if whole else None

    def of(function: Any, values: list[Any], digits: int = 2) -> float | None:
        return round(float(function(values)), digits) if values else None

    waits, recoveries = joined('waits'), joined('recoveries')
    rolls = np.sum([flight['rolls'] for flight in flights], axis=0).tolist()
    return {
        'flights': len(flights),
        'frames': sum(all_of('frames')),
        'wrong': sum(all_of('wrong')),
        'longest_wrong': max(all_of('longest_wrong'), default=0),
        'missed_percent': share(sum(all_of('missed')), sum(all_of('whole'))),
        'waits': len(waits),
        'longest_wait': max(waits, default=0),
        'start_mean': of(np.mean, all_of('start'), 1),
        'start_max': max(all_of('start'), default=0),
        'recovery_p95': of(lambda v: np.percentile(v, 95), recoveries, 1),
        'recovery_max': max(recoveries, default=0),
        'roll_percent': share(rolls[1], rolls[0]),
        'pose_percent': share(sum(all_of('poses')), sum(all_of('posable'))),
        'worst_moved_percent': round(100 * max(all_of('moved'), default=0.0), 2),
        'worst_turned_deg': round(max(all_of('turned'), default=0.0), 2),
        'nees': of(np.median, all_of('nees')),
        'usual_ms': of(np.median, all_of('usual_ms'), 3),
        'search_ms': of(np.mean, all_of('search_ms')),
        'worst_ms': of(max, all_of('worst_ms'), 1),
        'reliability': np.sum([flight['reliability'] for flight in flights], axis=0).tolist(),
    }
