"""Where the camera is, from edges whose places are known."""

import math
from dataclasses import replace

import numpy as np
import pytest

from mvuav_ros.vision.approach.approach_results import UNKNOWN_VARIANCE
from mvuav_ros.vision.approach.attitude import Derotation, horizon_from, mount_matrix
from mvuav_ros.vision.approach.guidance import locate
from mvuav_ros.vision.approach.strip_edges import EdgePoints
from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.frames import OPTICAL_FROM_BODY, Attitude, from_rpy, quaternion

CAMERA = CameraModel(640, 480, (600.0, 0.0, 320.0, 0.0, 600.0, 240.0, 0.0, 0.0, 1.0))


def edge(aside):
    """On a level image, of a line so many heights to the right of the camera, straight ahead."""
    rows = np.linspace(250.0, 400.0, 8)
    return EdgePoints(rows, 320.0 + aside * (rows - 240.0), np.ones(8), 1.0)


@pytest.mark.parametrize(
    ('near_row', 'x'), [(None, math.nan), (400.0, -10.0 * 600 / 160), (230.0, math.nan)]
)
def test_what_is_not_observed_has_no_variance_of_what_is(near_row, x):
    """A near end above the horizon is none: a wrong attitude shows it there."""
    level = Derotation(640, 480, 1, 0.0)
    guidance = locate((edge(-1.0), edge(2.0)), near_row, level, 0.001, CAMERA, 30.0)
    assert (guidance.y, guidance.z) == pytest.approx((5.0, 10.0))
    assert guidance.x == pytest.approx(x, nan_ok=True)
    assert (guidance.covariance[0, 0] == UNKNOWN_VARIANCE) == math.isnan(x)
    assert not guidance.covariance[0, 1:].any() or not math.isnan(x)


def test_edges_that_are_no_more_than_predicted_make_the_pose_as_uncertain_as_they_are():
    """Their points lie on straight lines: scatter says nothing of where these are."""
    level = Derotation(640, 480, 1, 0.0)
    doubts = np.array([(2.0, 8.0), (3.0, 5.0)])
    edges = [
        replace(edge(aside), doubt=tuple(doubt))
        for aside, doubt in zip((-1, 2), doubts, strict=True)
    ]
    covariance = locate(edges, None, level, 1e-6, CAMERA, 30.0).covariance
    rng, poses, along = np.random.default_rng(1), [], np.linspace(0.0, 1.0, 8)
    for _ in range(1000):
        moved = []
        for (far, near), points in zip(doubts * rng.normal(size=(2, 2)), edges, strict=True):
            columns = points.columns + far * (1 - along) + near * along
            moved.append(replace(points, columns=columns))
        poses.append(locate(moved, None, level, 1e-6, CAMERA, 30.0))
    for index, name in ((1, 'y'), (2, 'z'), (4, 'pitch'), (5, 'yaw')):
        scatter = np.std([getattr(pose, name) for pose in poses])
        assert math.sqrt(covariance[index, index]) == pytest.approx(scatter, rel=0.2)


def test_points_outside_of_the_edges_do_not_move_the_pose():
    """By how much they are is known only about, and that counts in the covariance."""
    level = Derotation(640, 480, 1, 0.0)
    true = locate((edge(-1.0), edge(2.0)), None, level, 1e-6, CAMERA, 30.0)
    along, outside = np.linspace(0.0, 1.0, 8), (2.0, 0.5)
    moved = [
        replace(
            edge(aside),
            columns=edge(aside).columns + sign * (outside[0] * (1 - along) + outside[1] * along),
            outside=outside,
        )
        for aside, sign in ((-1.0, -1.0), (2.0, 1.0))
    ]
    found = locate(moved, None, level, 1e-6, CAMERA, 30.0)
    assert (found.y, found.z, found.pitch) == pytest.approx((true.y, true.z, true.pitch))
    assert found.covariance[2, 2] > 1.5 * true.covariance[2, 2]


@pytest.mark.parametrize(
    ('model', 'd'),
    [
        ('', ()),
        ('plumb_bob', (-0.25, 0.06, 0, 0)),
        ('plumb_bob', (0, 0, 0.004, -0.003)),
        ('equidistant', (0, 0, 0, 0)),
    ],
)
@pytest.mark.parametrize(('roll_deg', 'yaw_deg'), [(0, 0), (0, 10), (20, 10), (-20, 5)])
def test_a_bent_horizon_does_not_roll_the_camera(model, d, roll_deg, yaw_deg):
    """Beside the axis a lens bends the horizon; tangential distortion turns it there, too."""
    camera = CameraModel(640, 480, CAMERA.k, d, model)
    angles = np.radians((roll_deg, 12.0, yaw_deg))
    position = np.array((-300.0, 5.0, 30.0))
    body = from_rpy(*angles)
    horizon = horizon_from(Attitude(*quaternion(body)), camera, mount_matrix((0, 0, 0)))
    level = Derotation(640, 480, 1, horizon.slope)
    # From the frame to the levelled image.
    back = Derotation(640, 480, 1, -horizon.slope)
    edges = []
    for y in (15.0, -15.0):
        ends = np.array([(700.0, y, 0.0), (-100.0, y, 0.0)]) - position
        columns, rows = back.to_frame(*camera.project(ends @ body @ OPTICAL_FROM_BODY.T).T)
        along = [np.linspace(*ends, 8) for ends in (rows, columns)]
        edges.append(EdgePoints(*along, np.ones(8), 1.0))
    found = locate(edges, None, level, 0.001, camera, 30.0)
    assert (found.y, found.z) == pytest.approx((5.0, 30.0), abs=0.02)
    assert (found.roll, found.pitch, found.yaw) == pytest.approx(angles, abs=1e-4)


def test_points_where_the_lens_model_has_turned_back_say_nothing():
    """A model that is fitted in the middle alone may end within the image."""
    camera = CameraModel(640, 480, CAMERA.k, (-0.6, 0.0, 0.0, 0.0))
    level = Derotation(640, 480, 1, 0.0)
    near = [edge(aside) for aside in (-1.7, 1.8)]
    inside = [camera.reaches(np.stack([each.columns, each.rows], axis=1)) for each in near]
    assert all(0 < np.count_nonzero(each) < 8 for each in inside)
    cut = [
        replace(each, weights=each.weights * kept) for each, kept in zip(near, inside, strict=True)
    ]
    found, known = (locate(each, 470.0, level, 0.001, camera, 30.0) for each in (near, cut))
    assert (found.y, found.z, found.yaw) == pytest.approx((known.y, known.z, known.yaw))
    assert math.isnan(found.x)


def test_edges_that_meet_below_them_show_no_height():
    """Few points of a small strip may lie so; the camera would be under the ground."""
    rows = np.linspace(250.0, 400.0, 8)
    edges = [
        EdgePoints(rows, first + slope * (rows - 250.0), np.ones(8), 1.0)
        for first, slope in ((300.0, 0.2), (360.0, -0.05))
    ]
    guidance = locate(edges, None, Derotation(640, 480, 1, 0.0), 0.001, CAMERA, 30.0)
    assert not guidance.known and math.isnan(guidance.z)
    assert np.array_equal(guidance.covariance, UNKNOWN_VARIANCE * np.eye(6))
