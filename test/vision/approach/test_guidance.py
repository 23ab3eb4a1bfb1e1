"""Where the camera is, from edges whose places are known."""

import math

import numpy as np
import pytest

from mvuav_ros.vision.approach.approach_results import UNKNOWN_VARIANCE
from mvuav_ros.vision.approach.attitude import Derotation
from mvuav_ros.vision.approach.guidance import EdgeFit, locate
from mvuav_ros.vision.camera import CameraModel

CAMERA = CameraModel(640, 480, (600.0, 0.0, 320.0, 0.0, 600.0, 240.0, 0.0, 0.0, 1.0))


def edge(aside):
    """On a level image, of a line so many heights to the right of the camera, straight ahead."""
    rows = np.array((250.0, 400.0))
    return EdgeFit(320.0 + aside * (rows - 240.0), rows, 0.01 * np.eye(2))


@pytest.mark.parametrize(
    ('near_row', 'x'), [(None, math.nan), (400.0, -10.0 * 600 / 160), (230.0, math.nan)]
)
def test_what_is_not_observed_has_no_variance_of_what_is(near_row, x):
    """A near end above the horizon is none: a wrong attitude shows it there."""
    level = Derotation(640, 480, 1, 0.0)
    guidance = locate(edge(-1.0), edge(2.0), near_row, level, 0.001, CAMERA, 30.0)
    assert (guidance.y, guidance.z) == pytest.approx((5.0, 10.0))
    assert guidance.x == pytest.approx(x, nan_ok=True)
    assert (guidance.covariance[0, 0] == UNKNOWN_VARIANCE) == math.isnan(x)
    assert not guidance.covariance[0, 1:].any() or not math.isnan(x)
