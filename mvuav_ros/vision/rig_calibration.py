"""Where the lights of a rig really are, from a flight of them: a bundle adjustment.

Unknown are the n positions and a pose in every image. The unknowns of one pose meet those of no
other, so that each is eliminated from its image's equations; a system of 3n is left. Of its
solutions the flight determines only the shape: turning, moving and scaling the rig changes no
image. These seven directions are held, and afterwards taken from the rough rig, the scale from a
measured distance if there is one.

Source: Triggs, McLauchlan, Hartley and Fitzgibbon, Bundle adjustment - a modern synthesis, 1999.
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

from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.reprojection import Reprojection, rotation_of

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

MIN_LIGHTS = 4
"""In an image: a pose takes six of the six numbers of three lights, and leaves none for the rig."""


@dataclass(frozen=True)
class RigCalibrationTuning:
    """What counts as an outlier, and when a flight does not determine the rig."""

    most_frames: int = 300  # those that differ most are taken
    fewest_frames: int = 10
    # An image is looked into for a wrong name where noise alone leaves such residuals in one of
    # so many.
    one_of: float = 2000.0
    # Of the noise per axis: residuals count less and less from about there on.
    outlying: float = 3.7
    # px, per axis: the least noise that is expected of a light's place.
    least_noise: float = 0.02
    # Of the span (1 sigma): from where on the motion does not determine where a light is.
    most_deviation: float = 0.005
    rounds: int = 6  # of adjustment, and naming outliers
    steps: int = 30  # of Gauss and Newton in one round


TUNING = RigCalibrationTuning()
_ALL_ALIKE = 1e6  # px: a bound within which all residuals lie
_FITS = 2.0  # px, rms per axis, to which the last pose is gone on with


class RigCalibrationError(ValueError):
    """A flight that does not determine the rig, with the reason."""


@dataclass(frozen=True, eq=False)
class LightSightings:
    """Named lights in the images of a flight, one row for each.

    Attributes:
        frames: (m,), number of the image.
        markers: (m,), place of the light in the rig.
        pixels: (m, 2), where it is seen, px.
    """

    frames: Indices
    markers: Indices
    pixels: Array


@dataclass(frozen=True, eq=False)
class RigCalibration:
    """A rig with the figures of how good it is.

    Attributes:
        positions: (n, 3), of the lights in the rough rig's frame, m.
        covariance: (3n, 3n), of the positions, m²; turns and shifts of the whole rig, which are
            a choice of its frame, are no part of it.
        scale_deviation: standard deviation of the scale, as a part of it; zero with a distance.
        residuals: (m, 2), seen minus projected of every sighting, px; NaN where its image has no
            pose.
        used: (m,), which sightings made the rig; the others are outliers or of images left out.
        frames: number of images used.
        noise: of a light's place per axis, from the residuals, px.
    """

    positions: Array
    covariance: Array
    scale_deviation: float
    residuals: Array
    used: NDArray[np.bool_]
    frames: int
    noise: float

    @property
    def deviations(self) -> Array:
        """(n, 3), standard deviations of the coordinates, m."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0)).reshape(-1, 3)


def calibrate_rig(
    rough: Array,
    camera: CameraModel,
    sightings: LightSightings,
    distance: tuple[int, int, float] | None = None,
    names: Sequence[str] = (),
) -> RigCalibration:
    """Find the positions of a rig's lights that explain the images of a flight best.

    Sightings that the others contradict (another light, a wrong name) are left out.

    Args:
        rough: (n, 3), positions that are about right, m.
        camera: calibrated.
        sightings: four lights and more in each image that counts.
        distance: two lights and their distance, m, taken as exact; without, the rig keeps the
            rough one's scale.
        names: of the lights, for messages.

    Raises:
        RigCalibrationError: the sightings are too few or too much alike to determine the rig.
    """
    names = names or [f'light {number}' for number in range(len(rough))]
    if len(rough) < MIN_LIGHTS:
        raise RigCalibrationError(
            f'{len(rough)} lights are too few: each image needs {MIN_LIGHTS} to determine more '
            'than its own pose'
        )
    bundle = _Bundle(camera, np.array(rough, np.float64), sightings)
    bundle.locate()
    bundle.choose_frames()
    for _ in range(TUNING.rounds):
        bundle.adjust()
        # Another light may pull the rig to itself as long as nobody knows the noise.
        bundle.bound = math.inf
        bundle.bound = TUNING.outlying * bundle.noise()
        bundle.adjust()
        before = bundle.used.copy()
        bundle.locate()
        if (before == bundle.used).all():
            break
    bundle.refuse_few(names)
    bundle.bound = _ALL_ALIKE
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
        len(np.unique(sightings.frames[bundle.used])),
        bundle.noise(),
    )


class _Bundle:
    """The adjustment on its way.

    Attributes:
        points: (n, 3), the positions, m, in any frame and scale.
        used: (m,), the sightings that count.
        bound: px, from where on residuals count less and less; infinite where all count alike.
    """

    def __init__(self, camera: CameraModel, points: Array, sightings: LightSightings) -> None:
        self._camera = camera
        self.points = points
        self._all = sightings
        order = np.argsort(sightings.frames, kind='stable')
        frames, starts = np.unique(sightings.frames[order], return_index=True)
        rows = np.split(order, starts[1:])
        # Of each image the rows of its sightings.
        self._rows = {int(f): r for f, r in zip(frames, rows, strict=True)}
        self._rows = {f: r for f, r in self._rows.items() if len(r) >= MIN_LIGHTS}
        self._poses: dict[int, Array] = {}
        self.used = np.zeros(len(sightings.frames), np.bool_)
        self.bound = math.inf

    def locate(self) -> None:
        """The pose of every image, and which of its lights fit it."""
        solved = {frame: self._solve(rows, frame) for frame, rows in self._rows.items()}
        poses = [(rows, solved[frame]) for frame, rows in self._rows.items()]
        usual = [found[1] / _usual(len(rows)) for rows, found in poses if found is not None]
        if not usual:
            raise RigCalibrationError('no pose fits the lights in any image: is it this rig?')
        variance = max(float(np.median(usual)), TUNING.least_noise**2)
        self._poses, self.used[:] = {}, False
        for frame, rows in self._rows.items():
            found, chosen = solved[frame], rows
            if found is None or found[1] > variance * _most(len(rows)):
                found, chosen = self._without_wrong(rows, frame, variance)
            if found is not None:
                self._poses[frame] = found[0]
                self.used[chosen] = True

    def _solve(
        self, rows: Indices, frame: int, thorough: bool = True
    ) -> tuple[Array, float] | None:
        """Pose and squared residuals, px²; thorough: from tilted starts as well."""
        points = np.ascontiguousarray(self.points[self._all.markers[rows]])
        view = Reprojection(self._camera, points, np.ascontiguousarray(self._all.pixels[rows]))
        solutions = []
        last = self._poses.get(frame)
        if last is not None:
            again = view.refine(rotation_of(last[:3]), last[3:])
            solutions = [] if again is None else [again]
        if thorough and not solutions:
            solutions = view.solve()
        elif not solutions or solutions[0].squares > 2 * len(rows) * _FITS**2:
            starts = view.closed_forms()
            solutions += [found for start in starts if (found := view.refine(*start)) is not None]
        if not solutions:
            return None
        best = min(solutions, key=lambda solution: solution.squares)
        rvec = cv2.Rodrigues(best.rotation)[0].ravel()
        return np.concatenate((rvec, best.translation)), best.squares

    def _without_wrong(
        self, rows: Indices, frame: int, variance: float
    ) -> tuple[tuple[Array, float] | None, Indices]:
        """The pose of an image without the one or two lights that the others contradict."""
        for out in (1, 2):
            if len(rows) - out <= MIN_LIGHTS - 1:
                break
            tried = []
            for wrong in combinations(range(len(rows)), out):
                rest = np.delete(rows, wrong)
                found = self._solve(rest, frame, thorough=False)
                if found is not None and found[1] <= variance * _most(len(rest)):
                    tried.append((found[1], found, rest))
            if tried:
                _, best, rest = min(tried, key=lambda each: each[0])
                return best, rest
        return None, rows

    def choose_frames(self) -> None:
        """Of too many images keep those whose poses differ most."""
        frames = list(self._poses)
        if len(frames) > TUNING.most_frames:
            places = np.array([self._poses[frame][3:] for frame in frames])
            depth = np.linalg.norm(places, axis=1)
            turns = np.array([rotation_of(self._poses[frame][:3]).ravel() for frame in frames])
            views = np.hstack((turns, places / depth[:, None], np.log(depth)[:, None]))
            chosen = [0]
            distance = np.linalg.norm(views - views[0], axis=1)
            while len(chosen) < TUNING.most_frames:
                chosen.append(int(distance.argmax()))
                distance = np.minimum(distance, np.linalg.norm(views - views[chosen[-1]], axis=1))
            frames = sorted(frames[index] for index in chosen)
        keep = set(frames)
        self._rows = {frame: rows for frame, rows in self._rows.items() if frame in keep}
        self._poses = {frame: self._poses[frame] for frame in frames}
        self.used &= np.isin(self._all.frames, frames)

    def _view(self, frame: int) -> tuple[Array, Array, Array]:
        """Residuals (2k,), and derivatives by the pose (2k, 6) and the points (2k, 3n)."""
        rows = self._rows[frame]
        rows = rows[self.used[rows]]
        markers, pose = self._all.markers[rows], self._poses[frame]
        points = self.points[markers]
        seen, by_pose = self._camera.project_with_jacobian(points, pose[:3], pose[3:])
        by_points = np.zeros((2 * len(rows), self.points.size))
        # A point moves before the camera as the body does, but for the body's turn.
        slopes = (by_pose[:, 3:] @ rotation_of(pose[:3])).reshape(-1, 2, 3)
        for row, (marker, slope) in enumerate(zip(markers, slopes, strict=True)):
            by_points[2 * row : 2 * row + 2, 3 * marker : 3 * marker + 3] = slope
        return (self._all.pixels[rows] - seen).ravel(), by_pose, by_points

    def adjust(self) -> None:
        """Gauss and Newton's steps until the residuals fall no more."""
        left = self._squares()
        for _ in range(TUNING.steps):
            before, points, places = left, self.points, self._poses
            step, turns = self._step()
            for part in (1.0, 0.3, 0.1, 0.03):
                self.points = points + part * step
                self._poses = {f: place + part * turns[f] for f, place in places.items()}
                left = self._squares()
                if left < before:
                    break
            else:
                self.points, self._poses = points, places
                return
            if before - left <= 1e-9 * before:
                return

    def _squares(self) -> float:
        """What `adjust` makes least, px²; with a bound, Cauchy's function of the residuals."""
        squares = [(self._view(f)[0].reshape(-1, 2) ** 2).sum(axis=1) for f in self._poses]
        each = np.concatenate(squares)
        if math.isfinite(self.bound):
            each = np.log1p(each / self.bound**2) * self.bound**2
        total = float(each.sum())
        return total if math.isfinite(total) else math.inf

    def _step(self) -> tuple[Array, dict[int, Array]]:
        """Of the points (n, 3), and of each pose (6,)."""
        size = self.points.size
        information, gradient = np.zeros((size, size)), np.zeros(size)
        eliminated = {}
        for frame in self._poses:
            residuals, by_pose, by_points = self._view(frame)
            squares = (residuals.reshape(-1, 2) ** 2).sum(axis=1)
            weight = np.repeat(1.0 / np.sqrt(1.0 + squares / self.bound**2), 2)
            residuals, by_pose = weight * residuals, weight[:, None] * by_pose
            by_points = weight[:, None] * by_points
            inverse = np.linalg.pinv(by_pose)
            rest = by_points - by_pose @ (inverse @ by_points)
            information += rest.T @ rest
            gradient += rest.T @ residuals
            eliminated[frame] = inverse @ residuals, inverse @ by_points
        held = _gauge(self.points)
        self._information = information
        information = information + float(np.trace(information)) * held @ held.T
        step = np.linalg.lstsq(information, gradient, rcond=1e-12)[0]
        turns = {frame: own - along @ step for frame, (own, along) in eliminated.items()}
        return np.asarray(step.reshape(-1, 3), np.float64), turns

    def noise(self) -> float:
        """Of a light's place per axis, from the residuals, px."""
        views = [self._view(frame)[0] for frame in self._poses]
        each = [float(residuals @ residuals) for residuals in views]
        count = sum(len(residuals) - 6 for residuals in views)
        # What the positions of the lights take up of the residuals.
        rest = max(count - self.points.size + 7, 1)
        if math.isfinite(self.bound):
            return max(math.sqrt(sum(each) / rest), TUNING.least_noise)
        ratios = [squares / _usual(len(r) // 2) for squares, r in zip(each, views, strict=True)]
        return max(math.sqrt(float(np.median(ratios)) * count / rest), TUNING.least_noise)

    def residuals(self) -> Array:
        """(m, 2) of all sightings, px; NaN without a pose."""
        found = np.full((len(self._all.frames), 2), np.nan)
        for frame, pose in self._poses.items():
            rows = self._rows[frame]
            seen = self._camera.project(self.points[self._all.markers[rows]], pose[:3], pose[3:])
            found[rows] = self._all.pixels[rows] - seen
        return found

    def refuse_few(self, names: Sequence[str]) -> None:
        """Say what is seen too rarely."""
        frames = len(self._poses)
        if frames < TUNING.fewest_frames:
            raise RigCalibrationError(
                f'{frames} images show {MIN_LIGHTS} lights and more that fit together; '
                f'{TUNING.fewest_frames} are needed, and 100 are good'
            )
        counts = np.bincount(self._all.markers[self.used], minlength=len(self.points))
        if counts.min() < TUNING.fewest_frames:
            rarest = int(counts.argmin())
            raise RigCalibrationError(
                f'{names[rarest]} is seen in {counts[rarest]} images, of {frames}: '
                f'{TUNING.fewest_frames} are needed'
            )

    def in_frame_of(
        self, rough: Array, distance: tuple[int, int, float] | None
    ) -> tuple[Array, Array, float]:
        """Positions, their covariance at this scale, and the scale's deviation, in its frame."""
        variance = self.noise() ** 2
        self._step()
        gauge = _gauge(self.points)
        # An orthonormal basis of what is perpendicular to it.
        rest = np.linalg.qr(gauge, mode='complete')[0][:, gauge.shape[1] :]
        inner = np.linalg.pinv(rest.T @ self._information @ rest, rcond=1e-14, hermitian=True)
        covariance = variance * rest @ inner @ rest.T
        turn, scale = _alignment(self.points, rough)
        middle = self.points.mean(axis=0)
        apart = (self.points - middle) @ turn.T
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
            covariance *= scale**2
        else:
            apart_rough = rough - rough.mean(axis=0)
            wrong = scale * apart - apart_rough
            spread = float((apart_rough**2).sum())
            # Of the rough positions' own errors, all of one size.
            deviation = math.sqrt(float((wrong**2).sum()) / (rough.size - 7) / spread)
            covariance *= scale**2
        return rough.mean(axis=0) + scale * apart, covariance, deviation


def _usual(lights: int) -> float:
    """The median of the squared residuals of an image, in squares of the noise (chi-square)."""
    return float(chdtri(2 * lights - 6, 0.5))


def _most(lights: int) -> float:
    """The most that noise leaves of them, but for one image of many."""
    return float(chdtri(2 * lights - 6, 1.0 / TUNING.one_of))


def _gauge(points: Array) -> Array:
    """(3n, 7), orthonormal: the shifts, small turns and the scaling of points (n, 3)."""
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
    worst = 0.0
    for index, name in enumerate(names):
        own = covariance[3 * index : 3 * index + 3, 3 * index : 3 * index + 3]
        variances, axes = np.linalg.eigh(own)
        deviation = math.sqrt(max(float(variances[-1]), 0.0))
        if deviation > worst:
            worst, light, axis = deviation, name, axes[:, -1]
    if worst > TUNING.most_deviation * span:
        where = ', '.join(f'{abs(part):.2f}' for part in axis)
        raise RigCalibrationError(
            f'the motion does not determine the shape: {light} is known to {1000 * worst:.3g} mm '
            f'({100 * worst / span:.2g} % of the span, 1 sigma) along [{where}]; the body has to '
            'turn before the camera by 20 degrees and more, about two axes'
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
