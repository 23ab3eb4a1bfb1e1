"""The strongest cells of a Hough accumulator, by the rules of MATLAB's ``houghpeaks``."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from mvuav_ros.vision.runway.hough import Accumulator


class Peak(NamedTuple):
    """A cell of an accumulator and its votes."""

    theta_index: int
    rho_index: int
    votes: int


def find_peaks(
    accumulator: Accumulator,
    num_peaks: int,
    threshold: float,
    neighborhood_rho: int,
    neighborhood_theta: int,
    first_cell: int = 0,
) -> list[Peak]:
    """Take the strongest cell, clear its neighbourhood, and so on.

    Of equal cells the one with the smaller theta is taken, then the one with the smaller rho.

    Args:
        accumulator: (theta, rho) votes of a `HoughGrid`. It is the same again in the end.
        num_peaks: peaks wanted at most.
        threshold: votes that a peak must have at least.
        neighborhood_rho: cells of the neighbourhood along rho, odd; cut off at the ends.
        neighborhood_theta: cells along theta, odd; beyond ±90° it continues at the other end with
            the sign of rho changed, where the same lines are.
        first_cell: cells of rho that are left out, in which there are no votes.

    Returns:
        Peaks with at least one vote, strongest first.
    """
    cells = accumulator.shape[1]
    reach = neighborhood_rho // 2, neighborhood_theta // 2
    peaks: list[Peak] = []
    cleared: list[tuple[Accumulator, Accumulator]] = []
    try:
        while len(peaks) < num_peaks:
            theta_index, cell = divmod(int(accumulator.argmax()), cells)
            votes = int(accumulator[theta_index, cell])
            if votes < max(threshold, 1):
                break
            peaks.append(Peak(theta_index, first_cell + cell, votes))
            mirrored = cells - 1 - cell - first_cell
            for part in _neighbourhood(accumulator, theta_index, cell, mirrored, *reach):
                cleared.append((part, part.copy()))
                part[:] = 0
    finally:
        # To give back what was cleared takes less time than to copy everything beforehand.
        for part, before in reversed(cleared):
            part[:] = before
    return peaks


def _neighbourhood(
    votes: Accumulator, theta_index: int, cell: int, mirrored: int, reach_rho: int, reach_theta: int
) -> Iterator[Accumulator]:
    """The parts around a cell; ``mirrored`` is the cell of -rho, which may be left out."""
    columns = votes.shape[0]
    first, last = theta_index - reach_theta, theta_index + reach_theta
    for half_turns in range(first // columns, last // columns + 1):
        centre = mirrored if half_turns % 2 else cell
        offset = half_turns * columns
        yield votes[
            max(first - offset, 0) : last - offset + 1,
            max(centre - reach_rho, 0) : max(centre + reach_rho + 1, 0),
        ]
