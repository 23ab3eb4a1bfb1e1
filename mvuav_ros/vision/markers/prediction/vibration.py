"""What a vibrating camera does next, foretold from what it did to all markers alike."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


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


TUNING = VibrationTuning()


class VibrationPredictor:
    """Autoregression of the Kalman filter's innovations.

    The innovations of a filter are white where its model holds. A camera's vibration is none of
    its model, moves all markers alike and comes again: the next innovation is predicted from the
    last six, with coefficients learnt from all markers by recursive least squares (a Kalman
    filter of its own, whose state is the coefficients). White jitter leaves them at zero.
    """

    def __init__(self, count: int) -> None:
        self.lagged: Array = np.zeros((TUNING.lags, 2 * count))
        self.predicted: Array = np.zeros(2 * count)  # (2 n,) px, the next innovation
        # Mean square of the innovations, and of what the predictions leave of them, px².
        self.level = self.left = 0.01
        self._coefficients: Array = np.zeros(TUNING.lags)
        self._normal: Array = np.zeros((TUNING.lags, TUNING.lags))
        self._moment: Array = np.zeros(TUNING.lags)
        self._unity: Array = np.eye(TUNING.lags)

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
        limit = TUNING.limit * math.sqrt(self.level)
        return np.asarray(TUNING.fading * np.clip(self.predicted, -limit, limit))

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
        self.lagged = np.hstack((self.lagged, np.zeros((TUNING.lags, 2 * count))))

    def keep(self, columns: NDArray[np.bool_]) -> None:
        """Forget all markers but some (2 n, true for those)."""
        self.lagged = self.lagged[:, columns]

    def learn(self, lagged: Array, innovation: Array, predicted: Array, solve: bool) -> None:
        """Improve the coefficients by some markers' newest innovations and their predictions, (m,).

        They follow from the lagged ones (lags, m), before `remember`; solving takes time.
        """
        memory = TUNING.memory
        self._normal *= memory
        self._normal += lagged.dot(lagged.T)
        self._moment *= memory
        self._moment += lagged.dot(innovation)
        error = innovation - predicted
        share = (1 - memory) / len(innovation)
        self.level = memory * self.level + share * float(innovation.dot(innovation))
        self.left = memory * self.left + share * float(error.dot(error))
        if solve:
            ridge = self._normal + (TUNING.ridge * self.level) * self._unity
            self._coefficients = np.asarray(np.linalg.solve(ridge, self._moment), np.float64)
