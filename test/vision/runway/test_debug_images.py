"""The debug images: what they show, not how."""

import math

import numpy as np
import pytest

from mvuav_ros.parameters.runway_detector import RunwayDetectorParameters
from mvuav_ros.vision.runway.debug_images import (
    AMBER,
    GREEN,
    MAGENTA,
    RED,
    draw_confined,
    draw_edges,
    draw_hough,
    draw_overlay,
    line_color,
)
from mvuav_ros.vision.runway.detector import RunwayDetector
from mvuav_ros.vision.runway.results import LineFlag

ALL = [draw_confined, draw_edges, draw_overlay, draw_hough]


def step_at(x, dtype=np.uint8, channels=3):
    """A frame, dark to the left of x and bright to the right."""
    frame = np.full((240, 320, channels), 40, dtype)
    frame[:, x:] = 180
    return frame if channels == 3 else frame[:, :, 0]


def results(*frames, **parameters):
    pipeline = RunwayDetector(RunwayDetectorParameters(**{'num_peaks': 1, **parameters}))
    return [pipeline.process(frame, 0) for frame in frames]


def column_of(image, color):
    """Mean column and number of rows with pixels close to the colour, at rows without numbers."""
    close = np.abs(image[20:180].astype(int) - color).max(axis=2) < 40
    rows, columns = np.nonzero(close)
    return columns.mean(), np.unique(rows).size


def test_the_overlay_shows_a_believed_line_solid_green_on_the_whole_frame():
    image = draw_overlay(results(step_at(100))[0])
    assert image.shape == (240, 320, 3)
    column, rows = column_of(image, GREEN)
    assert column == pytest.approx(99.5, abs=2) and rows == 160


@pytest.mark.parametrize('draw', ALL)
def test_a_frame_that_was_turned_by_a_quarter_is_drawn_as_its_copy(draw):
    turned = np.rot90(step_at(100))
    seen, copied = results(turned, np.ascontiguousarray(turned))
    np.testing.assert_array_equal(draw(seen), draw(copied))


def test_a_held_line_is_dashed_where_it_was_and_thin_where_it_was_measured():
    last = results(step_at(100), step_at(100), step_at(250))[-1]
    assert last.lines[0].flags == 5
    image = draw_overlay(last)
    _, rows = column_of(image[:, :180], AMBER)
    assert 40 < rows < 130
    column, rows = column_of(image[:, 180:], AMBER)
    assert column + 180 == pytest.approx(250, abs=2) and rows == 160


def test_flags_have_their_colours():
    rho, theta, corrected = LineFlag.RHO_ERROR, LineFlag.THETA_ERROR, LineFlag.CORRECTED
    assert line_color(LineFlag(0)) == GREEN
    assert line_color(rho | corrected) == AMBER
    assert line_color(theta | corrected) == MAGENTA
    assert line_color(rho | theta | corrected) == RED


def test_the_confined_image_is_the_channel_in_its_rows():
    frame = step_at(100)
    frame[:, :, 0] = 7
    image = draw_confined(results(frame)[0])
    np.testing.assert_array_equal(image, frame[50:130, :, 2])


def test_the_edges_image_is_white_at_edges():
    image = draw_edges(results(step_at(100))[0])
    expected = np.zeros((80, 320), np.uint8)
    expected[:, 99:101] = 255
    np.testing.assert_array_equal(image, expected)


def marks(image):
    """Centre of the green pixels inside the axes, which only peaks' marks have."""
    green = np.abs(image.astype(int) - (120, 255, 80)).max(axis=2) < 30
    rows, columns = np.nonzero(green)
    return columns.mean(), rows.size


def test_the_hough_image_marks_the_peak_at_its_theta_and_has_one_size():
    vertical = draw_hough(results(step_at(100))[0])
    diagonal = np.zeros((240, 320), np.uint8)
    diagonal[np.add.outer(np.arange(240), np.arange(320)) > 250] = 200
    diagonal = draw_hough(results(diagonal, rho_resolution=0.5, theta_resolution_deg=0.2)[0])
    assert vertical.shape == diagonal.shape
    left, count = marks(vertical)
    right, _ = marks(diagonal)
    assert count > 50
    # 540 px are 180 degrees.
    assert (right - left) / 3 == pytest.approx(45, abs=3)


def test_the_ticks_of_the_hough_image_are_where_the_cells_are():
    """With cells so coarse that half of one is seen: a line at 0° is above the tick of 0°."""
    image = draw_hough(results(step_at(100), theta_resolution_deg=10.0, rho_resolution=10.0)[0])
    area = image[24:424, 52:592].astype(int)
    rows, columns = np.nonzero(np.abs(area - (120, 255, 80)).max(axis=2) < 8)
    # Without the number, which stands apart above the box.
    box = columns[rows == rows.max()]
    below = image[426, 52:].min(axis=1) > 150
    ticks = np.flatnonzero(below)
    assert ticks.size == 4
    assert (box.min() + box.max()) / 2 == pytest.approx(ticks[2], abs=2)


def test_the_hough_image_is_readable_without_the_peaks_alone():
    """The sinusoids around the peak must be visible, not only the peak."""
    image = draw_hough(results(step_at(100))[0])
    assert np.count_nonzero(image.max(axis=2) > 60) > 2000


FRAMES = {
    'none': np.zeros((0, 0), np.uint8),
    'no columns': np.zeros((5, 0, 3), np.uint8),
    'one pixel': np.full((1, 1), 255, np.uint8),
    'one row': np.arange(9, dtype=np.uint8).reshape(1, 9),
    'too low': np.zeros((40, 30, 3), np.uint8),
    'black': np.zeros((240, 320, 3), np.uint8),
    'gray': step_at(100, channels=1),
    'sixteen bits': step_at(100, np.uint16) * 257,
    'sixteen bits gray': step_at(100, np.uint16, 1) * 257,
    'large': np.zeros((720, 1280, 3), np.uint8),
}


@pytest.mark.parametrize('parameters', [{}, {'start_row': 0, 'end_row': 0}])
@pytest.mark.parametrize('draw', ALL)
@pytest.mark.parametrize('name', FRAMES)
def test_every_frame_has_every_image(name, draw, parameters):
    frame = FRAMES[name]
    before = frame.copy()
    image = draw(results(frame, **parameters)[0])
    assert image.dtype == np.uint8 and image.flags.c_contiguous and image.size > 0
    if draw is draw_overlay:
        assert image.shape == (max(1, frame.shape[0]), max(1, frame.shape[1]), 3)
    np.testing.assert_array_equal(frame, before)


def test_sixteen_bits_show_their_upper_eight():
    image = draw_confined(results(step_at(100, np.uint16, 1) * 257)[0])
    assert set(np.unique(image)) == {40, 180}


def test_the_overlay_draws_many_lines_near_each_other():
    frame = np.random.default_rng(0).integers(0, 255, (480, 640, 3), dtype=np.uint8)
    result = results(frame, num_peaks=20, start_row=0, end_row=0, peak_threshold=1)[0]
    assert sum(not math.isnan(line.x) for line in result.lines) > 10
    assert np.count_nonzero(draw_overlay(result) != frame) > 1000
