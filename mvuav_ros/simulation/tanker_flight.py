"""The synthetic flight behind a tanker with marker lights, and what is true of its images."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.parameters.declaration import ParameterError
from mvuav_ros.simulation.airframe import IN_LAB, IN_SKY, Boom, paint_tanker, place_boom
from mvuav_ros.simulation.flight import Flight, RandomStream, apply_gain, motion_blur
from mvuav_ros.simulation.light_drawing import (
    LARGEST_RADIUS,
    Light,
    add_lights,
    core_of,
    drifting_glares,
)
from mvuav_ros.simulation.pinhole import seen_by
from mvuav_ros.simulation.settings import (
    ALL,
    ScheduleEntry,
    TankerSettings,
    affected,
    parse_schedule,
)
from mvuav_ros.simulation.shake import random_wave
from mvuav_ros.simulation.sky import Background
from mvuav_ros.vision.frames import OPTICAL_FROM_BODY, Matrix, Vector, about_y, from_rpy
from mvuav_ros.vision.point_operations import Pixels
from mvuav_ros.vision.rig import TANKER_747, MarkerRig, RigError, load_rig


class MarkerTruth(NamedTuple):
    """One light."""

    name: str
    x: float  # px, where its centre is projected, in the frame or not; NaN where no lens shows it
    y: float
    vx: float  # px/s, the camera's shake included
    vy: float
    visible: bool  # it is lit, its centre is on the frame and not behind the boom
    whole: bool  # all of its disc is visible, so that a centroid can be right


@dataclass(frozen=True, eq=False)
class TankerTruth:
    """What an image of the tanker shows."""

    markers: tuple[MarkerTruth, ...]  # in the rig's order
    # Rad, right wing down positive: atan2 of right wing minus left wing as projected; for a body
    # without lights of these names, of its rotation.
    roll: float
    rotation: Matrix  # of the body (x forward, y left, z up) in the camera's optical frame
    translation: Vector  # m, of the body's origin in the optical frame
    distance: float  # from the camera to the body's dock point, m
    gain: float  # by which the camera's image is brighter than usual


def true_roll(markers: Sequence[MarkerTruth], rotation: Matrix) -> float:
    """Roll (rad) from left_wing to right_wing, or without them that of the body's rotation."""
    places = {marker.name: marker for marker in markers}
    if not {'left_wing', 'right_wing'} <= places.keys():
        body = OPTICAL_FROM_BODY.T @ rotation
        return math.atan2(float(body[2, 1]), float(body[2, 2]))
    left, right = places['left_wing'], places['right_wing']
    return math.atan2(right.y - left.y, right.x - left.x)


LAB_DISTANCE = 3.3
"""From the camera to the body's origin in the lab view, in units of the body's reach: at 60
degrees the wings then span somewhat more than half of the frame."""
LAB_ELEVATION = math.radians(4.0)
RECEIVER_DISTANCE = 1.5
"""From the camera to the dock point in the receiver view when not docking, in reaches."""
RECEIVER_ELEVATION = math.radians(30.0)
ROLL_SWEEP = math.radians(60.0)
ROLL_PERIOD = 10.0
CROSSING_PITCH = math.radians(-7.65)
SETTLED = 0.1  # part of a docking approach that is flown at the final distance


class BodyPose(NamedTuple):
    """A body in the camera's optical frame: rotation (3, 3) and translation (3,), m."""

    rotation: Matrix
    translation: Vector


@dataclass(frozen=True)
class BodyOffset:
    """Where a motion puts the body, relative to flying straight ahead of the camera.

    Angles are rad, as `from_rpy` takes them; the offset is in reaches.
    """

    roll: float = 0.0
    pitch: float = 0.0
    yaw: float = 0.0
    x: float = 0.0  # ahead
    y: float = 0.0  # left
    z: float = 0.0  # up
    closeness: float = 0.0  # from 0 to 1 during a docking approach


OffsetByTime = Callable[[float], BodyOffset]


class TankerMotion:
    """The body's pose as a function of time, for a camera that does not shake."""

    def __init__(
        self, settings: TankerSettings, rig: MarkerRig, duration: float, rng: np.random.Generator
    ) -> None:
        random = _RANDOM_MOTIONS.get(settings.motion)
        self._move = random(duration, rng) if random else _MOTIONS[settings.motion]
        self._roll = math.radians(settings.roll_deg)
        self._reach = rig.reach
        lab = settings.actual_view == 'lab'
        elevation = LAB_ELEVATION if lab else RECEIVER_ELEVATION
        # Steady optical frame from level axes (x ahead, y left, z up).
        self.steady_frame: Matrix = OPTICAL_FROM_BODY @ about_y(-elevation).T
        self._look = np.array((math.cos(elevation), 0.0, math.sin(elevation)))
        docking = settings.motion == 'docking'
        # Seen from right behind, a turn about the origin stays in the middle of the frame.
        self._aim = np.array(rig.dock if docking or not lab else (0.0, 0.0, 0.0))
        usual = rig.reach * (LAB_DISTANCE if lab else RECEIVER_DISTANCE)
        self._start = settings.start_distance if docking else usual
        self._end = settings.end_distance if docking else usual

    def pose(self, time: float) -> BodyPose:
        """The body in the steady camera's optical frame at a time (s)."""
        placed = self._move(time)
        distance = self._start + (self._end - self._start) * placed.closeness
        # Wander that takes the same angle at any distance: a pilot steers closer when closer.
        scale = self._reach * min(1.0, distance / self._start)
        camera = self._aim - distance * self._look
        offset = scale * np.array((placed.x, placed.y, placed.z))
        body = from_rpy(placed.roll + self._roll, placed.pitch, placed.yaw)
        return BodyPose(self.steady_frame @ body, self.steady_frame @ (offset - camera))


def _sine(amplitude: float, period: float, time: float) -> float:
    return amplitude * math.sin(2 * math.pi * time / period)


def _roll(time: float) -> BodyOffset:
    return BodyOffset(roll=_sine(ROLL_SWEEP, ROLL_PERIOD, time))


def _translation(time: float) -> BodyOffset:
    return BodyOffset(x=_sine(0.15, 11.0, time), y=_sine(0.36, 8.0, time), z=_sine(0.22, 5.0, time))


def _roll_translation(time: float) -> BodyOffset:
    moved = _translation(time)
    return replace(moved, z=0.6 * moved.z, roll=_roll(time).roll)


def _crossing(time: float) -> BodyOffset:
    """A yaw at which one stabilizer passes its wing, then the other passes the other wing.

    The pitch sets how close (about 5 px in the lab view of 640 px): the tail lies 25 m behind
    the wings, so nose up lowers it.
    """
    return BodyOffset(pitch=CROSSING_PITCH, yaw=_sine(math.radians(42.0), 12.0, time))


def _erratic(_duration: float, rng: np.random.Generator) -> OffsetByTime:
    """Like a model moved by hand: several incommensurate frequencies in every direction."""
    hand = [(0.14, 0.11), (0.07, 0.29), (0.035, 0.67)]
    tilt = [(0.10, 0.13), (0.05, 0.31), (0.02, 0.71)]
    x, y, z = (random_wave(rng, hand) for _ in range(3))
    roll, pitch, yaw = (random_wave(rng, tilt) for _ in range(3))
    return lambda t: BodyOffset(roll(t), 0.5 * pitch(t), 0.5 * yaw(t), x(t), y(t), z(t))


def _docking(duration: float, rng: np.random.Generator) -> OffsetByTime:
    y, z = (random_wave(rng, [(0.02, 0.09), (0.008, 0.23)]) for _ in range(2))
    roll, pitch, yaw = (random_wave(rng, [(0.035, 0.07), (0.012, 0.31)]) for _ in range(3))

    def move(t: float) -> BodyOffset:
        part = min(1.0, t / ((1.0 - SETTLED) * duration))
        closeness = math.sin(0.5 * math.pi * part)
        attitude = (roll(t), 0.4 * pitch(t), 0.4 * yaw(t))
        return BodyOffset(*attitude, 0.0, y(t), z(t), closeness)

    return move


_MOTIONS: dict[str, OffsetByTime] = {
    'still': lambda time: BodyOffset(),
    'translation': _translation,
    'roll': _roll,
    'roll_translation': _roll_translation,
    'roll_360': lambda time: BodyOffset(roll=2 * math.pi * time / ROLL_PERIOD),
    'crossing': _crossing,
}
_RANDOM_MOTIONS = {'erratic': _erratic, 'docking': _docking}
"""Made for a duration (s) with a generator."""


BOOM_WIDTH = 0.9  # m
_STEP = 1e-4  # half of the time over which velocities are taken, s
_LONG_PATH = 0.25
"""A light that moves less than this during the exposure (px) is drawn standing still."""


class TankerFlight(Flight[TankerTruth]):
    """Images of a tanker's lights, with truth.

    The airframe never hides a light of the rig: all of them are drawn on top of it.
    """

    settings: TankerSettings

    def __init__(self, settings: TankerSettings | None = None) -> None:
        """Prepare a flight, of the default settings if None are given.

        Raises:
            ParameterError: the rig's file cannot be used, or a schedule names no light of it.
        """
        settings = settings or TankerSettings()
        super().__init__(settings, settings.camera(), settings.encoding)
        try:
            self.rig = load_rig(settings.layout) if settings.layout else TANKER_747
        except RigError as error:
            raise ParameterError('layout', str(error)) from error
        self._failures = self._schedule('failures')
        self._occlusions = self._schedule('occlusions')
        rng = self._rng(RandomStream.MOTION)
        self._motion = TankerMotion(self.settings, self.rig, self.duration, rng)

    def _schedule(self, setting: str) -> tuple[ScheduleEntry, ...]:
        schedule = parse_schedule(setting, getattr(self.settings, setting))
        markers = (*self.rig.names, ALL)
        for entry in schedule:
            if entry.marker not in markers:
                reason = f'{entry.marker!r} is not one of {", ".join(markers)}'
                raise ParameterError(setting, reason)
        return schedule

    def truth_at(self, time: float) -> TankerTruth:
        """What is true at any time (s)."""
        pose = self.pose(time)
        places = self._project(pose)
        before, after = (self._project(self.pose(time + step)) for step in (-_STEP, _STEP))
        velocities = (after - before) / (2 * _STEP)
        boom = self._boom(pose, places, time)
        markers = []
        lights = zip(self.rig.names, places, velocities, self._radii(pose), strict=True)
        for name, place, velocity, radius in lights:
            visible = self._shows(name, place, 0.0, boom, time)
            whole = self._shows(name, place, radius + 1.0, boom, time)
            (x, y), (vx, vy) = place.tolist(), velocity.tolist()
            markers.append(MarkerTruth(name, x, y, vx, vy, visible, whole))
        dock = pose.rotation @ np.array(self.rig.dock) + pose.translation
        return TankerTruth(
            tuple(markers),
            true_roll(markers, pose.rotation),
            pose.rotation,
            pose.translation,
            float(np.linalg.norm(dock)),
            self._gain(time),
        )

    def pose(self, time: float) -> BodyPose:
        """The body in the optical frame of the camera, which may shake, at a time (s)."""
        pose = self._motion.pose(time)
        turned = self._shake.rotation(time)
        if turned is None:
            return pose
        return BodyPose(turned @ pose.rotation, turned @ pose.translation)

    def _draw(self, truth: TankerTruth, time: float) -> Pixels:
        pose = BodyPose(truth.rotation, truth.translation)
        places = np.array([(m.x, m.y) for m in truth.markers])
        image = self._background.view(self._shake.rotation(time))
        if self.settings.airframe and self.rig.name == TANKER_747.name:
            lighting = IN_SKY if self.settings.actual_background == 'sky' else IN_LAB
            # The light stands still while the body turns under it.
            paint_tanker(image, self.camera, pose, lighting, self._motion.steady_frame)
        moved = [(m.vx, m.vy) for m in truth.markers if math.isfinite(m.vx)]
        mean_x, mean_y = np.mean(moved or [(0.0, 0.0)], axis=0)
        exposure = self.settings.exposure
        image = motion_blur(image, exposure * float(mean_x), exposure * float(mean_y))
        image = apply_gain(image, truth.gain)
        add_lights(image, self._lights(pose, places, time), truth.gain)
        boom = self._boom(pose, places, time)
        if boom is not None:
            boom.paint(image)
        return image

    def _lights(self, pose: BodyPose, places: NDArray[np.float64], time: float) -> list[Light]:
        exposure = self.settings.exposure
        first, last = (self._project(self.pose(time + s * 0.5 * exposure)) for s in (-1.0, 1.0))
        longest = float(np.nan_to_num(np.hypot(*(last - first).T)).max())
        if longest < _LONG_PATH:
            paths = places[None]
        else:
            count = min(2 * math.ceil(longest) + 1, 33)
            offsets = exposure * ((np.arange(count) + 0.5) / count - 0.5)
            paths = np.stack([self._project(self.pose(time + offset)) for offset in offsets])
        lights = map(Light, self._radii(pose), np.moveaxis(paths, 1, 0))
        named = zip(self.rig.names, lights, strict=True)
        lit = [light for name, light in named if not affected(self._failures, name, time)]
        radius = self.settings.light_radius
        return lit + [Light(radius, place[None]) for place in self._glares(time)]

    def _radii(self, pose: BodyPose) -> list[float]:
        """Larger when closer, though by the root only: the glow is the lens's."""
        usual, radius = self._usual_depth, self.settings.light_radius
        largest = max(radius, LARGEST_RADIUS)
        depths = self._optical(pose)[:, 2]
        radii = (radius * math.sqrt(usual / max(depth, 0.1)) for depth in depths)
        return [round(min(max(seen, 2.0), largest), 2) for seen in radii]

    def _optical(self, pose: BodyPose) -> NDArray[np.float64]:
        """The markers in the camera's optical frame, (n, 3), m."""
        return self.rig.positions @ pose.rotation.T + pose.translation

    def _project(self, pose: BodyPose) -> NDArray[np.float64]:
        return seen_by(self.camera, self._optical(pose))

    def _boom(self, pose: BodyPose, places: NDArray[np.float64], time: float) -> Boom | None:
        if not self._occlusions and self.settings.actual_view == 'lab':
            return None
        boom = np.array(self.rig.boom)
        below = boom + self.rig.reach * np.array((-0.1, 0.0, -0.2))
        points = np.stack((boom, below)) @ pose.rotation.T + pose.translation
        pivot, end = seen_by(self.camera, points)
        if not np.all(np.isfinite((pivot, end))) or not np.all(np.isfinite(places)):
            return None
        half = 0.5 * BOOM_WIDTH * self.camera.k[0] / float(points[0, 2])
        if self._occlusions:
            half = max(half, core_of(max(self._radii(pose))) + 1.5)
        lights = dict(zip(self.rig.names, places, strict=True))
        return place_boom(pivot, end - pivot, lights, self._occlusions, time, half)

    def _shows(
        self, name: str, place: NDArray[np.float64], radius: float, boom: Boom | None, time: float
    ) -> bool:
        if affected(self._failures, name, time) or not np.all(np.isfinite(place)):
            return False
        corners = np.stack((place - radius, place + radius))
        ends = self.camera.width - 0.5, self.camera.height - 0.5
        if not ((corners >= -0.5) & (corners < ends)).all():
            return False
        return boom is None or boom.distance(place) > radius

    @cached_property
    def _usual_depth(self) -> float:
        return float(np.median(self._optical(self._motion.pose(0.0))[:, 2]))

    @cached_property
    def _background(self) -> Background:
        settings, rng = self.settings, self._rng(RandomStream.BACKGROUND)
        in_colour = settings.encoding == 'bgr8'
        return Background(settings.actual_background, self.camera, in_colour, settings.detail, rng)

    @cached_property
    def _glares(self) -> Callable[[float], NDArray[np.float64]]:
        times = np.linspace(0.0, self.duration, 60 if self.settings.glares else 1)
        paths = np.concatenate([self._project(self.pose(float(t))) for t in times])
        return drifting_glares(
            self.settings.glares, self.camera, paths, self._rng(RandomStream.GLARES)
        )
