"""The synthetic flight to and over a runway, and what is true of its images."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.simulation.flight import Flight, RandomStream, apply_gain, motion_blur
from mvuav_ros.simulation.ground import GroundPainter, load_ground
from mvuav_ros.simulation.pinhole import CameraPose, seen_by
from mvuav_ros.simulation.settings import RunwaySettings
from mvuav_ros.simulation.shake import random_wave
from mvuav_ros.simulation.sky import Panorama
from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.frames import OPTICAL_FROM_BODY, Matrix, from_rpy, quaternion, rpy
from mvuav_ros.vision.point_operations import Pixels
from mvuav_ros.vision.runway.normal_form import NormalForm, clip_segment
from mvuav_ros.vision.runway.results import LineRole

MIN_DEPTH = 0.1  # lines are cut where they come closer than this to the camera's plane, m


class LineTruth(NamedTuple):
    """A straight line in the image: x cos theta + y sin theta = rho; NaN where none is visible."""

    role: LineRole  # which line of the runway; the edges are the pavement's
    visible: bool  # whether any of it is on the frame
    rho: float  # px
    theta: float  # rad, in (-pi/2, pi/2]
    x1: float  # px; the end that is nearer, or left for the runway's ends, cut at the frame
    y1: float
    x2: float  # the other end
    y2: float


@dataclass(frozen=True, eq=False)
class RunwayTruth:
    """What an image of the runway shows."""

    lines: tuple[LineTruth, ...]  # in the order of `LineRole`
    vanishing_point: tuple[float, float]  # px, where the lines meet; NaN behind the camera
    horizon: tuple[float, float]  # rho (px) and theta (rad) of the ground's horizon
    pose: CameraPose  # in the runway's frame, shake included
    gain: float  # by which the camera's image is brighter than usual

    def line(self, role: LineRole) -> LineTruth:
        """The line of that role."""
        return self.lines[role - 1]


def true_lines(
    camera: CameraModel, pose: CameraPose, width: float, length: float
) -> tuple[LineTruth, ...]:
    """The runway's lines as seen by a camera without distortion."""
    left, right = 0.5 * width, -0.5 * width
    ends = {
        LineRole.LEFT_EDGE: ((0.0, left, 0.0), (length, left, 0.0)),
        LineRole.RIGHT_EDGE: ((0.0, right, 0.0), (length, right, 0.0)),
        LineRole.CENTRELINE: ((0.0, 0.0, 0.0), (length, 0.0, 0.0)),
        LineRole.FAR_END: ((length, left, 0.0), (length, right, 0.0)),
        LineRole.NEAR_END: ((0.0, left, 0.0), (0.0, right, 0.0)),
    }
    return tuple(_project_line(camera, pose, role, np.array(line)) for role, line in ends.items())


def normal_form(line: NDArray[np.floating[Any]]) -> tuple[float, float]:
    """The normal form of a x + b y + c = 0: rho, and theta in (-pi/2, pi/2]."""
    a, b, c = (float(v) for v in line)
    size = math.hypot(a, b)
    if size == 0.0:
        return math.nan, math.nan
    return NormalForm(-c / size, math.atan2(b, a)).normalised()


def vanishing_point(camera: CameraModel, pose: CameraPose) -> tuple[float, float]:
    """Where lines along the runway meet, px."""
    ((x, y),) = seen_by(camera, pose.rotation[:1]).tolist()
    return x, y


def horizon(camera: CameraModel, pose: CameraPose) -> tuple[float, float]:
    """The horizon of the runway's plane: rho (px) and theta (rad)."""
    up = pose.rotation.T[:, 2]
    return normal_form(np.linalg.inv(camera.matrix).T @ up)


def _project_line(camera: CameraModel, pose: CameraPose, role: LineRole, ends: Matrix) -> LineTruth:
    points = (ends - pose.position) @ pose.rotation
    depth, cut = points[:, 2] - MIN_DEPTH, points.copy()
    # Moved along their line until both are in front of the camera.
    for end in (0, 1):
        if depth[end] < 0.0 < depth[1 - end]:
            part = depth[end] / (depth[end] - depth[1 - end])
            cut[end] = points[end] + part * (points[1 - end] - points[end])
    (x1, y1), (x2, y2) = seen_by(camera, cut).tolist()
    segment = None
    if depth.max() > 0.0:
        segment = clip_segment(x1, y1, x2, y2, camera.width - 1.0, camera.height - 1.0)
    if segment is None:
        return LineTruth(role, False, *[math.nan] * 6)
    plane = np.cross(points[0], points[1])
    rho, theta = normal_form(np.linalg.inv(camera.matrix).T @ plane)
    return LineTruth(role, True, rho, theta, *segment)


BIAS_DEG, NOISE_DEG = 0.4, 0.1
"""Standard deviations of roll and pitch each: of a flight, and from sample to sample, as small
inertial units have them."""
ATTITUDE_SIGMA = math.radians(math.hypot(BIAS_DEG, NOISE_DEG))
_STREAM = 1004


def measured_attitude(pose: CameraPose, seed: int, stamp_ns: int) -> tuple[float, ...]:
    """What the sensor of a flight says of a true pose: a quaternion x, y, z, w in a level world."""
    bias = np.random.default_rng((seed, _STREAM)).normal(0.0, math.radians(BIAS_DEG), 2)
    noise = np.random.default_rng((seed, _STREAM, stamp_ns)).normal(0.0, math.radians(NOISE_DEG), 2)
    roll, pitch = pose.roll + bias[0] + noise[0], pose.pitch + bias[1] + noise[1]
    return quaternion(from_rpy(float(roll), float(pitch), pose.yaw))


GLIDE = math.tan(math.radians(3.5))
AIMING_POINT = 150.0  # where the glide path meets the runway, m from the near end
FLARE_HEIGHT = 8.0
LOW_PASS_HEIGHT = 22.0
S_TURN_HEIGHT = 70.0
S_TURN_AMPLITUDE = 18.0
S_TURN_PERIOD = 14.0
CAPTURE_SECONDS = 6.0  # time in which an approach loses 63 % of its lateral offset
_GRAVITY = 9.81
_STEP = 1e-3


class RunwayPath:
    """The camera's pose as a function of time; the aircraft banks for its own turns."""

    def __init__(self, settings: RunwaySettings, rng: np.random.Generator) -> None:
        self._settings = settings
        self._wander_y = random_wave(rng, [(0.8, 0.07), (0.25, 0.19)])
        self._wander_z = random_wave(rng, [(0.5, 0.09), (0.15, 0.23)])
        self._wobble = tuple(
            random_wave(rng, [(math.radians(a), 0.13), (math.radians(0.4 * a), 0.37)])
            for a in (1.6, 0.5, 0.6)
        )

    def pose(self, time: float, shaken: Matrix | None = None) -> CameraPose:
        """Where the camera is at a time (s); ``shaken`` from its steady optical frame if it is."""
        settings = self._settings
        before, y, after = (self._y(time + step) for step in (-_STEP, 0.0, _STEP))
        position = np.array((self._x(time), y, self._z(time)))
        drift = (after - before) / (2 * _STEP)
        turn = (after - 2 * y + before) / _STEP**2
        roll, pitch, yaw = (wave(time) for wave in self._wobble)
        # To the left means y grows, which a left bank does: negative roll.
        roll -= math.atan(turn / _GRAVITY)
        pitch += math.radians(settings.camera_pitch_deg)
        if settings.speed > 0.0:
            yaw += math.atan(drift / settings.speed)
        rotation = from_rpy(roll, pitch, yaw) @ OPTICAL_FROM_BODY.T
        if shaken is not None:
            rotation = rotation @ shaken.T
            roll, pitch, yaw = rpy(rotation @ OPTICAL_FROM_BODY)
        return CameraPose(position, roll, pitch, yaw, rotation)

    def _x(self, time: float) -> float:
        return self._settings.speed * time - self._settings.start_distance

    def _y(self, time: float) -> float:
        offset = self._settings.lateral_offset
        if self._settings.motion == 's_turn':
            turn = 2 * math.pi * time / S_TURN_PERIOD
            return offset + S_TURN_AMPLITUDE * math.sin(turn) + self._wander_y(time)
        return offset * math.exp(-time / CAPTURE_SECONDS) + self._wander_y(time)

    def _z(self, time: float) -> float:
        wander = self._wander_z(time)
        if self._settings.motion == 's_turn':
            return S_TURN_HEIGHT + wander
        if self._settings.motion == 'low_pass':
            return LOW_PASS_HEIGHT + wander
        glide = (AIMING_POINT - self._x(time)) * GLIDE
        # A smooth maximum of the glide path and the height of the flare.
        above = glide - FLARE_HEIGHT
        return FLARE_HEIGHT + 0.5 * (above + math.hypot(above, 3.0)) + 0.5 * wander


class RunwayFlight(Flight[RunwayTruth]):
    """Images (bgr8) of a runway ahead, with truth."""

    settings: RunwaySettings

    def __init__(self, settings: RunwaySettings | None = None) -> None:
        settings = settings or RunwaySettings()
        super().__init__(settings, settings.camera())
        self._path = RunwayPath(self.settings, self._rng(RandomStream.MOTION))

    def truth_at(self, time: float) -> RunwayTruth:
        """What is true at any time (s)."""
        pose = self.pose(time)
        return RunwayTruth(
            true_lines(self.camera, pose, self.settings.runway_width, self.settings.runway_length),
            vanishing_point(self.camera, pose),
            horizon(self.camera, pose),
            pose,
            self._gain(time),
        )

    def pose(self, time: float) -> CameraPose:
        """The camera, which may shake, in the runway's frame at a time (s)."""
        return self._path.pose(time, self._shake.rotation(time))

    def _draw(self, truth: RunwayTruth, time: float) -> Pixels:
        image = self._panorama.view(truth.pose)
        self._painter.paint(image, truth.pose)
        return apply_gain(motion_blur(image, *self._smear(time)), truth.gain)

    def _smear(self, time: float) -> tuple[float, float]:
        """How far the vanishing point moves during the exposure, px."""
        half = 0.5 * self.settings.exposure
        x1, y1 = vanishing_point(self.camera, self.pose(time - half))
        x2, y2 = vanishing_point(self.camera, self.pose(time + half))
        dx, dy = x2 - x1, y2 - y1
        return (dx, dy) if math.isfinite(dx + dy) else (0.0, 0.0)

    @cached_property
    def _painter(self) -> GroundPainter:
        s = self.settings
        ground = load_ground(s.runway_width, s.runway_length, s.detail, s.seed)
        return GroundPainter(ground, self.camera, s.visibility)

    @cached_property
    def _panorama(self) -> Panorama:
        return Panorama(self.camera, self.settings.detail, self._rng(RandomStream.BACKGROUND))
