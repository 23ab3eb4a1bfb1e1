"""Poses of the tanker on a docking approach, and how far they are from the truth."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from mvuav_ros.offline.evaluation.metrics import Array
from mvuav_ros.simulation.settings import TankerSettings
from mvuav_ros.simulation.tanker_flight import TankerFlight
from mvuav_ros.sources.opening import camera_model
from mvuav_ros.vision.frames import Matrix, Vector
from mvuav_ros.vision.pose import Pose, PoseEstimator


@dataclass(frozen=True)
class PoseTask:
    """A docking approach seen with noise: of the markers' places, px per axis (1 sigma)."""

    seed: int
    frames: int = 1000
    noise: float = 0.3
    distortion: str = ''


@dataclass(frozen=True, eq=False)
class FlownPoses:
    """Poses against truth, by frame; NaN where there was no pose.

    Attributes:
        distance: (n,) m, from the camera to the tanker's dock point.
        moved: (n,) m, the position's error.
        turned: (n,) rad, the angle between the rotations.
        squares: (n,), error squared over its covariance; 6 on average if that is right.
    """

    distance: Array
    moved: Array
    turned: Array
    squares: Array


def pose_error(pose: Pose, rotation: Matrix, translation: Vector) -> tuple[Array, float]:
    """A pose's error (m, then rad about x, y and z), and its square over the covariance."""
    turn = np.asarray(cv2.Rodrigues(pose.rotation @ rotation.T)[0], np.float64).ravel()
    error = np.concatenate((pose.translation - translation, turn))
    return error, float(error @ np.linalg.solve(pose.covariance, error))


def fly_poses(task: PoseTask) -> FlownPoses:
    """Estimate the pose in every frame from the true places with noise; no image is drawn."""
    flight = TankerFlight(
        TankerSettings(
            motion='docking', frames=task.frames, seed=task.seed, distortion=task.distortion
        )
    )
    camera, estimator = camera_model(flight.camera), PoseEstimator(flight.rig)
    rng = np.random.default_rng(task.seed)
    rows = np.full((task.frames, 4), np.nan)
    for index in range(task.frames):
        truth = flight.truth(index)
        places = np.array([(marker.x, marker.y) for marker in truth.markers])
        pixels = places + rng.normal(0.0, task.noise, places.shape)
        pose = estimator.estimate(
            camera, range(len(pixels)), pixels, round(flight.time(index) * 1e9)
        )
        rows[index, 0] = truth.distance
        if pose is not None:
            error, square = pose_error(pose, truth.rotation, truth.translation)
            rows[index, 1:] = np.linalg.norm(error[:3]), np.linalg.norm(error[3:]), square
    return FlownPoses(*rows.T)
