"""How exactly markers are seen, as the residuals of earlier frames show."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class NoiseTuning:
    """How fast the noise follows the residuals.

    Chosen with `mvuav_ros.vision.pose.PoseTuning`.
    """

    first_noise: float = 0.3  # px, assumed before there are residuals
    first_weight: float = 4.0  # degrees of freedom that this assumption is worth
    first_memory: float = 0.9  # of that, per frame
    memory: float = 0.999  # of the residuals, per frame
    recent_memory: float = 0.6  # of those that show a sudden rise: back to normal in 15 frames
    rise: float = 2.5  # ratio of the recent noise to the usual one from which on it counts
    max_rise: int = 60  # frames after which it is the usual noise that has changed
    # px, of a centroid, the same from frame to frame: the residuals do not show all of it.
    steady_error: float = 0.015


TUNING = NoiseTuning()


class ResidualNoise:
    """Deviation of a marker's place per axis, px, from the residuals of poses that fit.

    A sudden rise counts while it lasts, and is soon forgotten.
    """

    def __init__(self) -> None:
        self._squares = self._freedom = self._recent = 0.0
        self._doubt = TUNING.first_weight
        self._risen_for = 0

    @property
    def noise(self) -> float:
        """In the newest frame, px."""
        variance = self._variance
        if self._recent > TUNING.rise**2 * variance:
            variance = self._recent
        return math.hypot(math.sqrt(variance), TUNING.steady_error)

    @property
    def usual(self) -> float:
        """Where there is no sudden rise, px."""
        return math.hypot(math.sqrt(self._variance), TUNING.steady_error)

    @property
    def _variance(self) -> float:
        squares = self._squares + self._doubt * TUNING.first_noise**2
        return squares / (self._freedom + self._doubt)

    def learn(self, squares: float, freedom: int) -> None:
        """Take a frame's squared residuals, px², and their degrees of freedom."""
        if freedom <= 0:
            return
        variance = self._variance
        self._recent += (1 - TUNING.recent_memory) * (squares / freedom - self._recent)
        rise = self._recent > TUNING.rise**2 * variance
        self._risen_for = self._risen_for + 1 if rise else 0
        most = math.inf
        if 0 < self._risen_for < TUNING.max_rise:
            most = variance * freedom
        self._squares = TUNING.memory * self._squares + min(squares, most)
        self._freedom = TUNING.memory * self._freedom + freedom
        self._doubt *= TUNING.first_memory
