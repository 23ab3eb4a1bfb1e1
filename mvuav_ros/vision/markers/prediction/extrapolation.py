"""The thesis's predictions (eqs 3.14 to 3.18, 4.1, 4.2) of any number of markers at once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

METHODS = ('none', 'velocity', 'acceleration', 'acceleration_program')
"""As `mvuav_ros.vision.markers.motion.Motion.predict` has them, for one marker."""
_SAME_TIME = 1e-9
"""s, by which intervals may differ and still be the same: stamps are whole nanoseconds."""


class Extrapolation:
    """The last three places of every marker, and where each method takes them.

    A marker out of sight goes on in a straight line at its last velocity; when it returns, the
    line from its last place to the new one is its velocity, as in `Motion`.
    """

    def __init__(self, count: int) -> None:
        # (2 n,) px, where each marker was last measured, x and y in turn.
        self.last: Array = np.zeros(2 * count)
        self._last_time: Array = np.zeros(2 * count)
        self._places: Array = np.zeros((3, 2 * count))
        self._times: tuple[float, float, float] = (-1.0, -2.0, -3.0)
        self._intervals = (0.0, 0.0, 0.0)
        self._steps: Array = np.zeros((3, 3))

    def add(self, places: Array) -> None:
        """Append markers at their first places, (2 k,) px, of the newest frame."""
        self.last = np.append(self.last, places)
        self._last_time = np.append(self._last_time, np.full(len(places), self._times[0]))
        self._places = np.hstack((self._places, np.tile(places, (3, 1))))

    def keep(self, columns: NDArray[np.bool_]) -> None:
        """Forget all markers but some (2 n, true for those)."""
        self.last, self._last_time = self.last[columns], self._last_time[columns]
        self._places = self._places[:, columns]

    def predict(self, time: float, rows: Array) -> None:
        """Extrapolate to a time (s); takes the rows (4 or more, 2 n) in `METHODS`' order, px."""
        newest, middle, oldest = self._times
        intervals = time - newest, newest - middle, middle - oldest
        if not _are_same(intervals, self._intervals):
            self._intervals, self._steps = intervals, _steps(*intervals)
        rows[0] = self.last
        rows[1:4] = self._steps.dot(self._places)

    def update(self, time: float, places: Array) -> None:
        """Take the places (2 n,), px, of a frame (s) that shows all, as the one before did."""
        history = np.empty_like(self._places)
        history[0] = places
        history[1:] = self._places[:-1]
        self._places = history
        self.last = places
        self._last_time[:] = time
        self._times = (time, *self._times[:2])

    def update_some(
        self,
        time: float,
        places: Array,
        new: NDArray[np.bool_],
        restarted: NDArray[np.bool_],
    ) -> None:
        """Take the places (2 n,), px, of any frame (s); NaN for markers that were not seen.

        New (2 n) are those seen for the first time; restarted those seen for the second time, or
        after an absence.
        """
        seen = ~np.isnan(places)
        elapsed = np.where(new, 1.0, time - self._last_time)
        velocity = (places - self.last) / np.maximum(elapsed, _SAME_TIME)
        straight = self._steps[0].dot(self._places)
        last, last_time = self.last, self._last_time.copy()
        self.update(time, np.where(seen, places, straight))
        self.last = np.where(seen, places, last)
        self._last_time = np.where(seen, time, last_time)
        for row, then in enumerate(self._times[1:], 1):
            line = places - velocity * (time - then)
            self._places[row, restarted] = line[restarted]
            self._places[row, new] = places[new]


def _are_same(first: tuple[float, float, float], second: tuple[float, float, float]) -> bool:
    (a, b, c), (d, e, f) = first, second
    return abs(a - d) < _SAME_TIME and abs(b - e) < _SAME_TIME and abs(c - f) < _SAME_TIME


def _steps(ahead: float, newer: float, older: float) -> Array:
    """What each of the last three places counts by velocity and both accelerations, (3, 3).

    The times (s) are from the newest place to the prediction, and between the places.
    """
    v = ahead / newer
    # Half of ahead², times what the places count in the acceleration. Each velocity belongs to
    # its interval's middle.
    per_speed = ahead * ahead / (newer + older)
    a2, a0 = per_speed / newer, per_speed / older
    a1 = -a2 - a0
    velocity = 1.0 + v, -v, 0.0
    acceleration = 1.0 + v + a2, -v + a1, a0
    program = 1.0 + v - 0.5 * a2, -v - 0.5 * a1, -0.5 * a0
    return np.array((velocity, acceleration, program))
