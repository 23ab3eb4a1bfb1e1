"""Strips that one image shows, wherever their edges meet."""

import numpy as np
import pytest
from support.drawn_ground import drawn_strip

from mvuav_ros.vision.approach.search import LevelledImage, find_candidates
from mvuav_ros.vision.approach.sight import Sight


@pytest.mark.parametrize('gray', [False, True])
@pytest.mark.parametrize(('horizon', 'width'), [(-46.0, 28.0), (-46.0, 32.0), (-60.0, 30.0)])
def test_a_strip_that_meets_above_the_image_and_leaves_it_at_its_sides(horizon, width, gray):
    """As before a camera that looks down: little of the edges is in view."""
    image = drawn_strip(0, height=10.0, width=width, horizon=horizon)
    if gray:
        image = np.ascontiguousarray(image[:, :, 2])
    ranges = Sight.unknown(240, 0.0).ranges
    strips = [find_candidates(LevelledImage(image), r[1:]).strips for r in ranges]
    x, y, left, right, _, _ = np.concatenate(strips).T
    # In the highest row of the picture and in the row in which the edges leave it.
    rows = np.array([0.0, min(200.0, 140.0 * 10 / (0.5 * width) + horizon)])
    errors = [
        np.abs(x[:, None] + slope[:, None] * (rows - y[:, None]) - 160.0 - true * (rows - horizon))
        for slope, true in ((left, -0.05 * width), (right, 0.05 * width))
    ]
    assert np.max(errors, axis=(0, 2)).min() < 12.0
