"""The accounts of names and poses: what is wrong must be counted as wrong."""

import math

import numpy as np
import pytest

from mvuav_ros.parameters.marker_tracker import MarkerTrackerParameters
from mvuav_ros.simulation.settings import TankerSettings
from mvuav_ros.vision.markers.marker_results import Marker, MarkerResult, MarkerState
from mvuav_ros.vision.markers.tracker import MarkerTracker
from mvuav_thesis import identity_runs
from mvuav_thesis.beyond import identity_table, pose_table, pose_tasks
from mvuav_thesis.identity_runs import (
    SCENES,
    IdentityTask,
    fly_names,
    identity_task,
)
from mvuav_thesis.integrity_runs import PoseTask, fly_poses
from mvuav_thesis.plan import Plan


class Exchanging(MarkerTracker):
    """From frame 10 on the wings have each other's names; frame 20 has none at all."""

    frames = 0

    def process(self, image, stamp_ns):
        result = super().process(image, stamp_ns)
        self.frames += 1
        left, *others, right = result.markers
        if self.frames - 1 == 20:
            return MarkerResult(tuple(Marker(i, MarkerState.LOST) for i in range(5)))
        if self.frames - 1 < 10:
            return result
        left, right = right._replace(label=left.label), left._replace(label=right.label)
        return MarkerResult((left, *others, right), result.roll + math.pi)


def test_exchanged_names_are_counted(monkeypatch):
    monkeypatch.setattr(identity_runs, 'MarkerTracker', Exchanging)
    flown = fly_names(IdentityTask('x', TankerSettings(frames=30, fps=30.0, seed=3)))
    assert {frame for frame, _, _ in flown.wrong} == set(range(10, 30)) - {20}
    assert {name for _, name, _ in flown.wrong} == {'left_wing', 'right_wing'}
    assert flown.switches == 2
    assert flown.roll_error > 3.0
    assert flown.named == pytest.approx(29 / 30)


def test_the_time_of_recovery(monkeypatch):
    """The thesis's tracking starts again with whole frames once a marker is back."""
    parameters = MarkerTrackerParameters(prediction='velocity', lost_timeout=0.2)
    settings = TankerSettings(
        motion='roll', frames=75, fps=30.0, seed=3, failures='left_wing@0.5-1.5, all@2-2.2'
    )
    thesis = fly_names(IdentityTask('x', settings, parameters))
    ours = fly_names(IdentityTask('x', settings))
    assert ours.wrong == ours.imagined == ()
    assert ours.slowest <= 3
    assert ours.named > thesis.named - 0.01
    assert len(ours.partial) + len(ours.total) >= 5 + 1 + 5


def test_every_scene_is_a_flight():
    for scene in SCENES:
        assert identity_task(scene, 4).flight.seed == 4


def test_the_largest_seed_is_one_of_every_docking_approach():
    for task in pose_tasks(Plan(seed=2**31 - 1, pose_frames=2)):
        assert len(fly_poses(task).distance) == 2


def test_table_of_names():
    task = IdentityTask('first frames', TankerSettings(frames=8, fps=30.0, seed=1))
    table = identity_table([fly_names(task), fly_names(task)])
    assert [row[:4] for row in table.rows] == [('first frames', 16, 0, 0)]


def test_poses_and_their_table():
    flown = fly_poses(PoseTask(seed=11, frames=1000))
    assert np.isfinite(flown.squares).all()
    near = flown.distance <= 30.0
    assert near.sum() > 400
    relative = flown.moved[near] / flown.distance[near]
    assert np.sqrt(np.mean(relative**2)) < 0.005
    assert np.degrees(flown.turned[near]).max() < 0.5
    assert np.mean(flown.squares) == pytest.approx(6.0, abs=0.5)
    table = pose_table([flown])
    everything = table.rows[-1]
    assert everything[1] == pytest.approx(1000, abs=20)
    assert 92.0 < everything[-1] < 98.0
    assert len(table.rows) > 5


def test_a_covariance_that_is_too_small_shows():
    flown = fly_poses(PoseTask(seed=11, frames=100))
    table = pose_table([type(flown)(flown.distance, flown.moved, flown.turned, 4 * flown.squares)])
    assert table.rows[-1][-1] < 80.0
