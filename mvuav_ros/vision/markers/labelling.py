"""Which cluster is which marker, and the roll that follows (Appendix A)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import combinations

from mvuav_ros.vision.markers.results import Cluster, Marker


def label_five(clusters: Sequence[Cluster]) -> tuple[int, int, int, int, int]:
    """Name five clusters by the ten distances between them.

    The greatest distance of all joins the wings, the greatest among the other three points the
    stabilizers; the point that remains is the rudder. Of a pair, left is the one that comes
    first in the scan (the smaller x), so the names hold for roll between -90° and 90°.

    Returns:
        Indices into five clusters in scan order: left wing, left stabilizer, rudder, right
        stabilizer and right wing.

    Raises:
        ValueError: there are not exactly five.
    """
    if len(clusters) != 5:
        raise ValueError(f'labels need five clusters, not {len(clusters)}')
    left_wing, right_wing = _farthest_pair(clusters, range(5))
    others = [i for i in range(5) if i not in (left_wing, right_wing)]
    left_stabilizer, right_stabilizer = _farthest_pair(clusters, others)
    (rudder,) = (i for i in others if i not in (left_stabilizer, right_stabilizer))
    return left_wing, left_stabilizer, rudder, right_stabilizer, right_wing


def roll_of(left: Marker, right: Marker) -> float:
    """Roll from the wings (rad), right wing down positive; NaN while either is lost."""
    return math.atan2(right.y - left.y, right.x - left.x)


def _farthest_pair(clusters: Sequence[Cluster], indices: Sequence[int]) -> tuple[int, int]:
    def squared_distance(pair: tuple[int, int]) -> float:
        a, b = clusters[pair[0]], clusters[pair[1]]
        return (a.x - b.x) ** 2 + (a.y - b.y) ** 2

    return max(combinations(indices, 2), key=squared_distance)
