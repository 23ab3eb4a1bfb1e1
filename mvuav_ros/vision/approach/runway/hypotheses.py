"""The strips that may be one runway, each weighed over many frames.

A runway is a strip within strips: its shoulders around it, side stripes, a streak of rubber. Which
of them is the runway one frame seldom tells. All keep their places in the runway's own
coordinates, columns in widths from its left edge, which do not change as the aircraft moves.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.approach.runway.geometry import columns_at, strips_through
from mvuav_ros.vision.approach.runway.search import Strips
from mvuav_ros.vision.approach.runway.tuning import TUNING

_MEMORY = 0.08
"""Share of a new weighing in a strip's log odds."""
_GONE = -8.0
"""Log odds of a strip that was not there."""
_FOLLOWS = 0.3
"""Share of a new measurement in a strip's place within the runway."""
_MOST = 10
_WORST = -9.0
"""Log odds under the best strip's below which one is given up."""
_DOUBT = 1.5
"""Log odds by which a new strip must be better than a known one beside it."""
_SAME, _SAME_PX = 0.06, 0.6
"""Widths, and px, between edges of strips that are the same."""
_NEW = 2.0
"""Weighings after which a strip counts half."""
_HOT, _COLD = (20.0, 2.5), (40.0, 1.0)
"""Px of width, and by what log odds are divided there, as frames err alike: where the strips are as
near to each other as the tolerance, their middle is right more often than the best. Runs 3, 5."""

Places = NDArray[np.float64]
"""(n, 2, 2): columns of the left and the right edge at `TUNING.first_row` of the near end's depth
and at the near end, in widths of the runway there."""


class Weighed(NamedTuple):
    """Strips (n, 6) as measured in the newest frame, and their shares (n,), which add up to 1."""

    strips: Strips
    shares: NDArray[np.float64]


class Hypotheses:
    """Strips around, within and beside one another."""

    def __init__(self) -> None:
        self._places: Places = np.empty((0, 2, 2))
        self._ends = np.empty((0, 2))
        self._odds = np.empty(0)
        self._count = np.empty(0)
        self._kept = np.empty(0, np.intp)

    def strips(self, frame: NDArray[np.float64]) -> Strips:
        """Where they are expected in a frame in which the runway is the strip (6,)."""
        rows = _rows(frame)
        edges = columns_at(frame[None], rows)[0]
        columns = edges[0] + self._places * (edges[1] - edges[0])
        ends = frame[1] + self._ends * frame[5]
        return strips_through(columns, rows, ends)

    def weigh(
        self,
        measured: Strips,
        odds: NDArray[np.float64],
        share: float,
        frame: NDArray[np.float64],
    ) -> Weighed:
        """Take in what a frame says of `strips` and others.

        Args:
            measured: (m, 6) strips as they are in the frame: the expected ones first.
            odds: (m,) log odds of each in this frame; minus infinity of what is no strip there.
            share: how many frames this one stands for.
            frame: (6,) the runway's strip.
        """
        known = len(self._odds)
        self._count += 1.0
        memory = np.maximum(1.0 - (1.0 - _MEMORY) ** share, 1.0 / np.maximum(self._count, 1.0))
        now = np.where(np.isfinite(odds[:known]), odds[:known], _GONE)
        self._odds += memory * (now - self._odds)
        all_odds = np.concatenate([self._odds, odds[known:]])
        count = np.concatenate([self._count, np.ones(len(odds) - known)])
        width = max(float((frame[3] - frame[2]) * frame[5]), 1.0)
        columns = columns_at(measured, _rows(frame))
        rank = all_odds - _DOUBT * (count == 1.0)
        kept = _distinct(columns, rank, max(_SAME * width, _SAME_PX))
        self._odds, self._count, self._kept = all_odds[kept], count[kept], kept
        return Weighed(measured[kept], self._shares(columns[kept]))

    def settle(self, measured: Strips, frame: NDArray[np.float64]) -> None:
        """Say where the runway is in the newest frame, for the places of `weigh`'s strips."""
        rows = _rows(frame)
        edges = columns_at(frame[None], rows)[0]
        places = (columns_at(measured, rows) - edges[0]) / np.maximum(edges[1] - edges[0], 0.5)
        ends = (measured[:, 1:2] + measured[:, 4:6] - frame[1]) / frame[5]
        old = self._kept < len(self._places)
        before = self._kept[old]
        places[old] += (1.0 - _FOLLOWS) * (self._places[before] - places[old])
        ends[old] += (1.0 - _FOLLOWS) * (self._ends[before] - ends[old])
        self._places, self._ends = places, ends

    def _shares(self, columns: NDArray[np.float64]) -> NDArray[np.float64]:
        if not len(self._odds):
            return np.empty(0)
        widths = np.maximum(columns[:, 1, 1] - columns[:, 0, 1], 1.0)
        known = self._count / (self._count + _NEW)
        usual = float(np.average(widths, weights=known))
        temperature = float(np.interp(usual, (_HOT[0], _COLD[0]), (_HOT[1], _COLD[1])))
        # Paint and rubber within a runway are seen more often than it: the wider counts more.
        weight = np.exp((self._odds - self._odds.max()) / temperature) * widths * known
        shares: NDArray[np.float64] = weight / weight.sum()
        return shares


def _rows(frame: NDArray[np.float64]) -> NDArray[np.float64]:
    rows: NDArray[np.float64] = frame[1] + np.array([TUNING.first_row, 1.0]) * frame[5]
    return rows


def _distinct(
    columns: NDArray[np.float64], odds: NDArray[np.float64], apart: float
) -> NDArray[np.intp]:
    """Numbers of the strips that differ, best first, without hopeless ones."""
    kept: list[int] = []
    if not odds.size:
        return np.array(kept, np.intp)
    for index in np.argsort(-odds, kind='stable'):
        if not odds[index] >= odds.max() + _WORST or len(kept) == _MOST:
            break
        if not kept or (np.abs(columns[kept] - columns[index]).max(axis=(1, 2)) > apart).all():
            kept.append(int(index))
    return np.array(kept, np.intp)
