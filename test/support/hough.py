"""Hough accumulators as MATLAB has them."""

import numpy as np


def full_accumulator(grid, edges):
    """The votes in all cells, also in those that no pixel can reach."""
    accumulator = np.zeros((grid.theta.size, grid.rho.size), int)
    accumulator[:, grid.first_reachable_cell :] = grid.accumulate(edges)
    return accumulator
