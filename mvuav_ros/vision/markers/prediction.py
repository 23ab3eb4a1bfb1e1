"""Where markers will be: a Kalman filter per marker, and what their errors have in common."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.markers.kalman import TUNING as KALMAN
from mvuav_ros.vision.markers.kalman import Array, KalmanFilter
from mvuav_ros.vision.markers.vibration import TUNING as VIBRATION
from mvuav_ros.vision.markers.vibration import VibrationPredictor

Position = tuple[float, float]


@dataclass(frozen=True)
class PredictionTuning:
    """How far a prediction is trusted.

    Chosen on the simulator's four trials with and without vibration.

    Attributes:
        first_deviation: px, assumed of a prediction before anything is known of the motion.
        least_deviation: px, of a prediction.
        level_memory: per frame, of the squared errors of a marker's predictions.
        young: frames in which the vibration is learnt from every frame, later from every other.
        irregular: frames after a missing one for which both ways of predicting are compared.
    """

    first_deviation: float = 3.0
    least_deviation: float = 0.3
    level_memory: float = 0.9
    young: int = 100
    irregular: int = 200


TUNING = PredictionTuning()


class MotionPredictor:
    """Predicts any number of markers, each with position, velocity and acceleration.

    Each marker has a Kalman filter of constant acceleration on the images' own clock; its
    innovations are predicted in turn, which is where a camera's vibration shows.

    A frame that was dropped is stepped over as one in which nothing was seen: states and lagged
    innovations go on as predicted.

    Attributes:
        time: of the newest frame, s; None before the first.
    """

    def __init__(self, count: int) -> None:
        self.time: float | None = None
        self._step: float | None = None
        self._kalman = KalmanFilter(count)
        self._vibration = VibrationPredictor(count)
        self._nothing: Array = np.zeros(2 * count)
        self._correction: Array = self._nothing
        self._frames = 0
        self._skipped = 0
        self._irregular = 0
        self._filtered = self._straight = self._nothing
        self._errors = [1.0, 1.0]
        self._track: list[tuple[float | None, Array]] = []
        self._seen = [0] * count
        self._unseen = [0] * count
        self._real = [0] * count
        self._variance = [TUNING.first_deviation**2] * count

    @property
    def count(self) -> int:
        """Number of lights."""
        return len(self._seen)

    def add(self, position: Position) -> None:
        """Append a light that was first seen in the newest frame, px."""
        self._kalman.add(*position)
        self._vibration.add()
        self._nothing = np.zeros(self._kalman.state.shape[1])
        self._seen.append(1)
        self._unseen.append(0)
        self._real.append(0)
        self._variance.append(TUNING.first_deviation**2)

    def remove(self, index: int) -> None:
        """Forget a light; those after it move up."""
        pair = slice(2 * index, 2 * index + 2)
        self._kalman.remove(pair)
        self._vibration.remove(pair)
        self._nothing = np.zeros(self._kalman.state.shape[1])
        for values in (self._seen, self._unseen, self._real, self._variance):
            del values[index]

    def forget(self, index: int) -> None:
        """The light's next measurement is its first."""
        self._seen[index] = 0
        self._real[index] = 0

    def knows(self, index: int) -> bool:
        """Whether the light has been seen."""
        return self._seen[index] > 0

    def unseen(self, index: int) -> int:
        """Frames since the light was last seen."""
        return self._unseen[index]

    def predict(self, time: float) -> list[float]:
        """Go on to the next frame.

        Args:
            time: s, later than the last frame's.

        Returns:
            x and y of every light in turn, px; meaningless for one that was never seen.
        """
        if self.time is None:
            self.time = time
        else:
            elapsed = time - self.time
            self.time = time
            steps = self._count_steps(elapsed)
            assert self._step is not None
            self._skipped = min(steps - 1, KALMAN.longest_gap)
            if self._skipped:
                self._irregular = TUNING.irregular
            for _ in range(self._skipped):
                elapsed -= self._step
                self._kalman.advance(self._step)
                self._predict_vibration()
                self._pass_over()
            self._kalman.advance(elapsed)
        self._predict_vibration()
        prediction = self._kalman.state[0] + self._correction
        if self._irregular:
            prediction = self._choose(prediction, time)
        predicted: list[float] = prediction.tolist()
        return predicted

    def _predict_vibration(self) -> None:
        predicted = self._vibration.predict()
        # Coefficients from few or disturbed frames may do harm; what they would have saved on
        # the frames seen so far decides.
        self._correction = predicted if self._vibration.helps else self._nothing

    def _choose(self, filtered: Array, time: float) -> Array:
        """The filter's prediction, or a straight line through the newest two positions.

        Echoes need frames in a row. While frames go missing and the camera vibrates, the older
        positions that the filter also looks at do more harm than good.
        """
        self._filtered = self._straight = filtered
        if len(self._track) == 2:
            (t0, p0), (t1, p1) = self._track
            if t0 is not None and t1 is not None and len(p0) == len(p1) == len(filtered):
                line = p1 + (p1 - p0) * ((time - t1) / (t1 - t0))
                self._straight = np.where(np.isnan(line), filtered, line)
        return self._straight if self._errors[1] < 0.9 * self._errors[0] else filtered

    def _compare(self, measured: Array) -> None:
        """Keep the account for `_choose`."""
        self._irregular -= 1
        for number, predicted in enumerate((self._filtered, self._straight)):
            error = measured - predicted
            error = error[~np.isnan(error)]
            if len(error):
                mean = float(error @ error) / len(error)
                self._errors[number] += 0.05 * (mean - self._errors[number])

    def deviation(self, index: int) -> float:
        """How far off the prediction of the newest frame may be (1 sigma, px, per axis)."""
        frames = 1 + self._unseen[index] + self._skipped
        variance = self._variance[index]
        if frames > 1:
            # Echoes tell of the next frame only.
            variance = max(variance, self._vibration.level)
        deviation = math.sqrt(variance)
        if self._seen[index] < 3:
            # No velocity or a poor one: the step from frame to frame may be anything usual.
            deviation = max(deviation, TUNING.first_deviation)
        return max(deviation, TUNING.least_deviation) * frames * math.sqrt(frames)

    def positions(self) -> list[float]:
        """X and y of every light in turn at the newest frame, px."""
        places: list[float] = self._kalman.state[0].tolist()
        return places

    def motions(self) -> list[list[float]]:
        """Velocity (px/s) and acceleration (px/s²) of every light: x and y in turn, two rows.

        NaN before there are two, or three, measurements.
        """
        rows: list[list[float]] = self._kalman.state[1:].tolist()
        if min(self._seen, default=3) < 3:
            for index, seen in enumerate(self._seen):
                for order in (0, 1):
                    if seen < order + 2:
                        rows[order][2 * index] = rows[order][2 * index + 1] = math.nan
        return rows

    def update(self, positions: Sequence[float | None]) -> None:
        """Take the newest frame's measurements.

        Args:
            positions: x and y of every light in turn, px; None twice for one that was not seen.
        """
        if None in positions or self._frames < VIBRATION.lags or min(self._real) < VIBRATION.lags:
            self._update_some(positions)
        else:
            measured: Array = np.array(positions)
            innovation = measured - self._kalman.state[0]
            # Once much has been learnt, every other frame is enough for each, and saves time.
            odd = self._frames % 2
            if odd:
                self._judge((innovation - self._correction).tolist())
            if not odd or self._frames < TUNING.young:
                self._learn(slice(None), innovation)
            if self._irregular:
                self._compare(measured)
            self._track = [*self._track[-1:], (self.time, measured)]
            self._kalman.state += self._kalman.settled * innovation
            self._vibration.remember(innovation)
        self._frames += 1

    def _judge(self, errors: list[float]) -> None:
        for index in range(len(errors) // 2):
            square = 0.5 * (errors[2 * index] ** 2 + errors[2 * index + 1] ** 2)
            variance = self._variance[index]
            self._variance[index] = variance + (1 - TUNING.level_memory) * (square - variance)

    def _update_some(self, positions: Sequence[float | None]) -> None:
        """As `update`, where lights are missing, new, or back."""
        measured = np.array([math.nan if p is None else p for p in positions])
        if self._irregular:
            self._compare(measured)
        self._track = [*self._track[-1:], (self.time, measured)]
        innovation = self._vibration.stand_in()
        gains = np.zeros_like(self._kalman.state)
        known = [False] * self.count
        for index in range(self.count):
            x, y = positions[2 * index], positions[2 * index + 1]
            pair = slice(2 * index, 2 * index + 2)
            if x is None or y is None:
                self._unseen[index] += 1
                self._real[index] = 0
                if self._seen[index]:
                    gains[:, pair] = self._kalman.settled
                self._kalman.fade(pair)
                innovation[pair] *= VIBRATION.fading
                continue
            if self._seen[index] == 0:
                self._start(index, x, y)
                innovation[pair] = 0.0
                continue
            innovation[pair] = (x, y) - self._kalman.state[0, pair]
            error = innovation[pair] - self._correction[pair]
            gap = min(self._unseen[index] + self._skipped, KALMAN.longest_gap)
            gains[:, pair] = self._kalman.gain(self._seen[index], gap)
            if self._seen[index] >= 3 and not gap:
                square = 0.5 * (error[0] ** 2 + error[1] ** 2)
                memory = TUNING.level_memory if self._seen[index] > 10 else 0.5
                self._variance[index] += (1 - memory) * (square - self._variance[index])
            known[index] = self._real[index] >= VIBRATION.lags
            self._seen[index] += 1
            self._unseen[index] = 0
            # The first innovations of a new filter tell of the filter, not of the camera.
            self._real[index] += 1 if self._seen[index] > 3 else 0
        if any(known):
            columns = np.repeat(known, 2)
            self._learn(columns, innovation[columns])
        self._kalman.state += gains * innovation
        self._vibration.remember(innovation)

    def _start(self, index: int, x: float, y: float) -> None:
        pair = slice(2 * index, 2 * index + 2)
        self._kalman.start(pair, x, y)
        self._vibration.clear(pair)
        self._seen[index], self._unseen[index], self._real[index] = 1, 0, 0
        self._variance[index] = TUNING.first_deviation**2

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
        self._step = step
        self._kalman.set_step(step)

    def _pass_over(self) -> None:
        """A frame that never came: everything goes on as foretold."""
        limited = self._vibration.stand_in()
        self._kalman.state += self._kalman.settled * limited
        self._vibration.remember(limited)
        self._real = [0] * self.count

    def _learn(self, columns: NDArray[np.bool_] | slice, innovation: Array) -> None:
        vibration = self._vibration
        solve = self._frames % VIBRATION.solve_every == 0
        lagged, predicted = vibration.lagged[:, columns], vibration.predicted[columns]
        vibration.learn(lagged, innovation, predicted, solve)
