"""Where markers will be next: a Kalman filter, vibration and the thesis's methods, by merit."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.markers.extrapolation import METHODS, Extrapolation
from mvuav_ros.vision.markers.kalman import TUNING as KALMAN
from mvuav_ros.vision.markers.kalman import Array, KalmanFilter
from mvuav_ros.vision.markers.mixture import PredictionMixture
from mvuav_ros.vision.markers.vibration import TUNING as VIBRATION
from mvuav_ros.vision.markers.vibration import VibrationPredictor

Mask = NDArray[np.bool_]
_KALMAN, _VIBRATION = len(METHODS), len(METHODS) + 1
"""Rows of the predictions after the thesis's."""
_SAME_STEP = 1e-6
"""Part of a step between frames that makes no difference to the gains."""


@dataclass(frozen=True)
class PredictionTuning:
    """How far a prediction is trusted.

    Chosen on the simulator's four trials with and without vibration.

    Attributes:
        prior: of each prediction's weight, the thesis's methods first, then the Kalman filter
            without and with the prediction of vibration. Markers that stand still are rarer.
        first_deviation: px, assumed of a prediction before anything is known of the motion.
        least_deviation: px, of a prediction.
        level_memory: per frame, of the squared errors of a marker's predictions.
        young: frames in which the vibration is learnt from every frame, later from every other.
    """

    prior: tuple[float, ...] = (0.5, 1.0, 1.0, 1.0, 1.0, 1.0)
    first_deviation: float = 3.0
    least_deviation: float = 0.3
    level_memory: float = 0.9
    young: int = 100


TUNING = PredictionTuning()


class _Record:
    """What has been seen of every marker.

    Attributes:
        seen: (n,), measurements since its first.
        unseen: (n,), frames since the last one.
        in_row: (n,), measurements without a gap, less the first three, whose innovations tell
            of the new filter and not of the camera.
        variance: (2 n,) px², of its predictions, x and y in turn.
    """

    def __init__(self, count: int) -> None:
        self.seen = np.zeros(count, np.intp)
        self.unseen = np.zeros(count, np.intp)
        self.in_row = np.zeros(count, np.intp)
        self.variance: Array = np.full(2 * count, TUNING.first_deviation**2)

    def add(self, count: int) -> None:
        """Append markers that were seen for the first time."""
        new = _Record(count)
        self.seen = np.append(self.seen, new.seen + 1)
        self.unseen = np.append(self.unseen, new.unseen)
        self.in_row = np.append(self.in_row, new.in_row)
        self.variance = np.append(self.variance, new.variance)

    def keep(self, kept: Mask) -> None:
        """Forget all markers but some (n, true for those)."""
        self.seen, self.unseen = self.seen[kept], self.unseen[kept]
        self.in_row, self.variance = self.in_row[kept], self.variance[np.repeat(kept, 2)]

    def count(self, visible: Mask) -> None:
        """Take note of which markers (n, where true) were seen in a frame."""
        self.seen[visible] += 1
        self.unseen = np.where(visible, 0, self.unseen + 1)
        self.in_row = np.where(visible, self.in_row + (self.seen > 3), 0)


class MotionPredictor:
    """Predicts any number of markers, each with position, velocity and acceleration.

    Six predictions compete: the thesis's four, a Kalman filter of constant acceleration, and the
    same with what a vibrating camera will do, predicted from the filter's innovations. Each
    counts as its errors so far on all markers say, so that smooth motion is filtered, erratic
    motion followed, jitter smoothed and vibration predicted.

    A frame that was dropped is stepped over as one in which nothing was seen. A marker out of
    sight is predicted by the Kalman filter alone.

    Attributes:
        time: of the newest frame, s; None before the first.
    """

    def __init__(self, count: int) -> None:
        self.time: float | None = None
        self._step: float | None = None
        self._kalman = KalmanFilter(count)
        self._vibration = VibrationPredictor(count)
        self._extrapolation = Extrapolation(count)
        self._mixture = PredictionMixture(TUNING.prior)
        self._record = _Record(count)
        self._rows: Array = np.zeros((len(TUNING.prior), 2 * count))
        self._prediction: Array = np.zeros(2 * count)
        self._hidden: Mask | None = None
        self._frames = 0
        self._skipped = 0
        self._steady = False

    @property
    def count(self) -> int:
        """Number of markers."""
        return len(self._record.seen)

    def add(self, places: Array) -> None:
        """Append markers that were first seen in the newest frame, (k, 2) px."""
        flat = np.asarray(places, np.float64).ravel()
        self._kalman.add(flat)
        self._vibration.add(len(flat) // 2)
        self._extrapolation.add(flat)
        self._record.add(len(flat) // 2)
        self._resize()

    def keep(self, kept: Mask) -> None:
        """Forget all markers but some (n, true for those), which move up."""
        columns = np.repeat(kept, 2)
        self._kalman.keep(columns)
        self._vibration.keep(columns)
        self._extrapolation.keep(columns)
        self._record.keep(kept)
        self._resize()

    def _resize(self) -> None:
        self._rows = np.zeros((len(self._rows), 2 * self.count))
        self._note()

    def _note(self) -> None:
        """Take note of whether all markers have been in sight for long."""
        in_row = self._record.in_row
        self._steady = len(in_row) > 0 and bool((in_row >= VIBRATION.lags).all())
        hidden = self._record.unseen > 0
        self._hidden = np.repeat(hidden, 2) if hidden.any() else None

    def forget(self, index: int) -> None:
        """The marker's next measurement is its first."""
        self._record.seen[index] = self._record.in_row[index] = 0
        self._steady = False

    def knows(self, index: int) -> bool:
        """Whether the marker has been seen."""
        return bool(self._record.seen[index] > 0)

    def unseen(self, index: int) -> int:
        """Frames since the marker was last seen."""
        return int(self._record.unseen[index])

    def predict(self, time: float, method: str = 'kalman') -> list[float]:
        """Go on to the next frame.

        Args:
            time: s, later than the last frame's.
            method: ``kalman`` for all predictions by their merit, or one of `METHODS`.

        Returns:
            x and y of every marker in turn, px; meaningless for one that was never seen.
        """
        if self.time is not None:
            self._advance(time - self.time)
            self._predict_rows(time)
        self.time = time
        if method in METHODS:
            self._prediction = self._rows[METHODS.index(method)]
        else:
            self._prediction = self._mixture.weights.dot(self._rows)
            if self._hidden is not None:
                self._prediction = np.where(self._hidden, self._rows[self._best], self._prediction)
        predicted: list[float] = self._prediction.tolist()
        return predicted

    @property
    def _best(self) -> int:
        # Coefficients from few or disturbed frames may do harm; what they would have saved on
        # the frames seen so far decides.
        return _VIBRATION if self._vibration.helps else _KALMAN

    def _predict_rows(self, time: float) -> None:
        rows = self._rows
        self._extrapolation.predict(time, rows)
        rows[_KALMAN] = self._kalman.state[0]
        np.add(rows[_KALMAN], self._vibration.predict(), rows[_VIBRATION])

    def _advance(self, elapsed: float) -> None:
        steps = self._count_steps(elapsed)
        assert self._step is not None
        self._skipped = min(steps - 1, KALMAN.longest_gap)
        for _ in range(self._skipped):
            elapsed -= self._step
            self._kalman.advance(self._step)
            self._vibration.predict()
            self._pass_over()
        self._kalman.advance(elapsed)

    def _pass_over(self) -> None:
        """A frame that never came: everything goes on as predicted."""
        innovation = self._vibration.stand_in()
        self._kalman.state += self._kalman.settled * innovation
        self._vibration.remember(innovation)
        self._record.in_row[:] = 0
        self._steady = False

    def _count_steps(self, elapsed: float) -> int:
        """How many frames on this one is, by the usual time between two."""
        if self._step is None or elapsed < 0.7 * self._step:
            # A first step, or the one before it had frames missing.
            self._set_step(elapsed)
            return 1
        steps = max(1, round(elapsed / self._step))
        if steps <= 3:
            self._set_step(self._step + 0.05 * (elapsed / steps - self._step))
        return steps

    def _set_step(self, step: float) -> None:
        if self._step is None or abs(step - self._step) > _SAME_STEP * step:
            self._step = step
            self._kalman.set_step(step)

    def deviation(self, index: int) -> float:
        """How far off the prediction of the newest frame may be (1 sigma, px, per axis)."""
        record = self._record
        frames = 1 + int(record.unseen[index]) + self._skipped
        variance = 0.5 * float(record.variance[2 * index] + record.variance[2 * index + 1])
        if frames > 1:
            # What vibrates can be told of the next frame only.
            variance = max(variance, self._vibration.level)
        deviation = math.sqrt(variance)
        if record.seen[index] < 3:
            # No velocity or a poor one: the step from frame to frame may be anything usual.
            deviation = max(deviation, TUNING.first_deviation)
        return max(deviation, TUNING.least_deviation) * frames * math.sqrt(frames)

    def deviations(self) -> Array:
        """The same of all markers, (n,)."""
        record = self._record
        frames = 1 + record.unseen + self._skipped
        least = np.where(frames > 1, self._vibration.level, TUNING.least_deviation**2)
        least[record.seen < 3] = TUNING.first_deviation**2
        variance = 0.5 * (record.variance[::2] + record.variance[1::2])
        variance = np.maximum(variance, np.maximum(least, TUNING.least_deviation**2))
        return np.asarray(np.sqrt(variance) * frames**1.5)

    def positions(self) -> list[float]:
        """X and y of every marker in turn at the newest frame, px."""
        places: list[float] = self._kalman.state[0].tolist()
        return places

    def motions(self) -> list[list[float]]:
        """Velocity (px/s) and acceleration (px/s²) of every marker: x and y in turn, two rows.

        NaN before there are two, or three, measurements.
        """
        if self._steady:
            rows: list[list[float]] = self._kalman.state[1:].tolist()
            return rows
        seen = np.repeat(self._record.seen, 2)
        state = self._kalman.state
        velocity = np.where(seen < 2, math.nan, state[1])
        return [velocity.tolist(), np.where(seen < 3, math.nan, state[2]).tolist()]

    def update(self, positions: Sequence[float | None] | Array) -> None:
        """Take the newest frame's measurements.

        Args:
            positions: x and y of every marker in turn, px; None or NaN twice for one not seen.
        """
        measured = np.array(positions, np.float64)
        if self._steady and not np.isnan(measured.sum()):
            self._update_all(measured)
        else:
            self._update_some(measured)
        self._frames += 1

    def _update_all(self, measured: Array) -> None:
        """The usual frame: every marker is in sight, and has been for some time."""
        assert self.time is not None
        errors = measured - self._rows
        self._mixture.learn(errors)
        innovation = errors[_KALMAN]
        # Once much has been learnt, every other frame is enough for each, and saves time.
        odd = self._frames % 2
        if odd:
            self._judge(measured)
        if not odd or self._frames < TUNING.young:
            self._learn_vibration(slice(None), innovation)
        self._kalman.state += self._kalman.settled * innovation
        self._vibration.remember(innovation)
        self._extrapolation.update(self.time, measured)

    def _judge(self, measured: Array) -> None:
        error = measured - self._prediction
        variance = self._record.variance
        variance *= TUNING.level_memory
        error *= error
        error *= 1 - TUNING.level_memory
        variance += error

    def _update_some(self, measured: Array) -> None:
        """As `_update_all`, where markers are missing, new, or back."""
        assert self.time is not None
        record = self._record
        visible = ~np.isnan(measured[::2])
        known = visible & (record.seen > 0)
        new = np.repeat(visible & ~known, 2)
        self._learn_from_some(measured, known)
        innovation = self._correct(measured, visible, known)
        if new.any():
            self._kalman.start(new, measured)
            self._vibration.clear(new)
            record.variance[new] = TUNING.first_deviation**2
        self._vibration.remember(innovation)
        restarted = np.repeat(known & ((record.seen == 1) | (record.unseen > 0)), 2)
        self._extrapolation.update_some(self.time, measured, new, restarted)
        record.count(visible)
        self._note()

    def _learn_from_some(self, measured: Array, known: Mask) -> None:
        """Judge the predictions by the markers whose motion was known (n, where true)."""
        record = self._record
        judged = known & (record.seen >= 3) & (record.unseen == 0)
        if judged.any():
            columns = np.repeat(judged, 2)
            self._mixture.learn((measured - self._rows)[:, columns])
            if not self._skipped:
                self._judge_some(measured, judged)
        columns = np.repeat(known & (record.in_row >= VIBRATION.lags), 2)
        if columns.any():
            innovation = (measured - self._kalman.state[0])[columns]
            self._learn_vibration(columns, innovation)

    def _judge_some(self, measured: Array, judged: Mask) -> None:
        record = self._record
        columns = np.repeat(judged, 2)
        share = np.repeat(np.where(record.seen > 10, 1 - TUNING.level_memory, 0.5), 2)
        change = share * ((measured - self._prediction) ** 2 - record.variance)
        record.variance[columns] += change[columns]

    def _correct(self, measured: Array, visible: Mask, known: Mask) -> Array:
        """Correct the Kalman filter, and tell the innovations, (2 n,) px."""
        record, kalman = self._record, self._kalman
        columns = np.repeat(visible, 2)
        innovation = VIBRATION.fading * self._vibration.stand_in()
        innovation[columns] = (measured - kalman.state[0])[columns]
        gains = kalman.gains(record.seen, record.unseen + self._skipped)
        gains = np.where(visible, gains, kalman.settled * (record.seen > 0))
        gains = np.repeat(gains, 2, axis=1)
        kalman.fade(~columns)
        innovation[np.repeat(visible & ~known, 2)] = 0.0
        kalman.state += gains * innovation
        return innovation

    def _learn_vibration(self, columns: Mask | slice, innovation: Array) -> None:
        vibration = self._vibration
        every = VIBRATION.solve_every if self._frames < TUNING.young else 2 * VIBRATION.solve_every
        solve = self._frames % every == 0
        lagged, predicted = vibration.lagged[:, columns], vibration.predicted[columns]
        vibration.learn(lagged, innovation, predicted, solve)
