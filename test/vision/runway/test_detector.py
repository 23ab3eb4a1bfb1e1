"""The whole scheme, frame by frame."""

import math

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from mvuav_ros.parameters.runway_detector import RunwayDetectorParameters
from mvuav_ros.vision.image import Image
from mvuav_ros.vision.runway.detector import RunwayDetector
from mvuav_ros.vision.runway.results import LineFlag, RunwayLine

WHOLE = {'start_row': 0, 'end_row': 0}


def pipeline(**parameters):
    return RunwayDetector(RunwayDetectorParameters(**parameters))


def painted(*ends, width=320, height=240, thickness=3, dtype=np.uint8):
    """A grey frame with bright lines from (x, y) to (x2, y2)."""
    frame = np.full((height, width), 60, dtype)
    for x, y, x2, y2 in ends:
        cv2.line(frame, (x, y), (x2, y2), 220, thickness)
    return frame


def all_nan(line):
    numbers = (
        line.rho, line.theta, line.votes, line.rho_raw, line.theta_raw,
        line.x, line.y, line.x2, line.y2,
    )  # fmt: skip
    return all(math.isnan(number) for number in numbers) and not line.found and line.flags == 0


TWO_LINES = [(140, 0, 60, 239), (180, 0, 260, 239)]


@pytest.mark.parametrize(
    'start_row, end_row', [(50, 130), (0, 0), (0, 240), (120, 239), (100, 140)]
)
def test_lines_are_those_of_the_whole_frame_whatever_rows_are_searched(start_row, end_row):
    result = pipeline(start_row=start_row, end_row=end_row, num_peaks=2).process(
        painted(*TWO_LINES), 7
    )
    for line, (x, y, x2, y2) in zip(
        sorted(result.lines, key=lambda line: line.x2), TWO_LINES, strict=True
    ):
        # Either edge of the three-pixel line, within a cell; a short slice sees theta coarsely.
        for px, py in ((x, y), (x2, y2)):
            error = px * math.cos(line.theta) + py * math.sin(line.theta) - line.rho
            assert abs(error) < 7
        assert (line.x, line.y) == pytest.approx((x, y), abs=7)
        assert (line.x2, line.y2) == pytest.approx((x2, y2), abs=7)
        assert line.votes >= 15
    assert result.stamp_ns == 7 and (result.width, result.height) == (320, 240)
    assert result.rows == ((start_row, end_row) if end_row else (0, 240))


def test_a_horizontal_line_has_theta_plus_90_and_a_positive_rho():
    # Opening removes flat edges; a thick bar's edge rows survive it without opening only.
    result = pipeline(num_peaks=1, opening_length=1).process(painted((0, 90, 319, 90)), 0)
    assert result.lines[0].theta == pytest.approx(math.pi / 2)
    assert result.lines[0].rho == pytest.approx(90, abs=3)
    assert (result.lines[0].x, result.lines[0].x2) == (0, 319)


@pytest.mark.parametrize('channel', ['red', 'green', 'blue', 'intensity'])
def test_only_the_chosen_channel_is_searched(channel):
    frame = np.zeros((240, 320, 3), np.uint8)
    for index, x in enumerate((80, 160, 240)):
        frame[:, x:, index] = 200
    expected = {'blue': [80], 'green': [160], 'red': [240], 'intensity': [80, 160, 240]}[channel]
    result = pipeline(channel=channel, num_peaks=len(expected)).process(frame, 0)
    assert sorted(line.x for line in result.lines) == pytest.approx(expected, abs=2)


def test_sixteen_bits_give_the_lines_of_eight():
    frame = painted(*TWO_LINES)
    eight = pipeline().process(frame, 0)
    sixteen = pipeline().process(frame.astype(np.uint16) * 257, 0)
    assert repr(sixteen.lines) == repr(eight.lines)
    assert eight.lines[0].found


@pytest.mark.parametrize(
    ('frame', 'parameters', 'status'),
    [
        (np.zeros((0, 0), np.uint8), {}, 'empty'),
        (np.zeros((0, 320, 3), np.uint8), WHOLE, 'empty'),
        (np.zeros((240, 0), np.uint8), {}, 'empty'),
        (np.zeros((1, 1), np.uint8), {}, 'rows 50 to 130 are outside the 1 rows'),
        (np.full((1, 1), 255, np.uint8), WHOLE, 'no edge'),
        (np.full((1, 1, 3), 255, np.uint8), WHOLE, 'no edge'),
        (np.repeat([[0, 9]], 8).astype(np.uint8).reshape(1, 16), WHOLE, 'the strongest has 2'),
        (np.repeat([[0, 9]], 8).astype(np.uint16).reshape(16, 1), WHOLE, 'no edge'),
        (np.zeros((240, 320, 3), np.uint8), {}, 'no edge in rows 50 to 130'),
        (np.full((240, 320), 255, np.uint8), {}, 'no edge'),
        (np.full((240, 320), 65535, np.uint16), WHOLE, 'no edge'),
        (painted(*TWO_LINES)[:50], {}, 'rows 50 to 130 are outside the 50 rows'),
        (painted(*TWO_LINES), {'peak_threshold': 1000}, 'no peak has 1000 votes; the strongest'),
        (painted(*TWO_LINES), {'opening_length': 999}, 'no edge'),
        (
            painted(*TWO_LINES, width=4000, height=3000),
            {'rho_resolution': 0.1, 'theta_resolution_deg': 0.1, **WHOLE},
            'Hough cells',
        ),
    ],
)  # fmt: skip
def test_frames_without_lines_give_nan_rows_and_say_why(frame, parameters, status):
    tested = pipeline(**parameters)
    for _ in range(2):
        result = tested.process(frame, 3)
        assert len(result.lines) == 3
        assert all(all_nan(line) for line in result.lines)
        assert status in result.status


@settings(deadline=None, max_examples=60)
@given(
    hnp.arrays(
        st.sampled_from([np.uint8, np.uint16]),
        st.one_of(
            hnp.array_shapes(min_dims=2, max_dims=2, min_side=0, max_side=40),
            st.tuples(st.integers(0, 40), st.integers(0, 40), st.just(3)),
        ),
    ),
    st.integers(0, 45),
    st.integers(1, 5),
    st.booleans(),
    st.sampled_from(['red', 'intensity']),
    st.sampled_from([1, 3, 9]),
)
def test_any_frame_gives_a_result(frame, start_row, num_peaks, thinning, channel, length):
    tested = pipeline(
        start_row=start_row,
        end_row=start_row + 10,
        num_peaks=num_peaks,
        edge_thinning=thinning,
        channel=channel,
        opening_length=length,
        peak_threshold=1,
    )
    before = frame.copy()
    for _ in range(2):
        result = tested.process(frame, 0)
        assert len(result.lines) == num_peaks
        assert all(line.found or all_nan(line) for line in result.lines)
        assert any(line.found for line in result.lines) or result.status
        for line in result.lines:
            if line.found:
                assert -math.pi / 2 < line.theta <= math.pi / 2
    np.testing.assert_array_equal(frame, before)


def test_rows_beyond_the_frame_are_cut_off_and_said():
    result = pipeline(num_peaks=2).process(painted(*TWO_LINES)[:100], 0)
    assert result.rows == (50, 100)
    assert 'cut off at 100' in result.status
    assert all(line.found for line in result.lines)


def test_views_and_fortran_order_are_read_right():
    frame = painted(*TWO_LINES)
    # As text: a row holds NaN, which equals nothing.
    expected = repr(pipeline(num_peaks=2).process(frame, 0).lines)
    wide = np.zeros((240, 640), np.uint8)
    wide[:, ::2] = frame
    assert repr(pipeline(num_peaks=2).process(wide[:, ::2], 0).lines) == expected
    assert repr(pipeline(num_peaks=2).process(np.asfortranarray(frame), 0).lines) == expected
    colour = np.dstack([frame * 0, frame * 0, frame])
    assert repr(pipeline(num_peaks=2).process(colour[:, :, ::1], 0).lines) == expected
    mirrored = np.ascontiguousarray(colour[:, ::-1])[:, ::-1]
    assert repr(pipeline(num_peaks=2).process(mirrored, 0).lines) == expected


LEFT, FAR = painted((100, 0, 100, 239)), painted((250, 0, 250, 239))


def flags(result):
    return [line.flags for line in result.lines]


def test_a_jump_is_flagged_and_keeps_both_old_values_beside_the_raw_ones():
    tested = pipeline(num_peaks=1)
    for _ in range(2):
        old = tested.process(LEFT, 0).lines[0]
    line = tested.process(FAR, 0).lines[0]
    assert line.flags == LineFlag.RHO_ERROR | LineFlag.CORRECTED == 5
    assert line.corrected and line.found
    assert (line.rho, line.theta, line.x, line.y2) == (old.rho, old.theta, old.x, old.y2)
    assert line.rho_raw == pytest.approx(250, abs=3)
    assert line.votes >= 15


def test_theta_and_combined_flags_as_bits():
    assert RunwayLine(theta_flag=True).flags == 6
    assert RunwayLine(rho_flag=True, theta_flag=True).flags == 7
    assert RunwayLine().flags == 0


def test_reset_starts_the_lines_again():
    tested = pipeline(num_peaks=1)
    for _ in range(3):
        tested.process(LEFT, 0)
    tested.reset()
    assert flags(tested.process(FAR, 0)) == [0]
    # Two of FAR: the warm-up is over.
    tested.process(FAR, 0)
    assert flags(tested.process(LEFT, 0)) == [5]


def test_another_frame_size_starts_the_lines_again():
    tested = pipeline(num_peaks=1)
    for _ in range(3):
        tested.process(LEFT, 0)
    assert flags(tested.process(FAR[:200], 0)) == [0]
    # An empty frame in between says nothing about the size.
    for _ in range(2):
        tested.process(FAR[:200], 0)
    tested.process(FAR[:0], 0)
    assert flags(tested.process(LEFT[:200], 0)) == [5]


@pytest.mark.parametrize(
    'change',
    [
        {'rho_resolution': 1.0},
        {'theta_resolution_deg': 0.5},
        {'start_row': 100, 'end_row': 200},
        {'num_peaks': 3},
        {'association': 'index'},
        {'channel': 'intensity'},
    ],
)
def test_known_lines_survive_a_change_of_parameters(change):
    tested = pipeline(num_peaks=1, rho_error_threshold=10.0)
    for _ in range(3):
        known = tested.process(LEFT, 0).lines[0]
    tested.configure(tested.parameters.changed(change))
    assert flags(tested.process(LEFT, 0))[0] == 0
    line = tested.process(FAR, 0).lines[0]
    assert line.rho_flag and line.rho == pytest.approx(known.rho, abs=4)
    tested.configure(tested.parameters.changed({'rho_error_threshold': 1_000.0}))
    assert flags(tested.process(FAR, 0))[0] == 0


def test_a_change_of_parameters_takes_effect_at_the_next_frame():
    tested = pipeline(num_peaks=1)
    frame = painted(*TWO_LINES)
    assert len(tested.process(frame, 0).lines) == 1
    tested.configure(RunwayDetectorParameters(num_peaks=5, peak_threshold=10, start_row=60))
    result = tested.process(frame, 0)
    assert len(result.lines) == 5 and result.rows == (60, 130)
    tested.configure(RunwayDetectorParameters(rho_resolution=1.0, theta_resolution_deg=3.0))
    grid = tested.process(frame, 0).workings.grid
    assert grid.rho[1] - grid.rho[0] == 1.0 and grid.theta.size == 60


def test_an_image_of_16_bit_colours_shows_what_the_same_array_does():
    """Its lower 8 bits, which a camera of 12 bits uses most, were cut off."""
    levels = np.repeat(np.array([900, 1000, 1100], np.uint16), 60)
    noise = np.random.default_rng(0).integers(0, 20, (120, 180), np.uint16)
    colour = cv2.merge([levels[None] + noise] * 3)
    array = RunwayDetector().process(colour, 0)
    image = RunwayDetector().process(Image(colour, 'bgr16'), 0)
    np.testing.assert_equal(image.lines, array.lines)
    assert array.lines[0].found
