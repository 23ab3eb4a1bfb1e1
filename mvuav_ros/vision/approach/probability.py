"""How likely a strip is a runway: the log odds of its features, fitted on the tuning half."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from importlib import resources

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.approach.appearance import FEATURES

_FILE = 'probability.json'
_FARTHEST = 4.0
"""Standard deviations: features beyond say no more."""


@dataclass(frozen=True, eq=False)
class EvidenceWeights:
    """Log odds as a sum of piecewise linear functions, one for each feature.

    Attributes:
        mean: (features,) of the tuning half.
        deviation: (features,) standard deviation there.
        knots: (knots, features) where the slopes change, in standard deviations.
        slopes: (knots + 1, features) slope of the first piece, then the changes of slope.
        offset: log odds of a strip with average features.
    """

    mean: NDArray[np.float64]
    deviation: NDArray[np.float64]
    knots: NDArray[np.float64]
    slopes: NDArray[np.float64]
    offset: float

    def log_odds(self, features: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n,) of (n, features) in the order of `FEATURES`."""
        values = np.clip((features - self.mean) / self.deviation, -_FARTHEST, _FARTHEST)
        total = values * self.slopes[0]
        for knot, slope in zip(self.knots, self.slopes[1:], strict=True):
            total += np.maximum(values - knot, 0.0) * slope
        result: NDArray[np.float64] = total.sum(axis=1) + self.offset
        return result


@cache
def evidence_weights() -> EvidenceWeights:
    """The weights that belong to this version; made by tools/fit_approach.py."""
    text = resources.files(__package__).joinpath(_FILE).read_text(encoding='utf-8')
    data = json.loads(text)
    if tuple(data['features']) != FEATURES:
        raise ValueError(f'{_FILE} is of other features: run tools/fit_approach.py again')
    mean, deviation, knots, slopes = (
        np.array(data[name], np.float64) for name in ('mean', 'deviation', 'knots', 'slopes')
    )
    return EvidenceWeights(mean, deviation, knots, slopes, float(data['offset']))
