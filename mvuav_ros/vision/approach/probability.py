"""How likely a strip is a runway, and a report right: fitted on the tuning half."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.approach.appearance import FEATURES
from mvuav_ros.vision.approach.tuning import PROBABILITY

_FILE = 'probability.json'
_DEPTH, _SKY = FEATURES.index('depth'), FEATURES.index('sky')


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
        """(n,) of (n, features) in the order of `FEATURES`; what is NaN does not count."""
        most = PROBABILITY.max_deviations
        values = np.clip((features - self.mean) / self.deviation, -most, most)
        total = values * self.slopes[0]
        for knot, slope in zip(self.knots, self.slopes[1:], strict=True):
            total += np.maximum(values - knot, 0.0) * slope
        # 0 is between what runways and what other strips have there.
        result: NDArray[np.float64] = np.nan_to_num(total).sum(axis=1) + self.offset
        return result


class Report(NamedTuple):
    """Evidence of whether a track's report is right.

    Attributes:
        log_odds: of the track, averaged over its frames.
        agreement: probability of the strips that are where the track's mean is.
        moved: frames for which it was followed and that differed from the one before.
        attitude: the horizon is known from a sensor.
        distinct: share of the last frames with clear lines along both sides, or clear colours.
        other_edges: odds that an edge is elsewhere; 1 where the image shows two places for it.
        shoulder_lines: from 0 to 1, whether shoulders have lines too, on both sides.
    """

    log_odds: float
    agreement: float
    moved: int
    attitude: bool
    distinct: float
    other_edges: float = 0.0
    shoulder_lines: float = 0.0

    @property
    def known(self) -> float:
        """From 0 to 1, how many different frames have spoken: a still says the same each time."""
        return min(self.moved / PROBABILITY.known_frames, 1.0)

    def of_the_runway(self) -> NDArray[np.float64]:
        """(4,) what speaks for its being the runway."""
        log_odds = min(max(self.log_odds, PROBABILITY.least_odds), PROBABILITY.most_odds)
        return np.array([log_odds, float(self.attitude), self.distinct, self.shoulder_lines])

    def of_the_place(self) -> NDArray[np.float64]:
        """(1,) what speaks for its edges' being within tolerance, if it is the runway."""
        sure = max(self.agreement, self.distinct * self.known)
        return np.array([math.log(sure + PROBABILITY.min_agreement)])


@dataclass(frozen=True, eq=False)
class ConfidenceWeights:
    """Two logistic functions, whose product, less the odds of other edges, is the confidence.

    Attributes:
        runway: (5,) offset and weights of `Report.of_the_runway`.
        place: (2,) offset and weights of `Report.of_the_place`.
    """

    runway: NDArray[np.float64]
    place: NDArray[np.float64]

    def runway_odds(self, report: Report) -> float:
        """Log odds of its being the runway, from all that speaks for it."""
        return float(self.runway[0] + (self.runway[1:] * report.of_the_runway()).sum())

    def confidence(self, report: Report) -> float:
        """Probability that both edges are where they were reported.

        Example:
            >>> weights = ConfidenceWeights(np.zeros(5), np.array([20.0, 0.0]))
            >>> round(weights.confidence(Report(1.0, 0.5, 30, True, 0.0)), 6)
            0.5
        """
        is_runway = _logistic(self.runway_odds(report))
        in_place = _logistic(self.place[0] + (self.place[1:] * report.of_the_place()).sum())
        return is_runway * in_place / (1.0 + report.other_edges)


def _logistic(log_odds: float) -> float:
    return 1.0 / (1.0 + math.exp(-log_odds))


def log_odds_of(features: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n,) log odds of strips with (n, features): of those seen from near by with other weights."""
    near_by, above = features[:, _DEPTH] > PROBABILITY.min_near_by, np.isnan(features[:, _SKY])
    odds = evidence_weights('').log_odds(features)
    for name, chosen in (('over', near_by & ~above), ('above', near_by & above)):
        if chosen.any():
            odds[chosen] = evidence_weights(name).log_odds(features[chosen])
    return odds


@cache
def evidence_weights(which: str) -> EvidenceWeights:
    """The weights that belong to this version; made by tools/fit_approach.py.

    Those named ``over`` and ``above`` are of strips seen from near by: the edges of the former meet
    in the picture, those of the latter above it.
    """
    data = _fitted()[which] if which else _fitted()
    if tuple(data['features']) != FEATURES:
        raise ValueError(f'{_FILE} is of other features: run tools/fit_approach.py again')
    arrays = {name: np.array(data[name]) for name in ('mean', 'deviation', 'knots', 'slopes')}
    return EvidenceWeights(**arrays, offset=data['offset'])


@cache
def confidence_weights() -> ConfidenceWeights:
    """The weights of the confidence; made by tools/fit_approach_confidence.py."""
    return ConfidenceWeights(**{k: np.array(v) for k, v in _fitted()['confidence'].items()})


@cache
def _fitted() -> Any:
    return json.loads(resources.files(__package__).joinpath(_FILE).read_text(encoding='utf-8'))
