"""Where the lights of a rig really are, from a flight of them: a bundle adjustment.

Images determine only the shape: turning, moving and scaling the rig changes none. These seven
directions are held, and afterwards taken from the rough rig, or the scale from a measured distance.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.special import chdtri

from mvuav_ros.vision.bundle_adjustment import Equations, adjust, eliminate_poses, farthest_first
from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.reprojection import Reprojection, Solution, rotation_of

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

MIN_LIGHTS = 4
"""In an image: a pose takes six of the six numbers of three lights, and leaves none for the rig."""


# What counts as an outlier, and when a flight does not determine the rig.

MAX_FRAMES = 300  # those that differ most are taken
MIN_FRAMES = 10
# An image is looked into for a wrong name where noise alone leaves such residuals in one of
# so many.
ONE_OF = 2000.0
# Of the noise per axis: residuals count less and less from about there on.
OUTLYING = 3.7
# px, per axis: the least noise that is expected of a light's place.
MIN_NOISE = 0.02
# Of the span (1 sigma): from where on the motion does not determine where a light is.
MAX_DEVIATION = 0.005
MAX_ROUNDS = 6  # of adjustment, and naming outliers
_FITS = 2.0  # px, rms per axis, to which the last pose is gone on with


class RigCalibrationError(ValueError):
    """A flight that does not determine the rig, with the reason."""


@dataclass(frozen=True, eq=False)
class RigCalibration:
    """A rig with the figures of how good it is."""

    positions: Array  # (n, 3), of the lights in the rough rig's frame, m
    # (3n, 3n), of the positions, m²; turns and shifts of the whole rig, which are a choice of its
    # frame, are no part of it.
    covariance: Array
    scale_deviation: float  # standard deviation of the scale, as a part of it; 0 with a distance
    residuals: Array  # (f, n, 2), seen minus projected, px; NaN where an image has no pose
    used: NDArray[np.bool_]  # (f, n), lights that made the rig: no outliers, of no image left out
    frames: int  # number of images used
    noise: float  # of a light's place per axis, from the residuals, px

    @property
    def deviations(self) -> Array:
        """(n, 3), standard deviations of the coordinates, m."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0)).reshape(-1, 3)


def calibrate_rig(
    rough: Array,
    camera: CameraModel,
    pixels: Array,
    distance: tuple[int, int, float] | None = None,
    names: Sequence[str] = (),
) -> RigCalibration:
    """Find the positions of a rig's lights that explain the images of a flight best.

    Lights that the others contradict (another light, a wrong name) are left out.

    Args:
        rough: (n, 3), positions that are about right, m.
        camera: calibrated.
        pixels: (f, n, 2), where each light is seen in each image, px, NaN where it is not; an image
            with fewer than four lights does not count.
        distance: two lights and their distance, m, taken as exact; without, the rig keeps the
            rough one's scale.
        names: of the lights, for messages.

    Raises:
        RigCalibrationError: the lights seen are too few or too much alike to determine the rig.
    """
    names = names or [f'light {number}' for number in range(len(rough))]
    refuse_few_lights(len(rough))
    bundle = _Bundle(camera, np.array(rough, np.float64), pixels)
    bundle.locate()
    bundle.choose_frames()
    bound = math.inf
    for _ in range(MAX_ROUNDS):
        bundle.adjust(bound)
        # Another light may pull the rig to itself as long as nobody knows the noise.
        bound = OUTLYING * bundle.noise(of_most=True)
        bundle.adjust(bound)
        before = bundle.used.copy()
        bundle.locate()
        if (before == bundle.used).all():
            break
    bundle.refuse_few(names)
    bundle.adjust()
    positions, covariance, scale_deviation = bundle.in_frame_of(rough, distance)
    # The scale is that of the rough rig, or of the distance, whatever the motion is.
    _refuse_untold(positions, covariance, names)
    apart = (positions - positions.mean(axis=0)).ravel()
    covariance += scale_deviation**2 * np.outer(apart, apart)
    _refuse_exchanged(positions, rough, names)
    return RigCalibration(
        positions,
        covariance,
        scale_deviation,
        bundle.residuals(),
        bundle.used,
        int(bundle.used.any(axis=1).sum()),
        bundle.noise(),
    )


def refuse_few_lights(count: int) -> None:
    """Raise RigCalibrationError where a rig has too few."""
    if count < MIN_LIGHTS:
        raise RigCalibrationError(
            f'{count} lights are too few: an image with {MIN_LIGHTS} tells more than its own pose'
        )


class _Bundle:
    """The adjustment on its way."""

    def __init__(self, camera: CameraModel, points: Array, pixels: Array) -> None:
        self._camera = camera
        self.points = points  # (n, 3), the positions, m, in any frame and scale
        self._pixels = pixels
        self._is_seen = np.isfinite(pixels[..., 0])
        self.used = np.zeros_like(self._is_seen)  # (f, n), the lights that count
        self._images = np.flatnonzero(self._is_seen.sum(axis=1) >= MIN_LIGHTS).tolist()
        self._poses: dict[int, Array] = {}

    def locate(self) -> None:
        """The pose of every image, and which of its lights fit it."""
        lights = {image: np.flatnonzero(self._is_seen[image]) for image in self._images}
        solved = {image: self._solve(image, seen) for image, seen in lights.items()}
        usual = [s.squares / _usual(len(lights[image])) for image, s in solved.items() if s]
        if not usual:
            raise RigCalibrationError('no pose fits the lights in any image: is it this rig?')
        variance = max(float(np.median(usual)), MIN_NOISE**2)
        self._poses, self.used[:] = {}, False
        for image, seen in lights.items():
            found, chosen = solved[image], seen
            if found is None or found.squares > variance * _most(len(seen)):
                found, chosen = self._without_wrong(image, seen, variance)
            if found is not None:
                rvec = cv2.Rodrigues(found.rotation)[0].ravel()
                self._poses[image] = np.concatenate((rvec, found.translation))
                self.used[image, chosen] = True

    def _solve(self, image: int, lights: Indices, thorough: bool = True) -> Solution | None:
        """The best pose of an image by some lights; thorough: from tilted starts as well."""
        view = Reprojection(self._camera, self.points[lights], self._pixels[image, lights])
        last = self._poses.get(image)
        solutions = [] if last is None else view.refined([(rotation_of(last[:3]), last[3:])])
        if thorough and not solutions:
            solutions = view.solve()
        elif not solutions or solutions[0].squares > 2 * len(lights) * _FITS**2:
            solutions += view.refined(view.closed_forms())
        return min(solutions, key=lambda solution: solution.squares, default=None)

    def _without_wrong(
        self, image: int, lights: Indices, variance: float
    ) -> tuple[Solution | None, Indices]:
        """The pose of an image without the one or two lights that the others contradict."""
        for out in (1, 2):
            if len(lights) - out <= MIN_LIGHTS - 1:
                break
            tried = []
            for wrong in combinations(range(len(lights)), out):
                rest = np.delete(lights, wrong)
                found = self._solve(image, rest, thorough=False)
                if found is not None and found.squares <= variance * _most(len(rest)):
                    tried.append((found, rest))
            if tried:
                return min(tried, key=lambda each: each[0].squares)
        return None, lights

    def choose_frames(self) -> None:
        """Of too many images keep those whose poses differ most."""
        if len(self._poses) > MAX_FRAMES:
            images, poses = list(self._poses), np.array(list(self._poses.values()))
            depth = np.linalg.norm(poses[:, 3:], axis=1)[:, None]
            turns = np.array([rotation_of(pose[:3]).ravel() for pose in poses])
            views = np.hstack((turns, poses[:, 3:] / depth, np.log(depth)))
            chosen = sorted(farthest_first(views, 0, MAX_FRAMES))
            self._poses = {images[index]: poses[index] for index in chosen}
        self._images = list(self._poses)
        self.used[np.setdiff1d(np.arange(len(self.used)), self._images)] = False

    def adjust(self, bound: float = math.inf) -> None:
        """Move points and poses; residuals count less and less from a bound (px) on."""
        images = list(self._poses)
        shared, poses, _ = adjust(
            lambda number, points, pose: self._view(images[number], points, pose),
            self.points.ravel(),
            list(self._poses.values()),
            bound,
            _gauge,
        )
        self.points = shared.reshape(-1, 3)
        self._poses = dict(zip(images, poses, strict=True))

    def _view(self, image: int, points: Array, pose: Array) -> Equations:
        """Of the lights that count, with the points (3n,) as what images share."""
        lights = np.flatnonzero(self.used[image])
        own = points.reshape(-1, 3)[lights]
        seen, by_pose, _ = self._camera.project_with_jacobians(own, pose[:3], pose[3:])
        by_points = np.zeros((len(lights), 2, len(self.points), 3))
        # A point moves before the camera as the body does, but for the body's turn.
        slopes = (by_pose[:, 3:] @ rotation_of(pose[:3])).reshape(-1, 2, 3)
        by_points[np.arange(len(lights)), :, lights] = slopes
        residuals = (self._pixels[image, lights] - seen).ravel()
        return Equations(residuals, by_pose, by_points.reshape(-1, points.size))

    def _views(self) -> list[Equations]:
        points = self.points.ravel()
        return [self._view(image, points, pose) for image, pose in self._poses.items()]

    def noise(self, *, of_most: bool = False) -> float:
        """Of a light's place per axis, from the residuals, px; of most images, or of all."""
        views = [view.residuals for view in self._views()]
        each = [float(residuals @ residuals) for residuals in views]
        count = sum(len(residuals) - 6 for residuals in views)
        # What the positions of the lights take up of the residuals.
        rest = max(count - self.points.size + 7, 1)
        squares = sum(each)
        if of_most:
            ratios = [one / _usual(len(r) // 2) for one, r in zip(each, views, strict=True)]
            squares = float(np.median(ratios)) * count
        return max(math.sqrt(squares / rest), MIN_NOISE)

    def residuals(self) -> Array:
        """(f, n, 2) of all lights, px; NaN where one is not seen, or without a pose."""
        found = np.full_like(self._pixels, np.nan)
        for image, pose in self._poses.items():
            seen = self._camera.project(self.points, pose[:3], pose[3:])
            found[image] = self._pixels[image] - seen
        return found

    def refuse_few(self, names: Sequence[str]) -> None:
        """Say what is seen too rarely."""
        frames = len(self._poses)
        if frames < MIN_FRAMES:
            raise RigCalibrationError(
                f'{frames} images show {MIN_LIGHTS} lights and more that fit together; '
                f'{MIN_FRAMES} are needed, and 100 are good'
            )
        counts = self.used.sum(axis=0)
        if counts.min() < MIN_FRAMES:
            rarest = int(counts.argmin())
            raise RigCalibrationError(
                f'{names[rarest]} is seen in {counts[rarest]} images, of {frames}: '
                f'{MIN_FRAMES} are needed'
            )

    def in_frame_of(
        self, rough: Array, distance: tuple[int, int, float] | None
    ) -> tuple[Array, Array, float]:
        """Positions, their covariance at this scale, and the scale's deviation, in its frame."""
        points, information = self.points, eliminate_poses(self._views())[0]
        gauge = _gauge(points)
        # An orthonormal basis of what is perpendicular to it.
        rest = np.linalg.qr(gauge, mode='complete')[0][:, gauge.shape[1] :]
        inner = np.linalg.pinv(rest.T @ information @ rest, rcond=1e-14, hermitian=True)
        covariance = self.noise() ** 2 * rest @ inner @ rest.T
        turn, scale = _alignment(points, rough)
        apart = (points - points.mean(axis=0)) @ turn.T
        mixed = np.kron(np.eye(len(apart)), turn)
        covariance = mixed @ covariance @ mixed.T
        deviation = 0.0
        if distance is not None:
            first, second, metres = distance
            between = apart[first] - apart[second]
            length = float(np.linalg.norm(between))
            scale = metres / length
            # With the distance held, its own error scales all others.
            along = np.zeros((len(apart), 3))
            along[first], along[second] = between / length**2, -between / length**2
            held = np.eye(apart.size) - np.outer(apart.ravel(), along.ravel())
            covariance = held @ covariance @ held.T
        else:
            apart_rough = rough - rough.mean(axis=0)
            wrong = scale * apart - apart_rough
            spread = float((apart_rough**2).sum())
            # Of the rough positions' own errors, all of one size.
            deviation = math.sqrt(float((wrong**2).sum()) / (rough.size - 7) / spread)
        return rough.mean(axis=0) + scale * apart, scale**2 * covariance, deviation


def _usual(lights: int) -> float:
    """The median of the squared residuals of an image, in squares of the noise (chi-square)."""
    return float(chdtri(2 * lights - 6, 0.5))


def _most(lights: int) -> float:
    """The most that noise leaves of them, but for one image of many."""
    return float(chdtri(2 * lights - 6, 1.0 / ONE_OF))


def _gauge(points: Array) -> Array:
    """(3n, 7), orthonormal: the shifts, small turns and the scaling of n points."""
    points = points.reshape(-1, 3)
    apart = points - points.mean(axis=0)
    columns = [np.tile(axis, len(points)) for axis in np.eye(3)]
    columns += [np.cross(axis, apart).ravel() for axis in np.eye(3)]
    columns.append(apart.ravel())
    return np.linalg.qr(np.column_stack(columns))[0]


def _alignment(points: Array, onto: Array) -> tuple[Array, float]:
    """The turn and the scale that bring centred points (n, 3) closest to others (Umeyama 1991)."""
    apart, wanted = points - points.mean(axis=0), onto - onto.mean(axis=0)
    u, d, vt = np.linalg.svd(wanted.T @ apart)
    sign = np.array((1.0, 1.0, np.sign(np.linalg.det(u @ vt))))
    return (u * sign) @ vt, float((d * sign).sum() / (apart**2).sum())


def _refuse_untold(positions: Array, covariance: Array, names: Sequence[str]) -> None:
    """Say which light the motion leaves unknown."""
    span = float(np.linalg.norm(positions[:, None] - positions, axis=2).max())
    count = range(len(names))
    variances, axes = np.linalg.eigh(covariance.reshape(-1, 3, len(names), 3)[count, :, count])
    worst = int(variances[:, -1].argmax())
    deviation = math.sqrt(max(float(variances[worst, -1]), 0.0))
    if deviation > MAX_DEVIATION * span:
        where = ', '.join(f'{abs(part):.2f}' for part in axes[worst, :, -1])
        raise RigCalibrationError(
            f'the motion does not determine the shape: {names[worst]} is known to '
            f'{1000 * deviation:.3g} mm ({100 * deviation / span:.2g} % of the span, 1 sigma) '
            f'along [{where}]; the body has to turn before the camera by 20 degrees and more, '
            'about two axes'
        )


def _refuse_exchanged(positions: Array, rough: Array, names: Sequence[str]) -> None:
    """Say which lights lie where the rough rig has others."""
    apart = np.linalg.norm(positions[:, None] - rough, axis=2)
    _, nearest = linear_sum_assignment(apart**2)
    others = [f'{names[i]} is where {names[j]} should be' for i, j in enumerate(nearest) if i != j]
    if others:
        raise RigCalibrationError(
            f'{", ".join(others)}: names are exchanged, or the rough rig is another one'
        )
