"""The stretch of rows in which evidence lasts."""

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
