"""Attitude to the horizon, held against where the simulator projects it."""

import math

import numpy as np
import pytest

from mvuav_ros.simulation.runway_flight import RunwayFlight, measured_attitude
from mvuav_ros.simulation.settings import RunwaySettings
from mvuav_ros.vision.approach.attitude import Attitude, horizon_from, mount_matrix
from mvuav_ros.vision.camera import CameraModel

CAMERA = CameraModel(640, 480, (500.0, 0, 319.5, 0, 500.0, 239.5, 0, 0, 1.0))
AHEAD = mount_matrix((0.0, 0.0, 0.0))


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
