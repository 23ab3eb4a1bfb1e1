"""Where lights will be next: a Kalman filter, vibration and the thesis's methods, by merit."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.markers.prediction.competition import Competition
from mvuav_ros.vision.markers.prediction.kalman import TUNING as KALMAN
from mvuav_ros.vision.markers.prediction.track_record import TrackRecord
from mvuav_ros.vision.markers.prediction.vibration import TUNING as VIBRATION

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

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
        self._skipped = min(steps - 1, KALMAN.longest_gap)
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
        """Correct the Kalman filter, and tell the innovations, (2 n,) px."""
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
