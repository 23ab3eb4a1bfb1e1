"""Flights of lights that try a tracker, made without anything of the package.

Motion, projection, lens and drawing are written anew here, so that no mistake of the simulator's is
taken for the truth. A body steers from one place to the next as a pilot would, lights go out, other
lights take their places, and frames are lost.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Pixels = NDArray[np.uint8]

WIDTH, HEIGHT = 640, 480
MATRIX = np.array([(612.0, 0.0, 331.0), (0.0, 608.0, 229.0), (0.0, 0.0, 1.0)])
DISTORTION = (-0.11, 0.03, 0.0008, -0.0006)
"""k1, k2, p1, p2."""
FPS = 30.0
SUBSTEPS = 4
SHARPNESS = 0.45
"""px, over which a light's edge falls off."""
OPTICAL = np.array([(0.0, -1.0, 0.0), (0.0, 0.0, -1.0), (1.0, 0.0, 0.0)])
"""Optical axes (right, down, ahead) of a body's (forward, left, up) seen from behind."""
TANKER_PLACES = {
    'left_wing': (-12.0, 29.8, 1.0),
    'left_stabilizer': (-37.0, 11.0, 3.0),
    'rudder': (-36.5, 0.0, 13.0),
    'right_stabilizer': (-37.0, -11.0, 3.0),
    'right_wing': (-12.0, -29.8, 1.0),
}
TANKER = np.array(list(TANKER_PLACES.values()))


@dataclass(frozen=True)
class Scene:
    """How a body flies, and what happens to its lights.

    Attributes:
        markers: how many it has; five are the tanker's.
        sway: px, by which its middle wanders in the image (1 sigma).
        roll, tilt: rad, of its turns (1 sigma); tilt of pitch and yaw each.
        zoom: of the logarithm of its distance (1 sigma).
        pace: 1/s, how quickly it takes up a new place.
        shake: rad, of the camera's (1 sigma).
        losses: markers that go dark for a time.
        impostors: markers that go dark while another light shines in their place.
        blind: times that all are dark for up to 2.5 s.
        glares: wide glares, each with a ghost on the other side of the image.
        clutter: lights that stay in sight and are no markers.
        lamps: lights on the body that are no markers.
        bright: share of the image, below, that is ground as bright as a marker.
        dropped: share of the frames that never come; half of them in a row.
        rig_error: of each marker's place against the rig, in parts of its size (1 sigma per axis).
        focal_error: of the calibration's focal length, either way; None: no calibration.
        frames: of the flight.
    """

    markers: int = 5
    sway: float = 25.0
    roll: float = 0.15
    tilt: float = 0.08
    zoom: float = 0.08
    pace: float = 1.6
    shake: float = 0.0005
    losses: int = 0
    impostors: int = 0
    blind: int = 0
    glares: int = 0
    clutter: int = 0
    lamps: int = 0
    bright: float = 0.0
    dropped: float = 0.0
    rig_error: float = 0.0
    focal_error: float | None = 0.0
    frames: int = 180


_LOST = {'losses': 4, 'tilt': 0.12}
SCENES = {
    'usual': Scene(),
    'lights out of view': Scene(sway=260.0, roll=0.4, zoom=0.15, pace=1.3),
    'impostors': Scene(impostors=4),
    'dropped frames': Scene(dropped=0.3, losses=2, roll=0.3),
    'glare': Scene(glares=3, losses=3),
    'crossing': Scene(tilt=0.5, pace=1.2),
    'lasting clutter': Scene(clutter=4, losses=4, roll=0.3),
    'blind seconds': Scene(blind=2, roll=0.25),
    'fast roll and shake': Scene(roll=1.2, pace=2.2, shake=0.004, losses=3),
    'everything at once': Scene(
        sway=80.0,
        roll=0.7,
        tilt=0.15,
        shake=0.002,
        losses=4,
        impostors=2,
        blind=1,
        glares=2,
        clutter=2,
        dropped=0.1,
    ),
    'lamps on the body': Scene(lamps=5, losses=4, blind=1, roll=0.3, tilt=0.12),
    'bright ground': Scene(sway=60.0, bright=0.2, losses=4, blind=1, roll=0.3, tilt=0.12),
    'three lights': Scene(markers=3, impostors=1, losses=1, tilt=0.12),
    'four lights': Scene(markers=4, impostors=2, losses=2, tilt=0.12),
    'eight lights': Scene(markers=8, impostors=3, losses=4, roll=0.5, tilt=0.2),
    'rig off by 0.2 %': Scene(rig_error=0.002, **_LOST),
    'rig off by 0.5 %': Scene(rig_error=0.005, **_LOST),
    'focal length off by 1 %': Scene(focal_error=0.01, **_LOST),
    'focal length off by 5 %': Scene(focal_error=0.05, **_LOST),
    'focal length off by 15 %': Scene(focal_error=0.15, **_LOST),
    'focal length off by 30 %': Scene(focal_error=0.30, **_LOST),
    'no calibration': Scene(focal_error=None, **_LOST),
}


class Truth(NamedTuple):
    """What is true of a frame.

    Attributes:
        pixels: (n, 2), the markers' places, px.
        whole: (n,), whether they shine, wholly in the frame, with nothing bright beside them.
        others: (m, 2), bright places that are no markers, px.
        rotation: (3, 3), optical frame from the body's.
        translation: (3,), of the body's origin, m.
    """

    pixels: Array
    whole: NDArray[np.bool_]
    others: Array
    rotation: Array
    translation: Array


class Other(NamedTuple):
    """A light that is no marker.

    Attributes:
        places: (frames, 2), px; NaN where it does not shine.
        radius: px.
        marker: whose place it takes; -1: of none.
    """

    places: Array
    radius: float
    marker: int = -1


def rotation_of(roll: float, pitch: float, yaw: float) -> Array:
    """A body's turn about its x, then y, then z axis, rad."""
    (a, b, c), (p, q, r) = np.cos((roll, pitch, yaw)), np.sin((roll, pitch, yaw))
    about_x = np.array([(1, 0, 0), (0, a, -p), (0, p, a)])
    about_y = np.array([(b, 0, q), (0, 1, 0), (-q, 0, b)])
    about_z = np.array([(c, -r, 0), (r, c, 0), (0, 0, 1)])
    return np.asarray(about_z @ about_y @ about_x)


def project(points: Array, rotation: Array, translation: Array) -> Array:
    """Where points (n, 3) of a body are seen, (n, 2) px: pinhole, then Brown's distortion."""
    x, y, z = rotation @ points.T + translation[:, None]
    x, y = x / z, y / z
    k1, k2, p1, p2 = DISTORTION
    square = x * x + y * y
    radial = 1.0 + k1 * square + k2 * square**2
    bent_x = radial * x + 2 * p1 * x * y + p2 * (square + 2 * x * x)
    bent_y = radial * y + p1 * (square + 2 * y * y) + 2 * p2 * x * y
    (fx, _, cx), (_, fy, cy), _ = MATRIX
    return np.stack((fx * bent_x + cx, fy * bent_y + cy), axis=-1)


def body_of(count: int, rng: np.random.Generator) -> Array:
    """Places of markers (n, 3), m, that can be told apart from behind; five are the tanker's."""
    if count == len(TANKER):
        return TANKER
    while True:
        points = rng.uniform(-1.0, 1.0, (count, 3)) * (4.0, 12.0, 8.0)
        apart = np.hypot(*(points[:, None, 1:] - points[None, :, 1:]).transpose(2, 0, 1))
        sides = np.sort(apart[np.triu_indices(count, 1)])
        scalene = count > 3 or (sides[0] > 0.2 * sides[2] and sides[2] < 0.8 * sum(sides[:2]))
        if sides[0] > 3.0 and scalene and (count > 3 or np.diff(sides).min() > 2.5):
            return points


class MarkerFlight:
    """One flight; iterating gives stamps (ns), grey images and the truth.

    Attributes:
        names: of the markers.
        rig: (n, 3), where the tracker is told that they are, m.
        body: (n, 3), where they are, m.
        matrix: (3, 3), the camera's as the tracker is told; None: it is not told.
        others: the lights that are no markers.
        dark: (frames, n), whether a marker does not shine.
        edge: (frames, width), row below which the ground is bright.
    """

    def __init__(self, scene: Scene, seed: int) -> None:
        self.scene = scene
        self._rng = rng = np.random.default_rng((seed, 7411))
        self.rig = body_of(scene.markers, rng)
        count = len(self.rig)
        self.names = tuple(TANKER_PLACES)
        if count != len(TANKER):
            self.names = tuple(f'light_{i}' for i in range(count))
        middle = self.rig.mean(axis=0)
        self.size = float(np.linalg.norm(self.rig - middle, axis=1).max())
        self.body = self.rig + rng.normal(0.0, scene.rig_error * self.size, self.rig.shape)
        self.matrix = None
        if scene.focal_error is not None:
            wrong = 1.0 + scene.focal_error * rng.choice((-1.0, 1.0))
            self.matrix = MATRIX * [(wrong, 1, 1), (1, wrong, 1), (1, 1, 1)]
        self._fly(middle)
        self._lights()

    def _wander(self, deviation: float) -> Array:
        """(frames,): a critically damped way to ever new places."""
        rng, pace = self._rng, self.scene.pace
        place, rate, goal = rng.normal(0.0, 0.3 * deviation), 0.0, 0.0
        step, left, way = 1.0 / (FPS * SUBSTEPS), 0.0, []
        for substep in range(self.scene.frames * SUBSTEPS):
            left -= step
            if left <= 0.0:
                left, goal = rng.exponential(1.4) + 0.3, rng.normal(0.0, deviation)
                goal = min(max(goal, -2.2 * deviation), 2.2 * deviation)
            rate += step * (pace * pace * (goal - place) - 2.0 * pace * rate)
            place += step * rate
            if substep % SUBSTEPS == 0:
                way.append(place)
        return np.array(way)

    def _shake(self) -> Array:
        """(frames, 3) rad: a camera's mounting that swings when noise pushes it."""
        rng, count = self._rng, self.scene.frames
        hertz, damping = rng.uniform(4.0, 12.0), 0.93
        turn = 2.0 * math.cos(2 * math.pi * hertz / FPS) * damping
        shaken = np.zeros((count + 30, 3))
        noise = rng.normal(size=shaken.shape)
        for i in range(2, len(shaken)):
            shaken[i] = turn * shaken[i - 1] - damping**2 * shaken[i - 2] + noise[i]
        return np.asarray(shaken[30:] * (self.scene.shake / max(shaken.std(), 1e-9)))

    def _fly(self, middle: Array) -> None:
        scene, rng = self.scene, self._rng
        across = float(np.hypot(*(self.rig - middle)[:, 1:].T).max())
        distance = rng.uniform(2.5, 3.4) * across
        zoom = distance * np.exp(self._wander(scene.zoom))
        roll, pitch, yaw = (self._wander(angle) for angle in (scene.roll, scene.tilt, scene.tilt))
        u, v = (self._wander(scene.sway * share) for share in (1.0, 0.75))
        shake = self._shake()
        self.rotations = np.empty((scene.frames, 3, 3))
        self.translations = np.empty((scene.frames, 3))
        for i in range(scene.frames):
            shaken = OPTICAL @ rotation_of(*shake[i]) @ OPTICAL.T
            rotation = OPTICAL @ rotation_of(roll[i], pitch[i], yaw[i])
            ahead = np.array((u[i] / MATRIX[0, 0], v[i] / MATRIX[1, 1], 1.0)) * zoom[i]
            self.rotations[i] = shaken @ rotation
            self.translations[i] = shaken @ (ahead - rotation @ middle)
        poses = zip(self.rotations, self.translations, strict=True)
        self.pixels = np.array([project(self.body, *pose) for pose in poses])
        # A nearer lamp is wider; none is alike.
        own = rng.uniform(0.8, 1.25, len(self.body))
        self.radii = np.clip(3.2 * own * (distance / zoom)[:, None], 2.0, 6.0)

    def _lights(self) -> None:
        scene, rng, frames = self.scene, self._rng, self.scene.frames
        self.dark = np.zeros((frames, len(self.body)), np.bool_)
        self.others: list[Other] = []
        for _ in range(scene.losses):
            start, marker = int(rng.integers(12, frames - 8)), int(rng.integers(len(self.body)))
            self.dark[start : start + int(rng.integers(4, 55)), marker] = True
        for number in range(scene.impostors):
            self._add_impostor(number)
        for number in range(scene.blind):
            self._go_blind(number)
        for _ in range(scene.glares):
            self._add_glare()
        for number in range(scene.clutter):
            self._add_clutter(moving=number % 2 == 1)
        for _ in range(scene.lamps):
            self._add_lamp()
        self.edge = np.full((frames, WIDTH), np.inf)
        if scene.bright:
            columns = np.arange(WIDTH) - WIDTH / 2
            waves = 5.0 * np.sin(columns / 37.0) + 3.0 * np.sin(columns / 11.0)
            middle, slope = self._wander(15.0), self._wander(0.06)
            middle += (1.0 - scene.bright) * HEIGHT
            self.edge = middle[:, None] + slope[:, None] * columns + waves

    def _add_impostor(self, number: int) -> None:
        """A light in the place of a marker that goes dark: it passes, drifts off, or comes late."""
        rng, frames = self._rng, self.scene.frames
        marker = int(rng.integers(len(self.body)))
        gap = (frames - 30) // self.scene.impostors
        start = 20 + gap * number + int(rng.integers(max(gap // 3, 1)))
        end = min(start + int(rng.integers(18, 45)), frames)
        self.dark[start:end, marker] = True
        kind = ('passes', 'drifts', 'comes late')[int(rng.integers(3))]
        angle, speed = rng.uniform(0.0, 2 * math.pi), rng.uniform(0.3, 3.5)
        along = 0.0
        first, met = start, start
        if kind == 'passes':
            first = max(start - int(rng.integers(5, 30)), 0)
        elif kind == 'drifts':
            speed, along = rng.uniform(0.15, 0.6), 1.0
        else:
            first = met = min(start + int(rng.integers(1, 5)), frames - 1)
        number_of = np.arange(frames)
        moved = along * (self.pixels[:, marker] - self.pixels[met, marker])
        drift = speed * np.array((math.cos(angle), math.sin(angle)))
        places = self.pixels[met, marker] + rng.normal(0.0, 1.0, 2) + moved
        places = places + drift * (number_of - met)[:, None]
        places[(number_of < first) | (number_of >= end + 5)] = np.nan
        self.others.append(Other(places, float(self.radii[met, marker]), marker))

    def _go_blind(self, number: int) -> None:
        """All dark; back at once, or some at a time."""
        rng, frames = self._rng, self.scene.frames
        gap = (frames - 40) // self.scene.blind
        start = 20 + gap * number + int(rng.integers(max(gap // 4, 1)))
        back = start + int(rng.integers(9, 75))
        waiting = rng.permutation(len(self.body))
        together = rng.random() < 0.5
        while len(waiting):
            batch, waiting = np.split(waiting, [len(waiting) if together else rng.integers(1, 4)])
            self.dark[start:back, batch] = True
            back += int(rng.integers(3, 15))

    def _add_glare(self) -> None:
        """A wide light that swings about, and its ghost on the other side of the lens."""
        rng = self._rng
        place = rng.uniform((60.0, 60.0), (WIDTH - 60.0, HEIGHT - 60.0))
        way = place + np.stack([self._wander(15.0) for _ in range(2)], axis=-1)
        seen = self._wander(1.0) > -0.7
        ghost = 2.0 * MATRIX[:2, 2] - way
        way[~seen], ghost[~seen] = np.nan, np.nan
        self.others += [Other(way, rng.uniform(8.0, 20.0)), Other(ghost, rng.uniform(2.0, 5.0))]

    def _add_clutter(self, moving: bool) -> None:
        """A light on the ground, or on something that crosses the image."""
        rng, frames = self._rng, self.scene.frames
        place = rng.uniform((30.0, 30.0), (WIDTH - 30.0, HEIGHT - 30.0))
        speed = rng.normal(0.0, 1.2 if moving else 0.1, 2)
        way = place + speed * (np.arange(frames) - frames // 2)[:, None]
        way = way + rng.normal(0.0, 0.1, way.shape)
        self.others.append(Other(way, rng.uniform(2.2, 4.5)))

    def _add_lamp(self) -> None:
        """A light anywhere on the body, or beside it."""
        rng, middle = self._rng, self.rig.mean(axis=0)
        point = middle + 1.1 * rng.uniform(-1.0, 1.0, 3) * np.abs(self.rig - middle).max(axis=0)
        poses = zip(self.rotations, self.translations, strict=True)
        way = np.array([project(point[None], *pose)[0] for pose in poses])
        self.others.append(Other(way, rng.uniform(2.2, 4.5)))

    def truth(self, frame: int) -> Truth:
        """What is true of a frame."""
        pixels, radii = self.pixels[frame], self.radii[frame]
        now = [(other.places[frame], other.radius) for other in self.others]
        now = [(place, radius) for place, radius in now if not np.isnan(place[0])]
        others = np.array([place for place, _ in now]).reshape(-1, 2)
        reach = np.array([radius for _, radius in now])
        inner = (pixels > radii[:, None] + 3.0) & (
            pixels < np.array((WIDTH, HEIGHT)) - radii[:, None] - 4.0
        )
        shining = ~self.dark[frame]
        whole = shining & inner.all(axis=1)
        # Two blobs have a dark pixel between them from about 3 px on.
        for places, sizes, is_marker in ((pixels, radii, True), (others, reach, False)):
            if not len(places):
                continue
            apart = np.hypot(*(pixels[:, None] - places).transpose(2, 0, 1))
            close = apart < radii[:, None] + sizes + 3.0
            if is_marker:
                close &= shining & ~np.eye(len(pixels), dtype=bool)
            whole &= ~close.any(axis=1)
        column = np.clip(pixels[:, 0], 0, WIDTH - 1).astype(int)
        # No wave rises by more than half of a lamp's width beside it.
        whole &= pixels[:, 1] + 1.5 * radii + 3.0 < self.edge[frame, column]
        return Truth(pixels, whole, others, self.rotations[frame], self.translations[frame])

    def __iter__(self) -> Iterator[tuple[int, NDArray[np.uint8], Truth]]:
        rng, scene = np.random.default_rng(self._rng.integers(2**31)), self.scene
        rows, columns = np.mgrid[:HEIGHT, :WIDTH]
        slope = rng.uniform(-30.0, 30.0, 2)
        ground = 70.0 + slope[0] * columns / WIDTH + slope[1] * rows / HEIGHT
        ground = (ground + rng.normal(0.0, 4.0, ground.shape)).clip(0, 255).astype(np.uint8)
        kept = rng.random(scene.frames) >= 0.5 * scene.dropped
        while (~kept).mean() < scene.dropped:
            start = int(rng.integers(scene.frames))
            kept[start : start + int(rng.integers(3, 10))] = False
        kept[:5] = True
        for frame in np.flatnonzero(kept).tolist():
            truth = self.truth(frame)
            image = np.where(rows > self.edge[frame], np.uint8(235), ground)
            for marker in np.flatnonzero(~self.dark[frame]):
                draw(image, truth.pixels[marker], self.radii[frame, marker])
            for other in self.others:
                if not np.isnan(other.places[frame, 0]):
                    draw(image, other.places[frame], other.radius)
            yield round(frame / FPS * 1e9), image, truth


def told(flight: MarkerFlight) -> tuple[Any, Any]:
    """The rig and the camera (None: no calibration) that a tracker is told, as the package's."""
    from mvuav_ros.vision.camera import CameraModel
    from mvuav_ros.vision.rig import MarkerRig

    markers = tuple(zip(flight.names, map(tuple, flight.rig.tolist()), strict=True))
    rig = MarkerRig('body', markers, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    if flight.matrix is None:
        return rig, None
    matrix = tuple(flight.matrix.ravel().tolist())
    return rig, CameraModel(WIDTH, HEIGHT, matrix, (*DISTORTION, 0.0))


def track_flight(
    flight: MarkerFlight, change: Callable[[Pixels, int], Pixels] = lambda pixels, number: pixels
) -> tuple[int, list[tuple[int, int]]]:
    """Wrong names, and of each frame how many names and how many markers that shine alone.

    A tracker of the package sees the frames (uint8, of a number), changed.
    """
    from mvuav_ros.parameters.marker_tracker import MarkerTrackerParameters
    from mvuav_ros.vision.image import Image
    from mvuav_ros.vision.markers.identity_tracker import IdentityTracker
    from mvuav_ros.vision.markers.marker_results import MarkerState

    tracker = IdentityTracker(*told(flight))
    parameters = MarkerTrackerParameters(prediction='kalman')
    wrong, counts = 0, []
    for number, (stamp_ns, pixels, truth) in enumerate(flight):
        image = Image(change(pixels, number), 'mono8')
        result = tracker.track(image, 1e-9 * stamp_ns, parameters)
        named = [m.state is MarkerState.DETECTED for m in result.markers]
        pairs = zip(result.markers, truth.pixels, named, strict=True)
        wrong += sum(math.dist((m.x, m.y), place) > 4.0 for m, place, is_named in pairs if is_named)
        counts.append((sum(named), int(truth.whole.sum())))
    return wrong, counts


def draw(image: NDArray[np.uint8], place: Array, radius: float) -> None:
    """Add a lamp that saturates, with a soft edge."""
    reach = math.ceil(radius + 7 * SHARPNESS)
    x, y = math.floor(place[0]), math.floor(place[1])
    x0, x1 = max(x - reach, 0), min(x + reach + 2, image.shape[1])
    y0, y1 = max(y - reach, 0), min(y + reach + 2, image.shape[0])
    if x1 <= x0 or y1 <= y0:
        return
    distance = np.hypot(np.arange(x0, x1) - place[0], (np.arange(y0, y1) - place[1])[:, None])
    light = 320.0 / (1.0 + np.exp((distance - radius) / SHARPNESS))
    part = image[y0:y1, x0:x1]
    part[:] = np.minimum(part + light, 255.0).astype(np.uint8)
