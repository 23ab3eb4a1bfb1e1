"""Levelling, strips and edges, each against what was drawn."""

import math

import cv2
import numpy as np
import pytest

from mvuav_ros.vision.approach.attitude import Derotation, line_through, turn_edge
from mvuav_ros.vision.approach.evidence import row_sums, shrink_levels
from mvuav_ros.vision.approach.road import (
    EdgeProfile,
    features_of,
    find_edges,
    score_strips,
)
from mvuav_ros.vision.approach.strip_edges import LevelledFrame

SHAPE = np.array([158.0, 70.0, -0.45, 0.35])
FAR, NEAR = 8.0, 90.0
LOOK = EdgeProfile()
CONTRAST = np.array([15.0, -60.0])


def strip(shape=SHAPE, far=FAR, near=NEAR, size=(320, 240), factor=1) -> np.ndarray:
    """A grey strip on green land, each pixel the mean of 16 points."""
    x, y, left, right = shape
    fine = 4 * factor
    rows = (np.arange(size[1] * fine)[:, None] + 0.5) / fine - 0.5
    columns = (np.arange(size[0] * fine) + 0.5) / fine - 0.5
    depth = rows - y
    within = (columns > x + left * depth) & (columns < x + right * depth)
    within &= (depth > far) & (depth < near)
    share = within.reshape(size[1] * factor, 4, size[0] * factor, 4).mean(axis=(1, 3))[:, :, None]
    image = (1 - share) * (60, 130, 110) + share * (150, 150, 150)
    return cv2.GaussianBlur(np.rint(image).astype(np.uint8), (0, 0), 0.8)


def test_a_level_point_comes_back_from_the_frame():
    level = Derotation(320, 240, 2, math.radians(12))
    x, y = level.to_frame(100.0, 90.0)
    # By hand: turned by 12 degrees about (159.5, 119.5), then two frame px for one.
    dx, dy = -59.5, -29.5
    cos, sin = math.cos(math.radians(12)), math.sin(math.radians(12))
    assert x == pytest.approx(2 * (159.5 + cos * dx - sin * dy + 0.5) - 0.5)
    assert y == pytest.approx(2 * (119.5 + sin * dx + cos * dy + 0.5) - 0.5)


def test_levelled_pixels_lie_where_the_points_do():
    image = np.zeros((240, 320, 3), np.uint8)
    level = Derotation(320, 240, 1, math.radians(9))
    x, y = level.to_frame(200.0, 150.0)
    cv2.circle(image, (round(x), round(y)), 3, (255, 255, 255), -1)
    turned = level.turned(image, (0, 100, 320, 240))[:, :, 0].astype(float)
    rows, columns = np.mgrid[100:240, :320]
    assert (turned * columns).sum() / turned.sum() == pytest.approx(200, abs=0.6)
    assert (turned * rows).sum() / turned.sum() == pytest.approx(150, abs=0.6)


def test_an_edge_stays_on_the_ground_when_the_level_turns():
    old, new = Derotation(320, 240, 1, 0.05), Derotation(320, 240, 1, -0.12)
    p, slope = turn_edge(140.0, -0.4, 180.0, old, new)
    before = line_through(*old.to_frame(140.0, 180.0), *old.to_frame(139.6, 181.0))
    after = line_through(*new.to_frame(p, 180.0), *new.to_frame(p + slope, 181.0))
    after = after.facing(before.theta)
    assert after.rho == pytest.approx(before.rho, abs=1e-6)
    assert after.theta == pytest.approx(before.theta, abs=1e-9)


@pytest.mark.parametrize('channels', [1, 3])
@pytest.mark.parametrize(('dtype', 'level'), [(np.uint8, 77), (np.uint16, 230)])
def test_frames_of_every_format_become_256_grey_levels(channels, dtype, level):
    """The brightest of 16 bits are raised: cameras of 10 to 14 bits use the lower part."""
    image = np.full((480, 640, channels), 77 if dtype == np.uint8 else 9000, dtype).squeeze()
    pixels, factor = shrink_levels(image)
    assert pixels.shape[:2] == (240, 320)
    assert factor == 2
    assert np.allclose(pixels, level, atol=0.5)


def test_the_true_shape_scores_and_others_do_not():
    table = row_sums(features_of(strip()))
    shapes = np.array(
        [SHAPE, SHAPE + np.array((60, 0, 0, 0)), SHAPE * (1, 1, 2.5, 2.5), SHAPE * (1, 1, 0.3, 0.3)]
    )
    scores = score_strips(table, shapes, LOOK)
    assert scores.score[0] > 4
    assert scores.score[0] > 3 * scores.score[1:].max()
    assert scores.far[0] == pytest.approx(FAR, abs=2)
    assert scores.near[0] == pytest.approx(NEAR, abs=2)
    assert not scores.open_end[0]
    # Grey on green: brighter, less colourful.
    assert scores.contrast[0, 0] > 10
    assert scores.contrast[0, 1] < -30


def test_no_strip_no_score():
    even = np.full((240, 320, 3), (60, 130, 110), np.uint8)
    scores = score_strips(row_sums(features_of(even)), SHAPE[None], LOOK)
    assert scores.score[0] == 0


@pytest.mark.parametrize('factor', [1, 2])
def test_edges_are_found_to_a_fraction_of_a_pixel_from_two_pixels_away(factor):
    image = strip(factor=factor)
    level = Derotation(320, 240, factor, 0.0)
    guess = SHAPE + np.array((1.5, 0, 0.01, -0.015))
    guess = np.array([*guess, FAR + 2, NEAR - 2])
    left, right = find_edges(LevelledFrame(image, level), guess, CONTRAST, LOOK.brightness)
    for points, slope in ((left, SHAPE[2]), (right, SHAPE[3])):
        used = points.weights > 0
        assert used.mean() > 0.9
        truth = SHAPE[0] + slope * (points.rows - SHAPE[1])
        assert np.abs(points.columns - truth)[used].mean() < 0.3
        assert points.support > 0.3


def test_an_even_image_supports_no_edge():
    even = np.full((240, 320, 3), (60, 130, 110), np.uint8)
    frame = LevelledFrame(even, Derotation(320, 240, 1, 0.0))
    expected = np.array([*SHAPE, FAR, NEAR])
    for points in find_edges(frame, expected, CONTRAST, LOOK.brightness):
        # But for the rounding of a smoothed image.
        assert points.support < 1e-6
        assert (points.weights == 0).all()
