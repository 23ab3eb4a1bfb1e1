"""Several Kalman filters of a view and its rates, side by side."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.markers.view import COUNT, ViewState
from mvuav_ros.vision.markers.view_fit import Fits, inverse

Array = NDArray[np.float64]

RATES_LAST = 1.0
"""s, after which a motion has changed."""


@dataclass(frozen=True, eq=False)
class FilterBank:
    """Parameters and rates of m filters at one time.

    Attributes:
        parameters, rates: (m, 8).
        covariance, rate_covariance: (m, 8, 8).
        cross: (m, 8, 8), covariance of the rates with the parameters.
    """

    parameters: Array
    covariance: Array
    rates: Array
    rate_covariance: Array
    cross: Array

    @classmethod
    def of(cls, view: ViewState, count: int, rates: Array) -> FilterBank:
        """So many filters that begin with a view, and variances (8,) of its unknown rates."""
        return cls(
            np.repeat(view.parameters[None], count, axis=0),
            np.repeat(view.covariance[None], count, axis=0),
            np.zeros((count, COUNT)),
            np.repeat(np.diag(rates + 1e-12)[None], count, 0),
            np.zeros((count, COUNT, COUNT)),
        )

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
        return FilterBank(
            self.parameters + reach * self.rates,
            self.covariance
            + reach * (self.cross + self.cross.transpose(0, 2, 1))
            + reach * reach * self.rate_covariance
            + np.diag(elapsed * walk + elapsed**3 / 3 * unrest),
            fade * self.rates,
            fade * fade * self.rate_covariance + np.diag(stationary * unrest),
            fade * (self.cross + reach * self.rate_covariance) + np.diag(reach**2 / 2 * unrest),
        )

    def updated(self, fits: Fits) -> FilterBank:
        """The same, with what each filter has made of a frame."""
        gain = self.cross @ inverse(self.covariance)
        step = (fits.parameters - self.parameters)[..., None]
        less = self.covariance - fits.covariance
        return FilterBank(
            fits.parameters,
            fits.covariance,
            self.rates + (gain @ step)[..., 0],
            self.rate_covariance - gain @ less @ gain.transpose(0, 2, 1),
            gain @ fits.covariance,
        )

    def all_as(self, index: int) -> FilterBank:
        """All filters as one of them."""
        parts = (self.parameters, self.covariance, self.rates, self.rate_covariance, self.cross)
        return FilterBank(*(np.repeat(part[index : index + 1], len(part), 0) for part in parts))

    def less_certain(self, factor: float) -> FilterBank:
        """The same with larger variances."""
        return replace(
            self,
            covariance=factor * self.covariance,
            rate_covariance=factor * self.rate_covariance,
            cross=factor * self.cross,
        )
