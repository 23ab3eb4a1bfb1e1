"""Pavement beyond a runway's edges, against what was drawn."""

import cv2
import numpy as np
import pytest

from mvuav_ros.vision.approach.attitude import Derotation
from mvuav_ros.vision.approach.strip_edges import LevelledFrame, shows_shoulders

LEVEL = Derotation(320, 240, 1, 0.0)
X, Y, SLOPE, SPAN = 160.0, 60.0, 0.4, (10.0, 120.0)
STRIP = np.array([X, Y, -SLOPE, SLOPE, *SPAN])
LAND, PAVEMENT, LINE = 150, 180, 230


def runway(left=1.0, right=1.0, land=LAND, shift=0.0, line=LINE):
    """Pavement with side lines, which goes on to so many half widths on either side."""
    fine = 4
    rows = (np.arange(240 * fine)[:, None] + 0.5) / fine - 0.5
    columns = (np.arange(320 * fine) + 0.5) / fine - 0.5
    depth = rows - Y
    aside = (columns - X - shift) / np.maximum(SLOPE * depth, 1e-3)
    image = np.full(aside.shape, land, np.float32)
    within = (depth > SPAN[0]) & (depth < SPAN[1])
    image[within & (aside > -left) & (aside < right)] = PAVEMENT
    image[within & (np.abs(aside) > 0.94) & (np.abs(aside) < 1.0)] = line
    return cv2.resize(image, (320, 240), interpolation=cv2.INTER_AREA).astype(np.uint8)


def shoulders(image, strip=STRIP):
    return shows_shoulders(LevelledFrame(image, LEVEL), strip)


@pytest.mark.parametrize('land', [LAND, 200])
def test_shoulders_on_both_sides_are_seen_by_day_and_in_grey(land):
    image = runway(1.2, 1.3, land)
    assert shoulders(image)
    assert shoulders(cv2.merge([image] * 3))
    assert shoulders(image.astype(np.uint16) * 256)


def test_shoulders_are_seen_however_short_the_exposure_was():
    dark = cv2.convertScaleAbs(runway(1.2, 1.3), alpha=0.25)
    assert shoulders(dark)


@pytest.mark.parametrize('sides', [(1.0, 1.0), (1.2, 1.0), (1.0, 1.2)])
def test_none_where_land_begins_at_an_edge(sides):
    assert shoulders(runway(*sides)) is False


def test_noise_is_no_shoulder():
    noise = np.random.default_rng(1).normal(0, 6, (240, 320))
    image = np.clip(runway() + noise, 0, 255).astype(np.uint8)
    assert shoulders(image) is False


def test_nothing_is_known_where_the_frame_ends_beside_the_runway():
    aside = STRIP + np.array([140.0, 0, 0, 0, 0, 0])
    assert shoulders(runway(1.2, 1.2, shift=140.0), aside) is None


def test_beside_an_edge_that_is_plain_to_see_a_faint_step_is_none():
    """Here land whose brightness changes by 7 grey levels beside a step of 80 and more."""
    assert shoulders(runway(1.2, 1.2, land=PAVEMENT - 7, line=90)) is False
    assert shoulders(runway(1.2, 1.2, land=PAVEMENT - 30, line=90))


def test_a_step_within_the_tolerance_is_none():
    assert shoulders(runway(1.06, 1.06)) is False
