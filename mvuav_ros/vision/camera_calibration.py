"""A camera's matrix and lens from views of a board: the fit, its uncertainty, its model."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.board import BoardView
from mvuav_ros.vision.camera import CalibrationError, CameraModel

Array = NDArray[np.float64]

MODELS = ('auto', 'plumb_bob', 'rational_polynomial', 'equidistant')
MIN_VIEWS = 5


@dataclass(frozen=True)
class LensCalibrationTuning:
    """When views are left out, and when a calibration is refused."""

    # Of the views' median rms residual, from where on a view is taken for blurred or wrong.
    outlying: float = 2.5
    most_outlying: float = 0.25  # of the views: the part that may be
    # Of the focal length (1 sigma), from where on the views do not determine it. Twenty rendered
    # videos leave 0.03 %; a board that is always parallel to the image leaves 3 % and more.
    most_focal_error: float = 0.01
    # px, per axis: the least noise that is expected of a corner.
    least_noise: float = 0.02
    folds: int = 4  # parts into which views are split, each kept back once
    most_kept_back: int = 40  # views, those that differ most, that models are compared on
    better: float = 0.01  # by which part a longer model must do better on views kept back


TUNING = LensCalibrationTuning()


@dataclass(frozen=True)
class _Lens:
    """A model of CameraInfo, and which of its coefficients are fitted."""

    model: str
    coefficients: int
    flags: int = 0


_LENSES = {
    'plumb_bob without k3': _Lens('plumb_bob', 4, cv2.CALIB_FIX_K3),
    'plumb_bob': _Lens('plumb_bob', 5),
    'equidistant': _Lens('equidistant', 4),
    'rational_polynomial': _Lens('rational_polynomial', 8, cv2.CALIB_RATIONAL_MODEL),
}
"""The simpler one first."""
_FISHEYE_FOCALS = (0.3, 0.5, 0.9)
"""Of the image's longer side: focal lengths from which an equidistant lens is fitted."""
_MAX_STEPS = 30


@dataclass(frozen=True, eq=False)
class CameraCalibration:
    """A calibration with the figures of how good it is.

    Attributes:
        camera: the matrix and the lens.
        deviations: standard deviations of fx, fy, cx, cy (px), then of the coefficients; of a
            coefficient that was kept at zero it is zero.
        used: (n,), which of the views given it is made from; the others were blurred or wrong.
        residuals: for each view (m, 2), seen minus projected, px.
        rotations: (n, 3), the rotation vectors of the board in the optical frame.
        rms: root mean square of the residuals of the used views per axis, px.
        kept_back: by model, the rms per axis on views that it was not fitted to, px; empty where
            there was no choice.
    """

    camera: CameraModel
    deviations: tuple[float, ...]
    used: NDArray[np.bool_]
    residuals: tuple[Array, ...]
    rotations: Array
    rms: float
    kept_back: Mapping[str, float]

    @property
    def tilts(self) -> Array:
        """(n,), between the board's normal and the camera's axis, rad."""
        normals = [cv2.Rodrigues(turn)[0][2, 2] for turn in self.rotations]
        return np.asarray(np.arccos(np.clip(np.abs(normals), 0.0, 1.0)), np.float64)


def calibrate_camera(
    views: Sequence[BoardView], size: tuple[int, int], model: str = 'auto'
) -> CameraCalibration:
    """Fit a camera to views of a board.

    The fit is OpenCV's (Zhang 2000; Kannala and Brandt 2006 for ``equidistant``). A view whose
    residuals stand out is left out. The model is the simplest one that no longer one beats on
    views that were kept back. Standard deviations are noise² (JᵀJ)⁻¹ with the poses of the board
    as further unknowns.

    Args:
        views: different ones, tilted in several directions; those that differ most first.
        size: width and height of the images, px.
        model: one of `MODELS`.

    Raises:
        CalibrationError: the views are too few, or do not determine the camera.
    """
    if len(views) < MIN_VIEWS:
        raise CalibrationError(
            f'{len(views)} different views of the board are too few: {MIN_VIEWS} are needed, '
            'and 20 to 40 are good'
        )
    names = [name for name in _LENSES if model in ('auto', _LENSES[name].model)]
    if not names:
        raise CalibrationError(f'there is no model {model!r}: {", ".join(MODELS)}')
    # Blurred views are found with a model that fits most lenses.
    used = _clean(views, size, _LENSES[names[-1] if len(names) < 3 else 'plumb_bob'])
    chosen = [view for view, use in zip(views, used, strict=True) if use]
    kept_back = _kept_back(chosen, size, names) if len(names) > 1 else {}
    name = names[0]
    for other in names[1:]:
        if kept_back[other] < (1.0 - TUNING.better) * kept_back[name]:
            name = other
    fit = _fit(chosen, size, _LENSES[name])
    deviations = fit.deviations(chosen)
    _refuse_untold(fit, deviations)
    poses = [fit.pose(view) for view in views]
    residuals = tuple(fit.residuals(view, pose) for view, pose in zip(views, poses, strict=True))
    inliers = np.concatenate([each for each, use in zip(residuals, used, strict=True) if use])
    return CameraCalibration(
        fit.camera(size),
        tuple(deviations.tolist()),
        used,
        residuals,
        np.array([pose[:3] for pose in poses]),
        _rms(inliers),
        {key: value for key, value in kept_back.items() if math.isfinite(value)},
    )


@dataclass(frozen=True, eq=False)
class _Fit:
    """A camera and the board's poses: rotation vector and translation, (6,) each."""

    lens: _Lens
    matrix: Array
    d: Array
    poses: list[Array]

    def camera(self, size: tuple[int, int]) -> CameraModel:
        k, d = (tuple(part.ravel().tolist()) for part in (self.matrix, self.d))
        return CameraModel(*size, k=k, d=d, distortion_model=self.lens.model)

    def project(self, points: Array, pose: Array) -> tuple[Array, Array, Array]:
        """Pixels (n, 2), and their derivatives by the pose (2n, 6) and the camera (2n, 4 + k)."""
        count = 4 + self.lens.coefficients
        if self.lens.model == 'equidistant':
            found = cv2.fisheye.projectPoints(
                points.reshape(-1, 1, 3), pose[:3], pose[3:], self.matrix, self.d
            )
            pixels, slopes = (np.asarray(part, np.float64) for part in found)
            by_camera, by_pose = slopes[:, :count], slopes[:, 8:14]
        else:
            found = cv2.projectPoints(points, pose[:3], pose[3:], self.matrix, self.d)
            pixels, slopes = (np.asarray(part, np.float64) for part in found)
            by_camera, by_pose = slopes[:, 6 : 6 + count], slopes[:, :6]
        return pixels.reshape(-1, 2), by_pose, by_camera

    def pose(self, view: BoardView) -> Array:
        """The board's pose that fits a view best: from the undistorted points, then refined."""
        rays = self.camera((1, 1)).undistort(view.pixels)
        good = np.isfinite(rays).all(axis=1) & (np.abs(rays) < 20.0).all(axis=1)
        if good.sum() < 4:
            return np.full(6, np.nan)
        flag = cv2.SOLVEPNP_IPPE
        start = cv2.solvePnP(view.points[good], rays[good], np.eye(3), None, flags=flag)
        pose = np.concatenate([np.asarray(part, np.float64).ravel() for part in start[1:]])
        for _ in range(5):
            seen, slopes, _ = self.project(view.points, pose)
            if not np.isfinite(slopes).all():
                return np.full(6, np.nan)
            step = np.linalg.lstsq(slopes, (view.pixels - seen).ravel(), rcond=None)[0]
            pose = pose + step
        return pose

    def residuals(self, view: BoardView, pose: Array) -> Array:
        return np.asarray(view.pixels - self.project(view.points, pose)[0])

    def squares(self, views: Sequence[BoardView]) -> float:
        """The sum of all squared residuals, px²; infinite where a pose is not one."""
        total = 0.0
        for view, pose in zip(views, self.poses, strict=True):
            residuals = self.residuals(view, pose)
            total += float((residuals * residuals).sum())
        return total if math.isfinite(total) else math.inf

    def eliminated(
        self, views: Sequence[BoardView]
    ) -> tuple[Array, Array, list[tuple[Array, Array]]]:
        """Normal equations of the camera alone; each pose's own step, and how it follows."""
        count = 4 + self.lens.coefficients
        information, gradient, poses = np.zeros((count, count)), np.zeros(count), []
        for view, pose in zip(views, self.poses, strict=True):
            seen, by_pose, by_camera = self.project(view.points, pose)
            residuals = (view.pixels - seen).ravel()
            inverse = np.linalg.pinv(by_pose)
            rest = by_camera - by_pose @ (inverse @ by_camera)
            information += rest.T @ rest
            gradient += rest.T @ residuals
            poses.append((inverse @ residuals, inverse @ by_camera))
        return information, gradient, poses

    def stepped(self, views: Sequence[BoardView], damping: float) -> _Fit:
        """After a part of Gauss and Newton's step of the camera and all poses."""
        information, gradient, eliminated = self.eliminated(views)
        step = damping * np.linalg.lstsq(information, gradient, rcond=1e-14)[0]
        matrix = self.matrix.copy()
        matrix[[0, 1, 0, 1], [0, 1, 2, 2]] += step[:4]
        poses = [
            pose + damping * own - along @ step
            for pose, (own, along) in zip(self.poses, eliminated, strict=True)
        ]
        return _Fit(self.lens, matrix, self.d + step[4:], poses)

    def deviations(self, views: Sequence[BoardView]) -> Array:
        """Standard deviations of the matrix and the coefficients, (4 + all coefficients,)."""
        information = self.eliminated(views)[0]
        left = sum(view.pixels.size - 6 for view in views) - len(information)
        scale = np.sqrt(np.maximum(np.diag(information), 1e-300))
        # What the views do not determine at all is to come out as unknown, not as zero.
        values, axes = np.linalg.eigh(information / np.outer(scale, scale))
        spread = ((axes / np.sqrt(np.maximum(values, 1e-15))) ** 2).sum(axis=1)
        noise = max(self.squares(views) / max(left, 1), TUNING.least_noise**2)
        variances = spread / scale**2 * noise
        deviations = np.sqrt(np.maximum(variances, 0.0))
        return np.append(deviations, np.zeros(4 + len(self.d) - len(information)))


def _fit(views: Sequence[BoardView], size: tuple[int, int], lens: _Lens) -> _Fit:
    """OpenCV's fit.

    Raises:
        CalibrationError: it fails.
    """
    if lens.model == 'equidistant':
        return _fit_fisheye(views, size)
    points = [view.points.reshape(-1, 1, 3).astype(np.float32) for view in views]
    pixels = [view.pixels.reshape(-1, 1, 2).astype(np.float32) for view in views]
    try:
        found = cv2.calibrateCamera(points, pixels, size, None, None, flags=lens.flags)
    except cv2.error as error:
        raise CalibrationError(
            f'OpenCV finds no {lens.model} camera that fits the views'
        ) from error
    matrix, d = (np.asarray(part, np.float64) for part in found[1:3])
    count = max(lens.coefficients, 5) if lens.model == 'plumb_bob' else lens.coefficients
    d = d.ravel()[:count]
    if not (np.isfinite(matrix).all() and np.isfinite(d).all() and found[0] < min(size)):
        raise CalibrationError(f'no {lens.model} camera fits the views')
    turns, places = found[3:5]
    poses = [
        np.append(turn, place).astype(np.float64) for turn, place in zip(turns, places, strict=True)
    ]
    return _Fit(lens, matrix, d, poses)


def _fit_fisheye(views: Sequence[BoardView], size: tuple[int, int]) -> _Fit:
    """Gauss and Newton's steps from several focal lengths.

    OpenCV's own fisheye.calibrate stops with an error from most starts, in OpenCV 5 from all.
    """
    lens, best, least = _LENSES['equidistant'], None, math.inf
    for share in _FISHEYE_FOCALS:
        focal = share * max(size)
        matrix = np.diag((focal, focal, 1.0))
        matrix[:2, 2] = 0.5 * (size[0] - 1), 0.5 * (size[1] - 1)
        fit = _Fit(lens, matrix, np.zeros(4), [])
        fit = replace(fit, poses=[fit.pose(view) for view in views])
        squares = fit.squares(views)
        if math.isinf(squares):  # A view that no board's pose explains with this focal length
            continue
        for _ in range(_MAX_STEPS):
            before = squares
            for damping in (1.0, 0.3, 0.1):
                stepped = fit.stepped(views, damping)
                if (squares := stepped.squares(views)) < before:
                    fit = stepped
                    break
            if not squares < before * (1.0 - 1e-9):
                break
        if before < least:
            best, least = fit, before
    if best is None:
        raise CalibrationError('no equidistant camera fits the views')
    return best


def _clean(views: Sequence[BoardView], size: tuple[int, int], lens: _Lens) -> NDArray[np.bool_]:
    """Which views are not blurred or wrong, by their residuals."""
    used = np.ones(len(views), np.bool_)
    for _ in range(2):
        fit = _fit([v for v, use in zip(views, used, strict=True) if use], size, lens)
        rms = np.array([_rms(fit.residuals(view, fit.pose(view))) for view in views])
        rms[~np.isfinite(rms)] = np.inf
        worst = max(
            TUNING.outlying * float(np.median(rms)),
            float(np.quantile(rms, 1.0 - TUNING.most_outlying, method='lower')),
        )
        before, used = used, rms <= worst
        if used.sum() < MIN_VIEWS:
            return before
        if (before == used).all():
            break
    return used


def _kept_back(
    views: Sequence[BoardView], size: tuple[int, int], names: Sequence[str]
) -> dict[str, float]:
    """The rms residual of each model on views that it was not fitted to, px."""
    errors: dict[str, list[Array]] = {name: [] for name in names}
    views = views[: TUNING.most_kept_back]
    folds = min(TUNING.folds, len(views) // 4)
    if folds < 2:  # Too few to keep some back: the simplest model
        return {name: 0.0 if name == names[0] else math.inf for name in names}
    for fold in range(folds):
        rest = [view for number, view in enumerate(views) if number % folds != fold]
        for name in names:
            try:
                fit = _fit(rest, size, _LENSES[name])
            except CalibrationError:
                errors[name].append(np.array([(np.inf, np.inf)]))
                continue
            errors[name] += [fit.residuals(view, fit.pose(view)) for view in views[fold::folds]]
    return {name: _rms(np.concatenate(found)) for name, found in errors.items()}


def _refuse_untold(fit: _Fit, deviations: Array) -> None:
    """Say why the views do not determine the focal length, if they do not."""
    focal = fit.matrix[0, 0], fit.matrix[1, 1]
    if min(focal) <= 0.0:
        raise CalibrationError('the views do not determine the focal length')
    share = max(deviations[0] / focal[0], deviations[1] / focal[1])
    if share < TUNING.most_focal_error:
        return
    raise CalibrationError(
        f'the views do not determine the focal length (standard deviation {100 * share:.2g} %): '
        'the board has to be tilted by 20 to 45 degrees against the image, in several directions'
    )


def _rms(residuals: Array) -> float:
    with np.errstate(invalid='ignore', over='ignore'):
        value = math.sqrt(float(np.mean(residuals * residuals)))
    return value if math.isfinite(value) else math.inf
