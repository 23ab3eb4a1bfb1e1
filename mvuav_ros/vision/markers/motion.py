"""The motion of any number of lights: six predictions, each of which counts by its merit."""

from __future__ import annotations

import math
import operator
from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

METHODS = ('none', 'velocity', 'acceleration', 'acceleration_program')
"""Of the thesis, as `thesis_tracker.Motion.predict` has them."""
_FILTER, _VIBRATION = len(METHODS), len(METHODS) + 1
"""Rows of the predictions after those: a Kalman filter, without and with predicted vibration."""
PRIOR = (0.5, 1.0, 1.0, 1.0, 1.0, 1.0)
"""Of each prediction's weight. Lights that stand still are rarer."""


# What is assumed of motions.
# Chosen on the simulator's four trials with and without vibration, on flights of the motions in
# `mvuav_thesis.marker_paths` with seeds of their own, and on the two reference videos.

# Weights of the predictions; memories of 0.98 to 0.99 and confidences of 2 to 3.5 give the same
# to 1 %.
ERROR_MEMORY = 0.985  # per frame, of the squared errors
# By how much a frame's evidence counts. Five rigid markers are worth about two independent
# coordinates, for which 0.5 x 2 would be Bayes's rule were the errors' sizes known.
CONFIDENCE = 2.5
# Filter: the acceleration's change within a frame over the measurement's standard deviation.
MANEUVER = 1.0
MAX_GAP = 10  # frames without a measurement, after which the gain grows no more
ACCELERATION_FADING = 0.7  # per frame unseen, of what cannot be trusted for long
VELOCITY_FADING = 0.95  # the same of the velocity
# Vibration: past innovations from which the next one is predicted, two for each harmonic.
LAGS = 6
VIBRATION_MEMORY = 0.99  # per frame, of what is learnt
RIDGE_FRAMES = 10.0  # pulls the coefficients to zero, in frames' worth of innovations
SOLVE_EVERY = 4  # frames between two solutions for the coefficients, which saves time
MAX_STAND_IN = 2.0  # standard deviations of an innovation that may stand in for a missing one
INNOVATION_FADING = 0.7  # of an innovation that stands in for a missing one
YOUNG = 100  # frames in which vibration is learnt from every frame, later every other
FIRST_DEVIATION = 3.0  # px, of a prediction before anything is known of the motion
MIN_DEVIATION = 0.3  # px, of a prediction
LEVEL_MEMORY = 0.9  # per frame, of the squared errors of a light's predictions
_RIDGE: Array = RIDGE_FRAMES * np.eye(LAGS)


class PredictionMixture:
    """The weights of competing predictions.

    Each is its prior times (mean squared error) to the power -c n: the posterior of a model whose
    errors have an unknown variance, from n frames. n is few where few make up most of the squares:
    (sum of squares)² over the sum of their squares (L. Kish, Survey Sampling, 1965).
    """

    def __init__(self, prior: Sequence[float]) -> None:
        self._prior = tuple(prior)
        self.weights: Array = np.array(prior) / sum(prior)  # (k,), sum 1
        self._losses = [0.0] * len(prior)
        self._sum = self._sum_of_squares = 0.0

    def learn(self, errors: Array) -> None:
        """Take the errors of the newest predictions, (k, m) px."""
        new: list[float] = errors.dot(errors.T).diagonal().tolist()
        memory, share = ERROR_MEMORY, 1.0 / errors.shape[1]
        losses = self._losses = [
            memory * old + share * loss for old, loss in zip(self._losses, new, strict=True)
        ]
        usual = share * sorted(new)[1]
        self._sum = memory * self._sum + usual
        self._sum_of_squares = memory * self._sum_of_squares + usual * usual
        least = min(losses)
        if least <= 0.0 or self._sum_of_squares <= 0.0:
            return
        power = -CONFIDENCE * self._sum * self._sum / self._sum_of_squares
        weights = [
            prior * (loss / least) ** power for prior, loss in zip(self._prior, losses, strict=True)
        ]
        total = sum(weights)
        self.weights = np.array([weight / total for weight in weights])


class Vibration:
    """Autoregression of the Kalman filter's innovations.

    They are white where its model holds. A camera's vibration is none of its model, moves all
    markers alike and comes again: the next innovation is predicted from the last six, with
    coefficients learnt from all markers by recursive least squares. White jitter leaves them zero.
    """

    def __init__(self) -> None:
        # What each innovation, the newest first, counts in the next one.
        self.coefficients: Array = np.zeros(LAGS)
        # What an innovation and those before it count in what the prediction leaves of it.
        self._left_of: Array = np.eye(1, 1 + LAGS)[0]
        # Mean square of the innovations, and of what the predictions leave of them, px².
        self.level = self.left = 0.01
        # Of an innovation and those before it, with each other: sums over markers and frames.
        self._products: Array = np.zeros((1 + LAGS, 1 + LAGS))

    @property
    def helps(self) -> bool:
        """Whether the predictions would have saved anything on the frames seen so far."""
        return self.left < self.level

    def stand_in(self, predicted: Array) -> Array:
        """What takes the place of missing innovations, so that it cannot build up, px."""
        if not self.helps:
            return np.zeros_like(predicted)
        limit = MAX_STAND_IN * math.sqrt(self.level)
        return np.asarray(INNOVATION_FADING * np.clip(predicted, -limit, limit))

    def learn(self, history: Array, solve: bool) -> None:
        """Learn from some markers' innovations, the newest first, (1 + lags, m)."""
        memory = VIBRATION_MEMORY
        products = history.dot(history.T)
        self._products *= memory
        self._products += products
        share = (1 - memory) / history.shape[1]
        self.level = memory * self.level + share * products.item(0)
        left = self._left_of.dot(history)
        self.left = memory * self.left + share * float(left.dot(left))
        if solve:
            ridge = self._products[1:, 1:] + self.level * _RIDGE
            # A third of the time of NumPy's.
            solution = cv2.solve(ridge, self._products[1:, :1], flags=cv2.DECOMP_CHOLESKY)[1]
            self.coefficients = np.asarray(solution, np.float64).ravel()
            self._left_of[1:] = -self.coefficients


def gain_tables() -> tuple[Array, Array]:
    """Gains (31, 3) of a marker's first measurements until they settle, in frames and px.

    And those (n + 1, 3) of the first measurement after up to n frames without. The process noise is
    white jerk.
    """
    transition = np.array([(1.0, 1.0, 0.5), (0.0, 1.0, 1.0), (0.0, 0.0, 1.0)])
    effect = np.array((0.5, 1.0, 1.0))
    noise = MANEUVER**2 * np.outer(effect, effect)
    covariance: Array = np.diag((1.0, 1e4, 1.0))
    starting, after = [np.array((1.0, 0.0, 0.0))], []
    for _ in range(100):
        covariance = transition @ covariance @ transition.T + noise
        starting.append(covariance[:, 0] / (covariance[0, 0] + 1.0))
        covariance = np.asarray(covariance - np.outer(starting[-1], covariance[0]))
    for _ in range(MAX_GAP + 1):
        covariance = transition @ covariance @ transition.T + noise
        after.append(covariance[:, 0] / (covariance[0, 0] + 1.0))
    return np.array(starting[:31]), np.array(after)


# Computed here, as the first frame has no time for it.
_STARTING_GAINS, _GAINS_AFTER_GAPS = gain_tables()

_POWERS = np.array([(0.0,), (1.0,), (2.0,)])  # Of time, in position, velocity and acceleration
_SAME_STEP = 1e-6  # Part of a step between frames that makes no difference to the gains
_SAME_TIME = 1e-9  # s, by which the same intervals differ: stamps are whole nanoseconds
_ODD = 3  # Intervals in a row, not one to three usual steps, after which the rate has changed

_STATE = slice(0, 3)  # Position (px), velocity (px/s) and acceleration (px/s²) by the filter
_LAST = 3  # Where the light was last measured, px
_PLACES = slice(4, 7)  # Newest places, px; a straight line where a light was out of sight
_LAGGED = slice(7, 7 + LAGS)  # Newest innovations of the filter, px
_LINEAR = _LAGGED.stop  # Rows from which the predictions follow
_HISTORY = slice(_LAGGED.start, _LINEAR + 1)  # Those innovations and one more
_TIME, _VARIANCE = _LINEAR + 1, _LINEAR + 2  # When it was last seen, s; of its predictions, px²
_SEEN, _UNSEEN = _LINEAR + 3, _LINEAR + 4  # Measurements since its first; frames since the last one
_IN_ROW = _LINEAR + 5  # Measurements without a gap, less the first three, as the filter is new
_ROWS = _LINEAR + 6  # What is remembered of a light, in a column for its x and one for its y


class MotionPredictor:
    """Predicts any number of lights, each with position, velocity and acceleration.

    Six predictions compete: the thesis's four, a Kalman filter of constant acceleration, and the
    same with what a vibrating camera will do. Each counts as its errors so far on all lights say. A
    frame that was dropped is stepped over as one in which nothing was seen. A light out of sight is
    predicted by the Kalman filter alone.
    """

    def __init__(self, count: int) -> None:
        self.time: float | None = None  # of the newest frame, s; None before the first
        self.competing: Array = np.zeros((len(PRIOR), 2 * count))  # predictions of it, (6, 2 n) px
        self._lights: Array = np.zeros((_ROWS, 2 * count))
        self._lights[_VARIANCE] = FIRST_DEVIATION**2
        self._mixture, self._vibration = PredictionMixture(PRIOR), Vibration()
        self._step: float | None = None
        self._odd = 0  # intervals in a row that are no usual step, nor a few
        self._times = (-1.0, -2.0, -3.0)  # s, of the newest places
        self._intervals = (0.0, 0.0, 0.0)
        # From a light's memory to the six predictions, its velocity and its acceleration.
        self._ahead: Array = np.zeros((len(PRIOR) + 2, _LINEAR))
        self._ahead[0, _LAST] = 1.0
        self._ahead[_FILTER : _VIBRATION + 1, 0] = self._ahead[6, 1] = self._ahead[7, 2] = 1.0
        self._settled: Array = _STARTING_GAINS[-1][:, None]  # (3, 1), when nothing was missed
        self._per_frame: Array = np.ones((3, 1))
        self._prediction: Array = np.zeros(2 * count)
        self._frames = self._skipped = 0
        self._stretch = 1.0  # of the gains' frames over a gap of more than they grow in
        self._steady = False  # whether all lights have been in sight for long

    def add(self, places: Array) -> None:
        """Append lights that were first seen in the newest frame, (k, 2) px."""
        new = np.zeros((_ROWS, places.size))
        new[[0, _LAST, 4, 5, 6]] = np.ravel(places)
        new[_TIME], new[_VARIANCE], new[_SEEN] = self._times[0], FIRST_DEVIATION**2, 1.0
        self._lights = np.hstack((self._lights, new))
        self._note()

    def keep(self, kept: Mask) -> None:
        """Forget all lights but some (n, true for those), which move up."""
        self._lights = self._lights[:, np.repeat(kept, 2)]
        self._note()

    def _note(self) -> None:
        in_row = self._lights[_IN_ROW]
        self._steady = len(in_row) > 0 and bool((in_row >= LAGS).all())

    def forget(self, index: int) -> None:
        """The light's next measurement is its first."""
        self._lights[[_SEEN, _IN_ROW], 2 * index : 2 * index + 2] = 0.0
        self._steady = False

    def predict(self, time: float, method: str = 'kalman') -> list[float]:
        """Go on to the next frame, of a later time (s): x and y of every light in turn, px.

        By ``kalman``, which is all predictions by their merit, or by one of `METHODS`. It means
        nothing for a light that was never seen.
        """
        lights = self._lights
        if self.time is not None:
            self._set_ahead(time, self._skip(time - self.time))
            ahead = self._ahead.dot(lights[:_LINEAR])
            self.competing = ahead[:-2]
            lights[0], lights[1:3] = ahead[_FILTER], ahead[-2:]
        self.time = time
        if method in METHODS:
            self._prediction = self.competing[METHODS.index(method)]
        else:
            self._prediction = self._mixture.weights.dot(self.competing)
            if not self._steady and (hidden := lights[_UNSEEN] > 0).any():
                # Coefficients from few or disturbed frames may do harm; what they would have saved
                # on the frames seen so far decides.
                best = _VIBRATION if self._vibration.helps else _FILTER
                self._prediction = np.where(hidden, self.competing[best], self._prediction)
        predicted: list[float] = self._prediction.tolist()
        return predicted

    def _set_ahead(self, time: float, elapsed: float) -> None:
        """What each prediction makes of what is remembered, so many s after the last frame."""
        newest, middle, oldest = self._times
        intervals = time - newest, newest - middle, middle - oldest
        ahead = self._ahead
        if max(map(abs, map(operator.sub, intervals, self._intervals))) > _SAME_TIME:
            self._intervals = intervals
            ahead[1:_FILTER, _PLACES] = _extrapolations(*intervals)
        ahead[_FILTER : _VIBRATION + 1, 1] = ahead[6, 2] = elapsed
        ahead[_FILTER : _VIBRATION + 1, 2] = 0.5 * elapsed * elapsed
        ahead[_VIBRATION, _LAGGED] = self._vibration.coefficients

    def _skip(self, elapsed: float) -> float:
        """Step over the frames that never came in a time, s; the time that is left."""
        steps = self._count_steps(elapsed)
        assert self._step is not None
        lights, step = self._lights, self._step
        self._skipped = min(steps - 1, MAX_GAP)
        self._stretch = steps / (self._skipped + 1)
        for _ in range(self._skipped):
            # Everything goes on as predicted.
            elapsed -= step
            lights[0] += step * lights[1] + 0.5 * step * step * lights[2]
            lights[1] += step * lights[2]
            vibration = self._vibration
            innovation = vibration.stand_in(vibration.coefficients.dot(lights[_LAGGED]))
            lights[_STATE] += self._settled * innovation
            self._remember(innovation)
            lights[_IN_ROW] = 0.0
            self._steady = False
        return elapsed

    def _count_steps(self, elapsed: float) -> int:
        """How many frames on this one is, by the usual time between two."""
        steps, step = 1, elapsed
        if self._step is not None:
            steps, step = max(1, round(elapsed / self._step)), self._step
            if elapsed >= 0.7 * step and steps <= 3:
                step += 0.05 * (elapsed / steps - step)
                self._odd = 0
            else:
                # A late stamp, or a gap; only what goes on is another rate.
                self._odd += 1
                if self._odd == _ODD:
                    steps, step, self._odd = 1, elapsed, 0
        if self._step is None or abs(step - self._step) > _SAME_STEP * step:
            self._step = step
            self._per_frame = np.array([(1.0,), (1.0 / step,), (1.0 / step**2,)])
            self._settled = _STARTING_GAINS[-1][:, None] * self._per_frame
        return steps

    def _remember(self, innovation: Array) -> None:
        history = self._lights[_HISTORY]
        history[1:] = history[:-1]
        history[0] = innovation

    def deviations(self) -> Array:
        """How far off the predictions of the newest frame may be, (n,) px, 1 sigma per axis."""
        lights = self._lights
        frames = 1.0 + lights[_UNSEEN, ::2] + self._skipped
        # What vibrates can be predicted for the next frame only.
        smallest = MIN_DEVIATION**2
        least = np.where(frames > 1, max(self._vibration.level, smallest), smallest)
        # No velocity or a poor one: the step from frame to frame may be anything usual.
        least[lights[_SEEN, ::2] < 3] = FIRST_DEVIATION**2
        variance = 0.5 * (lights[_VARIANCE, ::2] + lights[_VARIANCE, 1::2])
        return np.asarray(np.sqrt(np.maximum(variance, least)) * frames**1.5)

    def positions(self) -> Array:
        """Where every light is at the newest frame, (n, 2) px."""
        return np.asarray(self._lights[0].reshape(-1, 2))

    def motions(self) -> list[tuple[float, float, float, float]]:
        """Velocity and acceleration of every light, x and y each, px and s; NaN if not known."""
        rows = self._lights[1:3]
        if not self._steady:
            rows = np.where(self._lights[_SEEN] < [[2], [3]], math.nan, rows)
        v, a = rows.tolist()
        return list(zip(v[::2], v[1::2], a[::2], a[1::2], strict=True))

    def update(self, positions: Sequence[float] | Array) -> None:
        """Take the newest frame's x and y of every light in turn, px; NaN if not seen."""
        assert self.time is not None
        measured = np.array(positions, float)
        errors = measured - self.competing
        if self._steady and math.isfinite(sum(positions)):
            self._update_all(measured, errors)
        else:
            self._update_some(measured, errors)
        self._times = (self.time, *self._times[:2])
        self._frames += 1

    def _update_all(self, measured: Array, errors: Array) -> None:
        """The usual frame: every light is in sight, and has been for some time."""
        lights = self._lights
        self._mixture.learn(errors)
        # Once much has been learnt, every other frame is enough, and saves time.
        if self._frames % 2:
            error, variance = measured - self._prediction, lights[_VARIANCE]
            variance += (1 - LEVEL_MEMORY) * (error * error - variance)
        innovation, state = errors[_FILTER], lights[_STATE]
        state += self._settled * innovation
        # Places and innovations move down by one.
        lights[_PLACES.start + 1 : _HISTORY.stop] = lights[_PLACES.start : _LINEAR]
        lights[_LAST : _PLACES.start + 1], lights[_LAGGED.start] = measured, innovation
        lights[_TIME] = self.time
        if not self._frames % 2 or self._frames < YOUNG:
            self._learn_vibration(lights[_HISTORY])

    def _learn_vibration(self, history: Array) -> None:
        every = SOLVE_EVERY if self._frames < YOUNG else 2 * SOLVE_EVERY
        self._vibration.learn(history, self._frames % every == 0)

    def _update_some(self, measured: Array, errors: Array) -> None:
        """Take a frame in which lights are missing, new, or back."""
        lights = self._lights
        visible = ~np.isnan(measured)
        known = visible & (lights[_SEEN] > 0)
        new = visible & ~known
        self._learn_from_some(measured, errors, known)
        innovation = self._correct(errors[_FILTER], visible, known)
        self._go_on(measured, visible, new)
        lights[_STATE, new] = 0.0
        lights[0, new] = measured[new]
        lights[_LAGGED, new] = 0.0
        lights[_VARIANCE, new] = FIRST_DEVIATION**2
        self._remember(innovation)
        lights[_SEEN] += visible
        lights[_UNSEEN] = np.where(visible, 0.0, lights[_UNSEEN] + 1)
        lights[_IN_ROW] = np.where(visible, lights[_IN_ROW] + (lights[_SEEN] > 3), 0.0)
        self._note()

    def _learn_from_some(self, measured: Array, errors: Array, known: Mask) -> None:
        """Judge the predictions by the lights whose motion was known (2 n, where true)."""
        lights = self._lights
        judged = known & (lights[_SEEN] >= 3) & (lights[_UNSEEN] == 0)
        if judged.any():
            self._mixture.learn(errors[:, judged])
            if not self._skipped:
                share = np.where(lights[_SEEN, judged] > 10, 1 - LEVEL_MEMORY, 0.5)
                square = (measured - self._prediction)[judged] ** 2
                lights[_VARIANCE, judged] += share * (square - lights[_VARIANCE, judged])
        settled = known & (lights[_IN_ROW] >= LAGS)
        if settled.any():
            self._learn_vibration(np.vstack((errors[_FILTER, settled], lights[_LAGGED, settled])))

    def _correct(self, error: Array, visible: Mask, known: Mask) -> Array:
        """Correct the Kalman filter; the innovations, (2 n,) px."""
        lights = self._lights
        predicted = self.competing[_VIBRATION] - self.competing[_FILTER]
        innovation = np.where(visible, error, self._vibration.stand_in(predicted))
        innovation[visible & ~known] = 0.0
        seen = np.minimum(lights[_SEEN], len(_STARTING_GAINS) - 1).astype(np.intp)
        gap = np.minimum(lights[_UNSEEN] + self._skipped, MAX_GAP).astype(np.intp)
        gains = np.where(gap > 0, _GAINS_AFTER_GAPS[gap].T, _STARTING_GAINS[seen].T)
        per_frame = self._per_frame / self._stretch**_POWERS
        gains = np.where(visible, gains * per_frame, self._settled * (lights[_SEEN] > 0))
        lights[1, ~visible] *= VELOCITY_FADING
        lights[2, ~visible] *= ACCELERATION_FADING
        lights[_STATE] += gains * innovation
        return innovation

    def _go_on(self, measured: Array, visible: Mask, new: Mask) -> None:
        """Append to the newest places."""
        assert self.time is not None
        lights = self._lights
        places, times = lights[_PLACES], (self.time, *self._times[:2])
        restarted = visible & ~new & ((lights[_SEEN] == 1) | (lights[_UNSEEN] > 0))
        elapsed = np.where(new, 1.0, self.time - lights[_TIME])
        velocity = (measured - lights[_LAST]) / np.maximum(elapsed, _SAME_TIME)
        # A light out of sight goes on at its last velocity; when it returns, the line from its last
        # place to the new one is its velocity, as in the thesis's program.
        places[1:] = places[:-1]
        places[0] = np.where(visible, measured, self.competing[1])
        for row, then in enumerate(times[1:], 1):
            places[row, restarted] = (measured - velocity * (self.time - then))[restarted]
            places[row, new] = measured[new]
        lights[_LAST, visible], lights[_TIME, visible] = measured[visible], self.time


def _extrapolations(ahead: float, newer: float, older: float) -> Array:
    """What each of the last three places counts by velocity and both accelerations, (3, 3)."""
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
