"""Channel, Sobel and opening against definitions written out."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from mvuav_ros.vision.runway.edges import (
    automatic_threshold,
    detect_edges,
    open_edges,
    structuring_element,
)

grays = hnp.arrays(
    st.sampled_from([np.uint8, np.uint16]),
    hnp.array_shapes(min_dims=2, max_dims=2, min_side=1, max_side=9),
)


def squared_gradient_exactly(gray):
    """Gx² + Gy² in Python's integers, the image continued by its border."""
    p = np.pad(gray.astype(object), 1, mode='edge')
    height, width = gray.shape
    squared = np.zeros(gray.shape, object)
    for y in range(height):
        for x in range(width):
            n = p[y : y + 3, x : x + 3]
            gx = n[0, 2] + 2 * n[1, 2] + n[2, 2] - n[0, 0] - 2 * n[1, 0] - n[2, 0]
            gy = n[2, 0] + 2 * n[2, 1] + n[2, 2] - n[0, 0] - 2 * n[0, 1] - n[0, 2]
            squared[y, x] = gx * gx + gy * gy
    return squared


@given(grays)
def test_automatic_edges_exceed_four_times_the_mean_square_exactly(gray):
    squared = squared_gradient_exactly(gray)
    expected = squared * squared.size > 4 * squared.sum()
    np.testing.assert_array_equal(detect_edges(gray), expected)


@given(grays)
def test_the_automatic_threshold_is_twice_the_rms_gradient(gray):
    mean = squared_gradient_exactly(gray).sum() / gray.size
    scale = 8 * np.iinfo(gray.dtype).max
    assert automatic_threshold(gray) == pytest.approx(2 * np.sqrt(float(mean)) / scale)


def test_a_step_of_a_tenth_of_full_scale_is_seen_below_its_gradient_only():
    gray = np.zeros((5, 8), np.uint8)
    gray[:, 4:] = 51
    # Kernels divided by 8: a vertical step of height h has the gradient h / 2.
    expected = np.zeros((5, 8), np.uint8)
    expected[:, 3:5] = 1
    np.testing.assert_array_equal(detect_edges(gray, 0.0999), expected)
    assert not detect_edges(gray, 0.1001).any()


def test_thinning_leaves_the_middle_of_a_ramp():
    gray = np.zeros((6, 9), np.uint8)
    gray[:, 4] = 100
    gray[:, 5:] = 200
    expected = np.zeros((6, 9), np.uint8)
    expected[:, 4] = 1
    np.testing.assert_array_equal(detect_edges(gray, 0.1, thinning=True), expected)
    assert np.count_nonzero(detect_edges(gray, 0.1)) == 3 * np.count_nonzero(expected)


@given(grays)
def test_thinned_edges_are_edges(gray):
    # A gradient that equals the automatic threshold is decided by rounding when thinning.
    thinned = detect_edges(gray, 0.0517, thinning=True)
    assert not np.any(thinned & ~detect_edges(gray, 0.0517) & 1)


def naive_opening(edges, length):
    opened = np.zeros_like(edges)
    height, width = edges.shape
    for x in range(width):
        y = 0
        while y < height:
            end = y
            while end < height and edges[end, x]:
                end += 1
            run = end - y
            # A run at the border may go on outside, where it is not seen.
            reaches_out = (y == 0) + (end == height)
            needed = {0: length, 1: (length + 1) // 2, 2: 1}[reaches_out]
            if run >= needed:
                opened[y:end, x] = 1
            y = max(end, y + 1)
    return opened


@given(
    hnp.arrays(
        np.uint8, hnp.array_shapes(min_dims=2, max_dims=2, max_side=12), elements=st.integers(0, 1)
    ),
    st.sampled_from([1, 3, 5, 7, 31]),
)
def test_opening_removes_short_vertical_runs(edges, length):
    np.testing.assert_array_equal(
        open_edges(edges, 'vertical_line', length), naive_opening(edges, length)
    )


ELEMENTS = {
    ('vertical_line', 3): '1 1 1',
    ('square', 3): '111 111 111',
    ('diamond', 5): '00100 01110 11111 01110 00100',
    ('disk', 5): '01110 11111 11111 11111 01110',
}


@pytest.mark.parametrize(('which', 'rows'), ELEMENTS.items())
def test_structuring_elements_are_those_of_the_thesis(which, rows):
    expected = [[int(digit) for digit in row] for row in rows.split()]
    np.testing.assert_array_equal(structuring_element(*which), expected)


@pytest.mark.parametrize('shape', ['square', 'disk', 'diamond'])
@pytest.mark.parametrize('length', [3, 5, 9])
def test_opening_keeps_the_element_and_removes_what_is_smaller(shape, length):
    element = structuring_element(shape, length)
    assert element.shape == (length, length)
    edges = np.pad(element, 6)
    np.testing.assert_array_equal(open_edges(edges, shape, length), edges)
    row, column = np.argwhere(edges)[0]
    edges[row, column] = 0
    assert not open_edges(edges, shape, length).any()
