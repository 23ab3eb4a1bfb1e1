"""The synthetic flight behind a tanker with marker lights."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.parameters.declaration import ParameterError
from mvuav_ros.simulation.airframe import IN_LAB, IN_SKY, tanker_mesh
from mvuav_ros.simulation.boom import Boom, place_boom
from mvuav_ros.simulation.exposure import apply_gain, motion_blur
from mvuav_ros.simulation.flight import Flight, SimulatedFrame, Stream
from mvuav_ros.simulation.lights import LARGEST_RADIUS, Glares, Light, LightProfile, add_lights
from mvuav_ros.simulation.mesh import paint_mesh
from mvuav_ros.simulation.motion import BodyPose, TankerMotion
from mvuav_ros.simulation.schedule import (
    ALL,
    ScheduleError,
    affected,
    parse_schedule,
    refuse_unknown,
)
from mvuav_ros.simulation.settings import TankerSettings
from mvuav_ros.simulation.sky import Background
from mvuav_ros.simulation.tanker_truth import MarkerTruth, TankerTruth, true_roll
from mvuav_ros.vision.image import Image
from mvuav_ros.vision.point_operations import Pixels
from mvuav_ros.vision.rig import TANKER_747, MarkerRig, RigError, load_rig

BOOM_WIDTH = 0.9
"""m."""
_STEP = 1e-4
"""Half of the time over which velocities are taken, s."""
_LONG_PATH = 0.25
"""A light that moves less than this during the exposure (px) is drawn standing still."""


class TankerFlight(Flight[TankerTruth]):
    """Images of a tanker's lights, with truth.

    The airframe never hides a light: all of them are drawn on top of it.

    Attributes:
        settings: what was asked for.
        rig: the body's lights.
    """

    def __init__(self, settings: TankerSettings | None = None) -> None:
        """Prepare a flight, of the default settings if None are given.

        Raises:
            ParameterError: the rig's file cannot be used, or a schedule names no light of it.
        """
        self.settings = settings or TankerSettings()
        super().__init__(self.settings, self.settings.camera())
        self.rig = _open_rig(self.settings)
        self._failures = parse_schedule(self.settings.failures)
        self._occlusions = parse_schedule(self.settings.occlusions)
        for name, schedule in (('failures', self._failures), ('occlusions', self._occlusions)):
            try:
                refuse_unknown(schedule, (*self.rig.names, ALL))
            except ScheduleError as error:
                raise ParameterError(name, str(error)) from error
        self._motion = TankerMotion(
            self.settings, self.rig, self.duration, self._rng(Stream.MOTION)
        )

    def truth_at(self, time: float) -> TankerTruth:
        """What is true at any time (s)."""
        pose = self.pose(time)
        places = self._project(pose)
        velocities = (
            self._project(self.pose(time + _STEP)) - self._project(self.pose(time - _STEP))
        ) / (2 * _STEP)
        boom = self._boom(pose, places, time)
        markers = []
        for name, place, velocity, profile in zip(
            self.rig.names, places, velocities, self._profiles(pose), strict=True
        ):
            (x, y), (vx, vy) = place.tolist(), velocity.tolist()
            visible = self._shows(name, place, 0.0, boom, time)
            whole = self._shows(name, place, profile.radius + 1.0, boom, time)
            markers.append(MarkerTruth(name, x, y, vx, vy, visible, whole))
        dock = pose.rotation @ np.array(self.rig.dock) + pose.translation
        return TankerTruth(
            time,
            tuple(markers),
            true_roll(markers, pose.rotation),
            pose.rotation,
            pose.translation,
            float(np.linalg.norm(dock)),
            self._gain(time),
            self.camera,
        )

    def pose(self, time: float) -> BodyPose:
        """The body in the optical frame of the camera, which may shake, at a time (s)."""
        pose = self._motion.pose(time)
        if self._shake.still:
            return pose
        turned = self._shake.rotation(time)
        return BodyPose(turned @ pose.rotation, turned @ pose.translation)

    def frame(self, index: int) -> SimulatedFrame[TankerTruth]:
        """Draw frame ``index``, dropped or not."""
        time = self.seen_at(index)
        truth = self.truth_at(time)
        image = Image(self._exposed(self._draw(truth, time), time), self.settings.encoding)
        return SimulatedFrame(self.stamp_ns(index), image, truth)

    def _draw(self, truth: TankerTruth, time: float) -> Pixels:
        pose = BodyPose(truth.rotation, truth.translation)
        places = np.array([(m.x, m.y) for m in truth.markers])
        image = self._background.view(None if self._shake.still else self._shake.rotation(time))
        lab = self.settings.actual_background != 'sky'
        if self.settings.airframe and self.rig.name == TANKER_747.name:
            lighting = IN_LAB if lab else IN_SKY
            # The light stands still while the body turns under it.
            light = self._motion.steady_frame() @ np.array(lighting.towards)
            lighting = replace(lighting, towards=tuple(light.tolist()))
            paint_mesh(image, tanker_mesh(), self.camera, pose, lighting)
        mean_x, mean_y = np.nanmean([(m.vx, m.vy) for m in truth.markers], axis=0)
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
        lights = [
            Light(profile, path)
            for name, profile, path in zip(
                self.rig.names, self._profiles(pose), np.moveaxis(paths, 1, 0), strict=True
            )
            if not affected(self._failures, name, time)
        ]
        profile = LightProfile(self.settings.light_radius)
        return lights + [Light(profile, place[None]) for place in self._glares.places(time)]

    def _profiles(self, pose: BodyPose) -> list[LightProfile]:
        """Larger when closer, though by the root only: the glow is the lens's."""
        usual = self._usual_depth
        radius = self.settings.light_radius
        largest = max(radius, LARGEST_RADIUS)
        depths = self._optical(pose)[:, 2]
        radii = (radius * math.sqrt(usual / max(depth, 0.1)) for depth in depths)
        return [LightProfile(round(min(max(seen, 2.0), largest), 2)) for seen in radii]

    def _optical(self, pose: BodyPose) -> NDArray[np.float64]:
        """The markers in the camera's optical frame, (n, 3), m."""
        return self.rig.positions @ pose.rotation.T + pose.translation

    def _project(self, pose: BodyPose) -> NDArray[np.float64]:
        return self.camera.project(self._optical(pose))

    def _boom(self, pose: BodyPose, places: NDArray[np.float64], time: float) -> Boom | None:
        if not self._occlusions and self.settings.actual_view == 'lab':
            return None
        boom = np.array(self.rig.boom)
        below = boom + self.rig.reach * np.array((-0.1, 0.0, -0.2))
        points = np.stack((boom, below)) @ pose.rotation.T + pose.translation
        pivot, end = self.camera.project(points)
        if not np.all(np.isfinite((pivot, end))) or not np.all(np.isfinite(places)):
            return None
        half = 0.5 * BOOM_WIDTH * self.camera.fx / float(points[0, 2])
        if self._occlusions:
            half = max(half, max(profile.core for profile in self._profiles(pose)) + 1.5)
        lights = dict(zip(self.rig.names, places, strict=True))
        return place_boom(pivot, end - pivot, lights, self._occlusions, time, half)

    def _shows(
        self, name: str, place: NDArray[np.float64], radius: float, boom: Boom | None, time: float
    ) -> bool:
        if affected(self._failures, name, time) or not np.all(np.isfinite(place)):
            return False
        corners = np.stack((place - radius, place + radius))
        if not self.camera.contains(corners).all():
            return False
        return boom is None or boom.distance(place) > radius

    @cached_property
    def _usual_depth(self) -> float:
        return float(np.median(self._optical(self._motion.pose(0.0))[:, 2]))

    @cached_property
    def _background(self) -> Background:
        return Background(
            self.settings.actual_background,
            self.camera,
            self.settings.encoding == 'bgr8',
            self.settings.detail,
            self._rng(Stream.BACKGROUND),
        )

    @cached_property
    def _glares(self) -> Glares:
        times = np.linspace(0.0, self.duration, 60 if self.settings.glares else 1)
        paths = np.concatenate([self._project(self.pose(float(t))) for t in times])
        return Glares(self.settings.glares, self.camera, paths, self._rng(Stream.GLARES))


def _open_rig(settings: TankerSettings) -> MarkerRig:
    if not settings.layout:
        return TANKER_747
    try:
        return load_rig(settings.layout)
    except RigError as error:
        raise ParameterError('layout', str(error)) from error
