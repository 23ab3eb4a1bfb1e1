"""The result section: counts, means and deviations."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mvuav_ros.vision.runway.normal_form import NormalForm
from mvuav_ros.vision.runway.results import RunwayLine
from mvuav_ros.vision.runway.statistics import RunningMoments, RunwayStatistics


def found(rho, degrees, rho_flag=False, theta_flag=False):
    return RunwayLine(
        peak=0, rho=rho, theta=math.radians(degrees), rho_flag=rho_flag, theta_flag=theta_flag
    )


def summary_of(*frames):
    statistics = RunwayStatistics()
    for frame in frames:
        statistics.add(frame)
    return statistics.summary()


@given(st.lists(st.floats(-1e4, 1e4), min_size=2))
def test_moments_are_numpys(values):
    moments = RunningMoments()
    for value in values:
        moments.add(value)
    assert moments.mean == pytest.approx(np.mean(values), abs=1e-6)
    assert moments.std == pytest.approx(np.std(values, ddof=1), abs=1e-5)


def test_a_small_spread_far_from_zero_is_not_lost():
    moments = RunningMoments()
    for value in (1e9, 1e9 + 1, 1e9 + 2):
        moments.add(value)
    assert moments.std == pytest.approx(1.0)


def test_nothing_measured_is_nan_not_zero():
    summary = summary_of((RunwayLine(),), (found(1, 1),))
    assert (summary.frames, summary.lines[0].found) == (2, 1)
    assert summary.lines[0].rho_mean == 1 and math.isnan(summary.lines[0].rho_std)
    empty = summary_of((RunwayLine(),)).lines[0]
    assert math.isnan(empty.rho_mean) and math.isnan(empty.theta_mean)


def test_flags_are_counted_per_line_and_by_frame():
    """Two lines that raise the same flag in one frame are one frame with it."""
    summary = summary_of(
        (found(1, 1, True, False), found(1, 1, False, True)),
        (found(1, 1, True, True), found(1, 1)),
        (found(1, 1), RunwayLine()),
    )
    first, second = summary.lines
    assert (first.rho_flags, first.theta_flags, first.corrected) == (2, 1, 2)
    assert (second.rho_flags, second.theta_flags, second.corrected) == (0, 1, 1)
    assert (summary.frames, summary.rho_flags, summary.theta_flags, summary.corrected) == (
        3,
        2,
        2,
        2,
    )
    assert summary.flag_text == 'rho 2 / 3, theta 2 / 3, combined 2 / 3'
    assert (first.found, second.found) == (3, 2)


def test_flags_of_a_row_without_a_line_count_nowhere():
    """A recording of another program may have them."""
    summary = summary_of((RunwayLine(rho_flag=True),), (found(1, 1, theta_flag=True),))
    assert (summary.rho_flags, summary.theta_flags, summary.corrected) == (0, 1, 1)


def test_mean_and_deviation_of_rho_and_theta():
    line = summary_of((found(10, 4),), (found(12, 5),), (found(14, 9),)).lines[0]
    assert (line.rho_mean, line.rho_std) == (pytest.approx(12), pytest.approx(2))
    assert math.degrees(line.theta_mean) == pytest.approx(6)
    assert math.degrees(line.theta_std) == pytest.approx(np.std([4, 5, 9], ddof=1))


def test_a_line_that_turns_through_horizontal_averages_to_itself():
    frames = [(found(100, 89),), (found(-101, -89),), (found(-99, -88),), (found(100, 88),)]
    line = summary_of(*frames).lines[0]
    mean = NormalForm(line.rho_mean, line.theta_mean).facing(math.pi / 2)
    assert math.degrees(mean.theta) == pytest.approx(90)
    assert mean.rho == pytest.approx(100)
    assert line.rho_std == pytest.approx(np.std([100, 101, 99, 100], ddof=1))
    assert math.degrees(line.theta_std) == pytest.approx(np.std([89, 91, 92, 88], ddof=1))
    assert -math.pi / 2 < line.theta_mean <= math.pi / 2


def test_rows_come_and_go_with_the_number_of_peaks():
    summary = summary_of((found(1, 1),), (found(1, 1), found(2, 2)), (found(1, 1),))
    assert [line.found for line in summary.lines] == [3]
    summary = summary_of((found(1, 1),), (found(1, 1), found(2, 2)))
    assert [line.found for line in summary.lines] == [2, 1]


def test_reset_begins_at_zero():
    statistics = RunwayStatistics()
    statistics.add((found(1, 1, True),))
    statistics.reset()
    assert statistics.summary().frames == 0 and statistics.summary().lines == ()
    statistics.add((found(7, 1),))
    assert statistics.summary().lines[0].rho_mean == 7
