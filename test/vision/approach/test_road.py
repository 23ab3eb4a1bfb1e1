"""Levelling, strips and edges, each against what was drawn."""

import math

import cv2
import numpy as np
import pytest

from mvuav_ros.vision.approach.attitude import Derotation, line_through, turn_edge
from mvuav_ros.vision.approach.evidence import GreyLevels, shrink_levels
from mvuav_ros.vision.approach.ground_motion import Registration
from mvuav_ros.vision.approach.road import TARGETS, RoadTrack, find_strips
from mvuav_ros.vision.approach.search import LevelledImage
from mvuav_ros.vision.approach.sight import Sight
from mvuav_ros.vision.approach.strip_edges import LevelledFrame
from mvuav_ros.vision.approach.track import View

SHAPE = np.array([158.0, 70.0, -0.45, 0.35])
FAR = 8.0
PIPELINE = TARGETS['pipeline']


def strip(shape=SHAPE, far=FAR, size=(320, 240), factor=1) -> np.ndarray:
    """A grey strip on green land down to the lower end, each pixel the mean of 16 points."""
    x, y, left, right = shape
    fine = 4 * factor
    rows = (np.arange(size[1] * fine)[:, None] + 0.5) / fine - 0.5
    columns = (np.arange(size[0] * fine) + 0.5) / fine - 0.5
    depth = rows - y
    within = (columns > x + left * depth) & (columns < x + right * depth)
    within &= depth > far
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
@pytest.mark.parametrize(('value', 'level'), [(77, 77), (9000, 140), (900, 225), (65_535, 255)])
def test_frames_of_every_format_become_256_grey_levels(channels, value, level):
    """Cameras of 10 to 14 bits use the lower part of 16."""
    dtype = np.uint8 if value < 256 else np.uint16
    image = GreyLevels().levels(np.full((480, 640, channels), value, dtype).squeeze())
    pixels, factor = shrink_levels(image)
    assert pixels.shape[:2] == (240, 320)
    assert factor == 2
    assert pixels.dtype == np.uint8 and np.allclose(pixels, level, atol=0.5)


def test_a_dark_frame_is_not_raised_once_the_camera_is_known():
    depth = GreyLevels()
    assert depth.levels(np.full((4, 4), 4000, np.uint16)).max() == 250
    assert depth.levels(np.full((4, 4), 300, np.uint16)).max() == 18


def test_a_damaged_pixel_does_not_darken_all_frames_after_it():
    depth, whole = GreyLevels(), np.full((4, 4), 4000, np.uint16)
    depth.levels(whole)
    damaged = whole.copy()
    damaged[0, 0] = 65_535
    shown = depth.levels(damaged)
    assert (shown[0, 0], shown.min()) == (255, 250)
    assert depth.levels(whole).max() == 250
    sun = [depth.levels(damaged) for _ in range(2)][1]
    assert (sun.min(), depth.levels(whole).max()) == (15, 15)


def lane(left=1.0, right=1.0, dashed=False, middle=False) -> np.ndarray:
    """A lane between painted lines of so much contrast, and a line in the middle of it."""
    rows, columns = np.mgrid[:240, :320].astype(float)
    depth = rows - 90.0
    image = np.full((240, 320), 90.0)
    for slope, contrast in ((-1.3, left), (1.3, right), (-0.15, float(middle))):
        line = (np.abs(columns - 160.0 - slope * depth) < 0.02 * depth + 0.7) & (depth > 4)
        if dashed and slope < 0:
            line &= np.sin(600.0 / np.maximum(depth, 1.0)) > 0.3
        image[line] += 110.0 * contrast
    return cv2.GaussianBlur(np.rint(image).astype(np.uint8), (0, 0), 0.7)


def followed(image, shape, target, frames=6, factor=1) -> RoadTrack:
    """A track of a strip, after it was seen for some frames."""
    size = image.shape[1] // factor, image.shape[0] // factor
    level = Derotation(*size, factor, 0.0)
    pixels, _ = shrink_levels(image)
    registration = Registration()
    track = RoadTrack(target, np.array([*shape, FAR, size[1] - 1 - shape[1]]))
    for _ in range(frames):
        registration.take(pixels)
        frame = LevelledFrame(image, level)
        track.step(View(frame, LevelledImage(pixels, level), Sight(None, []), registration))
    return track


def test_lines_that_meet_are_found():
    assert_near(find_strips(strip(), PIPELINE, 70.0), SHAPE[2:])
    assert_near(find_strips(lane(), TARGETS['road'], None), (-1.3, 1.3))


def assert_near(found, slopes):
    assert np.abs(found[:, 2:4] - slopes).max(axis=1).min() < 0.05


def test_lines_that_meet_elsewhere_are_no_pipeline():
    assert not np.any(np.abs(find_strips(strip(), PIPELINE, 110.0)[:, 2:4] - SHAPE[2:]) < 0.05)


def test_the_true_shape_scores_and_others_do_not():
    image = strip()
    track = followed(image, SHAPE, PIPELINE)
    assert track.quality > 3
    assert track.far == pytest.approx(FAR, abs=3)
    assert track.strip()[1] + track.near == pytest.approx(239, abs=3)
    assert not track.ends_in_view(Derotation(320, 240, 1, 0.0))[1]
    others = SHAPE + np.array((60, 0, 0, 0)), SHAPE * (1, 1, 2.5, 2.5), SHAPE * (1, 1, 0.3, 0.3)
    for shape in others:
        assert followed(image, shape, PIPELINE).quality < 0.3 * track.quality


def test_no_strip_no_score():
    even = np.full((240, 320, 3), (60, 130, 110), np.uint8)
    track = followed(even, SHAPE, PIPELINE)
    assert track.quality == 0
    assert track.points is None


@pytest.mark.parametrize('factor', [1, 2])
def test_edges_are_found_to_a_fraction_of_a_pixel_from_two_pixels_away(factor):
    guess = SHAPE + np.array((1.5, 0, 0.01, -0.015))
    track = followed(strip(factor=factor), guess, PIPELINE, factor=factor)
    assert track.points is not None
    for points, slope in zip(track.points, SHAPE[2:], strict=True):
        used = points.weights > 0
        # The lower part of the left edge is outside of the image.
        assert used.mean() > 0.7
        truth = SHAPE[0] + slope * (points.rows - SHAPE[1])
        assert np.abs(points.columns - truth)[used].mean() < 0.3
        assert points.support > 0.3


@pytest.mark.parametrize('lines', [{}, {'dashed': True}, {'left': 0.3}])
def test_a_lane_may_have_a_dashed_or_a_faint_line(lines):
    track = followed(lane(**lines), (160.0, 90.0, -1.3, 1.3), TARGETS['road'], 12)
    assert track.quality > TARGETS['road'].start_score
    assert track.showable


def test_one_line_is_no_lane():
    track = followed(lane(left=0.0), (160.0, 90.0, -1.3, 1.3), TARGETS['road'], 12)
    assert track.quality < TARGETS['road'].keep_score


def test_a_line_in_the_middle_divides_a_road_into_lanes():
    image = lane(middle=True)
    road = followed(image, (160.0, 90.0, -1.3, 1.3), TARGETS['road'])
    half = followed(image, (160.0, 90.0, -0.15, 1.3), TARGETS['road'])
    assert half.rank > road.rank + 0.1
