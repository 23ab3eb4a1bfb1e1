"""Moves a strip's edges by a pixel or two to where the evidence is."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.approach.numeric import in_common
from mvuav_ros.vision.approach.runway.evidence import UNIT, EvidenceMap
from mvuav_ros.vision.approach.runway.search import Strips
from mvuav_ros.vision.approach.runway.tuning import TUNING

_FAR_STEPS = np.array([-1.5, -0.75, 0.0, 0.75, 1.5])
_NEAR_STEPS = np.array([-2.0, -1.0, 0.0, 1.0, 2.0])
_SAMPLES, _ROUNDS = 14, 2
_WEIGHTS = np.array(TUNING.weights)
_COST_PER_PX = 0.02
_SHIFTS, _SHIFT, _LEAST_SHIFT = 5, 0.11, 0.75
"""Places of each edge on either side that are tried, and px between them: widths, at least px."""
_NARROWER, _WIDER = 0.45, 2.2
"""Widths of the narrowest and the widest strip tried around another."""
_LEAST_SLOPE_GAP, _LEAST_DEPTH, _MOST_DEPTH = 0.1, 4.0, 60.0


def align(image: EvidenceMap, strips: Strips) -> tuple[Strips, NDArray[np.bool_]]:
    """Move both edges by turns to the most evidence that they have in common.

    They are moved at `TUNING.first_row` of the near end's depth and at the near end.

    Returns:
        The strips, and which of them are still strips that can be measured.
    """
    x, y, near = strips[:, 0:1], strips[:, 1:2], strips[:, 5:6]
    rows = _rows(y, near)
    depth = rows - y
    share = (depth / near - TUNING.first_row) / (1.0 - TUNING.first_row)
    moves = _FAR_STEPS[:, None, None] * (1 - share) + _NEAR_STEPS[:, None, None, None] * share
    moves = moves.reshape(-1, len(strips), _SAMPLES)
    edges = []
    for column, mirror in ((2, 1), (3, -1)):
        columns = x + strips[:, column : column + 1] * depth + moves
        edges.append(_signed(image, rows, columns, mirror))
    return _moved(strips, _choose(edges))


def around(image: EvidenceMap, strip: NDArray[np.float64], most: int) -> Strips:
    """Strips around, within and beside one, it first, then those with the most evidence."""
    x, y, left, right, _, near = (float(value) for value in strip)
    width = (right - left) * near
    step = max(_LEAST_SHIFT, _SHIFT * width)
    shifts = np.arange(-_SHIFTS, _SHIFTS + 1) * step
    rows = _rows(y, near)
    lefts, rights = left + shifts / near, right + shifts / near
    one, other = (
        _signed(image, rows, x + slopes[:, None] * (rows - y), mirror)
        for slopes, mirror in ((lefts, 1), (rights, -1))
    )
    total = in_common(one[:, None], other[None]).sum(axis=2, dtype=np.int32)
    score = np.abs(total) @ _WEIGHTS
    widths = (rights[None] - lefts[:, None]) * near
    score[(widths < max(_NARROWER * width, 2.0)) | (widths > _WIDER * width)] = -1.0
    found = [strip]
    while len(found) < most:
        first, second = divmod(int(score.argmax()), score.shape[1])
        if score[first, second] <= 0:
            break
        found.append(np.array([x, y, lefts[first], rights[second], *strip[4:]]))
        score[max(0, first - 1) : first + 2, max(0, second - 1) : second + 2] = -1.0
    return np.stack(found)


def _rows(y: Any, near: Any) -> NDArray[np.intp]:
    """Rows of the map in which strips are compared."""
    share = np.linspace(TUNING.first_row, 1.0, _SAMPLES)
    rows: NDArray[np.intp] = np.rint(y + share * near).astype(np.intp)
    return rows


def _signed(
    image: EvidenceMap, rows: NDArray[np.intp], columns: NDArray[Any], mirror: int
) -> NDArray[np.int16]:
    """Evidence at places, of which a right edge has the signs turned; paint has none."""
    signed = image.at(rows, columns)[0].astype(np.int16)
    signed[..., :3] *= mirror
    return signed


def _choose(edges: list[NDArray[np.int16]]) -> list[NDArray[np.intp]]:
    """For either edge the number of the move that is best for both."""
    count = edges[0].shape[1]
    cost = _COST_PER_PX * (np.abs(_NEAR_STEPS)[:, None] + np.abs(_FAR_STEPS)).reshape(-1, 1)
    middle = cost.size // 2
    chosen = [np.full(count, middle), np.full(count, middle)]
    number = np.arange(count)
    for _ in range(_ROUNDS):
        for side in (0, 1):
            other = edges[1 - side][chosen[1 - side], number]
            total = np.abs(in_common(edges[side], other).sum(axis=2, dtype=np.int32))
            score = total @ _WEIGHTS / (_SAMPLES * UNIT) - cost
            chosen[side] = score.argmax(axis=0)
    return chosen


def _moved(strips: Strips, chosen: list[NDArray[np.intp]]) -> tuple[Strips, NDArray[np.bool_]]:
    x, y, *_, near = strips.T
    places = []
    for column, number in zip((2, 3), chosen, strict=True):
        slope = strips[:, column]
        far_move = _FAR_STEPS[number % _FAR_STEPS.size]
        near_move = _NEAR_STEPS[number // _FAR_STEPS.size]
        at_far = x + slope * TUNING.first_row * near + far_move
        places.append((at_far, x + slope * near + near_move))
    length = (1.0 - TUNING.first_row) * near
    left, right = ((at_near - at_far) / length for at_far, at_near in places)
    depth = (places[1][1] - places[0][1]) / np.maximum(right - left, 0.05)
    moved = strips.copy()
    moved[:, 0] = places[0][1] - left * depth
    moved[:, 1] = y + near - depth
    moved[:, 2], moved[:, 3], moved[:, 5] = left, right, depth
    valid = (right - left > _LEAST_SLOPE_GAP) & (depth > _LEAST_DEPTH) & (depth < _MOST_DEPTH)
    return moved, valid
