"""The best run against all runs."""

import numpy as np
import pytest

from mvuav_ros.vision.approach.appearance import best_run


@pytest.mark.parametrize('slack', [0.0, 1e-9])
def test_no_other_run_has_a_larger_sum(slack):
    gain = np.random.default_rng(3).normal(size=(200, 12))
    for row, best, first, last in zip(gain, *best_run(gain, slack), strict=True):
        sums = [row[a:b].sum() for a in range(12) for b in range(a, 13)]
        assert best == pytest.approx(max(sums)) and row[first:last].sum() == pytest.approx(best)


def test_of_equal_runs_the_shortest_is_taken():
    gain = np.array([[1.0, -1.0, 2.0, 0.0]])
    assert [int(value[0]) for value in best_run(gain)] == [2, 2, 3]
    nearly = np.array([[1e-12, 2.0]])
    assert best_run(nearly)[1][0] == 0
    assert best_run(nearly, 1e-9)[1][0] == 1
