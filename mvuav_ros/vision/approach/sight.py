"""Where the edges of a strip on the ground may meet: on the horizon, if it is known."""

from __future__ import annotations

import math
from typing import NamedTuple

from mvuav_ros.vision.approach.tuning import DETECTOR, SEARCH


class SearchRange(NamedTuple):
    """Rows between which vanishing points lie on the working image levelled by a slope, rad."""

    slope: float
    first: float
    last: float


class Sight(NamedTuple):
    """Where edges may meet on the levelled working image."""

    row: float | None  # of the horizon, px, if it is known
    # hypotheses of where it is; the first has the frame's slope, as have all without a horizon
    ranges: list[SearchRange]
    # row of the vanishing point and its standard deviation, px; known with an attitude
    meeting: tuple[float, float] | None = None
    seen: float = 0.0  # frames in which a horizon was seen

    @classmethod
    def unknown(cls, height: int, slope: float) -> Sight:
        """No horizon is in view: anywhere in, or somewhat above, an image of a height, px.

        The slope is that of a level vehicle's camera, rad.
        """
        first, last = (share * height for share in DETECTOR.whole_range)
        beyond = SearchRange(slope, DETECTOR.range_above * height, first)
        return cls(None, [SearchRange(slope, first, last), beyond])

    @classmethod
    def about(cls, row: float, slope: float, unknown: Sight, seen: float) -> Sight:
        """The image shows a horizon, or the edge of clouds or hills, in so many frames.

        In infinitely many where a sensor has given its row and slope; else it may be elsewhere.
        """
        if seen == math.inf:
            near = SearchRange(slope, row - SEARCH.attitude_reach, row + SEARCH.attitude_reach)
            return cls(row, [near], (row, SEARCH.attitude_sigma), seen)
        above, below = SEARCH.horizon_reach
        ranges = [SearchRange(slope, row - above, row + below), *unknown.ranges]
        return cls(row, ranges, seen=seen)
