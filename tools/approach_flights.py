"""Simulated approaches, with truth to the pixel."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from approach_rows import Pixels, Row, Timed, judged
from numpy.typing import NDArray

from mvuav_ros.offline.evaluation.corners import LabelledFrame
from mvuav_ros.simulation.airfield import NUMBERS, Surface, draw_number, draw_terrain
from mvuav_ros.simulation.ground import GroundPainter, Ripmap, load_ground
from mvuav_ros.simulation.pinhole import CameraPose
from mvuav_ros.simulation.runway_flight import RunwayFlight, RunwayTruth, measured_attitude
from mvuav_ros.simulation.settings import RunwaySettings
from mvuav_ros.simulation.texture import smooth_noise
from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.frames import OPTICAL_FROM_BODY, Attitude, from_rpy

FLIGHTS: dict[str, dict[str, Any]] = {
    'approach': {},
    'from the right': {'seed': 3, 'lateral_offset': -12.0},
    'low pass': {'seed': 5, 'motion': 'low_pass'},
    'from afar': {'seed': 9, 'start_distance': 900.0, 'camera_pitch_deg': 5.0},
    'centred': {'seed': 11, 'lateral_offset': 0.0},
    '15 m aside': {'seed': 12, 'lateral_offset': 15.0},
    '20 m aside': {'seed': 13, 'lateral_offset': -20.0},
    'shaken': {'seed': 14, 'shake': 2},
    'low pass, seed 15': {'seed': 15, 'motion': 'low_pass'},
    'S-turn': {'seed': 16, 'motion': 's_turn'},
    'S-turn, attitude': {'seed': 16, 'motion': 's_turn'},
    'noise, defocus': {'seed': 17, 'noise': 6.0, 'blur': 1.5},
}
BANKS = {f'bank {bank}': bank for bank in (-30, -20, 20, 30)}
"""Degrees by which an approach flies banked; the attitude comes from the simulated sensor, as on
flights so named."""
STEEP: dict[str, dict[str, Any]] = {
    'pitch 26': {'seed': 31, 'camera_pitch_deg': 26.0},
    'pitch 26, attitude': {'seed': 31, 'camera_pitch_deg': 26.0},
    'pitch 32, shaken': {'seed': 32, 'camera_pitch_deg': 32.0, 'shake': 2},
    'pitch 32, shaken, attitude': {'seed': 32, 'camera_pitch_deg': 32.0, 'shake': 2},
    'low pass, pitch 28': {'seed': 33, 'camera_pitch_deg': 28.0, 'motion': 'low_pass'},
    'low pass, pitch 28, attitude': {'seed': 33, 'camera_pitch_deg': 28.0, 'motion': 'low_pass'},
    'slabs, pitch 27': {'seed': 34, 'camera_pitch_deg': 27.0},
    'slabs, pitch 27, attitude': {'seed': 34, 'camera_pitch_deg': 27.0},
    'slabs, low pass, pitch 30': {'seed': 35, 'camera_pitch_deg': 30.0, 'motion': 'low_pass'},
    'slabs, low pass, pitch 30, attitude': {
        'seed': 35,
        'camera_pitch_deg': 30.0,
        'motion': 'low_pass',
    },
}
"""The camera looks down: no horizon is in view, and the runway reaches the top."""
STEEP_CHECK = tuple(name for name in STEEP if 'pitch 32' in name or 'pitch 30' in name)
LOOKING_DOWN: dict[str, dict[str, Any]] = {
    'pitch 26': {'camera_pitch_deg': 26.0},
    'low pass, pitch 30': {'camera_pitch_deg': 30.0, 'motion': 'low_pass'},
    'slabs, pitch 29, shaken': {'camera_pitch_deg': 29.0, 'shake': 2},
    'pitch 31, shaken': {'camera_pitch_deg': 31.0, 'shake': 2},
    'pitch 33, shaken': {'camera_pitch_deg': 33.0, 'shake': 2},
}
"""The same with several seeds each, whose pitch differs by up to 1.2 degrees."""
GREY = ', grey'
LOOKING_DOWN_GREY: dict[str, dict[str, Any]] = {
    'pitch 31, shaken, grey': LOOKING_DOWN['pitch 31, shaken'],
    'slabs, pitch 29, shaken, grey': LOOKING_DOWN['slabs, pitch 29, shaken'],
    'bright slabs, pitch 29, shaken, grey': LOOKING_DOWN['slabs, pitch 29, shaken'],
}
"""The same before a camera without colours, to which the other slabs are as bright as the land."""
OVERFLOWN: dict[str, dict[str, Any]] = {
    'low': {'camera_pitch_deg': 8.0, 'motion': 'low_pass', 'runway_length': 500.0},
    'low, narrow, shaken': {
        'camera_pitch_deg': 10.0,
        'motion': 'low_pass',
        'runway_length': 400.0,
        'runway_width': 14.0,
        'shake': 2,
    },
    'slabs, low': {'camera_pitch_deg': 8.0, 'motion': 'low_pass', 'runway_length': 400.0},
    'airstrip, low': {
        'camera_pitch_deg': 12.0,
        'motion': 'low_pass',
        'runway_length': 300.0,
        'runway_width': 12.0,
    },
    'S-turn': {'camera_pitch_deg': 15.0, 'motion': 's_turn', 'runway_length': 600.0},
    'S-turn, narrow': {
        'camera_pitch_deg': 12.0,
        'motion': 's_turn',
        'runway_length': 500.0,
        'runway_width': 15.0,
    },
}
"""Flights over a short runway, whose near end is out of sight and whose far end is not, with a
horizon in view; at a height of 22 m, or 70 m and banked. Each has several seeds, as above."""
CAMERAS: tuple[dict[str, float], ...] = (
    {},
    {'blur': 1.0, 'noise': 4.0},
    {'visibility': 2500.0},
    {'blur': 1.6, 'visibility': 5000.0},
    {'noise': 8.0, 'gain_steps': 0.1},
)
"""By seed, of flights over a runway: what else spoils the picture."""


def overflown_settings(name: str, seed: int) -> dict[str, Any]:
    """Settings of one of `OVERFLOWN`."""
    return {**OVERFLOWN[name], 'seed': seed, **CAMERAS[seed % len(CAMERAS)]}


HIGHER = 'concrete, higher, grey'
"""Flights over concrete slabs of any kind, higher than on a glide path, before a grey
camera that looks down: the runway reaches the top of the picture, no horizon is in view."""
HIGHER_SEEDS = range(250, 258), range(260, 272)
"""Tuned, and check."""


def higher_settings(name: str, seed: int) -> dict[str, Any]:
    """Settings of `HIGHER`: what the camera is like is drawn at random."""
    draw = np.random.default_rng((seed, 78))
    width = int(draw.choice([320, 640]))
    fov = float(draw.uniform(35.0, 65.0))
    upright = 2.0 * math.degrees(math.atan(0.75 * math.tan(math.radians(fov / 2.0))))
    return {
        'seed': seed,
        'width': width,
        'height': 3 * width // 4,
        'fov_deg': fov,
        'camera_pitch_deg': upright / 2.0 + float(draw.uniform(2.0, 8.0)),
        'shake': int(draw.integers(0, 3)),
        'noise': float(draw.choice([1.0, 2.0, 4.0])),
        'runway_width': float(draw.uniform(20.0, 45.0)),
        'lateral_offset': float(draw.uniform(-8.0, 8.0)),
        'visibility': float(draw.uniform(3000.0, 20000.0)),
    }


TUNED_SEEDS, CHECK_SEEDS = range(100, 105), range(135, 140)
FLIGHT_FRAMES = 275


def label_of(truth: RunwayTruth) -> LabelledFrame | None:
    """The ends of what is in view of both edges of a runway, if there is something of each."""
    left, right = truth.lines[:2]
    if not (left.visible and right.visible):
        return None
    near, far = (
        ((left.x1, left.y1), (right.x1, right.y1)),
        ((right.x2, right.y2), (left.x2, left.y2)),
    )
    return LabelledFrame('', *near, *far)


MIN_IN_VIEW = 0.2
"""Of the height of the image: less of an edge is no view of it."""


def is_long(label: LabelledFrame | None, height: int) -> bool:
    """Whether both edges are long enough in the picture, and go up in it."""
    if label is None:
        return False
    edges = (label.near_left, label.far_left), (label.near_right, label.far_right)
    return all(near[1] - far[1] >= MIN_IN_VIEW * height for near, far in edges)


def slope_of(truth: RunwayTruth) -> float:
    """Of the horizon, rad, right end down positive."""
    return math.atan(-1.0 / math.tan(truth.horizon[1]))


class BankedFlight(RunwayFlight):
    """A flight with one wing down all the time."""

    bank_deg = 0.0

    def pose(self, time: float) -> CameraPose:
        """As `RunwayFlight.pose`, rolled."""
        pose = super().pose(time)
        roll = pose.roll + math.radians(self.bank_deg)
        rotation = from_rpy(roll, pose.pitch, pose.yaw) @ OPTICAL_FROM_BODY.T
        return CameraPose(pose.position, roll, pose.pitch, pose.yaw, rotation)


class Slabs(Surface):
    """A runway of concrete slabs with dark joints and no side lines; a taxiway joins it."""

    def _pavement(
        self, width: float, length: float, detail: float, rng: np.random.Generator
    ) -> NDArray[np.float32]:
        pavement = 1.5 * super()._pavement(width, length, detail, rng)
        x, y = self._centres(0)[None, :], self._centres(1)[:, None]
        for places in (x, y):
            joint = np.abs((places + 0.25) % 7.5 - 0.25) < 0.16
            pavement *= np.where(joint, 0.72, 1.0)[:, :, None]
        return np.asarray(pavement, np.float32)

    def _mark(self, width: float, length: float) -> None:
        self._mark_end(width / 30.0, 0.5 * width, length, far=False)


class BrightSlabs(Slabs):
    """The same of light concrete."""

    def _pavement(
        self, width: float, length: float, detail: float, rng: np.random.Generator
    ) -> NDArray[np.float32]:
        return np.asarray(1.5 * super()._pavement(width, length, detail, rng), np.float32)


class Concrete(Slabs):
    """Slabs whose size, brightness and joints are drawn at random; few markings or a number."""

    def __init__(
        self, land: NDArray[np.uint8], width: float, length: float, detail: float, seed: int
    ) -> None:
        self._drawn = np.random.default_rng((seed, 1004))
        super().__init__(land, width, length, detail, seed)

    def _pavement(
        self, width: float, length: float, detail: float, rng: np.random.Generator
    ) -> NDArray[np.float32]:
        draw = self._drawn
        pavement = Surface._pavement(self, width, length, detail, rng) * draw.uniform(1.2, 2.6)
        across = width / round(width / draw.uniform(3.5, 7.6))
        sizes = float(draw.choice([5.0, 6.0, 7.5])), across
        half, dark = draw.uniform(0.04, 0.2), draw.uniform(0.4, 0.9)
        places = self._centres(0)[None, :], self._centres(1)[:, None] + 0.5 * width
        column, row = (
            np.floor(p / size).astype(int) for p, size in zip(places, sizes, strict=True)
        )
        tones = 1.0 + draw.uniform(0.0, 0.06) * draw.normal(size=(64, 512))
        pavement *= tones[row % 64, column % 512][:, :, None]
        for place, size in zip(places, sizes, strict=True):
            joint = np.abs((place + 0.5 * size) % size - 0.5 * size) < half
            pavement *= np.where(joint, dark, 1.0)[:, :, None]
        return np.asarray(pavement, np.float32)

    def _mark(self, width: float, length: float) -> None:
        if self._drawn.random() < 0.4:
            super()._mark(width, length)
            return
        draw_number(partial(self._cover, self._paint), NUMBERS[0], 12.0, width / 30.0)


class Airstrip(Surface):
    """A runway of patched asphalt without any markings."""

    def _pavement(
        self, width: float, length: float, detail: float, rng: np.random.Generator
    ) -> NDArray[np.float32]:
        pavement = super()._pavement(width, length, detail, rng)
        patches = smooth_noise(self._shape, 24.0, rng, octaves=2, stretch=4.0)
        return np.asarray(pavement * (0.8 + 0.12 * patches)[:, :, None], np.float32)

    def _mark(self, width: float, length: float) -> None:
        """There are none."""


SURFACES = {
    'concrete': Concrete,
    'bright slabs': BrightSlabs,
    'slabs': Slabs,
    'airstrip': Airstrip,
}


def flight_of(name: str, given: dict[str, Any]) -> BankedFlight:
    """A flight with settings; its name says what runway is drawn."""
    for word, surface in SURFACES.items():
        if word in name:
            kind = HigherFlight if HIGHER in name else SurfaceFlight
            return kind(RunwaySettings(frames=1000, **given), surface)
    return BankedFlight(RunwaySettings(frames=1000, **given))


def frames_between(flight: BankedFlight, first: float, last: float, step: int) -> range:
    """Numbers of the frames from one place to another, m behind the near end."""
    settings = flight.settings
    ways = settings.start_distance + first, settings.start_distance + last
    begin, end = (round(way / settings.speed * settings.fps) for way in ways)
    return range(begin, end, step)


class SurfaceFlight(BankedFlight):
    """A flight to a runway with another surface."""

    def __init__(self, settings: RunwaySettings, surface: type[Surface]) -> None:
        super().__init__(settings)
        self._surface = surface

    @cached_property
    def _painter(self) -> GroundPainter:
        s = self.settings
        ground = load_ground(s.runway_width, s.runway_length, s.detail, s.seed)
        land = draw_terrain(s.runway_length, s.detail, s.seed)
        surface = self._surface(land, s.runway_width, s.runway_length, s.detail, s.seed)
        runway = Ripmap(surface.texture, surface.origin, surface.step, wrap=False)
        return GroundPainter(ground._replace(runway=runway), self.camera, s.visibility)


class HigherFlight(SurfaceFlight):
    """The same, higher than on a glide path by a factor drawn at random."""

    def pose(self, time: float) -> CameraPose:
        """As `RunwayFlight.pose`, higher."""
        pose = super().pose(time)
        higher = float(np.random.default_rng((self.settings.seed, 79)).uniform(1.2, 4.0))
        return pose._replace(position=pose.position * (1.0, 1.0, higher))


def simulated(name: str, step: int, cache: Path | None) -> Row:
    """A simulated flight down to 20 m before the runway; within 3 px of the true ends."""
    return of_flight(name, (FLIGHTS | STEEP).get(name, {'seed': 21}), step, cache)


def looking_down_settings(name: str, seed: int) -> dict[str, Any]:
    """Settings of one of `LOOKING_DOWN` or `LOOKING_DOWN_GREY`."""
    settings = (LOOKING_DOWN | LOOKING_DOWN_GREY)[name]
    pitch = settings['camera_pitch_deg'] + 0.3 * (seed % 5)
    return {**settings, 'seed': seed, 'camera_pitch_deg': pitch}


def looking_down(name: str, seeds: range, step: int, cache: Path | None) -> Row:
    """Several flights with a camera that looks down, each without its first frames."""
    return of_flights('looking down', looking_down_settings, name, seeds, step, cache)


def higher(name: str, seeds: range, step: int, cache: Path | None) -> Row:
    """Several flights of `HIGHER`, each without its first frames."""
    return of_flights('higher', higher_settings, name, seeds, step, cache)


def overflown(name: str, seeds: range, step: int, cache: Path | None) -> Row:
    """Several flights over a runway, each without its first frames."""
    return of_flights('over', overflown_settings, name, seeds, step, cache)


def of_flights(
    kind: str,
    settings: Callable[[str, int], dict[str, Any]],
    name: str,
    seeds: range,
    step: int,
    cache: Path | None,
) -> Row:
    """The row of several flights of a kind, one for each seed; attitude is known if so named."""
    plain = name.removesuffix(', attitude')
    rows = []
    for seed in seeds:
        flown = name.replace(plain, f'{kind}, {plain}, seed {seed}')
        rows.append(of_flight(flown, settings(plain, seed), step, cache))
    frames = [frame for row in rows for frame in row.frames[row.warm_up :]]
    row = Row(f'{name}, seeds {seeds[0]} to {seeds[-1]}', frames, warm_up=0)
    for time in ('first_ms', 'later_ms', 'opencv_ms'):
        setattr(row, time, float(np.mean([getattr(each, time) for each in rows])))
    return row


def of_flight(name: str, given: dict[str, Any], step: int, cache: Path | None) -> Row:
    """The row of a flight with settings; its name says what is drawn, and whether attitude is."""
    flight = flight_of(name, given)
    flight.bank_deg = BANKS.get(name, 0.0)
    settings = flight.settings
    row, detector = Row(f'simulated {name}'), Timed(settings.runway_width)
    camera = flight.camera
    detector.detector.set_camera(
        CameraModel(camera.width, camera.height, tuple(camera.matrix.ravel()))
    )
    last = int((settings.start_distance - 20) / settings.speed * settings.fps)
    errors = []
    frames = range(last - FLIGHT_FRAMES, last, step)
    near_by = name in STEEP or name.startswith(('looking down', 'higher', 'over'))
    if name.startswith('over'):
        # The far end then goes out of view.
        frames = frames_between(flight, 20.0, settings.runway_length - 60.0, step)
    elif near_by:
        # Of the near end until the far one comes into view.
        begin = last - 100 if name.startswith('higher') else last - 50
        frames = range(begin, last + 150, step)
    for index in frames:
        truth = flight.truth_at(flight.seen_at(index))
        if not all(line.visible for line in truth.lines[:2]):
            continue
        if name.startswith('higher') and not is_long(label_of(truth), flight.camera.height):
            continue
        attitude = None
        if name in BANKS or name.endswith('attitude'):
            attitude = Attitude(*measured_attitude(truth.pose, settings.seed, index))
        image = drawn(flight, name.removesuffix(', attitude').replace(GREY, ''), index, cache)
        if GREY in name:
            image = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY))
        result = detector.process(image, attitude)
        worst, allowed = 0.0, 3.0
        if near_by:
            # As labelled flights are judged: near by, the runway is as wide as the frame.
            left, right = truth.lines[:2]
            ends = (left.x1, right.x1), (left.x2, right.x2)
            allowed = max(allowed, *(0.05 * abs(b - a) for a, b in ends))
        for line in result.lines[:2]:
            true = truth.lines[line.role - 1]
            for x, y in ((true.x1, true.y1), (true.x2, true.y2)):
                away = abs(x * math.cos(line.theta) + y * math.sin(line.theta) - line.rho)
                worst = max(worst, away / allowed if line.found else math.inf)
        row.frames.append(judged(str(index), detector, result, worst))
        guidance = result.guidance
        if guidance is not None and guidance.known:
            pose = truth.pose
            errors.append(
                (
                    100 * (guidance.z / pose.position[2] - 1),
                    guidance.y - pose.position[1],
                    math.degrees(guidance.yaw - pose.yaw),
                    math.dist(result.vanishing_point, truth.vanishing_point),
                )
            )
    if errors:
        height, aside, yaw, place = np.sqrt((np.array(errors) ** 2).mean(axis=0))
        row.name += f' z{height:.1f}% y{aside:.2f} {yaw:.2f}° vp{place:.1f}'
    return detector.put(row)


def drawn(flight: RunwayFlight, name: str, index: int, cache: Path | None) -> Pixels:
    """A frame of a simulated flight, kept as PNG where that was asked for."""
    if cache is None:
        return flight.frame(index).image.pixels
    path = cache / name.replace(' ', '_') / f'{index}.png'
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        # As a whole: another evaluation may read it meanwhile.
        written = path.with_suffix(f'.{os.getpid()}.png')
        cv2.imwrite(str(written), flight.frame(index).image.pixels)
        written.replace(path)
    return cv2.imread(str(path))
