"""The horizon: from attitude, held against where the simulator projects it, and on drawn images."""

import math
from dataclasses import replace

import numpy as np
import pytest

from mvuav_ros.simulation.runway_flight import RunwayFlight, measured_attitude
from mvuav_ros.simulation.settings import RunwaySettings
from mvuav_ros.vision.approach.attitude import HorizonFinder, horizon_from, mount_matrix
from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.frames import OPTICAL_FROM_BODY, Attitude

CAMERA = CameraModel(640, 480, (500.0, 0, 319.5, 0, 500.0, 239.5, 0, 0, 1.0))
AHEAD = mount_matrix((0.0, 0.0, 0.0))
HEIGHT, WIDTH = 240, 320


def test_level_flight_has_the_horizon_in_the_middle():
    horizon = horizon_from(Attitude.from_roll_pitch(0.0, 0.0), CAMERA, AHEAD)
    assert horizon.row == pytest.approx(239.5)
    assert horizon.slope == pytest.approx(0.0)


@pytest.mark.parametrize('pitch_deg', [-8.0, 3.0, 12.0])
def test_nose_down_moves_the_horizon_up(pitch_deg):
    pitch = math.radians(pitch_deg)
    horizon = horizon_from(Attitude.from_roll_pitch(0.0, pitch), CAMERA, AHEAD)
    assert horizon.row == pytest.approx(239.5 - 500 * math.tan(pitch))


@pytest.mark.parametrize('roll_deg', [-30.0, 10.0, 30.0])
def test_right_wing_down_turns_the_horizon_the_other_way(roll_deg):
    horizon = horizon_from(Attitude.from_roll_pitch(math.radians(roll_deg), 0.0), CAMERA, AHEAD)
    assert math.degrees(horizon.slope) == pytest.approx(-roll_deg)
    assert horizon.row == pytest.approx(239.5)


def test_a_camera_that_looks_down_on_a_level_body_is_a_body_that_looks_down():
    down = horizon_from(Attitude.from_roll_pitch(0.0, 0.0), CAMERA, mount_matrix((0.0, 10.0, 0.0)))
    assert down.row == pytest.approx(239.5 - 500 * math.tan(math.radians(10.0)))


@pytest.mark.parametrize(
    'attitude',
    [
        Attitude(math.nan, 0.0, 0.0, 1.0),
        Attitude(0.0, 0.0, 0.0, 0.0),
        Attitude.from_roll_pitch(0.0, math.radians(85.0)),
    ],
)
def test_no_horizon_without_a_usable_attitude(attitude):
    assert horizon_from(attitude, CAMERA, AHEAD) is None


def test_no_horizon_where_the_lens_model_has_turned_back():
    lens = replace(CAMERA, k=(320, 0, 319.5, 0, 320, 239.5, 0, 0, 1), d=(-0.4, 0.2, 0, 0, -0.05))
    steep, flat = (Attitude.from_roll_pitch(0.0, math.radians(down)) for down in (60.0, 40.0))
    # The model has it in the image again, at row 104.
    assert horizon_from(steep, lens, AHEAD) is None
    assert horizon_from(flat, lens, AHEAD).row == pytest.approx(24.67, abs=0.01)


def test_it_is_where_the_simulated_runways_direction_vanishes():
    """The vanishing point of a level runway lies on the horizon."""
    flight = RunwayFlight(RunwaySettings(frames=200, seed=3, motion='s_turn'))
    camera = CameraModel(
        flight.camera.width, flight.camera.height, tuple(flight.camera.matrix.flat)
    )
    for index in range(0, 200, 40):
        truth = flight.truth(index)
        attitude = Attitude.from_roll_pitch(truth.pose.roll, truth.pose.pitch)
        horizon = horizon_from(attitude, camera, AHEAD)
        x, y = truth.vanishing_point
        middle = 0.5 * (camera.width - 1)
        assert horizon.row + (x - middle) * math.tan(horizon.slope) == pytest.approx(y, abs=0.5)


def test_the_simulated_sensor_errs_by_its_bias_and_noise():
    pose = RunwayFlight(RunwaySettings(frames=10)).truth(5).pose
    errors = []
    for seed in range(200):
        up = Attitude(*measured_attitude(pose, seed, 1)).up
        true = Attitude.from_roll_pitch(pose.roll, pose.pitch).up
        errors.append(math.degrees(math.acos(min(1.0, float(np.dot(up, true))))))
    assert 0.3 < np.median(errors) < 0.8
    assert max(errors) < 2.5


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
    assert math.degrees(horizon.slope) == pytest.approx(slope, abs=0.3)
    assert horizon.row == pytest.approx(row, abs=1.5)


def test_small_slopes_are_measured_closely():
    finder = HorizonFinder(HEIGHT, WIDTH)
    for slope in (-1.3, -0.4, 0.0, 0.7, 1.9):
        horizon = finder.find(view(100.3, slope))
        assert math.degrees(horizon.slope) == pytest.approx(slope, abs=0.15)
        assert horizon.row == pytest.approx(100.3, abs=0.6)


@pytest.mark.parametrize(('model', 'd'), [('plumb_bob', (-0.25, 0, 0, 0)), ('equidistant', ())])
@pytest.mark.parametrize('roll_deg', [-20.0, 0.0, 12.0])
def test_a_horizon_that_a_lens_bends_is_where_the_attitude_has_it(roll_deg, model, d):
    camera = CameraModel(WIDTH, HEIGHT, (277, 0, 150, 0, 270, 125, 0, 0, 1), d, model)
    attitude = Attitude.from_roll_pitch(math.radians(roll_deg), math.radians(9.0))
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    rays = camera.undistort(np.stack((x.ravel(), y.ravel()), axis=1))
    above = np.column_stack((rays, np.ones(len(rays)))) @ OPTICAL_FROM_BODY @ attitude.up
    image = np.where(above > 0, 235, 50).astype(np.uint8).reshape(HEIGHT, WIDTH)
    found = HorizonFinder(HEIGHT, WIDTH).find(image, camera)
    true = horizon_from(attitude, camera, AHEAD)
    assert math.degrees(found.slope) == pytest.approx(math.degrees(true.slope), abs=0.1)
    assert found.row == pytest.approx(true.row, abs=0.4)


def test_a_horizon_that_moves_a_little_is_followed_and_one_that_jumps_is_found_again():
    finder = HorizonFinder(HEIGHT, WIDTH)
    finder.find(view(100, 0))
    near = finder.find(view(102, 1))
    assert near.row == pytest.approx(102, abs=0.7)
    far = finder.find(view(150, 30))
    assert far.row == pytest.approx(150, abs=1.5)
    assert math.degrees(far.slope) == pytest.approx(30, abs=0.3)


def test_treetops_and_an_even_image_are_not_trusted():
    finder = HorizonFinder(HEIGHT, WIDTH)
    assert finder.find(view(110, 0, treetops=True)) is None
    assert finder.find(np.full((HEIGHT, WIDTH), 90, np.uint8)) is None


@pytest.mark.parametrize('road', [180, 230])
def test_a_bright_road_across_the_land_is_no_horizon(road):
    """All that is above a horizon is sky."""
    land = np.full((HEIGHT, WIDTH), 60, np.uint8)
    land[90:102] = road
    assert HorizonFinder(HEIGHT, WIDTH).find(land) is None
    land[:90] = road
    assert HorizonFinder(HEIGHT, WIDTH).find(land).row == pytest.approx(101.5, abs=1.0)


@pytest.mark.parametrize('row', [13, 18, 24])
@pytest.mark.parametrize('slope', [0.0, -3.0])
def test_a_narrow_strip_of_sky_shows_the_horizon(row, slope):
    found = HorizonFinder(HEIGHT, WIDTH).find(view(row, slope))
    assert found.row == pytest.approx(row, abs=1.0)
    assert math.degrees(found.slope) == pytest.approx(slope, abs=0.3)
