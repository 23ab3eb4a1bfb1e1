"""Flights whose names other lights take, and docking approaches: poses against truth."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field

import cv2
import numpy as np

from mvuav_ros.offline.evaluation.metrics import Array
from mvuav_ros.simulation.settings import TankerSettings
from mvuav_ros.simulation.tanker_flight import TankerFlight
from mvuav_ros.vision.frames import Matrix, Vector
from mvuav_ros.vision.image import Image
from mvuav_ros.vision.markers.marker_results import MarkerResult, MarkerState
from mvuav_ros.vision.markers.tracker import MarkerTracker
from mvuav_ros.vision.pose import Pose, PoseEstimator
from mvuav_ros.vision.reprojection import MIN_MARKERS
from mvuav_ros.vision.rig import TANKER_747
from mvuav_thesis.light_flights import LightFlight, LightScene, LightTruth, random_rig


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
    camera, estimator = flight.camera, PoseEstimator(flight.rig)
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


TOLD_APART = 4.0
"""px from a marker's true place at which another light can be distinguished."""
THEFTS = LightScene(thefts=3)
STORM = LightScene(roll=1.0, tilt=0.1, shake=1.0, losses=7, dark=0.8, glares=3, dropped=0.1)
SCENES: Mapping[str, tuple[LightScene, int]] = {
    'calm': (LightScene(), 5),
    'docking, k1 -0.12': (LightScene(near=1.7, barrel=-0.12), 5),
    'a light passes where a marker goes dark': (THEFTS, 5),
    'the same, k1 -0.3': (LightScene(thefts=3, barrel=-0.3), 5),
    'the same, rolling, k1 -0.12': (LightScene(roll=0.7, thefts=3, barrel=-0.12), 5),
    'rolling, shaking, losses and three glares': (STORM, 5),
    'lights cross, k1 -0.3': (LightScene(roll=0.5, tilt=0.45, tilt_hz=0.2, barrel=-0.3), 5),
    'all dark, back in batches': (LightScene(roll=0.5, batches=True), 5),
    'all dark for three seconds': (LightScene(roll=0.5, dark=3.0), 5),
    'three markers at any roll': (LightScene(any_roll=True, tilt=0.12, frames=20), 3),
    'eight markers at any roll': (LightScene(any_roll=True, tilt=0.12, frames=20), 8),
}
"""Scenes, and how many markers the rig has; five are the tanker."""


@dataclass(frozen=True)
class IntegrityTask:
    """One of `SCENES` with a seed."""

    scene: str
    seed: int
    calibrated: bool = True


@dataclass(eq=False)
class IntegrityFlight:
    """What became of names and poses on a flight.

    Attributes:
        scene: of the task.
        frames: seen.
        wrong: lengths, frames, of every run in which a name was on another light.
        seen: whole markers times frames.
        missed: of these, without a name.
        waits: lengths, frames, of the times in which three or more whole markers were in sight
            and not all had names, after all had had them once.
        poses: (n, 3), errors of the poses published: of the position as a share of the distance, of
            the attitude in degrees, and of both squared over their covariance.
    """

    scene: str
    frames: int = 0
    wrong: tuple[int, ...] = ()
    seen: int = 0
    missed: int = 0
    waits: tuple[int, ...] = ()
    poses: tuple[tuple[float, float, float], ...] = ()
    _running: Counter[int] = field(default_factory=Counter)
    _wait: int = 0
    _started: bool = False

    @property
    def moved(self) -> Array:
        """Errors of the poses published, share of the distance."""
        return np.reshape(self.poses, (-1, 3))[:, 0]

    @property
    def turned(self) -> Array:
        """Errors of the attitudes published, degrees."""
        return np.reshape(self.poses, (-1, 3))[:, 1]

    @property
    def squares(self) -> Array:
        """Errors squared over their covariance."""
        return np.reshape(self.poses, (-1, 3))[:, 2]

    def add_names(self, result: MarkerResult, truth: LightTruth) -> None:
        """Count a frame's names."""
        self.frames += 1
        named = np.array([m.state is MarkerState.DETECTED for m in result.markers])
        for index, (marker, place) in enumerate(zip(result.markers, truth.pixels, strict=True)):
            away = math.hypot(marker.x - place[0], marker.y - place[1])
            if named[index] and away > TOLD_APART:
                self._running[index] += 1
            elif index in self._running:
                self.wrong += (self._running.pop(index),)
        missed = truth.whole & ~named
        self.seen += int(truth.whole.sum())
        self.missed += int(missed.sum())
        waiting = bool(self._started and missed.any() and truth.whole.sum() >= MIN_MARKERS)
        if self._wait and not waiting:
            self.waits += (self._wait,)
        self._wait = self._wait + 1 if waiting else 0
        self._started |= bool(named.all())

    def add_pose(self, pose: Pose, truth: LightTruth) -> None:
        """Hold a pose against the truth."""
        error, square = pose_error(pose, truth.rotation, truth.translation)
        moved = float(np.linalg.norm(error[:3]) / np.linalg.norm(truth.translation))
        turned = math.degrees(float(np.linalg.norm(error[3:])))
        self.poses += ((moved, turned, square),)

    def close(self) -> None:
        """Count what the flight's end cut short."""
        self.wrong += tuple(self._running[index] for index in sorted(self._running))
        self.waits += (self._wait,) * bool(self._wait)


def fly_integrity(task: IntegrityTask) -> IntegrityFlight:
    """Follow a flight and hold names and poses against the truth."""
    scene, count = SCENES[task.scene]
    rig = TANKER_747 if count == len(TANKER_747.names) else random_rig(count, task.seed)
    flight = LightFlight(scene, task.seed, rig)
    tracker, poses = MarkerTracker(rig=rig), PoseEstimator(rig)
    if task.calibrated:
        tracker.set_camera(flight.camera)
    flown = IntegrityFlight(task.scene)
    for stamp_ns, pixels, truth in flight:
        result = tracker.process(Image(pixels, 'mono8'), stamp_ns)
        seen = [m for m in result.markers if m.state is MarkerState.DETECTED]
        places = np.array([(marker.x, marker.y) for marker in seen])
        labels = [int(marker.label) for marker in seen]
        flown.add_names(result, truth)
        pose = poses.estimate(flight.camera, labels, places, stamp_ns)
        if pose is not None:
            flown.add_pose(pose, truth)
    flown.close()
    return flown
