"""Where lights will be: a Kalman filter per light, and what the lights' errors have in common."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Position = tuple[float, float]

MANEUVER = 1.0
"""Process noise over measurement noise, as the acceleration's change within a frame over the
measurement's deviation. The level of both follows from the innovations."""
ECHOES = 6
"""Past innovations from which the next one is foretold: two for each harmonic of a vibration."""
MEMORY = 0.99
"""Per frame, of what is learnt about the echoes."""
_RIDGE = 10.0
_SOLVE_EVERY = 4
_YOUNG = 100
_LEVEL_MEMORY = 0.9
FIRST_DEVIATION = 3.0
"""px, assumed of a prediction before anything is known of the motion."""
LEAST_DEVIATION = 0.3
"""px, of a prediction."""
_LONGEST_GAP = 10
_IRREGULAR = 200
"""Frames after a missing one for which both ways of predicting are compared."""
_UNSEEN_FADING = 0.7
_VELOCITY_FADING = 0.95
"""Per frame unseen: an acceleration cannot be trusted for long, a velocity somewhat longer."""


class KalmanFilter:
    """Predicts any number of lights, each with position, velocity and acceleration.

    Each light has a Kalman filter of constant acceleration with white jerk, on the images' own
    clock. With frames in regular steps its gains settle, so they are taken from tables: for the
    n-th measurement of a new light, and for the first one after n frames without. The level of
    the noise, process and measurement alike, follows each light's innovations.

    Such a filter's innovations are white where its model holds. A camera's vibration is none of
    its model, moves all lights alike and echoes: the next innovation is foretold from the last
    six, with coefficients learnt from all lights by recursive least squares (a Kalman filter of
    its own, whose state is the coefficients). White jitter has no echo and leaves them at zero.

    A frame that was dropped is stepped over as one in which nothing was seen: states and echoes
    go on as predicted.

    Attributes:
        time: of the newest frame, s; None before the first.
    """

    def __init__(self, count: int) -> None:
        self.time: float | None = None
        self._step: float | None = None
        self._state: Array = np.zeros((3, 2 * count))
        self._transition: Array = np.eye(3)
        self._echo: Array = np.zeros((ECHOES, 2 * count))
        self._foretold: Array = np.zeros(2 * count)
        self._nothing: Array = np.zeros(2 * count)
        self._correction: Array = self._nothing
        self._weights: Array = np.zeros(ECHOES)
        self._normal: Array = np.zeros((ECHOES, ECHOES))
        self._moment: Array = np.zeros(ECHOES)
        self._level = self._left = 0.01
        self._frames = 0
        self._skipped = 0
        self._irregular = 0
        self._filtered = self._straight = self._nothing
        self._errors = [1.0, 1.0]
        self._track: list[tuple[float | None, Array]] = []
        self._seen = [0] * count
        self._unseen = [0] * count
        self._real = [0] * count
        self._variance = [FIRST_DEVIATION**2] * count

    @property
    def count(self) -> int:
        """Number of lights."""
        return len(self._seen)

    def add(self, position: Position) -> None:
        """Append a light that was first seen in the newest frame, px."""
        column = np.array(position)
        self._state = np.hstack((self._state, [column, (0.0, 0.0), (0.0, 0.0)]))
        self._echo = np.hstack((self._echo, np.zeros((ECHOES, 2))))
        self._nothing = np.zeros(self._state.shape[1])
        self._seen.append(1)
        self._unseen.append(0)
        self._real.append(0)
        self._variance.append(FIRST_DEVIATION**2)

    def remove(self, index: int) -> None:
        """Forget a light; those after it move up."""
        self._state = np.delete(self._state, (2 * index, 2 * index + 1), axis=1)
        self._echo = np.delete(self._echo, (2 * index, 2 * index + 1), axis=1)
        self._nothing = np.zeros(self._state.shape[1])
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
            self._skipped = min(steps - 1, _LONGEST_GAP)
            if self._skipped:
                self._irregular = _IRREGULAR
            for _ in range(self._skipped):
                elapsed -= self._step
                self._advance(self._step)
                self._foretell()
                self._pass_over()
            self._advance(elapsed)
        self._foretell()
        prediction = self._state[0] + self._correction
        if self._irregular:
            prediction = self._choose(prediction, time)
        predicted: list[float] = prediction.tolist()
        return predicted

    def _foretell(self) -> None:
        self._foretold = self._weights @ self._echo
        # Coefficients from few or disturbed frames may do harm; what they would have saved on
        # the frames seen so far decides.
        self._correction = self._foretold if self._left < self._level else self._nothing

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
            variance = max(variance, self._level)
        deviation = math.sqrt(variance)
        if self._seen[index] < 3:
            # No velocity or a poor one: the step from frame to frame may be anything usual.
            deviation = max(deviation, FIRST_DEVIATION)
        return max(deviation, LEAST_DEVIATION) * frames * math.sqrt(frames)

    def positions(self) -> list[float]:
        """X and y of every light in turn at the newest frame, px."""
        places: list[float] = self._state[0].tolist()
        return places

    def motions(self) -> list[list[float]]:
        """Velocity (px/s) and acceleration (px/s²) of every light: x and y in turn, two rows.

        NaN before there are two, or three, measurements.
        """
        rows: list[list[float]] = self._state[1:].tolist()
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
        if None in positions or self._frames < ECHOES or min(self._real) < ECHOES:
            self._update_some(positions)
        else:
            measured: Array = np.array(positions)
            innovation = measured - self._state[0]
            # Once much has been learnt, every other frame is enough for each, and saves time.
            odd = self._frames % 2
            if odd:
                self._judge((innovation - self._correction).tolist())
            if not odd or self._frames < _YOUNG:
                self._learn(self._echo, innovation, self._foretold)
            if self._irregular:
                self._compare(measured)
            self._track = [*self._track[-1:], (self.time, measured)]
            self._state += self._gain * innovation
            self._remember(innovation)
        self._frames += 1

    def _judge(self, errors: list[float]) -> None:
        for index in range(len(errors) // 2):
            square = 0.5 * (errors[2 * index] ** 2 + errors[2 * index + 1] ** 2)
            variance = self._variance[index]
            self._variance[index] = variance + (1 - _LEVEL_MEMORY) * (square - variance)

    def _update_some(self, positions: Sequence[float | None]) -> None:
        """As `update`, where lights are missing, new, or back."""
        measured = np.array([math.nan if p is None else p for p in positions])
        if self._irregular:
            self._compare(measured)
        self._track = [*self._track[-1:], (self.time, measured)]
        innovation = self._limited()
        gains = np.zeros_like(self._state)
        known = [False] * self.count
        for index in range(self.count):
            x, y = positions[2 * index], positions[2 * index + 1]
            pair = slice(2 * index, 2 * index + 2)
            if x is None or y is None:
                self._unseen[index] += 1
                self._real[index] = 0
                if self._seen[index]:
                    gains[:, pair] = self._gain
                self._state[2, pair] *= _UNSEEN_FADING
                self._state[1, pair] *= _VELOCITY_FADING
                innovation[pair] *= _UNSEEN_FADING
                continue
            if self._seen[index] == 0:
                self._start(index, x, y)
                innovation[pair] = 0.0
                continue
            innovation[pair] = (x, y) - self._state[0, pair]
            error = innovation[pair] - self._correction[pair]
            gap = min(self._unseen[index] + self._skipped, _LONGEST_GAP)
            gains[:, pair] = self._gain_of(self._seen[index], gap)
            if self._seen[index] >= 3 and not gap:
                square = 0.5 * (error[0] ** 2 + error[1] ** 2)
                memory = _LEVEL_MEMORY if self._seen[index] > 10 else 0.5
                self._variance[index] += (1 - memory) * (square - self._variance[index])
            known[index] = self._real[index] >= ECHOES
            self._seen[index] += 1
            self._unseen[index] = 0
            # The first innovations of a new filter tell of the filter, not of the camera.
            self._real[index] += 1 if self._seen[index] > 3 else 0
        if any(known):
            columns = np.repeat(known, 2)
            self._learn(self._echo[:, columns], innovation[columns], self._foretold[columns])
        self._state += gains * innovation
        self._remember(innovation)

    def _start(self, index: int, x: float, y: float) -> None:
        pair = slice(2 * index, 2 * index + 2)
        self._state[:, pair] = 0.0
        self._state[0, pair] = x, y
        self._echo[:, pair] = 0.0
        self._seen[index], self._unseen[index], self._real[index] = 1, 0, 0
        self._variance[index] = FIRST_DEVIATION**2

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
        per_frame = np.array([(1.0,), (1.0 / step,), (1.0 / step**2,)])
        self._units: Array = per_frame
        self._gain: Array = _settled_gain() * per_frame

    def _gain_of(self, seen: int, gap: int) -> Array:
        if gap == 0:
            starting = _starting_gains()
            if seen < len(starting):
                return np.asarray(starting[seen] * self._units)
            return self._gain
        return np.asarray(_gains_after_gaps()[gap] * self._units)

    def _advance(self, elapsed: float) -> None:
        transition = self._transition
        transition[0, 1] = transition[1, 2] = elapsed
        transition[0, 2] = 0.5 * elapsed * elapsed
        self._state = transition @ self._state

    def _pass_over(self) -> None:
        """A frame that never came: everything goes on as foretold."""
        limited = self._limited()
        self._state += self._gain * limited
        self._remember(limited)
        self._real = [0] * self.count

    def _limited(self) -> Array:
        """What is foretold in the place of a measurement, so that it cannot build up."""
        limit = 2.0 * math.sqrt(self._level)
        return np.asarray(_UNSEEN_FADING * np.clip(self._correction, -limit, limit))

    def _remember(self, innovation: Array) -> None:
        echo = np.empty_like(self._echo)
        echo[0] = innovation
        echo[1:] = self._echo[:-1]
        self._echo = echo

    def _learn(self, echo: Array, innovation: Array, foretold: Array) -> None:
        self._normal *= MEMORY
        self._normal += echo @ echo.T
        self._moment *= MEMORY
        self._moment += echo @ innovation
        error = innovation - foretold
        share = (1 - MEMORY) / len(innovation)
        self._level = MEMORY * self._level + share * float(innovation @ innovation)
        self._left = MEMORY * self._left + share * float(error @ error)
        if self._frames % _SOLVE_EVERY == 0:
            ridge = self._normal + (_RIDGE * self._level) * _UNITY
            self._weights = np.asarray(np.linalg.solve(ridge, self._moment), np.float64)


_UNITY = np.eye(ECHOES)


def _transition() -> tuple[Array, Array]:
    """State transition over one frame, and the process noise's covariance; frames and px."""
    transition = np.array([(1.0, 1.0, 0.5), (0.0, 1.0, 1.0), (0.0, 0.0, 1.0)])
    effect = np.array((0.5, 1.0, 1.0))
    return transition, MANEUVER**2 * np.outer(effect, effect)


@lru_cache(maxsize=1)
def _starting_gains() -> tuple[Array, ...]:
    """Gains (3, 1) of a light's first, second ... measurement until they settle."""
    transition, noise = _transition()
    covariance: Array = np.diag((1.0, 1e4, 1.0))
    gains: list[Array] = [np.array([(1.0,), (0.0,), (0.0,)])]
    for _ in range(30):
        covariance = transition @ covariance @ transition.T + noise
        gains.append(covariance[:, :1] / (covariance[0, 0] + 1.0))
        covariance = covariance - gains[-1] @ covariance[:1]
    return tuple(gains)


@lru_cache(maxsize=1)
def _settled_gain() -> Array:
    return _starting_gains()[-1]


@lru_cache(maxsize=1)
def _gains_after_gaps() -> tuple[Array, ...]:
    """Gains (3, 1) of the first measurement after n frames without, n up to `_LONGEST_GAP`."""
    transition, noise = _transition()
    covariance: Array = np.diag((1.0, 1e4, 1.0))
    for _ in range(100):
        covariance = transition @ covariance @ transition.T + noise
        gain = covariance[:, :1] / (covariance[0, 0] + 1.0)
        covariance = np.asarray(covariance - gain @ covariance[:1])
    gains: list[Array] = []
    for _ in range(_LONGEST_GAP + 1):
        covariance = transition @ covariance @ transition.T + noise
        gains.append(covariance[:, :1] / (covariance[0, 0] + 1.0))
    return tuple(gains)
