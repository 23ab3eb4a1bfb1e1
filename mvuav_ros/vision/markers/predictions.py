"""Where lights will be next: the thesis's extrapolations, a Kalman filter, and vibration."""

from __future__ import annotations

import math
from dataclasses import dataclass

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


@dataclass(frozen=True)
class KalmanTuning:
    """What the filter assumes of the motion.

    Chosen on the simulator's four trials and on the two reference videos.
    """

    # Process noise over measurement noise: the acceleration's change within a frame over the
    # measurement's standard deviation. The level of both follows from the innovations.
    maneuver: float = 1.0
    max_gap: int = 10  # frames without a measurement, after which the gain grows no more
    # Part of the acceleration kept for each frame unseen: it cannot be trusted for long.
    acceleration_fading: float = 0.7
    velocity_fading: float = 0.95  # the same of the velocity, which can be trusted somewhat longer


KALMAN = KalmanTuning()


class KalmanFilter:
    """Position, velocity and acceleration of any number of markers, all on one clock.

    The process noise is white jerk. With frames in regular steps the gains settle, so they are
    taken from tables: for the n-th measurement of a new marker, and for the first one after n
    frames without.
    """

    def __init__(self, count: int) -> None:
        # (3, 2 n): position (px), velocity (px/s) and acceleration (px/s²) by x and y of every
        # marker in turn.
        self.state: Array = np.zeros((3, 2 * count))
        self.settled: Array = _STARTING_GAINS[-1]  # (3, 1), the gain when nothing has been missed
        self._per_frame: Array = np.ones((3, 1))
        self._transition: Array = np.eye(3)

    def set_step(self, step: float) -> None:
        """Say how far apart frames usually are, s."""
        self._per_frame = np.array([(1.0,), (1.0 / step,), (1.0 / step**2,)])
        self.settled = _STARTING_GAINS[-1] * self._per_frame

    def advance(self, elapsed: float) -> None:
        """Go on by a time, s."""
        transition = self._transition
        transition[0, 1] = transition[1, 2] = elapsed
        transition[0, 2] = 0.5 * elapsed * elapsed
        self.state = transition.dot(self.state)

    def gains(self, seen: NDArray[np.intp], gap: NDArray[np.intp]) -> Array:
        """The gain of every marker's next measurement, (3, n).

        By its earlier measurements (n,), and the frames since the last of them (n,).
        """
        new = _STARTING_GAINS[np.minimum(seen, len(_STARTING_GAINS) - 1), :, 0]
        returned = _GAINS_AFTER_GAPS[np.minimum(gap, len(_GAINS_AFTER_GAPS) - 1), :, 0]
        return np.asarray(np.where(gap[:, None] > 0, returned, new).T * self._per_frame)

    def start(self, columns: NDArray[np.bool_], places: Array) -> None:
        """Put markers (2 n, where true) to their first places (2 n,), px, at rest."""
        self.state[:, columns] = 0.0
        self.state[0, columns] = places[columns]

    def fade(self, columns: NDArray[np.bool_]) -> None:
        """Trust the motion of markers that are out of sight (2 n, where true) a frame less."""
        self.state[1, columns] *= KALMAN.velocity_fading
        self.state[2, columns] *= KALMAN.acceleration_fading

    def add(self, places: Array) -> None:
        """Append markers at their first places, (2 k,) px, at rest."""
        rest = np.zeros_like(places)
        self.state = np.hstack((self.state, np.stack((places, rest, rest))))

    def keep(self, columns: NDArray[np.bool_]) -> None:
        """Forget all markers but some (2 n, true for those)."""
        self.state = self.state[:, columns]


def _gain_tables() -> tuple[Array, Array]:
    """Gains (31, 3, 1) of a marker's first measurements until they settle, and after gaps.

    The latter (n + 1, 3, 1) are those of the first measurement after up to n frames without.
    """
    # Frames and px.
    transition = np.array([(1.0, 1.0, 0.5), (0.0, 1.0, 1.0), (0.0, 0.0, 1.0)])
    effect = np.array((0.5, 1.0, 1.0))
    noise = KALMAN.maneuver**2 * np.outer(effect, effect)
    covariance: Array = np.diag((1.0, 1e4, 1.0))
    starting, after = [np.array([(1.0,), (0.0,), (0.0,)])], []
    for _ in range(100):
        covariance = transition @ covariance @ transition.T + noise
        starting.append(covariance[:, :1] / (covariance[0, 0] + 1.0))
        covariance = np.asarray(covariance - starting[-1] @ covariance[:1])
    for _ in range(KALMAN.max_gap + 1):
        covariance = transition @ covariance @ transition.T + noise
        after.append(covariance[:, :1] / (covariance[0, 0] + 1.0))
    return np.array(starting[:31]), np.array(after)


# Computed here, as the first frame has no time for it.
_STARTING_GAINS, _GAINS_AFTER_GAPS = _gain_tables()


@dataclass(frozen=True)
class VibrationTuning:
    """How the autoregression is learnt.

    Chosen on the simulator's vibrations 1 to 3 at 30 frames/s and on the two reference videos.
    """

    lags: int = 6  # past innovations from which the next one is predicted: two for each harmonic
    memory: float = 0.99  # per frame, of what is learnt
    ridge: float = 10.0  # pulls the coefficients to zero, in frames' worth of innovations
    solve_every: int = 4  # frames between two solutions for the coefficients, which saves time
    limit: float = 2.0  # standard deviations of an innovation that may stand in for a missing one
    fading: float = 0.7  # per frame, of an innovation that stands in for a missing one


VIBRATION = VibrationTuning()


class VibrationPredictor:
    """Autoregression of the Kalman filter's innovations.

    The innovations of a filter are white where its model holds. A camera's vibration is none of
    its model, moves all markers alike and comes again: the next innovation is predicted from the
    last six, with coefficients learnt from all markers by recursive least squares (a Kalman
    filter of its own, whose state is the coefficients). White jitter leaves them at zero.
    """

    def __init__(self, count: int) -> None:
        self.lagged: Array = np.zeros((VIBRATION.lags, 2 * count))
        self.predicted: Array = np.zeros(2 * count)  # (2 n,) px, the next innovation
        # Mean square of the innovations, and of what the predictions leave of them, px².
        self.level = self.left = 0.01
        self._coefficients: Array = np.zeros(VIBRATION.lags)
        self._normal: Array = np.zeros((VIBRATION.lags, VIBRATION.lags))
        self._moment: Array = np.zeros(VIBRATION.lags)
        self._unity: Array = np.eye(VIBRATION.lags)

    @property
    def helps(self) -> bool:
        """Whether the predictions would have saved anything on the frames seen so far."""
        return self.left < self.level

    def predict(self) -> Array:
        """The next innovation, (2 n,) px."""
        self.predicted = self._coefficients.dot(self.lagged)
        return self.predicted

    def stand_in(self) -> Array:
        """What is predicted in the place of a measurement, so that it cannot build up, px."""
        if not self.helps:
            return np.zeros_like(self.predicted)
        limit = VIBRATION.limit * math.sqrt(self.level)
        return np.asarray(VIBRATION.fading * np.clip(self.predicted, -limit, limit))

    def remember(self, innovation: Array) -> None:
        """Take the newest innovation, (2 n,) px."""
        lagged = np.empty_like(self.lagged)
        lagged[0] = innovation
        lagged[1:] = self.lagged[:-1]
        self.lagged = lagged

    def clear(self, columns: NDArray[np.bool_]) -> None:
        """Forget the innovations of some markers (2 n, where true)."""
        self.lagged[:, columns] = 0.0

    def add(self, count: int) -> None:
        """Append markers without innovations."""
        self.lagged = np.hstack((self.lagged, np.zeros((VIBRATION.lags, 2 * count))))

    def keep(self, columns: NDArray[np.bool_]) -> None:
        """Forget all markers but some (2 n, true for those)."""
        self.lagged = self.lagged[:, columns]

    def learn(self, lagged: Array, innovation: Array, predicted: Array, solve: bool) -> None:
        """Improve the coefficients by some markers' newest innovations and their predictions, (m,).

        They follow from the lagged ones (lags, m), before `remember`; solving takes time.
        """
        memory = VIBRATION.memory
        self._normal *= memory
        self._normal += lagged.dot(lagged.T)
        self._moment *= memory
        self._moment += lagged.dot(innovation)
        error = innovation - predicted
        share = (1 - memory) / len(innovation)
        self.level = memory * self.level + share * float(innovation.dot(innovation))
        self.left = memory * self.left + share * float(error.dot(error))
        if solve:
            ridge = self._normal + (VIBRATION.ridge * self.level) * self._unity
            self._coefficients = np.asarray(np.linalg.solve(ridge, self._moment), np.float64)
