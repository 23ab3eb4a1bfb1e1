"""Edges from the lines along a runway's sides, against what was drawn."""

import cv2
import numpy as np
import pytest

from mvuav_ros.vision.approach.attitude import Derotation
from mvuav_ros.vision.approach.side_lines import find_side_lines
from mvuav_ros.vision.approach.strip_edges import LevelledFrame
from mvuav_ros.vision.approach.strips import points_along

LEVEL = Derotation(320, 240, 1, 0.0)
X, Y, SLOPE, SPAN = 160.0, 60.0, 0.3, (10.0, 40.0)
LAND, PAVEMENT, RUBBER, LINE = 110, 112, 70, 170


def runway(*lines, rubber=RUBBER, fine=8):
    """Pavement hardly brighter than land, rubber in its middle, and lines along both sides.

    Args:
        lines: (inner, outer) side of a line, in half widths of the runway.
        rubber: grey level of the runway's middle.
        fine: by which everything is drawn larger.
    """
    rows = (np.arange(240 * fine)[:, None] + 0.5) / fine - 0.5
    columns = (np.arange(320 * fine) + 0.5) / fine - 0.5
    depth = rows - Y
    aside = np.abs(columns - X) / np.maximum(SLOPE * depth, 1e-3)
    image = np.full(aside.shape, LAND, np.float32)
    within = (depth > SPAN[0]) & (depth < SPAN[1])
    image[within & (aside < 1.0)] = PAVEMENT
    image[within & (aside < 0.45)] = rubber
    for inner, outer in lines:
        image[within & (aside > inner) & (aside < outer)] = LINE
    return cv2.resize(image, (320, 240), interpolation=cv2.INTER_AREA).astype(np.uint8)


def offsets(image, expected=1.0, slope=SLOPE):
    """How far outside the true edges the points lie on average, px; None without points."""
    strip = np.array([X, Y, -slope * expected, slope * expected, *SPAN])
    known = points_along(strip, np.zeros((2, 2)))
    found = find_side_lines(LevelledFrame(image, LEVEL), strip, known)
    if found is None:
        return None
    left, right = found
    return (
        float((X - SLOPE * (left.rows - Y) - left.columns).mean()),
        float((right.columns - X - SLOPE * (right.rows - Y)).mean()),
    )


@pytest.mark.parametrize('expected', [0.75, 0.9, 1.0, 1.15])
def test_the_edge_is_where_the_line_ends_wherever_it_was_expected(expected):
    assert offsets(runway((0.7, 1.0)), expected) == pytest.approx((0, 0), abs=0.5)


@pytest.mark.parametrize('inner', [0.85, 0.9, 0.94])
def test_points_of_thin_lines_say_how_far_outside_they_lie(inner):
    """That is where the line is thinnest, at the far end."""
    strip = np.array([X, Y, -SLOPE, SLOPE, *SPAN])
    image = cv2.convertScaleAbs(runway((inner, 1.0)), alpha=1.2)
    sides = find_side_lines(LevelledFrame(image, LEVEL), strip)
    for side, sign in zip(sides, (-1.0, 1.0), strict=True):
        away = sign * (side.columns - X) - SLOPE * (side.rows - Y)
        line = np.polyfit(side.rows, away, 1, w=np.sqrt(side.weights))
        found = np.polyval(line, side.rows[0])
        assert found > 0.7
        assert found - side.outside[0] == pytest.approx(0, abs=0.35)
        assert 0.0 <= side.outside[1] < side.outside[0]


def test_points_of_lines_that_leave_the_frame_say_how_far_outside_those_in_view_lie():
    """A camera that looks down: the far half of the strip is above the picture."""
    above = 85
    image = cv2.convertScaleAbs(runway((0.9, 1.0)), alpha=1.2)[above:]
    strip = np.array([X, Y - above, -SLOPE, SLOPE, *SPAN])
    sides = find_side_lines(LevelledFrame(image, Derotation(320, 240 - above, 1, 0.0)), strip)
    for side, sign in zip(sides, (-1.0, 1.0), strict=True):
        seen = side.weights > 0
        assert 0 < np.count_nonzero(side.rows < 0) < side.rows.size
        away = sign * (side.columns - X) - SLOPE * (side.rows - Y + above)
        line = np.polyfit(side.rows[seen], away[seen], 1)
        ends = np.polyval(line, side.rows[seen][[0, -1]])
        assert ends - side.outside == pytest.approx(0, abs=0.6)


@pytest.mark.parametrize('expected', [1.0, 1.15])
def test_of_two_lines_the_outer_one_is_the_shoulders(expected):
    image = runway((0.8, 1.0), (1.3, 1.5))
    assert offsets(image, expected) == pytest.approx((0, 0), abs=0.6)


def test_grey_and_colour_are_the_same():
    gray = runway((0.7, 1.0))
    colour = cv2.cvtColor(gray, cv2.COLOR_GRAY2BGR)
    assert offsets(colour) == pytest.approx(offsets(gray), abs=0.1)


def test_without_lines_there_is_no_answer():
    assert offsets(runway(rubber=PAVEMENT)) is None
    noise = np.random.default_rng(1).integers(90, 130, (240, 320)).astype(np.uint8)
    assert offsets(noise) is None


def test_a_wide_runway_is_measured_by_its_pavement():
    assert offsets(runway((0.7, 1.0)), slope=1.2) is None


@pytest.mark.parametrize('seed', [3, 8, 12, 23])
def test_patches_of_land_along_both_sides_are_no_lines(seed):
    """Among so many straight lines one goes through enough bright patches to stand out."""
    land = np.random.default_rng(seed).normal(0.0, 1.0, (240, 320))
    land = cv2.GaussianBlur(land, (0, 0), 2.0)
    image = np.clip(100.0 + 40.0 * land / land.std(), 0, 255).astype(np.uint8)
    assert offsets(image, slope=0.6) is None


@pytest.mark.parametrize(('beyond', 'seen'), [(130, True), (155, False)])
def test_a_joint_between_slabs_is_not_as_dark_as_the_land_on_the_other_side(beyond, seen):
    image = runway((0.7, 1.0))
    right = image[:, int(X) :]
    right[right == LAND] = beyond
    assert (offsets(image) is not None) is seen
