"""Single views of simulated runways from over them, each from another place and another camera.

What differs between airfields and cameras is drawn at random: the runway's size and markings, how
bright and colourful it and the land are, the camera's place, turn, field of view and faults.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import cv2
import numpy as np
from approach_flights import Airstrip, Concrete, Slabs, SurfaceFlight, is_long, label_of, slope_of
from approach_rows import Pixels
from numpy.typing import NDArray

from mvuav_ros.offline.evaluation.corners import LabelledFrame
from mvuav_ros.simulation.airfield import Surface
from mvuav_ros.simulation.pinhole import CameraPose
from mvuav_ros.simulation.settings import RunwaySettings
from mvuav_ros.vision.frames import OPTICAL_FROM_BODY, from_rpy


class Glimpses(SurfaceFlight):
    """Frames of one runway; each is from another place.

    Attributes:
        surfaces: by seed.
        widest: of the runways, m.
    """

    widest = 45.0
    surfaces: tuple[type[Surface], ...] = (Surface, Surface, Slabs, Airstrip, Airstrip)

    def pose(self, time: float) -> CameraPose:
        """Anywhere over the runway, looking about along it, at the time of a frame."""
        settings = self.settings
        width, length = settings.runway_width, settings.runway_length
        rng = np.random.default_rng((settings.seed, round(time * settings.fps)))
        height = width * math.exp(rng.uniform(math.log(0.4), math.log(4.0)))
        ahead = math.exp(rng.uniform(math.log(1.5 * height), math.log(length)))
        position = np.array((length - ahead, width * rng.uniform(-1.0, 1.0), height))
        roll, yaw = (math.radians(degrees) * rng.normal() for degrees in (9.0, 5.0))
        pitch = math.radians(settings.camera_pitch_deg + 3.0 * rng.normal())
        rotation = from_rpy(roll, pitch, yaw) @ OPTICAL_FROM_BODY.T
        return CameraPose(position, roll, pitch, yaw, rotation)


class GlimpsesBefore(Glimpses):
    """The same from before the near end, which is in view."""

    surfaces = Surface, Concrete, Concrete, Airstrip

    def pose(self, time: float) -> CameraPose:
        """Anywhere before the runway, looking about at its near end, at the time of a frame."""
        settings = self.settings
        width = settings.runway_width
        rng = np.random.default_rng((settings.seed, round(time * settings.fps)))
        height = width * math.exp(rng.uniform(math.log(0.5), math.log(6.0)))
        down = math.radians(math.exp(rng.uniform(math.log(5.0), math.log(40.0))))
        away = height / math.tan(down)
        aside = width * float(rng.uniform(-1.5, 1.5))
        view = 2.0 * math.atan(0.5 * self.camera.height / self.camera.k[4])
        pitch = down + view * float(rng.uniform(-0.3, 0.42))
        roll, turned = (math.radians(degrees) * rng.normal() for degrees in (6.0, 4.0))
        yaw = rng.uniform(0.3, 1.0) * math.atan2(-aside, away) + turned
        rotation = from_rpy(roll, pitch, yaw) @ OPTICAL_FROM_BODY.T
        return CameraPose(np.array((-away, aside, height)), roll, pitch, yaw, rotation)


class RoadGlimpses(Glimpses):
    """The same as from a car on a narrow strip, which is a road then."""

    widest = 15.0
    surfaces = Surface, Airstrip

    def pose(self, time: float) -> CameraPose:
        """Anywhere on the road, looking along it, at the time of a frame."""
        settings = self.settings
        rng = np.random.default_rng((settings.seed, round(time * settings.fps)))
        along = settings.runway_length * float(rng.uniform(0.1, 0.6))
        aside = 0.4 * settings.runway_width * float(rng.uniform(-1.0, 1.0))
        roll, turned = (math.radians(degrees) * rng.normal() for degrees in (1.0, 2.0))
        pitch = math.radians(float(rng.uniform(-2.0, 10.0)))
        rotation = from_rpy(roll, pitch, turned) @ OPTICAL_FROM_BODY.T
        position = np.array((along, aside, float(rng.uniform(1.0, 2.2))))
        return CameraPose(position, roll, pitch, turned, rotation)


def settings_of(seed: int, rng: np.random.Generator, widest: float) -> RunwaySettings:
    """A camera, and a runway of up to a width (m), drawn at random."""
    width = float(rng.uniform(8.0, widest))
    return RunwaySettings(
        frames=1000,
        seed=seed,
        exposure=0.0,
        fov_deg=float(rng.uniform(40.0, 95.0)),
        camera_pitch_deg=float(rng.uniform(0.0, 32.0)),
        runway_width=width,
        runway_length=max(200.0, width * float(rng.uniform(8.0, 40.0))),
        visibility=float(rng.uniform(2000.0, 20000.0)),
        noise=float(rng.choice([1.0, 2.0, 5.0])),
    )


def glimpses(
    seeds: range, most: int, kind: type[Glimpses] = Glimpses
) -> Iterator[tuple[Pixels, LabelledFrame, float]]:
    """At most so many views of a kind of each seed's runway.

    Yields:
        The image, blue first, the corners of what is in view, and the horizon's slope, rad.
    """
    for seed in seeds:
        rng = np.random.default_rng((seed, 77))
        flight = kind(settings_of(seed, rng, kind.widest), kind.surfaces[seed % len(kind.surfaces)])
        found = 0
        for index in range(4 * most):
            truth = flight.truth_at(flight.seen_at(index))
            label = label_of(truth)
            if label is None or not is_long(label, flight.camera.height) or found == most:
                continue
            found += 1
            image = flight.frame(index).image.pixels
            yield recoloured(image, label, truth.horizon, rng), label, slope_of(truth)


def road_views(seeds: range, most: int) -> Iterator[tuple[Pixels, float]]:
    """So many views of each seed's road: image and the horizon's slope, rad."""
    for seed in seeds:
        rng = np.random.default_rng((seed, 77))
        surfaces = RoadGlimpses.surfaces
        settings = settings_of(seed, rng, RoadGlimpses.widest)
        flight = RoadGlimpses(settings, surfaces[seed % len(surfaces)])
        for index in range(most):
            truth = flight.truth_at(flight.seen_at(index))
            image, label = flight.frame(index).image.pixels, label_of(truth)
            if label is not None:
                image = recoloured(image, label, truth.horizon, rng)
            yield image, slope_of(truth)


def recoloured(
    image: Pixels, label: LabelledFrame, horizon: tuple[float, float], rng: np.random.Generator
) -> Pixels:
    """Runway, land and sky brighter or darker, of other colours, and blurred; as JPEG."""
    height, width = image.shape[:2]
    rows, columns = np.mgrid[:height, :width].astype(np.float32)
    rho, theta = horizon
    level = math.cos(theta) * columns + math.sin(theta) * rows - rho
    sky = np.clip(0.5 - level * math.copysign(1.0, math.sin(theta)), 0.0, 1.0)[:, :, None]
    pairs = (label.far_left, label.near_left), (label.far_right, label.near_right)
    down = [_beyond(*pair) if _is_cut(pair[1], width, height) else pair[1] for pair in pairs]
    polygon = np.array([*down, label.far_right, label.far_left])
    mask = np.zeros((height, width), np.uint8)
    cv2.fillPoly(mask, [np.rint(16 * polygon).astype(np.int32)], 255, cv2.LINE_AA, 4)
    pavement = cv2.GaussianBlur(mask, (3, 3), 0)[:, :, None] / np.float32(255)
    land = np.maximum(1.0 - pavement - sky, 0.0)
    colours = image.astype(np.float32)
    usual = (colours * land).sum(axis=(0, 1)) / max(float(land.sum()), 1.0)
    of_pavement, of_land = (
        np.exp(rng.normal(0.0, spread)) * np.exp(rng.normal(0.0, colour, 3))
        for spread, colour in ((0.4, 0.03), (0.3, 0.08))
    )
    of_land = of_land * (1.0 - float(rng.uniform(0.0, 0.5)) * patches((height, width), rng))
    alike = float(rng.uniform(0.0, 0.7))
    drawn = (1.0 - alike) * colours * of_pavement + alike * usual * of_land
    bright = 255.0 - (255.0 - colours) * float(rng.uniform(0.0, 1.3))
    mixed = pavement * drawn + land * colours * of_land + sky * bright
    blur = float(rng.choice([0.0, 0.8, 1.5, 2.5]))
    if blur:
        mixed = cv2.GaussianBlur(mixed, (0, 0), blur)
    quality = [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(30, 96))]
    packed = cv2.imencode('.jpg', np.clip(mixed, 0, 255).astype(np.uint8), quality)[1]
    return np.asarray(cv2.imdecode(packed, cv2.IMREAD_COLOR))


def patches(size: tuple[int, int], rng: np.random.Generator) -> NDArray[np.float32]:
    """(height, width, 1) from 0 to 1: dark patches of grass and bushes of several sizes."""
    height, width = size
    total = np.zeros(size, np.float32)
    for cell in (5, 12, 30, 80):
        noise = rng.random((height // cell + 2, width // (2 * cell) + 2)).astype(np.float32)
        total += rng.random() * cv2.resize(noise, (width, height), interpolation=cv2.INTER_CUBIC)
    total -= total.min()
    return np.asarray(total / total.max())[:, :, None]


def _is_cut(near: tuple[float, float], width: int, height: int) -> bool:
    """Whether an edge goes on beyond the image."""
    x, y = near
    return not (1.0 < x < width - 2.0 and y < height - 2.0)


def _beyond(far: tuple[float, float], near: tuple[float, float]) -> tuple[float, float]:
    return far[0] + 6.0 * (near[0] - far[0]), far[1] + 6.0 * (near[1] - far[1])
