"""Lights that jump against the others: in that moment another light may have taken their place."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from statistics import median


@dataclass(frozen=True)
class JumpTuning:
    """When a light has jumped.

    Chosen on seeds 9500 to 9529, 9900 to 9929 and 9982 of `offline.evaluation.integrity_runs`.
    """

    fewest: int = 3  # lights whose middle one tells how all have moved
    deviations: float = 4.5  # of what is usual, from which on it has
    least: float = 0.03  # px, of what is usual at least
    alone: float = 0.5  # part of its jump by which all others must be nearer to their places
    learning: float = 0.05  # per frame, of what is usual
    forgetting: float = 0.9  # per frame, of the evidence of a jump
    most: float = 60.0  # evidence that a jump can be


TUNING = JumpTuning()


class Jumps:
    """How far lights lie from where their own motion takes them, against what is usual."""

    def __init__(self) -> None:
        # That a marker's light is another one since a moment ago: the square of how many times
        # farther than usual it was.
        self.evidence: dict[int, float] = {}
        self._usual = 1.0

    def update(self, away: Mapping[int, tuple[float, float]]) -> int | None:
        """Take from where its own motion takes each marker to where its light is, px.

        Returns:
            The marker whose light has jumped in this frame, if one has.
        """
        kept = {m: TUNING.forgetting * evidence for m, evidence in self.evidence.items()}
        self.evidence = {m: evidence for m, evidence in kept.items() if evidence > 1.0}
        if len(away) < TUNING.fewest:
            return None
        # What has shaken the camera has moved all of them.
        x, y = (median(values) for values in zip(*away.values(), strict=True))
        usual = math.hypot(self._usual, TUNING.least)
        limit = TUNING.deviations * usual
        apart = sorted((math.hypot(dx - x, dy - y), m) for m, (dx, dy) in away.items())
        farthest, marker = apart[-1]
        # Where others have moved oddly as well, it is the motion that was not foreseen.
        has_jumped = farthest > limit and apart[-2][0] < TUNING.alone * farthest
        if has_jumped:
            jumped = min((farthest / usual) ** 2, TUNING.most)
            self.evidence[marker] = max(self.evidence.get(marker, 0.0), jumped)
        mean = sum(min(distance, limit) for distance, _ in apart) / len(apart)
        self._usual += TUNING.learning * (mean - self._usual)
        return marker if has_jumped else None
