"""How likely a strip is a runway, and a report right: fitted on the tuning half."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.approach.appearance import FEATURES
from mvuav_ros.vision.approach.tuning import TRACK

_FILE = Path(__file__).with_name('probability.json')
_FITTED: Any = json.loads(_FILE.read_text(encoding='utf-8'))


@dataclass(frozen=True, eq=False)
class EvidenceWeights:
    """Log odds of a strip by its features: a linear part, and a hidden layer of tanh units.

    What a feature says depends on others: a strip whose near end is in the picture looks other than
    one that goes on below it. A sum over the features cannot know that, a hidden layer can.
    """

    mean: NDArray[np.float64]  # (features,) of the tuning half
    deviation: NDArray[np.float64]  # (features,) standard deviation there
    slopes: NDArray[np.float64]  # (features,) of the linear part, per standard deviation
    inward: NDArray[np.float64]  # (features, units) weights of the hidden units
    bias: NDArray[np.float64]  # (units,) of the hidden units
    outward: NDArray[np.float64]  # (units,) what each unit adds
    offset: NDArray[np.float64]  # () log odds of a strip with average features and no unit

    def log_odds(self, features: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n,) of (n, features) in the order of `FEATURES`; what is NaN counts as usual.

        Example:
            >>> one = np.ones(1)
            >>> weights = EvidenceWeights(0 * one, one, 2 * one, one[None], 0 * one, one, -one)
            >>> weights.log_odds(np.array([[0.0], [np.nan], [1.0]])).round(2).tolist()
            [-1.0, -1.0, 1.76]
        """
        values = standardised(features, self.mean, self.deviation)
        hidden = np.tanh(values @ self.inward + self.bias)
        return values @ self.slopes + hidden @ self.outward + self.offset


def standardised(
    features: NDArray[np.float64], mean: NDArray[np.float64], deviation: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Features in standard deviations from the mean, limited; the mean of what is NaN."""
    most = TRACK.max_deviations
    return np.nan_to_num(np.clip((features - mean) / deviation, -most, most))


class Report(NamedTuple):
    """Evidence of whether a track's report is right."""

    log_odds: float  # of the track, averaged over its frames
    agreement: float  # probability of the strips that are where the track's mean is
    moved: int  # frames for which it was followed and that differed from the one before
    distinct: float  # share of the last frames with clear lines along both sides, or clear colours
    # odds that an edge is elsewhere; 1 where the image shows two places for it
    other_edges: float = 0.0

    def values(self) -> NDArray[np.float64]:
        """(4,) what speaks for it: a still says the same each time, so moved frames count."""
        log_odds = min(max(self.log_odds, TRACK.least_odds), TRACK.most_odds)
        in_place = math.log(self.agreement + TRACK.min_agreement)
        known = min(self.moved / TRACK.known_frames, 1.0)
        return np.array([log_odds, self.distinct, in_place, known])

    def confidence(self, weights: NDArray[np.float64]) -> float:
        """Probability that both edges are where they were reported, less the odds of other edges.

        Example:
            >>> report = Report(1.0, agreement=0.5, moved=30, distinct=0.0)
            >>> report.confidence(np.array([-1.0, 1.0, 0.0, 0.0, 0.0]))
            0.5
        """
        return 1.0 / ((1.0 + math.exp(-self.log_odds_right(weights))) * (1.0 + self.other_edges))

    def log_odds_right(self, weights: NDArray[np.float64]) -> float:
        """The same as log odds, but for other edges: linear, by `confidence_weights`."""
        return float(weights[0] + weights[1:] @ self.values())


def log_odds_of(features: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n,) log odds of strips with (n, features): of those seen from near by with other weights."""
    near_by = features[:, FEATURES.index('depth')] > TRACK.min_near_by
    odds = np.empty(len(features))
    for name, chosen in (('ahead', ~near_by), ('near_by', near_by)):
        if chosen.any():
            odds[chosen] = evidence_weights(name).log_odds(features[chosen])
    return odds


@cache
def evidence_weights(which: str) -> EvidenceWeights:
    """The weights that belong to this version; made by tools/fit_approach.py.

    Those of strips ``ahead``, or seen from ``near_by``.
    """
    if tuple(_FITTED['features']) != FEATURES:
        raise ValueError(f'{_FILE.name} is of other features: run tools/fit_approach.py again')
    return EvidenceWeights(**{name: np.array(value) for name, value in _FITTED[which].items()})


@cache
def confidence_weights() -> NDArray[np.float64]:
    """(5,) offset and weights of `Report.values`; made by tools/fit_approach_confidence.py."""
    return np.array(_FITTED['confidence'])
