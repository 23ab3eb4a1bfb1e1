"""Flights of bare lights that try a tracker's names: thefts, storms, batches, lenses, any rig.

The images show discs on a dull ground and cost little, so that hundreds of flights can be flown.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.simulation.shake import Wave, random_wave
from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.frames import OPTICAL_FROM_BODY, from_rpy
from mvuav_ros.vision.reprojection import rotation_of
from mvuav_ros.vision.rig import TANKER_747, MarkerRig

Array = NDArray[np.float64]
Place = Callable[[int], Array]
"""Where a light is that is no marker, px, by frame."""

WIDTH, HEIGHT, FOCAL = 640, 480, 554.0
FPS = 30.0
RADIUS = 3.5
"""px, of every light."""
MARGIN = 8.0
"""px from the frame's edge within which no light is drawn."""
_GROUND, _GRAIN = 60.0, 4.0


class LightTruth(NamedTuple):
    """What is true of a frame.

    Attributes:
        pixels: (n, 2), the markers' places, px.
        visible: (n,), whether they shine within the frame.
        whole: (n,), whether nothing else shines close by as well.
        rotation: (3, 3), optical frame from the body's.
        translation: (3,), of the body's origin, m.
    """

    pixels: Array
    visible: NDArray[np.bool_]
    whole: NDArray[np.bool_]
    rotation: Array
    translation: Array


@dataclass(frozen=True)
class LightScene:
    """How a rig flies, and what happens to its lights.

    Attributes:
        roll, tilt: rad, amplitudes; tilt_hz how often the body pitches and yaws.
        shake: times the simulator's strongest vibration.
        near: reaches from the camera at the end of a docking approach; 0: none.
        thefts: markers that go dark while another light passes there.
        losses: markers that go dark for a third to two seconds.
        batches: whether all go dark and come back some at a time.
        dark: s, for which all are dark once.
        glares: lights that stand about.
        dropped: share of frames that never come.
        any_roll: whether the body starts at any roll.
        barrel: k1 of the lens.
        frames: of the flight.
    """

    roll: float = 0.1
    tilt: float = 0.06
    tilt_hz: float = 0.15
    shake: float = 0.0
    near: float = 0.0
    thefts: int = 0
    losses: int = 0
    batches: bool = False
    dark: float = 0.0
    glares: int = 0
    dropped: float = 0.0
    any_roll: bool = False
    barrel: float = 0.0
    frames: int = 210


class LightFlight:
    """One flight; iterating gives stamps (ns), grey images and the truth.

    Attributes:
        rig: the body.
        camera: calibrated.
    """

    def __init__(self, scene: LightScene, seed: int, rig: MarkerRig = TANKER_747) -> None:
        self.scene, self.rig = scene, rig
        matrix = (FOCAL, 0.0, 0.5 * (WIDTH - 1), 0.0, FOCAL, 0.5 * (HEIGHT - 1), 0.0, 0.0, 1.0)
        self.camera = CameraModel(WIDTH, HEIGHT, matrix, (scene.barrel, 0.0, 0.0, 0.0, 0.0))
        self._rng = np.random.default_rng(seed)
        self._move = _motion(scene, rig, self._rng)
        self._poses = [self._move(frame) for frame in range(scene.frames)]
        self._pixels = np.array(
            [self.camera.project(rig.positions, cv2.Rodrigues(r)[0], t) for r, t in self._poses]
        )
        self._dark = np.zeros((scene.frames, len(rig.names)), np.bool_)
        self._others: list[tuple[range, Place]] = []
        for number in range(scene.thefts):
            self._add_theft(number)
        self._add_losses()
        self._add_glares()

    def _add_theft(self, number: int) -> None:
        """A marker goes dark; in that moment, or up to three frames later, a light passes."""
        rng = self._rng
        marker = int(rng.integers(self._dark.shape[1]))
        gap = (self.scene.frames - 20) // self.scene.thefts
        start = 20 + gap * number + int(rng.integers(12))
        self._dark[start : start + int(rng.integers(25, 45)), marker] = True
        start += int(rng.integers(4))
        angle, speed = rng.uniform(0.0, 2 * math.pi), rng.uniform(0.3, 4.0)
        step = speed * np.array((math.cos(angle), math.sin(angle)))
        pixels, along = self._pixels[:, marker], float(rng.integers(2))
        place = pixels[min(start, len(pixels) - 1)] + rng.normal(0.0, 1.0, 2)
        first = start - int(rng.integers(30)) if rng.random() < 0.7 else start

        def at(frame: int) -> Array:
            moved = pixels[frame] - pixels[min(start, len(pixels) - 1)]
            return np.asarray(place + along * moved + step * (frame - start))

        self._others.append((range(max(first, 0), start + 48), at))

    def _add_losses(self) -> None:
        scene, rng = self.scene, self._rng
        count = self._dark.shape[1]
        for _ in range(scene.losses):
            start = int(rng.integers(10, scene.frames - 10))
            marker = int(rng.integers(count))
            self._dark[start : start + int(rng.integers(10, 60)), marker] = True
        if scene.dark:
            start = int(rng.integers(30, scene.frames // 3))
            self._dark[start : start + round(scene.dark * FPS)] = True
        start = 30
        while scene.batches and start < scene.frames - 40:
            back = start + int(rng.integers(8, 60))
            waiting = rng.permutation(count)
            while len(waiting):
                batch, waiting = np.split(waiting, [int(rng.integers(1, 4))])
                self._dark[start:back, batch] = True
                back += int(rng.integers(5, 25))
            start = back + 25

    def _add_glares(self) -> None:
        for _ in range(self.scene.glares):
            place = self._rng.uniform((40.0, 40.0), (WIDTH - 40.0, HEIGHT - 40.0))
            swing = [random_wave(self._rng, [(6.0, 0.2), (2.0, 0.7)]) for _ in range(2)]

            def at(frame: int, place: Array = place, swing: list[Wave] = swing) -> Array:
                return place + [wave(frame / FPS) for wave in swing]

            self._others.append((range(self.scene.frames), at))

    def __iter__(self) -> Iterator[tuple[int, NDArray[np.uint8], LightTruth]]:
        rng = np.random.default_rng(self._rng.integers(2**31))
        grain = rng.normal(_GROUND, _GRAIN, (HEIGHT, WIDTH)).clip(0, 255).astype(np.uint8)
        for frame in range(self.scene.frames):
            if frame > 3 and rng.random() < self.scene.dropped:
                continue
            others = [place(frame) for when, place in self._others if frame in when]
            others = [place for place in others if _is_inside(place)]
            pixels = self._pixels[frame]
            visible = ~self._dark[frame] & np.array([_is_inside(place) for place in pixels])
            lights = [*pixels[visible], *others]
            image = grain.copy()
            for light in lights:
                _draw(image, light)
            apart = np.hypot(*(pixels[:, None] - np.reshape(lights, (-1, 2))).transpose(2, 0, 1))
            alone = ((apart > 1e-9) & (apart < 2 * RADIUS + 3.0)).sum(axis=1) == 0
            truth = LightTruth(pixels, visible, visible & alone, *self._poses[frame])
            yield round(frame / FPS * 1e9), image, truth


def _is_inside(place: Array) -> bool:
    x, y = place
    return bool(MARGIN < x < WIDTH - MARGIN and MARGIN < y < HEIGHT - MARGIN)


def _draw(image: NDArray[np.uint8], place: Array) -> None:
    """Draw a light with a soft edge."""
    x0, y0 = (max(int(value) - 9, 0) for value in place)
    part = image[y0 : y0 + 19, x0 : x0 + 19]
    rows, columns = np.ogrid[y0 : y0 + part.shape[0], x0 : x0 + part.shape[1]]
    distance = np.hypot(columns - place[0], rows - place[1])
    light = (RADIUS + 0.9 - distance).clip(0.0, 1.8) / 1.8 * 250.0
    np.maximum(part, light.astype(np.uint8), out=part)


def _motion(
    scene: LightScene, rig: MarkerRig, rng: np.random.Generator
) -> Callable[[int], tuple[Array, Array]]:
    """Rotation and translation by frame: smooth, but for the camera's shaking."""
    tilts = [(scene.tilt, scene.tilt_hz), (0.4 * scene.tilt, 2.2 * scene.tilt_hz)]
    angles = [random_wave(rng, [(scene.roll, 0.1), (0.2 * scene.roll, 0.31)])]
    angles += [random_wave(rng, tilts) for _ in range(2)]
    moves = [random_wave(rng, [(0.25 * m, 0.12), (0.07 * m, 0.33)]) for m in (0.5, 1.0, 0.7)]
    shakes = [
        random_wave(rng, [(math.radians(0.2) * scene.shake * a, f) for a, f in _HARMONICS])
        for _ in range(3)
    ]
    first_roll = rng.uniform(-math.pi, math.pi) if scene.any_roll else 0.0
    distance = 4.0 if scene.near else rng.uniform(2.4, 3.2)

    def move(frame: int) -> tuple[Array, Array]:
        time = frame / FPS
        done = min(frame / (0.9 * scene.frames), 1.0)
        now = distance + (scene.near - distance) * done**2 * (3 - 2 * done) * bool(scene.near)
        roll, pitch, yaw = (wave(time) for wave in angles)
        offset = [now / distance * wave(time) for wave in moves]
        shaken = rotation_of(np.array([wave(time) for wave in shakes]))
        rotation = shaken @ OPTICAL_FROM_BODY @ from_rpy(roll + first_roll, pitch, yaw)
        translation = shaken @ OPTICAL_FROM_BODY @ (np.array((now, 0.0, 0.0)) + offset)
        return rotation, translation * rig.reach

    return move


_HARMONICS = ((1.0, 4.0), (0.5, 8.0), (0.25, 12.0))
"""Amplitude and Hz, as of the simulator's strongest vibration."""


def random_rig(count: int, seed: int) -> MarkerRig:
    """A rig whose markers lie well apart; three of them far from any line."""
    rng = np.random.default_rng(seed)
    while True:
        points = rng.uniform(-1.0, 1.0, (count, 3)) * (5.0, 10.0, 7.5)
        apart = np.hypot(*(points[:, None, 1:] - points[None, :, 1:]).transpose(2, 0, 1))
        sides = np.sort(apart[np.triu_indices(count, 1)])
        if sides[0] > 2.5 and (count > 3 or sides[2] < sides[0] + sides[1] - 1.5):
            break
    markers = tuple((f'm{i}', (float(x), float(y), float(z))) for i, (x, y, z) in enumerate(points))
    return MarkerRig(f'random_{count}', markers, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
