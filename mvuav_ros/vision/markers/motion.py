"""The motion of any number of lights: competing predictions, each by its merit."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.markers.predictions import (
    KALMAN,
    METHODS,
    VIBRATION,
    Extrapolation,
    KalmanFilter,
    VibrationPredictor,
)

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class RecordTuning:
    """How far a prediction is trusted.

    Chosen on the simulator's four trials with and without vibration.
    """

    # px, assumed of a prediction before anything is known of the motion.
    first_deviation: float = 3.0
    min_deviation: float = 0.3  # px, of a prediction
    level_memory: float = 0.9  # per frame, of the squared errors of a light's predictions


RECORD = RecordTuning()


class TrackRecord:
    """What has been seen of every light."""

    def __init__(self, count: int) -> None:
        self.seen = np.zeros(count, np.intp)  # (n,), measurements since its first
        self.unseen = np.zeros(count, np.intp)  # (n,), frames since the last one
        # (n,), measurements without a gap, less the first three, whose innovations are of the new
        # filter and not of the camera.
        self.in_row = np.zeros(count, np.intp)
        # (2 n,) px², of its predictions, x and y in turn.
        self.variance: Array = np.full(2 * count, RECORD.first_deviation**2)

    def add(self, count: int) -> None:
        """Append lights that were seen for the first time."""
        new = TrackRecord(count)
        self.seen = np.append(self.seen, new.seen + 1)
        self.unseen = np.append(self.unseen, new.unseen)
        self.in_row = np.append(self.in_row, new.in_row)
        self.variance = np.append(self.variance, new.variance)

    def keep(self, kept: Mask) -> None:
        """Forget all lights but some (n, true for those)."""
        self.seen, self.unseen = self.seen[kept], self.unseen[kept]
        self.in_row, self.variance = self.in_row[kept], self.variance[np.repeat(kept, 2)]

    def count(self, visible: Mask) -> None:
        """Take note of which lights (n, where true) were seen in a frame."""
        self.seen[visible] += 1
        self.unseen = np.where(visible, 0, self.unseen + 1)
        self.in_row = np.where(visible, self.in_row + (self.seen > 3), 0)

    def judge(self, error: Array) -> None:
        """Take the errors of all lights' predictions, (2 n,) px, which it may change."""
        variance = self.variance
        variance *= RECORD.level_memory
        error *= error
        error *= 1 - RECORD.level_memory
        variance += error

    def judge_some(self, error: Array, judged: Mask) -> None:
        """The same of some lights (n, where true)."""
        columns = np.repeat(judged, 2)
        share = np.repeat(np.where(self.seen > 10, 1 - RECORD.level_memory, 0.5), 2)
        change = share * (error**2 - self.variance)
        self.variance[columns] += change[columns]

    def start(self, columns: Mask) -> None:
        """Lights (2 n, where true) of whose motion nothing is known."""
        self.variance[columns] = RECORD.first_deviation**2

    def deviations(self, skipped: int, level: float) -> Array:
        """How far off the predictions of the newest frame may be, (n,) px, 1 sigma per axis.

        Before it some frames were skipped; the level (px²) is of what vibrates, which can be
        predicted for the next frame only.
        """
        frames = 1 + self.unseen + skipped
        least = np.where(frames > 1, level, RECORD.min_deviation**2)
        # No velocity or a poor one: the step from frame to frame may be anything usual.
        least[self.seen < 3] = RECORD.first_deviation**2
        variance = 0.5 * (self.variance[::2] + self.variance[1::2])
        variance = np.maximum(variance, np.maximum(least, RECORD.min_deviation**2))
        return np.asarray(np.sqrt(variance) * frames**1.5)


PRIOR = (0.5, 1.0, 1.0, 1.0, 1.0, 1.0)
"""Of each prediction's weight, the thesis's methods first, then the Kalman filter without and
with the prediction of vibration. Lights that stand still are rarer."""
YOUNG = 100  # Frames in which the vibration is learnt from every frame, later from every other
_KALMAN, _VIBRATION = len(METHODS), len(METHODS) + 1  # Rows of the predictions after the thesis's


@dataclass(frozen=True)
class MixtureTuning:
    """How fast the weights follow the errors.

    Chosen on flights of the motions in `mvuav_thesis.marker_paths` and some more, with seeds of
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
        self.kalman = KalmanFilter(count)  # one of them, which also estimates places and motions
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


_SAME_STEP = 1e-6  # Part of a step between frames that makes no difference to the gains


class MotionPredictor:
    """Predicts any number of lights, each with position, velocity and acceleration.

    Six predictions compete: the thesis's four, a Kalman filter of constant acceleration, and the
    same with what a vibrating camera will do, predicted from the filter's innovations. Each
    counts as its errors so far on all lights say, so that smooth motion is filtered, erratic
    motion followed, jitter smoothed and vibration predicted.

    A frame that was dropped is stepped over as one in which nothing was seen. A light out of
    sight is predicted by the Kalman filter alone.
    """

    def __init__(self, count: int) -> None:
        self.time: float | None = None  # of the newest frame, s; None before the first
        self._step: float | None = None
        self._predictions = Competition(count)
        self._record = TrackRecord(count)
        self._prediction: Array = np.zeros(2 * count)
        self._hidden: Mask | None = None
        self._skipped = 0
        self._steady = False

    def add(self, places: Array) -> None:
        """Append lights that were first seen in the newest frame, (k, 2) px."""
        self._predictions.add(np.asarray(places, np.float64).ravel())
        self._record.add(len(places))
        self._note()

    def keep(self, kept: Mask) -> None:
        """Forget all lights but some (n, true for those), which move up."""
        self._predictions.keep(np.repeat(kept, 2))
        self._record.keep(kept)
        self._note()

    def _note(self) -> None:
        """Take note of whether all lights have been in sight for long."""
        in_row = self._record.in_row
        self._steady = len(in_row) > 0 and bool((in_row >= VIBRATION.lags).all())
        hidden = self._record.unseen > 0
        self._hidden = np.repeat(hidden, 2) if hidden.any() else None

    def forget(self, index: int) -> None:
        """The light's next measurement is its first."""
        self._record.seen[index] = self._record.in_row[index] = 0
        self._steady = False

    def unseen(self, index: int) -> int:
        """Frames since the light was last seen."""
        return int(self._record.unseen[index])

    def predict(self, time: float, method: str = 'kalman') -> list[float]:
        """Go on to the next frame, of a later time (s).

        By ``kalman``, which is all predictions by their merit, or by one of `METHODS`.

        Returns:
            x and y of every light in turn, px; meaningless for one that was never seen.
        """
        if self.time is not None:
            elapsed = self._skip(time - self.time)
            self._predictions.predict(time, elapsed)
        self.time = time
        self._prediction = self._predictions.prediction(method, self._hidden)
        predicted: list[float] = self._prediction.tolist()
        return predicted

    def _skip(self, elapsed: float) -> float:
        """Step over the frames that never came in a time, s; the time that is left."""
        steps = self._count_steps(elapsed)
        assert self._step is not None
        self._skipped = min(steps - 1, KALMAN.max_gap)
        for _ in range(self._skipped):
            elapsed -= self._step
            self._predictions.skip(self._step)
            self._record.in_row[:] = 0
            self._steady = False
        return elapsed

    def _count_steps(self, elapsed: float) -> int:
        """How many frames on this one is, by the usual time between two."""
        steps, step = 1, elapsed
        # Otherwise a first step, or the one before it had frames missing.
        if self._step is not None and elapsed >= 0.7 * self._step:
            steps, step = max(1, round(elapsed / self._step)), self._step
            if steps <= 3:
                step += 0.05 * (elapsed / steps - step)
        if self._step is None or abs(step - self._step) > _SAME_STEP * step:
            self._step = step
            self._predictions.kalman.set_step(step)
        return steps

    def deviations(self) -> Array:
        """How far off the predictions of the newest frame may be, (n,) px, 1 sigma per axis."""
        return self._record.deviations(self._skipped, self._predictions.vibration.level)

    def positions(self) -> list[float]:
        """X and y of every light in turn at the newest frame, px."""
        places: list[float] = self._predictions.kalman.state[0].tolist()
        return places

    def motions(self) -> list[list[float]]:
        """Velocity (px/s) and acceleration (px/s²) of every light: x and y in turn, two rows.

        NaN before there are two, or three, measurements.
        """
        state = self._predictions.kalman.state
        if self._steady:
            rows: list[list[float]] = state[1:].tolist()
            return rows
        seen = np.repeat(self._record.seen, 2)
        velocity = np.where(seen < 2, math.nan, state[1])
        return [velocity.tolist(), np.where(seen < 3, math.nan, state[2]).tolist()]

    def update(self, positions: Sequence[float | None] | Array) -> None:
        """Take the newest frame's x and y of every light in turn, px; NaN or None if not seen."""
        assert self.time is not None
        measured = np.array(positions, np.float64)
        if self._steady and not np.isnan(measured.sum()):
            # As with the vibration, every other frame is enough.
            if self._predictions.frames % 2:
                self._record.judge(measured - self._prediction)
            self._predictions.update_all(self.time, measured)
        else:
            self._update_some(self.time, measured)
        self._predictions.frames += 1

    def _update_some(self, time: float, measured: Array) -> None:
        """Take a frame in which lights are missing, new, or back."""
        record, predictions = self._record, self._predictions
        visible = ~np.isnan(measured[::2])
        known = visible & (record.seen > 0)
        new = np.repeat(visible & ~known, 2)
        self._learn_from_some(measured, known)
        innovation = self._correct(measured, visible, known)
        if new.any():
            predictions.kalman.start(new, measured)
            predictions.vibration.clear(new)
            record.start(new)
        predictions.vibration.remember(innovation)
        restarted = np.repeat(known & ((record.seen == 1) | (record.unseen > 0)), 2)
        predictions.update_some(time, measured, new, restarted)
        record.count(visible)
        self._note()

    def _learn_from_some(self, measured: Array, known: Mask) -> None:
        """Judge the predictions by the lights whose motion was known (n, where true)."""
        record, predictions = self._record, self._predictions
        judged = known & (record.seen >= 3) & (record.unseen == 0)
        if judged.any():
            predictions.judge(measured, np.repeat(judged, 2))
            if not self._skipped:
                record.judge_some(measured - self._prediction, judged)
        columns = np.repeat(known & (record.in_row >= VIBRATION.lags), 2)
        if columns.any():
            innovation = (measured - predictions.kalman.state[0])[columns]
            predictions.learn_vibration(columns, innovation)

    def _correct(self, measured: Array, visible: Mask, known: Mask) -> Array:
        """Correct the Kalman filter, and return the innovations, (2 n,) px."""
        record, kalman = self._record, self._predictions.kalman
        columns = np.repeat(visible, 2)
        innovation = VIBRATION.fading * self._predictions.vibration.stand_in()
        innovation[columns] = (measured - kalman.state[0])[columns]
        gains = kalman.gains(record.seen, record.unseen + self._skipped)
        gains = np.where(visible, gains, kalman.settled * (record.seen > 0))
        gains = np.repeat(gains, 2, axis=1)
        kalman.fade(~columns)
        innovation[np.repeat(visible & ~known, 2)] = 0.0
        kalman.state += gains * innovation
        return innovation
