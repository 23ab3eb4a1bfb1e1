"""Six predictions of any number of lights: the thesis's four, a Kalman filter, and vibration."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.markers.prediction.extrapolation import METHODS, Extrapolation
from mvuav_ros.vision.markers.prediction.kalman import KalmanFilter
from mvuav_ros.vision.markers.prediction.vibration import TUNING as VIBRATION
from mvuav_ros.vision.markers.prediction.vibration import VibrationPredictor

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

PRIOR = (0.5, 1.0, 1.0, 1.0, 1.0, 1.0)
"""Of each prediction's weight, the thesis's methods first, then the Kalman filter without and
with the prediction of vibration. Lights that stand still are rarer."""
YOUNG = 100  # Frames in which the vibration is learnt from every frame, later from every other
_KALMAN, _VIBRATION = len(METHODS), len(METHODS) + 1  # Rows of the predictions after the thesis's


@dataclass(frozen=True)
class MixtureTuning:
    """How fast the weights follow the errors.

    Chosen on flights of the motions in `simulation.marker_paths` and some more, with seeds of
    their own; memories of 0.98 to 0.99 and confidences of 2 to 3.5 give the same to 1 %.
    """

    memory: float = 0.985  # per frame, of the squared errors
    # By how much a frame's evidence counts. A frame of five rigid markers is worth about that of
    # two independent coordinates, for which 0.5 x 2 would be Bayes's rule were the errors' sizes
    # known; that of frames which stand out is counted below.
    confidence: float = 2.5


MIXTURE = MixtureTuning()


class PredictionMixture:
    """The weighted mean of competing predictions.

    The weight of each is its prior times (mean squared error) to the power -c n: the posterior
    of a model whose errors have an unknown variance, from n frames. Where few frames make up
    most of the squares, as after the start of a gust, n is that few: (sum of squares)² over the
    sum of their squares, as for weighted samples (L. Kish, Survey Sampling, 1965).
    """

    def __init__(self, prior: Sequence[float]) -> None:
        self._prior = tuple(prior)
        self.weights: Array = np.array(prior) / sum(prior)  # (k,), sum 1
        self._share: Array = np.empty(0)
        self._losses = [0.0] * len(prior)
        self._sum = self._sum_of_squares = 0.0

    def learn(self, errors: Array) -> None:
        """Take the errors of the newest predictions, (k, m) px."""
        count = errors.shape[1]
        if count != len(self._share):
            self._share = np.full(count, 1.0 / count)
        new: list[float] = (errors * errors).dot(self._share).tolist()
        memory = MIXTURE.memory
        losses = self._losses = [
            memory * old + loss for old, loss in zip(self._losses, new, strict=True)
        ]
        usual = sorted(new)[1]
        self._sum = memory * self._sum + usual
        self._sum_of_squares = memory * self._sum_of_squares + usual * usual
        least = min(losses)
        if least <= 0.0 or self._sum_of_squares <= 0.0:
            return
        power = -MIXTURE.confidence * self._sum * self._sum / self._sum_of_squares
        weights = [
            prior * (loss / least) ** power for prior, loss in zip(self._prior, losses, strict=True)
        ]
        total = sum(weights)
        self.weights = np.array([weight / total for weight in weights])


class Competition:
    """The predictions, and how far each of them counts by its errors so far on all lights."""

    def __init__(self, count: int) -> None:
        self.kalman = KalmanFilter(count)  # one of them, which also tells places and motions
        self.vibration = VibrationPredictor(count)  # what a vibrating camera will do
        self.frames = 0  # seen
        self._extrapolation = Extrapolation(count)
        self._mixture = PredictionMixture(PRIOR)
        self._rows: Array = np.zeros((len(PRIOR), 2 * count))

    def add(self, places: Array) -> None:
        """Append lights at their first places, (2 k,) px, x and y in turn."""
        self.kalman.add(places)
        self.vibration.add(len(places) // 2)
        self._extrapolation.add(places)
        self._rows = np.zeros((len(PRIOR), self._rows.shape[1] + len(places)))

    def keep(self, columns: Mask) -> None:
        """Forget all lights but some (2 n, true for those)."""
        self.kalman.keep(columns)
        self.vibration.keep(columns)
        self._extrapolation.keep(columns)
        self._rows = np.zeros((len(PRIOR), int(columns.sum())))

    def skip(self, step: float) -> None:
        """A frame that never came, s after the last one: everything goes on as predicted."""
        self.kalman.advance(step)
        self.vibration.predict()
        innovation = self.vibration.stand_in()
        self.kalman.state += self.kalman.settled * innovation
        self.vibration.remember(innovation)

    def predict(self, time: float, elapsed: float) -> None:
        """Go on to the next frame at a time, so many s after the one before it."""
        rows = self._rows
        self.kalman.advance(elapsed)
        self._extrapolation.predict(time, rows)
        rows[_KALMAN] = self.kalman.state[0]
        np.add(rows[_KALMAN], self.vibration.predict(), rows[_VIBRATION])

    def prediction(self, method: str, hidden: Mask | None) -> Array:
        """Of the newest frame, (2 n,) px, by one of `METHODS`, or by all of them by their merit.

        The Kalman filter alone predicts lights out of sight (2 n, where hidden).
        """
        if method in METHODS:
            return np.asarray(self._rows[METHODS.index(method)])
        weighed: Array = self._mixture.weights.dot(self._rows)
        if hidden is None:
            return weighed
        # Coefficients from few or disturbed frames may do harm; what they would have saved on
        # the frames seen so far decides.
        best = _VIBRATION if self.vibration.helps else _KALMAN
        return np.asarray(np.where(hidden, self._rows[best], weighed))

    def update_all(self, time: float, measured: Array) -> None:
        """The usual frame: every light is in sight, and has been for some time."""
        errors = measured - self._rows
        self._mixture.learn(errors)
        innovation = errors[_KALMAN]
        # Once much has been learnt, every other frame is enough, and saves time.
        if not self.frames % 2 or self.frames < YOUNG:
            self.learn_vibration(slice(None), innovation)
        self.kalman.state += self.kalman.settled * innovation
        self.vibration.remember(innovation)
        self._extrapolation.update(time, measured)

    def judge(self, measured: Array, columns: Mask) -> None:
        """Learn the merits from some lights (2 n, where true) whose motion was known."""
        self._mixture.learn((measured - self._rows)[:, columns])

    def update_some(self, time: float, measured: Array, new: Mask, restarted: Mask) -> None:
        """Take places (2 n,), NaN where not seen; see `Extrapolation.update_some`."""
        self._extrapolation.update_some(time, measured, new, restarted)

    def learn_vibration(self, columns: Mask | slice, innovation: Array) -> None:
        """Learn from the innovations of some lights."""
        vibration = self.vibration
        every = VIBRATION.solve_every if self.frames < YOUNG else 2 * VIBRATION.solve_every
        solve = self.frames % every == 0
        lagged, predicted = vibration.lagged[:, columns], vibration.predicted[columns]
        vibration.learn(lagged, innovation, predicted, solve)
