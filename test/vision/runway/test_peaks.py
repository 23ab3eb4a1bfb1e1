"""Peaks against a plain transcription of the rules of MATLAB's ``houghpeaks``.

scikit-image's ``hough_line_peaks`` cannot serve here: it keeps only cells that are maxima of
their whole neighbourhood (a second maximum at the neighbourhood's rim is lost), wants strictly
more than its threshold, and its order of equal peaks is unspecified.
"""

import numpy as np
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from support.hough import full_accumulator

from mvuav_ros.vision.runway.hough import HoughGrid
from mvuav_ros.vision.runway.peaks import Peak, find_peaks


def matlab_houghpeaks(h, num_peaks, threshold, neighborhood):
    """``h`` is MATLAB's matrix, rho down and theta across; returns (row, column), 1-based."""
    rows, columns = h.shape
    h = {(p, q): h[p - 1, q - 1] for q in range(1, columns + 1) for p in range(1, rows + 1)}
    reach_rho, reach_theta = ((size - 1) // 2 for size in neighborhood)
    peaks = []
    while len(peaks) < num_peaks:
        # max() keeps the first of equal cells, and cells come column by column.
        p, q = max(h, key=h.get)
        if h[p, q] < threshold:
            break
        peaks.append((p, q))
        for qq in range(q - reach_theta, q + reach_theta + 1):
            for pp in range(max(p - reach_rho, 1), min(p + reach_rho, rows) + 1):
                if qq < 1:
                    h[rows - pp + 1, qq + columns] = 0
                elif qq > columns:
                    h[rows - pp + 1, qq - columns] = 0
                else:
                    h[pp, qq] = 0
    return peaks


def check(accumulator, num_peaks, threshold, neighborhood):
    before = accumulator.copy()
    found = find_peaks(accumulator, num_peaks, threshold, *neighborhood)
    expected = matlab_houghpeaks(accumulator.T, num_peaks, threshold, neighborhood)
    assert [(peak.rho_index + 1, peak.theta_index + 1) for peak in found] == expected
    assert [p.votes for p in found] == [accumulator[q - 1, p - 1] for p, q in expected]
    np.testing.assert_array_equal(accumulator, before)
    return found


@st.composite
def edge_images(draw):
    """A few straight lines, often within a few degrees of ±90° or of 0°, and some noise."""
    height, width = draw(st.integers(1, 24)), draw(st.integers(1, 24))
    random = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    edges = random.random((height, width)) < draw(st.sampled_from([0.0, 0.03, 0.2]))
    y, x = np.mgrid[:height, :width]
    for _ in range(draw(st.integers(0, 3))):
        near = draw(st.sampled_from([-90.0, 90.0, 0.0, 33.0]))
        theta = np.deg2rad(near + draw(st.floats(-4, 4)))
        through_x, through_y = random.integers(0, width), random.integers(0, height)
        distance = (x - through_x) * np.cos(theta) + (y - through_y) * np.sin(theta)
        edges |= np.abs(distance) <= 0.5
    return edges.astype(np.uint8)


@settings(deadline=None, max_examples=150)
@given(
    edge_images(),
    st.sampled_from([(2.0, 3.0), (1.0, 5.0), (1.5, 10.0)]),
    st.integers(1, 6),
    st.integers(1, 12),
    st.sampled_from([(11, 11), (1, 1), (3, 7), (101, 3), (1, 17)]),
)
@example(np.zeros((10, 10), np.uint8), (2.0, 3.0), 3, 1, (11, 11))
@example(np.ones((1, 12), np.uint8), (2.0, 3.0), 6, 1, (3, 7))
def test_peaks_of_edge_images(edges, resolutions, num_peaks, threshold, neighborhood):
    grid = HoughGrid(*edges.shape, *resolutions)
    found = check(full_accumulator(grid, edges), num_peaks, threshold, neighborhood)
    reachable = grid.accumulate(edges), num_peaks, threshold, *neighborhood
    assert find_peaks(*reachable, grid.first_reachable_cell) == found


@settings(deadline=None, max_examples=200)
@given(
    st.data(),
    st.integers(2, 8),
    st.integers(0, 8),
    st.integers(1, 8),
    st.floats(0.5, 4),
)
def test_peaks_of_any_numbers_with_many_ties(data, half_columns, half_cells, num_peaks, threshold):
    shape = 2 * half_columns, 2 * half_cells + 1
    accumulator = data.draw(hnp.arrays(np.intp, shape, elements=st.integers(0, 4)))
    reach_theta = data.draw(st.integers(0, half_columns - 1))
    reach_rho = data.draw(st.integers(0, 10))
    check(accumulator, num_peaks, threshold, (2 * reach_rho + 1, 2 * reach_theta + 1))


def test_a_horizontal_line_is_one_peak_although_it_lies_at_both_ends_of_theta():
    edges = np.zeros((40, 60), np.uint8)
    edges[20] = 1
    grid = HoughGrid(40, 60, 1.0, 1.0)
    accumulator = full_accumulator(grid, edges)
    found = check(accumulator, 2, 25, (11, 11))
    assert [
        (grid.rho[p.rho_index], round(np.rad2deg(grid.theta[p.theta_index]))) for p in found
    ] == [(-20.0, -90)]
    # Without the wrap, its mirror image at +89° would be the second peak.
    assert accumulator[-1].max() >= 25


def test_a_cell_without_votes_is_never_a_peak():
    assert find_peaks(np.zeros((4, 5), np.intp), 3, 0, 3, 3) == []


def test_a_neighborhood_wider_than_half_a_turn_covers_both_signs_of_rho():
    accumulator = np.arange(4 * 7, dtype=np.intp).reshape(4, 7)
    assert find_peaks(accumulator, 9, 1, 13, 99) == [Peak(3, 6, 27)]
    found = find_peaks(accumulator, 9, 1, 1, 99)
    # Each clears its row and its mirror image of all columns: rho 6 and 0, 5 and 1, 4 and 2, 3.
    assert [peak.rho_index for peak in found] == [6, 5, 4, 3]
