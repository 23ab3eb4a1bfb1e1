"""A Kalman filter of constant acceleration for each of any number of markers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class KalmanTuning:
    """What the filter assumes of the motion.

    Chosen on the simulator's four trials and on the two reference videos.
    """

    # Process noise over measurement noise: the acceleration's change within a frame over the
    # measurement's standard deviation. The level of both follows from the innovations.
    maneuver: float = 1.0
    longest_gap: int = 10  # frames without a measurement, after which the gain grows no more
    # Part of the acceleration kept for each frame unseen: it cannot be trusted for long.
    acceleration_fading: float = 0.7
    velocity_fading: float = 0.95  # the same of the velocity, which can be trusted somewhat longer


TUNING = KalmanTuning()


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
        self.state[1, columns] *= TUNING.velocity_fading
        self.state[2, columns] *= TUNING.acceleration_fading

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
    noise = TUNING.maneuver**2 * np.outer(effect, effect)
    covariance: Array = np.diag((1.0, 1e4, 1.0))
    starting, after = [np.array([(1.0,), (0.0,), (0.0,)])], []
    for _ in range(100):
        covariance = transition @ covariance @ transition.T + noise
        starting.append(covariance[:, :1] / (covariance[0, 0] + 1.0))
        covariance = np.asarray(covariance - starting[-1] @ covariance[:1])
    for _ in range(TUNING.longest_gap + 1):
        covariance = transition @ covariance @ transition.T + noise
        after.append(covariance[:, :1] / (covariance[0, 0] + 1.0))
    return np.array(starting[:31]), np.array(after)


# Computed here, as the first frame has no time for it.
_STARTING_GAINS, _GAINS_AFTER_GAPS = _gain_tables()
