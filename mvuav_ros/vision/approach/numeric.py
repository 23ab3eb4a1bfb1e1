"""Small computations that several steps of the approach share."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def best_run(
    gain: NDArray[Any], slack: float = 0.0
) -> tuple[NDArray[Any], NDArray[np.intp], NDArray[np.intp]]:
    """The run of columns with the largest sum in each row.

    Args:
        gain: (n, columns) what each column adds.
        slack: sums that differ by no more begin equally well; the shortest such run is taken.

    Returns:
        Arrays (n,): the sum, the first column, and the one after the last.

    Examples:
        >>> best_run(np.array([[-1.0, 2.0, 3.0, -4.0]]))
        (array([5.]), array([1]), array([3]))
    """
    total = np.zeros((gain.shape[0], gain.shape[1] + 1))
    np.cumsum(gain, axis=1, out=total[:, 1:])
    lowest = np.minimum.accumulate(total, axis=1)
    rise = total - lowest
    last = rise.argmax(axis=1)
    number = np.arange(gain.shape[0])
    columns = np.arange(total.shape[1])
    # The last place before the end at which the total was that low.
    least = lowest[number, last][:, None] + slack
    at_lowest = (total <= least) & (columns <= last[:, None])
    first = total.shape[1] - 1 - at_lowest[:, ::-1].argmax(axis=1)
    return rise[number, last], np.minimum(first, gain.shape[1] - 1), last


def in_common(one: NDArray[Any], other: NDArray[Any]) -> NDArray[Any]:
    """What both sides agree in: the smaller of two values of one sign, else 0.

    Examples:
        >>> in_common(np.array([3.0, -3.0, 3.0]), np.array([5.0, -2.0, -1.0]))
        array([ 3., -2.,  0.])
    """
    common: NDArray[Any] = np.minimum(one, other)
    np.maximum(common, 0, out=common)
    negative = np.maximum(one, other)
    np.minimum(negative, 0, out=negative)
    common += negative
    return common


def vertex(values: NDArray[Any], index: int) -> float:
    """Where the parabola through a maximum and its neighbours has its vertex, from the maximum."""
    if not 0 < index < values.size - 1:
        return 0.0
    before, at, after = (float(value) for value in values[index - 1 : index + 2])
    bend = before - 2 * at + after
    return 0.5 * (before - after) / bend if bend < 0 else 0.0
