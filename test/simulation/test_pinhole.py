import math

import cv2
import numpy as np
import pytest

from mvuav_ros.simulation.pinhole import parse_distortion, pinhole_camera, seen_by
from mvuav_ros.simulation.runway_flight import normal_form
from mvuav_ros.simulation.settings import TankerSettings
from mvuav_ros.simulation.tanker_flight import TankerFlight
from mvuav_ros.vision.rig import TANKER_747


@pytest.mark.parametrize('text', ['', '-0.25 0.08 0.001 -0.002 -0.01', '0.1, -0.05, 0, 0'])
def test_projection_agrees_with_opencv(text):
    camera = pinhole_camera(640, 480, 70.0, parse_distortion(text))
    rng = np.random.default_rng(1)
    points = rng.uniform((-10, -8, 15), (10, 8, 60), (200, 3))
    expected, _ = cv2.projectPoints(
        points, np.zeros(3), np.zeros(3), camera.matrix, np.array(camera.distortion)
    )
    assert np.abs(seen_by(camera, points) - expected[:, 0]).max() < 1e-9


def test_flight_truth_agrees_with_opencv_from_the_pose():
    sim = TankerFlight(TankerSettings(motion='docking', shake=2, distortion='-0.1 0.01 0.001 0.0'))
    for index in (0, 150, 299):
        truth = sim.truth(index)
        vector, _ = cv2.Rodrigues(truth.rotation)
        expected, _ = cv2.projectPoints(
            sim.rig.positions,
            vector,
            truth.translation,
            sim.camera.matrix,
            np.array(sim.camera.distortion),
        )
        places = [(m.x, m.y) for m in truth.markers]
        assert np.abs(places - expected[:, 0]).max() < 1e-6


def test_points_behind_the_camera_are_nowhere():
    camera = pinhole_camera(640, 480, 60.0)
    pixels = seen_by(camera, np.array([(0.0, 0.0, -1.0), (1.0, 1.0, 0.0), (0.0, 0.0, 5.0)]))
    assert np.isnan(pixels[:2]).all()
    assert pixels[2] == pytest.approx((319.5, 239.5))


def test_a_lens_folds_nothing_from_outside_into_the_image():
    settings = {'motion': 'docking', 'fov_deg': 60.0, 'start_distance': 30.0, 'end_distance': 6.0}
    flight = TankerFlight(TankerSettings(frames=97, distortion='-0.3 0 0 0', **settings))
    frame = flight.frame(96)
    assert not any(marker.visible for marker in frame.truth.markers)
    assert frame.image.gray().max() < 200


def test_field_of_view_reaches_the_edges_of_the_frame():
    camera = pinhole_camera(640, 480, 60.0)
    edge = seen_by(camera, np.array([(math.tan(math.radians(30.0)), 0.0, 1.0)]))[0]
    assert edge[0] == pytest.approx(639.5)


def test_the_tanker_has_a_747s_proportions():
    places = dict(TANKER_747.markers)
    assert places['left_wing'][1] - places['right_wing'][1] == pytest.approx(59.6)
    assert places['left_stabilizer'][1] - places['right_stabilizer'][1] == pytest.approx(22.0)
    for left, right in (('left_wing', 'right_wing'), ('left_stabilizer', 'right_stabilizer')):
        x, y, z = places[left]
        assert places[right] == (x, -y, z)


def test_another_body_flies_too(tmp_path):
    path = tmp_path / 'drone.yaml'
    path.write_text('markers: {a: [0, 0.3, 0], b: [0, -0.3, 0], c: [-0.2, 0, 0.2]}')
    sim = TankerFlight(
        TankerSettings(layout=str(path), frames=3, noise=0.0, motion='translation', roll_deg=25.0)
    )
    frame = sim.frame(1)
    assert [m.name for m in frame.truth.markers] == ['a', 'b', 'c']
    assert math.degrees(frame.truth.roll) == pytest.approx(25.0, abs=1e-6)
    left, right = frame.truth.markers[:2]
    seen = math.atan2(right.y - left.y, right.x - left.x)
    assert math.degrees(seen) == pytest.approx(25.0, abs=2.0)
    gray = frame.image.gray()
    assert all(gray[round(m.y), round(m.x)] > 240 for m in frame.truth.markers)


def test_normal_form_covers_every_direction():
    for angle in np.radians(np.arange(-180, 180, 7.5)):
        a, b = math.cos(angle), math.sin(angle)
        rho, theta = normal_form(np.array((3 * a, 3 * b, -3 * 20.0)))
        assert -math.pi / 2 < theta <= math.pi / 2
        assert rho * math.cos(theta) == pytest.approx(20.0 * a, abs=1e-9)
        assert rho * math.sin(theta) == pytest.approx(20.0 * b, abs=1e-9)
