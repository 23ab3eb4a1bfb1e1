"""The accumulator against eq. 3.25, pixel by pixel."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from support.hough import full_accumulator

from mvuav_ros.vision.runway import hough
from mvuav_ros.vision.runway.hough import HoughGrid, HoughVideo

RESOLUTIONS = [(2.0, 1.0), (1.0, 5.0), (0.5, 45.0), (3.7, 7.0), (100.0, 30.0)]

edge_images = hnp.arrays(
    np.uint8,
    hnp.array_shapes(min_dims=2, max_dims=2, max_side=14),
    elements=st.integers(0, 1),
)


def naive_accumulator(edges, theta, rho):
    """MATLAB's ``hough``: each pixel's rho rounded to the nearest cell, halves upwards."""
    accumulator = np.zeros((theta.size, rho.size), int)
    step = rho[1] - rho[0] if rho.size > 1 else 1.0
    for y, x in np.argwhere(edges):
        for column, angle in enumerate(theta):
            distance = x * math.cos(angle) + y * math.sin(angle)
            accumulator[column, math.floor((distance - rho[0]) / step + 0.5)] += 1
    return accumulator


@settings(deadline=None)
@given(edge_images, st.sampled_from(RESOLUTIONS))
def test_every_edge_pixel_votes_once_for_every_theta(edges, resolutions):
    grid = HoughGrid(*edges.shape, *resolutions)
    accumulator = full_accumulator(grid, edges)
    expected = naive_accumulator(edges, grid.theta, grid.rho)
    # At a boundary between cells (a corner's distance, to 14 digits) rounding may choose either.
    if np.any(accumulator != expected):
        nudged = naive_accumulator(edges, grid.theta, grid.rho - 1e-11)
        other = naive_accumulator(edges, grid.theta, grid.rho + 1e-11)
        assert np.all((accumulator == expected) | (nudged != other))
    assert (accumulator.sum(axis=1) == edges.sum()).all()


@given(edge_images, st.sampled_from(RESOLUTIONS))
def test_large_images_take_another_way_to_the_same_votes(edges, resolutions):
    with pytest.MonkeyPatch.context() as patch:
        expected = HoughGrid(*edges.shape, *resolutions).accumulate(edges)
        patch.setattr(hough, '_TABLE_BYTES', 0)
        patch.setattr(hough, '_BLOCK_VOTES', 100)
        np.testing.assert_array_equal(
            HoughGrid(*edges.shape, *resolutions).accumulate(edges), expected
        )


def test_the_grid_of_more_cells_than_16_bits_can_number():
    edges = (np.random.default_rng(0).random((40, 320)) < 0.02).astype(np.uint8)
    grid = HoughGrid(*edges.shape, 0.5, 1.0)
    assert math.prod(grid.shape) > 2**16
    np.testing.assert_array_equal(
        full_accumulator(grid, edges), naive_accumulator(edges, grid.theta, grid.rho)
    )


@pytest.mark.parametrize(
    ('resolution', 'columns'), [(1.0, 180), (45.0, 4), (0.3, 600), (90 / 161, 322), (7.0, 26)]
)
def test_theta_covers_half_a_turn_in_equal_steps(resolution, columns):
    theta = np.rad2deg(HoughGrid(2, 2, 1.0, resolution).theta)
    assert theta.size == columns
    assert theta[0] == pytest.approx(-90)
    np.testing.assert_allclose(np.diff(theta), 180 / columns, atol=1e-9)


def test_rho_reaches_the_far_corner_and_is_symmetric():
    rho = HoughGrid(31, 41, 2.0, 1.0).rho
    assert rho[-1] == 50
    np.testing.assert_array_equal(rho, -rho[::-1])


@given(edge_images)
def test_the_first_reachable_cell_is_reached(edges):
    grid = HoughGrid(*edges.shape, 1.0, 3.0)
    edges[-1] = 1
    assert grid.accumulate(edges)[:, 0].any()


@pytest.mark.parametrize('table_bytes', [hough._TABLE_BYTES, 0])
def test_the_votes_of_a_video_are_those_of_each_of_its_images(table_bytes, monkeypatch):
    monkeypatch.setattr(hough, '_TABLE_BYTES', table_bytes)
    random = np.random.default_rng(0)
    grid = HoughGrid(30, 40, 2.0, 1.0)
    video = HoughVideo(grid)
    edges = np.zeros((30, 40), np.uint8)
    for change in (0.0, 0.2, 0.01, 0.0, 0.02, 0.9, 0.05, 1.0, 0.1):
        edges = edges ^ (random.random(edges.shape) < change).astype(np.uint8)
        np.testing.assert_array_equal(video.accumulate(edges), grid.accumulate(edges))
    for empty_or_full in (0, 1, 0):
        edges = np.full_like(edges, empty_or_full)
        np.testing.assert_array_equal(video.accumulate(edges), grid.accumulate(edges))


def test_too_many_cells_are_refused_before_any_memory_is_taken():
    with pytest.raises(ValueError, match='coarser resolutions'):
        HoughGrid(2160, 3840, 0.1, 0.1)


def test_many_cells_are_not_made_anew_for_few_votes(monkeypatch):
    """A frame took 0.6 s where cells were 0.1 px high and 0.1 degrees wide."""
    monkeypatch.setattr(hough, '_BLOCK_VOTES', 1)
    grid = HoughGrid(30, 40, 1.0, 1.0)
    edges = (np.random.default_rng(0).random((30, 40)) < 0.1).astype(np.uint8)
    expected, count, counted = grid.accumulate(edges), grid._count, []
    monkeypatch.setattr(grid, '_count', lambda p: counted.append(p.size * 180) or count(p))
    np.testing.assert_array_equal(grid.accumulate(edges), expected)
    assert len(counted) <= sum(counted) / np.prod(grid.shape) + 1
