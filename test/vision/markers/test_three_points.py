"""Views of a rig from three of its markers."""

import math
from itertools import combinations

import cv2
import numpy as np

from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.image import Image
from mvuav_ros.vision.markers.lights import Lens
from mvuav_ros.vision.markers.marker_results import MarkerState
from mvuav_ros.vision.markers.rig_view import WeakPerspective, views_of_three
from mvuav_ros.vision.markers.tracker import MarkerTracker
from mvuav_ros.vision.rig import TANKER_747, MarkerRig
from mvuav_thesis.light_flights import random_rig

FOCAL = 554.0
CAMERA = CameraModel(640, 480, (FOCAL, 0.0, 319.5, 0.0, FOCAL, 239.5, 0.0, 0.0, 1.0))
LENS = Lens((640, 480), CAMERA)


def random_views(count, seed):
    rng = np.random.default_rng(seed)
    views = np.zeros((count, 8))
    views[:, 0] = rng.uniform(-math.pi, math.pi, count)
    views[:, 1] = np.log(rng.uniform(60.0, 220.0, count))
    views[:, 2:4] = rng.uniform((200.0, 150.0), (440.0, 330.0), (count, 2))
    views[:, 4:6] = rng.uniform(-0.3, 0.3, (count, 2))
    views[:, 6] = math.log(FOCAL)
    return views


def any_view(views):
    return np.ones(len(views), bool)


def errors(shape, triple, truth):
    """How far the nearest of a triple's views shows the markers from where they are, px."""
    nearest = []
    for seen in shape.project(truth):
        places = seen[None, list(triple), 0] + 1j * seen[None, list(triple), 1]
        views = views_of_three(shape, np.array([triple]), places, FOCAL, any_view)
        found = shape.project(views)
        nearest.append(np.abs(found - seen).max(axis=(1, 2)).min())
    return np.array(nearest)


def test_one_of_the_views_is_the_one_from_which_three_markers_were_seen():
    shape = WeakPerspective.of(TANKER_747, LENS)
    (triangle,) = shape.triangles(0)
    assert triangle == (0, 2, 4)
    assert np.sort(errors(shape, triangle, random_views(500, 1)))[490] < 1e-3


def test_any_three_of_any_rig_tell_the_view_in_nearly_all_cases():
    shape = WeakPerspective.of(random_rig(5, 4), LENS)
    truth = random_views(200, 2)
    for triple in combinations(range(5), 3):
        assert (errors(shape, triple, truth) < 1e-2).mean() > 0.7
    assert (errors(shape, shape.triangles(0)[0], truth) < 1e-2).mean() > 0.9


def test_places_that_three_markers_cannot_have_give_finite_views():
    shape = WeakPerspective.of(TANKER_747, LENS)
    places = np.array([[0j, 0j, 0j], [1j, 2j, 3j], [1 + 1j, 600 + 400j, 601 + 400j]])
    triples = np.tile((0, 2, 4), (3, 1))
    assert np.isfinite(views_of_three(shape, triples, places, FOCAL, any_view)).all()


def test_lights_in_a_row_are_no_body_whose_markers_form_a_triangle():
    corners = (('left', (0.0, 3.0, 0.0)), ('right', (0.0, -3.0, 0.0)), ('top', (0.0, 0.0, 4.0)))
    tracker = MarkerTracker(rig=MarkerRig('triangle', corners, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)))
    tracker.set_camera(CAMERA)
    frame = np.zeros((480, 640), np.uint8)
    for x in (200, 320, 440):
        cv2.circle(frame, (x, 240), 4, 255, -1)
    result = tracker.process(Image(frame, 'mono8'), 0)
    assert all(marker.state is MarkerState.LOST for marker in result.markers)
    assert result.status


def test_a_flat_body_that_is_seen_from_above_gets_its_names():
    """From straight behind all its lights are on one line: no three of them were tried."""
    corners = (
        ('nose', (0.6, 0.0, 0.0)),
        ('left', (0.2, 0.5, 0.0)),
        ('right', (0.1, -0.55, 0.0)),
        ('tail', (-0.5, 0.1, 0.0)),
        ('side', (-0.2, -0.3, 0.0)),
    )
    rig = MarkerRig('flat', corners, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    tracker = MarkerTracker(rig=rig)
    tracker.set_camera(CAMERA)
    c, s = math.cos(math.radians(20.0)), math.sin(math.radians(20.0))
    # Nose down by 20 degrees.
    turn = np.array([(0.0, -1.0, 0.0), (s, 0.0, -c), (c, 0.0, s)])
    seen = CAMERA.project(rig.positions @ turn.T + (0.1, 0.0, 3.0))
    frame = np.zeros((480, 640), np.uint8)
    for x, y in seen.tolist():
        cv2.circle(frame, (round(x), round(y)), 3, 255, -1)
    markers = tracker.process(Image(frame, 'mono8'), 0).markers
    np.testing.assert_allclose([(marker.x, marker.y) for marker in markers], seen, atol=1.0)
