"""Rho/theta correction on sequences made by hand."""

import math

import pytest

from mvuav_ros.parameters.runway_detector import RunwayDetectorParameters
from mvuav_ros.vision.runway.correction import CorrectedLine, RhoThetaCorrection
from mvuav_ros.vision.runway.hough import HoughGrid
from mvuav_ros.vision.runway.normal_form import NormalForm


def line(rho, degrees):
    return NormalForm(float(rho), math.radians(degrees))


LEFT, CENTRE, RIGHT = line(150, 16), line(160, 0), line(162, -15)
# Thresholds are 30 px and 2°.
RHO_JUMP, THETA_JUMP, BOTH_JUMP = line(191, 0), line(160, 2.1), line(200, 10)


def correction(**parameters):
    given = RunwayDetectorParameters(**{'num_peaks': 1, **parameters})
    return RhoThetaCorrection(given)


def flags(rows):
    return [(row.rho_flag, row.theta_flag) for row in rows]


def run(corrector, *frames):
    """The last frame's rows."""
    rows = []
    for frame in frames:
        rows = corrector.correct(frame)
    return rows


def test_warmup_believes_two_frames_whatever_they_are():
    corrector = correction()
    assert corrector.correct([CENTRE]) == [CorrectedLine(0, CENTRE)]
    assert corrector.correct([BOTH_JUMP]) == [CorrectedLine(0, BOTH_JUMP)]
    # The third is compared with the second, not with the first.
    assert corrector.correct([CENTRE]) == [CorrectedLine(0, BOTH_JUMP, True, True)]


@pytest.mark.parametrize(('warmup', 'first_flag'), [(0, 1), (1, 1), (2, 2), (4, 4)])
def test_warmup_lasts_as_many_frames_as_asked_and_the_first_is_always_believed(warmup, first_flag):
    corrector = correction(correction_warmup=warmup)
    jumping = [corrector.correct([line(1000 * frame, 0)])[0] for frame in range(6)]
    assert [row.rho_flag for row in jumping] == [frame >= first_flag for frame in range(6)]


@pytest.mark.parametrize(
    ('bad', 'rho_flag', 'theta_flag'),
    [(RHO_JUMP, True, False), (THETA_JUMP, False, True), (BOTH_JUMP, True, True)],
)
def test_one_bad_frame_is_flagged_and_both_old_values_stay(bad, rho_flag, theta_flag):
    corrector = correction()
    slightly_on = line(165, 1)
    run(corrector, [CENTRE], [CENTRE])
    assert corrector.correct([bad]) == [CorrectedLine(0, CENTRE, rho_flag, theta_flag)]
    assert corrector.correct([slightly_on]) == [CorrectedLine(0, slightly_on)]


@pytest.mark.parametrize('association', ['index', 'nearest'])
def test_a_bad_line_leaves_the_others_untouched(association):
    corrector = correction(num_peaks=3, association=association)
    run(corrector, [LEFT, CENTRE, RIGHT], [LEFT, CENTRE, RIGHT])
    moved_left, moved_right = line(155, 17), line(160, -14)
    rows = corrector.correct([moved_left, BOTH_JUMP, moved_right])
    assert rows == [
        CorrectedLine(0, moved_left),
        CorrectedLine(1, CENTRE, True, True),
        CorrectedLine(2, moved_right),
    ]


def test_a_change_equal_to_the_threshold_is_no_jump():
    corrector = correction(rho_error_threshold=30.0, theta_error_threshold_deg=2.0)
    run(corrector, [line(100, 0)], [line(100, 0)])
    assert flags(corrector.correct([NormalForm(130.0, math.radians(2.0))])) == [(False, False)]


def test_a_change_of_just_as_many_cells_as_the_threshold_is_no_jump_at_any_angle():
    grid = HoughGrid(80, 320, 2.0, 1.0)
    lines = [NormalForm(100.0, float(theta)).moved_down(50) for theta in grid.theta]
    for last, new in zip(lines, lines[2:], strict=False):
        assert flags(run(correction(), [last], [last], [new])) == [(False, False)]


def test_comparison_is_with_the_last_corrected_values():
    """A drift passes step by step; the same distance at once does not."""
    corrector = correction()
    run(corrector, [line(0, 0)], [line(0, 0)])
    for step in range(1, 6):
        assert flags(corrector.correct([line(25 * step, 0)])) == [(False, False)]
    assert flags(corrector.correct([line(0, 0)])) == [(True, False)]


def test_a_true_jump_is_given_up_after_max_hold_frames_and_starts_again():
    corrector = correction(max_hold=4)
    run(corrector, [CENTRE], [CENTRE])
    for _ in range(4):
        assert corrector.correct([BOTH_JUMP]) == [CorrectedLine(0, CENTRE, True, True)]
    assert corrector.correct([BOTH_JUMP]) == [CorrectedLine(0, BOTH_JUMP)]
    # Starting again includes the warm-up: one more frame is believed, the next one is not.
    assert corrector.correct([LEFT]) == [CorrectedLine(0, LEFT)]
    assert flags(corrector.correct([BOTH_JUMP])) == [(True, True)]


def test_a_good_frame_in_between_starts_the_hold_anew():
    corrector = correction(max_hold=4)
    run(corrector, [CENTRE], [CENTRE], *[[BOTH_JUMP]] * 4, [CENTRE])
    for _ in range(4):
        assert flags(corrector.correct([BOTH_JUMP])) == [(True, True)]


def test_max_hold_zero_feeds_the_line_back_for_ever():
    corrector = correction(max_hold=0)
    run(corrector, [CENTRE], [CENTRE])
    for _ in range(200):
        assert corrector.correct([BOTH_JUMP]) == [CorrectedLine(0, CENTRE, True, True)]


def test_peaks_that_swap_raise_flags_by_index():
    corrector = correction(num_peaks=2, association='index')
    run(corrector, [LEFT, RIGHT], [LEFT, RIGHT])
    assert corrector.correct([RIGHT, LEFT]) == [
        CorrectedLine(0, LEFT, False, True),
        CorrectedLine(1, RIGHT, False, True),
    ]


def test_peaks_that_swap_raise_no_flags_by_nearest():
    corrector = correction(num_peaks=2, association='nearest')
    run(corrector, [LEFT, RIGHT], [LEFT, RIGHT])
    assert corrector.correct([RIGHT, LEFT]) == [
        CorrectedLine(1, LEFT),
        CorrectedLine(0, RIGHT),
    ]


def test_a_missing_peak_is_no_line_and_no_flag_and_the_others_keep_their_rows():
    corrector = correction(num_peaks=3)
    run(corrector, [LEFT, CENTRE, RIGHT], [LEFT, CENTRE, RIGHT])
    assert corrector.correct([RIGHT, LEFT]) == [
        CorrectedLine(1, LEFT),
        CorrectedLine(),
        CorrectedLine(0, RIGHT),
    ]


def test_by_index_the_last_row_misses_whichever_line_is_gone():
    corrector = correction(num_peaks=3, association='index')
    run(corrector, [LEFT, CENTRE, RIGHT], [LEFT, CENTRE, RIGHT])
    rows = corrector.correct([LEFT, RIGHT])
    assert rows[1] == CorrectedLine(1, CENTRE, False, True)
    assert rows[2] == CorrectedLine()


def test_a_line_that_was_missing_is_compared_with_its_old_values():
    corrector = correction()
    run(corrector, [CENTRE], [CENTRE], [], [], [])
    assert corrector.correct([BOTH_JUMP]) == [CorrectedLine(0, CENTRE, True, True)]
    assert corrector.correct([CENTRE]) == [CorrectedLine(0, CENTRE)]


def test_missing_frames_count_towards_max_hold():
    corrector = correction(max_hold=4)
    run(corrector, [CENTRE], [CENTRE], [], [BOTH_JUMP], [], [BOTH_JUMP])
    assert corrector.correct([BOTH_JUMP]) == [CorrectedLine(0, BOTH_JUMP)]


def test_a_line_missing_for_longer_than_max_hold_is_forgotten():
    corrector = correction(max_hold=2, correction_warmup=1)
    run(corrector, [CENTRE], [CENTRE], [], [])
    assert flags(corrector.correct([BOTH_JUMP])) == [(False, False)]
    run(corrector, [CENTRE], *[[CENTRE]] * 3, [], [], [])
    assert corrector.correct([LEFT]) == [CorrectedLine(0, LEFT)]


def test_without_history_a_row_without_a_peak_stays_empty():
    corrector = correction(num_peaks=2)
    assert run(corrector, [], [CENTRE]) == [CorrectedLine(0, CENTRE), CorrectedLine()]


@pytest.mark.parametrize('association', ['index', 'nearest'])
def test_a_line_that_turns_through_horizontal_is_the_same_line(association):
    """Horizontal lines are where theta goes from +90° to -90° and rho changes its sign."""
    corrector = correction(association=association)
    before, after = line(100, 89.6), line(-101, -89.6)
    run(corrector, [before], [before])
    assert corrector.correct([after]) == [CorrectedLine(0, after)]
    assert corrector.correct([before]) == [CorrectedLine(0, before)]


def test_nearest_tells_lines_apart_across_the_turn():
    corrector = correction(num_peaks=2)
    upper, lower = line(50, 89.5), line(120, 89.5)
    run(corrector, [upper, lower], [upper, lower])
    upper_turned, lower_turned = line(-51, -89.5), line(-119, -89.5)
    assert corrector.correct([lower_turned, upper_turned]) == [
        CorrectedLine(1, upper_turned),
        CorrectedLine(0, lower_turned),
    ]


def test_reset_forgets_and_warms_up_again():
    corrector = correction()
    run(corrector, [CENTRE], [CENTRE], [CENTRE])
    corrector.reset()
    assert corrector.correct([BOTH_JUMP]) == [CorrectedLine(0, BOTH_JUMP)]
    assert corrector.correct([CENTRE]) == [CorrectedLine(0, CENTRE)]


def test_more_peaks_keep_the_known_rows_and_fewer_keep_the_first():
    corrector = correction(num_peaks=2)
    run(corrector, [LEFT, RIGHT], [LEFT, RIGHT])
    corrector.configure(RunwayDetectorParameters(num_peaks=3))
    assert flags(corrector.correct([BOTH_JUMP, RIGHT, LEFT]))[:2] == [(False, False)] * 2
    corrector.configure(RunwayDetectorParameters(num_peaks=1))
    assert corrector.correct([BOTH_JUMP]) == [CorrectedLine(0, LEFT, True, True)]


def test_changed_thresholds_apply_to_lines_already_known():
    corrector = correction()
    run(corrector, [CENTRE], [CENTRE])
    corrector.configure(RunwayDetectorParameters(num_peaks=1, rho_error_threshold=31.5))
    assert flags(corrector.correct([RHO_JUMP])) == [(False, False)]


def test_zero_thresholds_flag_every_change_and_still_assign():
    corrector = correction(num_peaks=2, rho_error_threshold=0.0, theta_error_threshold_deg=0.0)
    run(corrector, [LEFT, RIGHT], [LEFT, RIGHT])
    assert flags(corrector.correct([RIGHT, LEFT])) == [(False, False)] * 2
    assert flags(corrector.correct([RIGHT, line(150.5, 16)])) == [(True, False), (False, False)]
