"""Several Kalman filters of a view and its rates, side by side."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.markers.view.fit import (
    SETTLED,
    NamedPlaces,
    columns_of,
    limited,
    possible,
    surprise_of,
)
from mvuav_ros.vision.markers.view.weak_perspective import COUNT, ViewState, WeakPerspective

Array = NDArray[np.float64]

RATES_LAST = 1.0
"""s, after which a motion has changed."""
MOST_ITERATIONS = 6
_STATES = 2 * COUNT
_UNITY: Array = np.eye(_STATES)


@dataclass(frozen=True, eq=False)
class FilterBank:
    """Parameters and rates of m filters at one time.

    Attributes:
        states: (m, 16), parameters, then their rates.
        covariances: (m, 16, 16).
    """

    states: Array
    covariances: Array

    @classmethod
    def of(cls, view: ViewState, count: int, rates: Array) -> FilterBank:
        """So many filters that begin with a view, and variances (8,) of its unknown rates."""
        covariance = np.diag(np.concatenate((np.zeros(COUNT), rates + 1e-12)))
        covariance[:COUNT, :COUNT] = view.covariance
        state = np.concatenate((view.parameters, np.zeros(COUNT)))
        return cls(np.repeat(state[None], count, 0), np.repeat(covariance[None], count, 0))

    @property
    def parameters(self) -> Array:
        """(m, 8)."""
        return self.states[:, :COUNT]

    @property
    def rates(self) -> Array:
        """(m, 8), per s."""
        return self.states[:, COUNT:]

    @property
    def covariance(self) -> Array:
        """(m, 8, 8), of the parameters."""
        return self.covariances[:, :COUNT, :COUNT]

    def predicted(self, elapsed: float, walk: Array, unrest: Array) -> FilterBank:
        """The same, so many s later.

        Args:
            elapsed: s.
            walk: (8,), variance of the parameters' random walk, per s.
            unrest: (8,), the same of their rates.
        """
        fade = math.exp(-elapsed / RATES_LAST)
        reach = RATES_LAST * (1.0 - fade)
        stationary = 0.5 * RATES_LAST * (1.0 - fade * fade)
        # What lies on the diagonals of the four blocks of 8 x 8.
        transition, noise, step = _UNITY.copy(), np.zeros(_STATES * _STATES), _STATES + 1
        flat = transition.ravel()
        flat[COUNT : COUNT * step : step] = reach
        flat[COUNT * step :: step] = fade
        noise[: COUNT * step : step] = elapsed * walk + (elapsed**3 / 3) * unrest
        noise[COUNT : COUNT * step : step] = (0.5 * reach * reach) * unrest
        noise[COUNT * _STATES :: step] = noise[COUNT : COUNT * step : step]
        noise[COUNT * step :: step] = stationary * unrest
        covariances = transition @ self.covariances @ transition.T
        covariances += noise.reshape(_STATES, _STATES)
        return FilterBank(self.states.dot(transition.T), covariances)

    def all_as(self, index: int) -> FilterBank:
        """All filters as one of them."""
        count = len(self.states)
        return FilterBank(
            np.repeat(self.states[index : index + 1], count, 0),
            np.repeat(self.covariances[index : index + 1], count, 0),
        )

    def less_certain(self, factor: float, known: Sequence[int] = ()) -> FilterBank:
        """The same with variances that are larger by a factor, but for some known parameters."""
        growth = np.full(_STATES, math.sqrt(factor))
        growth[list(known)] = 1.0
        return replace(self, covariances=growth[:, None] * self.covariances * growth)

    def corrected(self, shape: WeakPerspective, seen: NamedPlaces, variances: Array) -> Correction:
        """What each filter makes of some markers: an iterated extended Kalman filter's update.

        Args:
            shape: the rig.
            seen: k markers, the same for all filters.
            variances: (m, k), px², of the places from what the rig says, for each filter.
        """
        m, k = variances.shape
        markers = seen.markers[0].tolist()
        columns = None if markers == list(range(len(shape.points))) else columns_of(seen.markers[0])
        places = seen.places.reshape(1, 2 * k)
        prior = parameters = np.ascontiguousarray(self.parameters)
        for _ in range(MOST_ITERATIONS):
            expected, slopes = shape.linearize_all(parameters)
            if columns is not None:
                expected, slopes = expected[:, columns], slopes[:, :, columns]
            innovation = places - expected
            away = prior - parameters
            if parameters is not prior:
                innovation -= (away[:, None] @ slopes)[:, 0]
            towards = self.covariances[:, :, :COUNT] @ slopes
            spread = slopes.transpose(0, 2, 1) @ towards[:, :COUNT]
            diagonals = spread.reshape(m, -1)[:, :: 2 * k + 1].reshape(m, k, 2)
            diagonals += variances[..., None]
            weight = np.asarray(np.linalg.inv(spread), np.float64)
            weighed = (weight @ innovation[..., None])[..., 0]
            change = (towards @ weighed[..., None])[..., 0]
            step, largest = limited(change[:, :COUNT] + away)
            parameters = possible(parameters + step)
            if largest < SETTLED:
                break
        else:
            # What the last slopes foretell of the residuals cannot be trusted.
            expected = shape.linearize_all(parameters)[0]
            residual = places - (expected if columns is None else expected[:, columns])
            weighed = (residual.reshape(m, k, 2) / variances[..., None]).reshape(m, 2 * k)
        change[:, :COUNT] = parameters - prior
        return Correction(
            self, change, slopes, towards, weight, weighed, variances, float(seen.deviation**2)
        )


@dataclass(frozen=True, eq=False)
class Correction:
    """What the filters of a bank make of k markers of a frame.

    Attributes:
        before: the filters.
        change: (m, 16), of their states.
        slopes: (m, 8, 2 k), of the places by the parameters.
        towards: (m, 16, 2 k), covariance of the states with the places.
        weight: (m, 2 k, 2 k), inverse covariance of the innovations, px^-2.
        weighed: (m, 2 k), the innovations times that.
        variances: (m, k), px², at which the markers take part.
        own: px², variance of a marker's place.
    """

    before: FilterBank
    change: Array
    slopes: Array
    towards: Array
    weight: Array
    weighed: Array
    variances: Array
    own: float

    @cached_property
    def after(self) -> FilterBank:
        """The filters with what they have seen, in Joseph's form: no variance gets negative."""
        m, k = self.variances.shape
        gain = self.towards @ self.weight
        left = np.repeat(_UNITY[None], m, axis=0)
        left[:, :, :COUNT] -= gain @ self.slopes.transpose(0, 2, 1)
        own = gain.reshape(m, _STATES, k, 2) * self.variances[:, None, :, None]
        covariances = left @ self.before.covariances @ left.transpose(0, 2, 1)
        covariances += own.reshape(m, _STATES, 2 * k) @ gain.transpose(0, 2, 1)
        covariances = 0.5 * (covariances + covariances.transpose(0, 2, 1))
        return FilterBank(self.before.states + self.change, covariances)

    @cached_property
    def residual(self) -> Array:
        """(m, 2 k), px."""
        m, k = self.variances.shape
        return (self.weighed.reshape(m, k, 2) * self.variances[..., None]).reshape(m, 2 * k)

    @cached_property
    def surprise(self) -> Array:
        """(m, k), for each marker how far it lies from where all others put it (see `Fits`)."""
        # What the innovations' covariance leaves of a marker's is what the others tell.
        m, k = self.variances.shape
        weight, step = self.weight.reshape(m, -1), 4 * k + 2
        xx, xy, yy = weight[:, ::step], weight[:, 1::step], weight[:, 2 * k + 1 :: step]
        half = 0.5 * self.variances
        deviator = np.empty((m, k), np.complex128)
        deviator.real = half * (xx - yy)
        deviator.imag = self.variances * xy
        left = half * (xx + yy), deviator
        return surprise_of(self.residual, left, self.variances, self.own)

    def view(self, index: int) -> ViewState:
        """By one of the filters."""
        residual = self.residual[index]
        return ViewState(
            self.after.parameters[index],
            self.after.covariance[index],
            math.sqrt(float(residual.dot(residual)) / len(self.variances[index])),
            surprise=self.surprise[index],
        )
