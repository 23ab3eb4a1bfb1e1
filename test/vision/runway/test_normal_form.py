"""Lines in normal form, and where they leave the frame."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mvuav_ros.vision.runway.normal_form import NormalForm, clip_segment, segment_ends

lines = st.builds(NormalForm, st.floats(-500, 500), st.floats(-10, 10))
sizes = st.integers(1, 400)


def distance(line, x, y):
    return x * math.cos(line.theta) + y * math.sin(line.theta) - line.rho


@given(lines)
def test_normalised_is_the_same_line_in_the_half_open_half_turn(line):
    same = line.normalised()
    assert -math.pi / 2 < same.theta <= math.pi / 2
    for x, y in ((0, 0), (300, 0), (0, 200)):
        assert abs(distance(same, x, y)) == pytest.approx(abs(distance(line, x, y)), abs=1e-9)
    assert abs(same.rho) == abs(line.rho)


def test_a_horizontal_line_has_theta_plus_90():
    assert NormalForm(-20.0, -math.pi / 2).normalised() == NormalForm(20.0, math.pi / 2)
    assert NormalForm(20.0, math.pi / 2).normalised() == NormalForm(20.0, math.pi / 2)


@given(lines, st.floats(-10, 10))
def test_facing_is_the_same_line_at_most_a_quarter_turn_away(line, theta):
    same = line.facing(theta)
    assert abs(same.theta - theta) <= math.pi / 2 + 1e-9
    assert abs(distance(same, 70, 90)) == pytest.approx(abs(distance(line, 70, 90)), abs=1e-9)


@given(lines, st.integers(0, 300), st.floats(0, 319), st.floats(0, 80))
def test_a_line_of_a_slice_moves_down_with_it(line, rows, x, y):
    moved = line.moved_down(rows)
    assert distance(moved, x, y + rows) == pytest.approx(distance(line, x, y), abs=1e-9)


@given(lines, sizes, sizes)
def test_ends_lie_on_the_line_and_on_the_frames_border(line, width, height):
    x, y, x2, y2 = segment_ends(line, width, height)
    corners = [distance(line, cx, cy) for cx in (0, width - 1) for cy in (0, height - 1)]
    if math.isnan(x):
        assert min(corners) > -1e-6 or max(corners) < 1e-6
        return
    assert min(corners) < 1e-6 and max(corners) > -1e-6
    for px, py in ((x, y), (x2, y2)):
        assert distance(line, px, py) == pytest.approx(0, abs=1e-6)
        assert 0 <= px <= width - 1 and 0 <= py <= height - 1
        assert min(px, py, width - 1 - px, height - 1 - py) == pytest.approx(0, abs=1e-6)
    assert y <= y2 + 1e-9


@given(st.floats(1, 318), st.floats(-1.3, 1.3), st.floats(1, 238))
def test_the_segment_is_not_shorter_than_the_frame_allows(x, theta, y):
    """Through an inner point, both ends are on the border: neither is the point itself."""
    line = NormalForm(x * math.cos(theta) + y * math.sin(theta), theta)
    ends = segment_ends(line, 320, 240)
    assert math.dist(ends[:2], ends[2:]) > 1.9


@pytest.mark.parametrize(
    ('line', 'ends'),
    [
        (NormalForm(100, 0), (100, 0, 100, 239)),
        (NormalForm(0, 0), (0, 0, 0, 239)),
        (NormalForm(319, 0), (319, 0, 319, 239)),
        (NormalForm(50, math.pi / 2), (0, 50, 319, 50)),
        (NormalForm(239, math.pi / 2), (0, 239, 319, 239)),
        (NormalForm(0, math.pi / 2), (0, 0, 319, 0)),
        (NormalForm(-50, -math.pi / 2), (0, 50, 319, 50)),
        (NormalForm(0, -math.pi / 4), (0, 0, 239, 239)),
        (NormalForm(0, math.pi / 4), (0, 0, 0, 0)),
    ],
)
def test_ends_by_hand(line, ends):
    assert segment_ends(line, 320, 240) == pytest.approx(ends, abs=1e-9)


@pytest.mark.parametrize(
    'line',
    [
        NormalForm(320, 0),
        NormalForm(-1, 0),
        NormalForm(240, math.pi / 2),
        NormalForm(500, math.pi / 4),
        NormalForm(math.nan, 0.0),
        NormalForm(0.0, math.nan),
        NormalForm(math.inf, 0.0),
    ],
)
def test_a_line_beside_the_frame_has_no_ends(line):
    assert all(math.isnan(value) for value in segment_ends(line, 320, 240))


def test_an_empty_frame_has_no_ends():
    assert math.isnan(segment_ends(NormalForm(0, 0), 0, 10)[0])


def test_segments_are_cut_at_the_frame():
    assert clip_segment(-10, 5, 30, 5, 20, 10) == pytest.approx((0, 5, 20, 5))
    assert clip_segment(2, 3, 4, 5, 20, 10) == pytest.approx((2, 3, 4, 5))
    assert clip_segment(-5, -5, -1, 20, 20, 10) is None
    assert clip_segment(0, -10, 40, 30, 20, 20) == pytest.approx((10, 0, 20, 10))
