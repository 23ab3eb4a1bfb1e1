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
_SKY, _WIDTH = FEATURES.index('sky'), FEATURES.index('width')


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
        values = np.clip(
            (features - self.mean) / self.deviation,
            -PROBABILITY.max_deviations,
            PROBABILITY.max_deviations,
        )
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
        rivals: the other tracks' odds over the track's.
        distinct: share of the last frames with clear lines along both sides, or clear colours.
        other_edges: odds that an edge is elsewhere; 1 where the image shows two places for it.
        shoulder_lines: from 0 to 1, whether shoulders have lines too, on both sides.
    """

    log_odds: float
    agreement: float
    moved: int
    attitude: bool
    rivals: float
    distinct: float
    other_edges: float = 0.0
    shoulder_lines: float = 0.0

    def of_the_runway(self) -> NDArray[np.float64]:
        """(7,) what speaks for its being the runway."""
        values = (
            min(max(self.log_odds, -6.0), PROBABILITY.steady_odds),
            min(max(self.log_odds - PROBABILITY.steady_odds, 0.0), 6.0),
            min(self.moved / PROBABILITY.known_frames, 1.0),
            float(self.attitude),
            math.log1p(min(self.rivals, 20.0)),
            self.distinct,
            self.shoulder_lines,
        )
        return np.array(values)

    def of_the_place(self) -> NDArray[np.float64]:
        """(1,) what speaks for its edges' being within tolerance, if it is the runway."""
        lines = self.distinct * min(self.moved / PROBABILITY.known_frames, 1.0)
        return np.array([math.log(max(self.agreement, lines) + PROBABILITY.min_agreement)])


@dataclass(frozen=True, eq=False)
class ConfidenceWeights:
    """Two logistic functions, whose product, less the odds of other edges, is the confidence.

    Attributes:
        runway: (8,) offset and weights of `Report.of_the_runway`.
        place: (2,) offset and weights of `Report.of_the_place`.
    """

    runway: NDArray[np.float64]
    place: NDArray[np.float64]

    def confidence(self, report: Report) -> float:
        """Probability that both edges are where they were reported.

        Example:
            >>> weights = ConfidenceWeights(np.zeros(8), np.array([20.0, 0.0]))
            >>> round(weights.confidence(Report(1.0, 0.5, 30, True, 0.0, 0.0)), 6)
            0.5
        """
        is_runway = _logistic(self.runway, report.of_the_runway())
        in_place = _logistic(self.place, report.of_the_place())
        return is_runway * in_place / (1.0 + report.other_edges)


def _logistic(weights: NDArray[np.float64], values: NDArray[np.float64]) -> float:
    return 1.0 / (1.0 + math.exp(-float(weights[0] + (weights[1:] * values).sum())))


def log_odds_of(features: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n,) log odds of strips with (n, features); of those seen from near by other weights."""
    above = np.isnan(features[:, _SKY]) & (features[:, _WIDTH] > PROBABILITY.min_near_by)
    odds = evidence_weights('').log_odds(features)
    if above.any():
        odds[above] = evidence_weights('above').log_odds(features[above])
    return odds


@cache
def evidence_weights(which: str) -> EvidenceWeights:
    """The weights that belong to this version; made by tools/fit_approach.py.

    Those named ``above`` are of wide strips whose edges meet above the image.
    """
    data = _fitted()
    if which:
        data = data[which]
    if tuple(data['features']) != FEATURES:
        raise ValueError(f'{_FILE} is of other features: run tools/fit_approach.py again')
    arrays = {name: np.array(data[name]) for name in ('mean', 'deviation', 'knots', 'slopes')}
    return EvidenceWeights(**arrays, offset=data['offset'])


@cache
def confidence_weights() -> ConfidenceWeights:
    """The weights of the confidence; made by tools/fit_approach.py."""
    data = _fitted()['confidence']
    return ConfidenceWeights(np.array(data['runway']), np.array(data['place']))


def _fitted() -> dict[str, Any]:
    text = resources.files(__package__).joinpath(_FILE).read_text(encoding='utf-8')
    data: dict[str, Any] = json.loads(text)
    return data
