"""What named lights of a frame make of views of a rig: a Kalman filter's gain and correction."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.markers.lights import Point
from mvuav_ros.vision.markers.rig_view import (
    COUNT,
    SETTLED,
    Array,
    ViewState,
    WeakPerspective,
    limited,
    possible,
)

Distance = tuple[float, float, float, float]
"""Factors of x², x y and y², and the logarithm of the density at no distance, px^-2."""
BESIDE = 6.0  # px (1 sigma): how far from a marker's place a light lies that has been taken for it
_LOG_TURN = math.log(2.0 * math.pi)
FREEDOM = 4.0  # Degrees, of the distribution of a place about where the others put it
TAIL = 0.5 * FREEDOM + 1.0  # Exponent of its density in two dimensions


class Belief(NamedTuple):
    """States (f, s), whose first 8 numbers are views' parameters, and covariances (f, s, s)."""

    mean: Array
    covariance: Array


class NamedPlaces(NamedTuple):
    """Where k markers are seen, in f ways of naming lights or in one for all."""

    markers: NDArray[np.intp]  # (f, k) or (1, k)
    places: Array  # (f, 2 k) or (1, 2 k), px without distortion, x and y in turn

    @classmethod
    def of(cls, found: Mapping[int, Point]) -> NamedPlaces:
        """One way of naming lights."""
        places: Array = np.array(list(found.values()), np.float64)
        return cls(np.array([list(found)], np.intp), places.reshape(1, -1))


@dataclass(eq=False)
class Gain:
    """What k named lights will make of f views wherever near they are seen."""

    covariance: Array  # (f, s, s), of the priors, or (1, s, s) of one for all
    markers: list[int]  # those seen, in the first of them
    noise: Array  # (f, 2 k), px², variances at which the coordinates take part
    own: float  # px², variance of a marker's place
    at: Array  # (f, 2 k + 8), places, px, and the views at which they have their slopes
    slopes: Array  # (f, 8, 2 k), of the places by the parameters
    _distances: dict[tuple[int | None, bool], list[Distance]] = field(default_factory=dict)

    @cached_property
    def towards(self) -> Array:
        """(f, s, 2 k), covariance of the state with the places."""
        return np.asarray(self.covariance[:, :, :COUNT] @ self.slopes)

    @cached_property
    def weight(self) -> Array:
        """(f, 2 k, 2 k), inverse covariance of the innovations, px^-2."""
        spread = self.slopes.transpose(0, 2, 1) @ self.towards[:, :COUNT]
        count = spread.shape[2]
        spread.reshape(-1, count * count)[:, :: count + 1] += self.noise
        return _inverses(spread)

    @cached_property
    def effect(self) -> Array:
        """(f, s + 2 k, 2 k + 8): makes what differs from `at` a change and weighed innovations."""
        effect = np.concatenate((self._kalman, self.weight), axis=1)
        return np.concatenate((effect, -effect @ self.slopes.transpose(0, 2, 1)), axis=2)

    @cached_property
    def _kalman(self) -> Array:
        return np.asarray(self.towards @ self.weight)

    @cached_property
    def after(self) -> Array:
        """The covariances with what has been seen, in Joseph's form: no variance gets negative.

        It is A - (A H - K R) K^T with A = (I - K H^T) P, the gain K, slopes H and prior P.
        """
        gain = self._kalman
        transposed = gain.transpose(0, 2, 1)
        left = self.covariance - gain @ self.towards.transpose(0, 2, 1)
        rest = left[:, :, :COUNT] @ self.slopes
        rest -= gain * self.noise[:, None]
        left -= rest @ transposed
        return np.asarray(0.5 * (left + left.transpose(0, 2, 1)))

    def distances(self, row: int | None, beside: bool = False) -> list[Distance]:
        """What makes weighed innovations squared distances from where the others put each marker.

        By the filter in a row; None: for each marker by the filter that ignores it. With w = S⁻¹ r,
        the weighed innovations, and B the marker's 2 x 2 block of S⁻¹, the innovation by all other
        markers alone is B⁻¹ w with the covariance B⁻¹, of which the marker's own variance is a
        part. Where it is another one by d, as for a light beside the marker (see `BESIDE`), the
        squared distance is w (B + d B²)⁻¹ w, where B² is tr(B) B - det(B).
        """
        found = self._distances.get((row, beside))
        if found is None:
            found = self._distances[row, beside] = []
            own = self.own + BESIDE * BESIDE if beside else self.own
            for index, marker in enumerate(self.markers):
                one, x = 1 + marker if row is None else row, 2 * index
                (xx, xy), (_, yy) = self.weight[one, x : x + 2, x : x + 2].tolist()
                other = own - self.noise.item(one, x)
                size = max(xx * yy - xy * xy, 1e-12 * xx * yy)
                share, less = 1.0 + other * (xx + yy), other * size
                wider = share + other * less  # the determinant of I + d B
                both = wider * size
                factors = (share * yy - less) / both, -2.0 * share * xy / both
                peak = -0.5 * math.log(wider / size) - _LOG_TURN
                found.append((*factors, (share * xx - less) / both, peak))
        return found


@dataclass(eq=False)
class Correction:
    """What k named lights of a frame make of views: an iterated extended Kalman filter's update.

    It is that of f filters at once, of which the first is the main one, and the one after marker i
    of the rig's is that which ignores it; or of one prior by f ways of naming lights.
    """

    gain: Gain  # where the places were linearized last
    before: Array  # (f, s), the priors' means, or (1, s), that of one for all
    change: Array  # (f, s), of the state
    weighed: Array  # (f, 2 k), the innovations over their covariance, px^-1

    @classmethod
    def of(
        cls,
        shape: WeakPerspective,
        before: Belief,
        named: NamedPlaces,
        own: float,
        noise: Array | None = None,
        starts: Array | None = None,
        iterations: int = 6,
    ) -> Correction:
        """Correct priors by lights, of whose places each has its own variance, px².

        They may take part at others (f, 2 k). The steps begin at the starts (f, 8), or the priors.
        """
        mean, covariance = before
        ways, width = named.places.shape
        if noise is None:
            noise = np.full((max(ways, len(mean)), width), own)
        markers: list[int] = named.markers[0].tolist()
        columns = None
        if ways > 1 or markers != list(range(len(shape.points))):
            columns = (2 * named.markers[..., None] + (0, 1)).reshape(ways, width)
        prior = np.ascontiguousarray(mean[:, :COUNT])
        parameters = (
            np.repeat(prior, len(noise) // len(prior), axis=0) if starts is None else starts
        )
        for number in range(iterations):
            expected, slopes = _seen(columns, *shape.linearize(parameters))
            innovation = named.places - expected
            away = prior - parameters
            if number or starts is not None:
                innovation -= times(slopes.transpose(0, 2, 1), away)
            at = np.concatenate((expected, parameters), axis=1)
            gain = Gain(covariance, markers, noise, own, at, slopes)
            weighed = times(gain.weight, innovation)
            change = times(gain.towards, weighed)
            step, largest = limited(change[:, :COUNT] + away)
            parameters = possible(parameters + step)
            if largest < SETTLED:
                break
        else:
            # What the last slopes predict of the residuals cannot be trusted.
            expected, _ = _seen(columns, *shape.linearize(parameters))
            weighed = (named.places - expected) / noise
        change[:, :COUNT] = parameters - prior
        return cls(gain, mean, change, weighed)

    @property
    def after(self) -> Belief:
        """The states with what has been seen."""
        return Belief(self.before + self.change, self.gain.after)

    def rms_residual(self, row: int = 0) -> float:
        """Root mean square of the markers' distances from their places in a filter's view, px."""
        residual = self.weighed[row] * self.gain.noise[row]
        return math.sqrt(float(residual.dot(residual)) / max(len(self.gain.markers), 1))

    @cached_property
    def cost(self) -> Array:
        """(f,), squared residuals and squared distance from the prior, over their variances."""
        gain, weighed = self.gain, self.weighed
        moved = times(gain.slopes.transpose(0, 2, 1), times(gain.towards[:, :COUNT], weighed))
        return np.asarray((weighed * (gain.noise * weighed + moved)).sum(axis=1))

    @cached_property
    def evidence(self) -> Array:
        """(f,), logarithm of how probable the priors made the lights' places, per px² each."""
        _, log_determinant = np.linalg.slogdet(self.gain.weight)
        return np.asarray(0.5 * (log_determinant - self.cost) - len(self.gain.markers) * _LOG_TURN)

    @cached_property
    def nis(self) -> list[float]:
        """For each marker how far it lies from where the others put it, by the main filter."""
        return self.nis_by(0)

    def nis_by(self, row: int) -> list[float]:
        """The same by another filter: chi squared with two degrees of freedom."""
        return _squares(self.weighed[row].tolist(), self.gain.distances(row))

    def nis_by_ignoring(self) -> list[float]:
        """The same, each marker by the filter that ignores it."""
        weighed, every = [], self.weighed.tolist()
        for index, marker in enumerate(self.gain.markers):
            weighed += every[1 + marker][2 * index : 2 * index + 2]
        return _squares(weighed, self.gain.distances(None))

    def log_densities(self, row: int) -> list[float]:
        """Logarithm of how probable a filter's others make each marker's place, per px²."""
        pairs = zip(self.nis_by(row), self.gain.distances(row), strict=True)
        return [factors[3] - 0.5 * square for square, factors in pairs]

    def log_likelihoods(self) -> dict[int, tuple[float, float]]:
        """How probable each marker's place is by all others, logarithm per px².

        First that of the marker itself, then that of another light beside there (see `BESIDE`). It
        is Student's t in two dimensions, as a motion is at times not foreseen.
        """
        own, other = self.gain.distances(0), self.gain.distances(0, beside=True)
        far = _squares(self.weighed[0].tolist(), other)
        rows = zip(self.gain.markers, own, self.nis, other, far, strict=True)
        return {
            marker: (
                by_it[3] - TAIL * math.log1p(near / FREEDOM),
                by_another[3] - TAIL * math.log1p(far / FREEDOM),
            )
            for marker, by_it, near, by_another, far in rows
        }

    def view(self, row: int = 0) -> ViewState:
        """What follows of a filter's view."""
        mean, covariance = self.after
        return ViewState(mean[row, :COUNT], covariance[row, :COUNT, :COUNT], self.rms_residual(row))


def _squares(weighed: list[float], distances: Sequence[Distance]) -> list[float]:
    """Squared distances over variances of weighed innovations, x and y of each marker in turn."""
    rows = zip(weighed[::2], weighed[1::2], distances, strict=True)
    return [(xx * x + xy * y) * x + yy * y * y for x, y, (xx, xy, yy, _) in rows]


def _seen(columns: NDArray[np.intp] | None, expected: Array, slopes: Array) -> tuple[Array, Array]:
    """Of the places (f, 2 n) and slopes (f, 8, 2 n) those of some columns, (f, 2 k) or (1, 2 k)."""
    if columns is None:
        return expected, slopes
    if len(columns) > 1:
        places = np.take_along_axis(expected, columns, axis=1)
        return places, np.take_along_axis(slopes, columns[:, None], axis=2)
    return expected[:, columns[0]], slopes[:, :, columns[0]]


def times(matrices: Array, vectors: Array) -> Array:
    """Products of matrices (f, n, k) and vectors (f, k)."""
    return np.asarray((matrices @ vectors[..., None])[..., 0])


def _inverses(matrices: Array) -> Array:
    """Of positive matrices (f, n, n)."""
    inverses = np.empty_like(matrices)
    for matrix, inverse in zip(matrices, inverses, strict=True):
        if not cv2.invert(matrix, inverse, cv2.DECOMP_CHOLESKY)[0]:
            inverse[:] = np.linalg.pinv(matrix, hermitian=True)
    return inverses
