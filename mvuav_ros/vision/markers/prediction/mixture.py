"""Several predictions made one: each counts as far as its past errors say."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class MixtureTuning:
    """How fast the weights follow the errors.

    Chosen on flights of the motions in `simulation.marker_paths` and some more, with seeds of
    their own; memories of 0.98 to 0.99 and confidences of 2 to 3.5 give the same to 1 %.
    """

    memory: float = 0.985  # per frame, of the squared errors
    # By how much a frame's evidence counts. A frame of five rigid markers is worth about that of
    # two independent coordinates, for which 0.5 x 2 would be Bayes's rule were the errors' sizes
    # known; that of frames which stand out is counted below.
    confidence: float = 2.5


TUNING = MixtureTuning()


class PredictionMixture:
    """The weighted mean of competing predictions.

    The weight of each is its prior times (mean squared error) to the power -c n: the posterior
    of a model whose errors have an unknown variance, from n frames. Where few frames make up
    most of the squares, as after the start of a gust, n is that few: (sum of squares)² over the
    sum of their squares, as for weighted samples (L. Kish, Survey Sampling, 1965).

    Attributes:
        weights: (k,), sum 1.
    """

    def __init__(self, prior: Sequence[float]) -> None:
        self._prior = tuple(prior)
        self.weights: Array = np.array(prior) / sum(prior)
        self._share: Array = np.empty(0)
        self._losses = [0.0] * len(prior)
        self._sum = self._sum_of_squares = 0.0

    def learn(self, errors: Array) -> None:
        """Take the errors of the newest predictions, (k, m) px."""
        count = errors.shape[1]
        if count != len(self._share):
            self._share = np.full(count, 1.0 / count)
        new: list[float] = (errors * errors).dot(self._share).tolist()
        memory = TUNING.memory
        losses = self._losses = [
            memory * old + loss for old, loss in zip(self._losses, new, strict=True)
        ]
        usual = sorted(new)[1]
        self._sum = memory * self._sum + usual
        self._sum_of_squares = memory * self._sum_of_squares + usual * usual
        least = min(losses)
        if least <= 0.0 or self._sum_of_squares <= 0.0:
            return
        power = -TUNING.confidence * self._sum * self._sum / self._sum_of_squares
        weights = [
            prior * (loss / least) ** power for prior, loss in zip(self._prior, losses, strict=True)
        ]
        total = sum(weights)
        self.weights = np.array([weight / total for weight in weights])
