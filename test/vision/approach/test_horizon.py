"""The horizon on drawn images."""

import math

import numpy as np
import pytest

from mvuav_ros.vision.approach.horizon import HorizonFinder

HEIGHT, WIDTH = 240, 320


def view(row: float, slope_deg: float, *, treetops: bool = False) -> np.ndarray:
    """Blue of bright sky over land; with treetops the sky is as restless as leaves before it."""
    rng = np.random.default_rng(1)
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    below = y - row - np.tan(np.radians(slope_deg)) * (x - 0.5 * (WIDTH - 1))
    land = np.clip(below + 0.5, 0, 1)
    sky = np.array(235.0)
    if treetops:
        sky = rng.choice((30.0, 230.0), (HEIGHT // 8, WIDTH // 8))
        sky = np.repeat(np.repeat(sky, 8, 0), 8, 1)
    image = (1 - land) * sky + land * 50.0
    return np.clip(image + rng.normal(0, 4, image.shape), 0, 255).astype(np.uint8)


@pytest.mark.parametrize('slope', [-60.0, -31.0, -7.3, 0.0, 2.2, 18.0, 45.0])
@pytest.mark.parametrize('row', [95.0, 131.4])
def test_the_horizon_is_found_at_any_bank(row, slope):
    horizon = HorizonFinder(HEIGHT, WIDTH).find(view(row, slope))
    assert horizon.trusted
    assert math.degrees(horizon.slope) == pytest.approx(slope, abs=0.3)
    assert horizon.row == pytest.approx(row, abs=1.5)


def test_small_slopes_are_measured_closely():
    finder = HorizonFinder(HEIGHT, WIDTH)
    for slope in (-1.3, -0.4, 0.0, 0.7, 1.9):
        horizon = finder.find(view(100.3, slope))
        assert math.degrees(horizon.slope) == pytest.approx(slope, abs=0.15)
        assert horizon.row == pytest.approx(100.3, abs=0.6)


def test_a_horizon_that_moves_a_little_is_followed_and_one_that_jumps_is_found_again():
    finder = HorizonFinder(HEIGHT, WIDTH)
    last = finder.find(view(100, 0))
    near = finder.find(view(102, 1), last)
    assert near.row == pytest.approx(102, abs=0.7)
    far = finder.find(view(150, 30), near)
    assert far.row == pytest.approx(150, abs=1.5)
    assert math.degrees(far.slope) == pytest.approx(30, abs=0.3)


def test_treetops_and_an_even_image_are_not_trusted():
    finder = HorizonFinder(HEIGHT, WIDTH)
    assert not finder.find(view(110, 0, treetops=True)).trusted
    assert not finder.find(np.full((HEIGHT, WIDTH), 90, np.uint8)).trusted
