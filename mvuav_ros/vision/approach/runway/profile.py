"""A strip row by row: the evidence along its edges, and where it ends."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.approach.numeric import best_run, in_common
from mvuav_ros.vision.approach.runway.evidence import UNIT, EvidenceMap
from mvuav_ros.vision.approach.runway.search import Strips
from mvuav_ros.vision.approach.runway.tuning import TUNING

WEIGHTS = np.array(TUNING.weights, np.float32)
ROWS = 44
"""Below the vanishing point: near ends of up to 28 px and half as much again."""
MOST_GAIN = 5.0
_FIRST_DEPTH, _LEAST_WIDTH = 1.5, 2.0
_SLACK = 1e-9
"""Of sums of evidence, which are rounded."""
Numbers = NDArray[np.floating[Any]]


@dataclass(frozen=True, eq=False)
class Profile:
    """Strips row by row; arrays are (n, rows) unless said.

    Attributes:
        strips: (n, 6), with the ends that were found.
        rows: of the map.
        depth: rows below the vanishing point.
        left: column of the left edge.
        right: column of the right edge.
        visible: both edges are in the image.
        parts: (n, rows, 4) what both edges have in common, in textures, with the strip's sign.
        total: their weighted sum, limited.
        inside: rows from the far to the near end.
        run: (n,) sum of `total` above the bias over the logarithm of depth.
        last: (n,) index of the near end's row.
        apart: (n,) logarithm of the near end's depth by the left edge over that by the right.
        balance: (n,) fainter over stronger edge.
    """

    strips: Strips
    rows: NDArray[np.intp]
    depth: Numbers
    left: Numbers
    right: Numbers
    visible: NDArray[np.bool_]
    parts: Numbers
    total: Numbers
    inside: NDArray[np.bool_]
    run: Numbers
    last: NDArray[np.intp]
    apart: Numbers
    balance: Numbers

    def mean(self, values: Any) -> Numbers:
        """(n,) mean over the strip's rows."""
        count = np.maximum(self.inside.sum(axis=1), 1)
        result: Numbers = (values * self.inside).sum(axis=1) / count
        return result


def profile(image: EvidenceMap, strips: Strips) -> Profile:
    """Measure strips row by row, on the level where near ends are 10 to 40 px deep, and find ends.

    Their near ends say which rows the strips are known by.
    """
    x, y, left_slope, right_slope, _, expected = strips.T
    rows = np.rint(y[:, None] + np.arange(1, ROWS + 1)).astype(np.intp)
    depth = rows - y[:, None]
    left, right = (x[:, None] + slope[:, None] * depth for slope in (left_slope, right_slope))
    lefts, in_left = image.at(rows, left)
    rights, in_right = image.at(rows, right)
    visible = in_left & in_right
    one, other = lefts.astype(np.float32) / UNIT, rights.astype(np.float32) / UNIT
    other[..., :3] *= -1
    common = in_common(one, other)
    known = (depth > TUNING.first_row * expected[:, None]) & (depth <= expected[:, None])
    sign = np.where((common * known[..., None]).sum(axis=1) >= 0, 1.0, -1.0)[:, None]
    parts = common * sign
    total = np.minimum(parts @ WEIGHTS, MOST_GAIN)
    used = visible & (depth >= _FIRST_DEPTH) & (right - left >= _LEAST_WIDTH)
    used &= depth <= 1.9 * expected[:, None]
    worth = used / np.maximum(depth, 2.0)
    run, first, last = best_run((total - TUNING.row_bias) * worth, _SLACK)
    number = np.arange(len(strips))
    last = np.maximum(last - 1, first)
    found = strips.copy()
    found[:, 4], found[:, 5] = depth[number, first], depth[number, last] + 0.5
    index = np.arange(ROWS)
    inside = used & (index >= first[:, None]) & (index <= last[:, None])
    single = [np.minimum((each * sign) @ WEIGHTS, MOST_GAIN) for each in (one, other)]
    ends = [best_run((each - TUNING.row_bias) * worth, _SLACK)[2] for each in single]
    near = [depth[number, np.maximum(end - 1, 0)] for end in ends]
    apart = np.log(np.maximum(near[0], 1.0) / np.maximum(near[1], 1.0))
    means = [(each * inside).sum(axis=1) for each in single]
    balance = np.minimum(*means) / np.maximum(np.maximum(*means), 1e-6)
    return Profile(
        found, rows, depth, left, right, visible, parts, total, inside, run, last, apart, balance
    )
