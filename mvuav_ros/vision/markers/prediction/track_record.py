"""How often and how lately each of several lights was seen, and how well it was predicted."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class RecordTuning:
    """How far a prediction is trusted.

    Chosen on the simulator's four trials with and without vibration.
    """

    # px, assumed of a prediction before anything is known of the motion.
    first_deviation: float = 3.0
    least_deviation: float = 0.3  # px, of a prediction
    level_memory: float = 0.9  # per frame, of the squared errors of a light's predictions


TUNING = RecordTuning()


class TrackRecord:
    """What has been seen of every light."""

    def __init__(self, count: int) -> None:
        self.seen = np.zeros(count, np.intp)  # (n,), measurements since its first
        self.unseen = np.zeros(count, np.intp)  # (n,), frames since the last one
        # (n,), measurements without a gap, less the first three, whose innovations tell of the new
        # filter and not of the camera.
        self.in_row = np.zeros(count, np.intp)
        # (2 n,) px², of its predictions, x and y in turn.
        self.variance: Array = np.full(2 * count, TUNING.first_deviation**2)

    def add(self, count: int) -> None:
        """Append lights that were seen for the first time."""
        new = TrackRecord(count)
        self.seen = np.append(self.seen, new.seen + 1)
        self.unseen = np.append(self.unseen, new.unseen)
        self.in_row = np.append(self.in_row, new.in_row)
        self.variance = np.append(self.variance, new.variance)

    def keep(self, kept: Mask) -> None:
        """Forget all lights but some (n, true for those)."""
        self.seen, self.unseen = self.seen[kept], self.unseen[kept]
        self.in_row, self.variance = self.in_row[kept], self.variance[np.repeat(kept, 2)]

    def count(self, visible: Mask) -> None:
        """Take note of which lights (n, where true) were seen in a frame."""
        self.seen[visible] += 1
        self.unseen = np.where(visible, 0, self.unseen + 1)
        self.in_row = np.where(visible, self.in_row + (self.seen > 3), 0)

    def judge(self, error: Array) -> None:
        """Take the errors of all lights' predictions, (2 n,) px, which it may change."""
        variance = self.variance
        variance *= TUNING.level_memory
        error *= error
        error *= 1 - TUNING.level_memory
        variance += error

    def judge_some(self, error: Array, judged: Mask) -> None:
        """The same of some lights (n, where true)."""
        columns = np.repeat(judged, 2)
        share = np.repeat(np.where(self.seen > 10, 1 - TUNING.level_memory, 0.5), 2)
        change = share * (error**2 - self.variance)
        self.variance[columns] += change[columns]

    def start(self, columns: Mask) -> None:
        """Lights (2 n, where true) of whose motion nothing is known."""
        self.variance[columns] = TUNING.first_deviation**2

    def deviations(self, skipped: int, level: float) -> Array:
        """How far off the predictions of the newest frame may be, (n,) px, 1 sigma per axis.

        Before it some frames were skipped; the level (px²) is of what vibrates, which can be
        foretold for the next frame only.
        """
        frames = 1 + self.unseen + skipped
        least = np.where(frames > 1, level, TUNING.least_deviation**2)
        # No velocity or a poor one: the step from frame to frame may be anything usual.
        least[self.seen < 3] = TUNING.first_deviation**2
        variance = 0.5 * (self.variance[::2] + self.variance[1::2])
        variance = np.maximum(variance, np.maximum(least, TUNING.least_deviation**2))
        return np.asarray(np.sqrt(variance) * frames**1.5)
