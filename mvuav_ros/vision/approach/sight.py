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
    def unknown(cls, height: int) -> Sight:
        """No horizon is in view: anywhere in, or somewhat above, an image of a height, px."""
        first, last = (share * height for share in DETECTOR.whole_range)
        beyond = SearchRange(0.0, DETECTOR.range_above * height, first)
        return cls(None, [SearchRange(0.0, first, last), beyond])

    @classmethod
    def from_attitude(cls, row: float, slope: float) -> Sight:
        """A sensor has given the horizon's row and slope."""
        reach = SEARCH.attitude_reach
        ranges = [SearchRange(slope, row - reach, row + reach)]
        return cls(row, ranges, (row, SEARCH.attitude_sigma), math.inf)

    @classmethod
    def from_image(cls, row: float, slope: float, height: int, seen: int) -> Sight:
        """The image shows a horizon, or the edge of clouds or hills, in so many frames."""
        above, below = SEARCH.horizon_reach
        ranges = [SearchRange(slope, row - above, row + below), *cls.unknown(height).ranges]
        return cls(row, ranges, seen=seen)
