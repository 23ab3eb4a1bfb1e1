"""Which measured line goes to which row."""

import math
import subprocess
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import linear_sum_assignment

from mvuav_ros.vision.runway.correction import _cheapest, by_distance
from mvuav_ros.vision.runway.normal_form import NormalForm


def line(rho, degrees):
    return NormalForm(float(rho), math.radians(degrees))


LEFT, CENTRE, RIGHT = line(150, 16), line(160, 0), line(162, -15)


def test_one_wild_line_does_not_pull_the_good_ones_apart():
    """The plain sum of changes is smaller with both lines exchanged: 20 + 9 against 1 + 30."""
    known = [line(0, 0), line(10, 0)]
    assert by_distance(known, [line(1, 0), line(-20, 0)], 15, 1) == [0, 1]


def test_few_flags_go_before_little_change():
    """A line just beyond the limit of the second row is still within that of the first."""
    assert by_distance([line(0, 0), line(30, 0)], [line(1000, 0), line(14, 0)], 15, 1) == [1, 0]


def test_new_lines_go_to_free_rows_in_their_order():
    assert by_distance([None, CENTRE, None], [LEFT, RIGHT, CENTRE], 30, 0.04) == [0, 2, 1]


@given(
    st.lists(st.tuples(st.floats(-400, 400), st.floats(-1.5, 1.5)), min_size=1, max_size=6),
    st.randoms(use_true_random=False),
)
def test_any_order_of_the_same_lines_is_assigned_without_a_change(values, random):
    known = [NormalForm(*value) for value in values]
    order = list(range(len(known)))
    random.shuffle(order)
    assigned = by_distance(known, [known[i] for i in order], 30, 0.04)
    assert sorted(assigned) == sorted(order)
    assert [known[order[column]] for column in assigned] == known


@given(st.integers(1, 6), st.integers(1, 6), st.randoms(use_true_random=False))
def test_the_least_sum_is_scipys_for_any_number_of_lines(rows, columns, random):
    costs = [[random.random() for _ in range(columns)] for _ in range(rows)]
    pairs = _cheapest(costs)
    best = sum(
        costs[row][column] for row, column in zip(*linear_sum_assignment(costs), strict=True)
    )
    assert sum(costs[row][column] for row, column in pairs) == pytest.approx(best)
    for used in zip(*pairs, strict=True):
        assert len(set(used)) == min(rows, columns)


def test_a_runway_of_few_lines_starts_without_scipy():
    """Its import takes longer than the rest of a node's start."""
    code = (
        'import sys; import mvuav_ros.processing.runway_processor as d;'
        'from mvuav_ros.vision.runway.correction import by_distance;'
        'from mvuav_ros.vision.runway.normal_form import NormalForm as N;'
        'by_distance([N(1, 0)] * 3, [N(1, 0)] * 3, 1, 1);'
        "sys.exit('scipy' in sys.modules)"
    )
    subprocess.run([sys.executable, '-c', code], check=True)


def test_a_runway_of_many_lines_does_not_import_scipy_in_a_frame():
    code = (
        'import sys, mvuav_ros.parameters.runway_detector as p;'
        'from mvuav_ros.vision.runway.detector import RunwayDetector;'
        'RunwayDetector(p.RunwayDetectorParameters(num_peaks=5));'
        "sys.exit('scipy.optimize' not in sys.modules)"
    )
    subprocess.run([sys.executable, '-c', code], check=True)
