"""A camera's matrix and lens from views of a board: the fit, its uncertainty, its model."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import compress
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.board import BoardView
from mvuav_ros.vision.bundle_adjustment import Equations, adjust, eliminate_poses
from mvuav_ros.vision.camera import EQUIDISTANT, CalibrationError, CameraModel

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
    # px, rms: above it residuals are not those of corners, which are found to some tenths.
    most_rms: float = 1.0
    # px, per axis: the least noise that is expected of a corner.
    least_noise: float = 0.02
    # px: from where on a corner counts less and less in a fisheye's fit. OpenCV's model mirrors
    # what is more than 90 degrees off the axis, and a view with such corners is left out.
    outlying_corner: float = 5.0
    folds: int = 4  # parts into which views are split, each kept back once
    most_kept_back: int = 40  # views, those that differ most, that models are compared on
    better: float = 0.01  # by which part a longer model must do better on views kept back


TUNING = LensCalibrationTuning()
TOO_MUCH = (
    'too much; the images are blurred, the board is bent, it reaches farther than 90 degrees off '
    'the axis, or the lens is another'
)
"""Why residuals may be beyond `LensCalibrationTuning.most_rms`."""


class _Lens(NamedTuple):
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


@dataclass(frozen=True, eq=False)
class CameraCalibration:
    """A calibration with the figures of how good it is."""

    camera: CameraModel  # the matrix and the lens
    # Standard deviations of fx, fy, cx, cy (px), then of the coefficients; zero of one that was
    # kept at zero.
    deviations: tuple[float, ...]
    used: NDArray[np.bool_]  # (n,), of the views given; the others were blurred or wrong
    residuals: tuple[Array, ...]  # for each view (m, 2), seen minus projected, px
    rotations: Array  # (n, 3), the rotation vectors of the board in the optical frame
    rms: float  # root mean square of the residuals of the used views per axis, px
    # By model, the rms per axis on views that it was not fitted to, px; empty without a choice.
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
    used = _clean(views, size, names)
    chosen = list(compress(views, used))
    kept_back = _kept_back(chosen, size, names) if len(names) > 1 else {}
    name = names[0]
    for other in names[1:]:
        if kept_back[other] < (1.0 - TUNING.better) * kept_back[name]:
            name = other
    fit = _fit(chosen, size, _LENSES[name])
    deviations = fit.deviations(chosen)
    poses = [fit.pose(view) for view in views]
    residuals = tuple(map(fit.residuals, views, poses))
    rms = _rms(np.concatenate(list(compress(residuals, used))))
    _refuse_untold(fit, deviations, rms)
    return CameraCalibration(
        fit.camera,
        tuple(deviations.tolist()),
        used,
        residuals,
        np.array([pose[:3] for pose in poses]),
        rms,
        {key: value for key, value in kept_back.items() if math.isfinite(value)},
    )


@dataclass(frozen=True, eq=False)
class _Fit:
    """A camera, of which some coefficients are fitted, and the board's poses.

    A pose is a rotation vector and a translation, (6,).
    """

    camera: CameraModel
    coefficients: int
    poses: Sequence[Array] = ()

    def pose(self, view: BoardView) -> Array:
        """The board's pose that fits a view best: from the undistorted points, then refined."""
        rays = self.camera.undistort(view.pixels)
        good = np.isfinite(rays).all(axis=1) & (np.abs(rays) < 20.0).all(axis=1)
        if good.sum() < 4:
            return np.full(6, np.nan)
        flag = cv2.SOLVEPNP_IPPE
        found, *start = cv2.solvePnP(view.points[good], rays[good], np.eye(3), None, flags=flag)
        if not found:
            return np.full(6, np.nan)
        pose = np.concatenate([np.asarray(part, np.float64).ravel() for part in start])
        for _ in range(5):
            residuals, slopes, _ = self.equations(view, pose)
            if not np.isfinite(slopes).all():
                return np.full(6, np.nan)
            pose = pose + np.linalg.lstsq(slopes, residuals, rcond=None)[0]
        return pose

    def equations(self, view: BoardView, pose: Array) -> Equations:
        project = self.camera.project_with_jacobians
        seen, by_pose, by_camera = project(view.points, pose[:3], pose[3:])
        residuals = (view.pixels - seen).ravel()
        return Equations(residuals, by_pose, by_camera[:, : 4 + self.coefficients])

    def residuals(self, view: BoardView, pose: Array) -> Array:
        return view.pixels - self.camera.project(view.points, pose[:3], pose[3:])

    def deviations(self, views: Sequence[BoardView]) -> Array:
        """Standard deviations of the matrix and the coefficients, (4 + all coefficients,)."""
        equations = list(map(self.equations, views, self.poses))
        information = eliminate_poses(equations)[0]
        left = sum(view.pixels.size - 6 for view in views) - len(information)
        scale = np.sqrt(np.maximum(np.diag(information), 1e-300))
        # What the views do not determine at all is to come out as unknown, not as zero.
        values, axes = np.linalg.eigh(information / np.outer(scale, scale))
        spread = ((axes / np.sqrt(np.maximum(values, 1e-15))) ** 2).sum(axis=1)
        squares = sum(float(each.residuals @ each.residuals) for each in equations)
        variances = spread / scale**2 * max(squares / max(left, 1), TUNING.least_noise**2)
        return np.append(np.sqrt(variances), np.zeros(len(self.camera.d) - self.coefficients))


def _fit(views: Sequence[BoardView], size: tuple[int, int], lens: _Lens) -> _Fit:
    """OpenCV's fit; a CalibrationError where it fails."""
    if lens.model == EQUIDISTANT:
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
    poses = [np.append(*pose).astype(np.float64) for pose in zip(*found[3:5], strict=True)]
    k = tuple(matrix.ravel().tolist())
    camera = CameraModel(*size, k, tuple(d.tolist()), lens.model)
    return _Fit(camera, lens.coefficients, poses)


def _fit_fisheye(views: Sequence[BoardView], size: tuple[int, int]) -> _Fit:
    """Gauss and Newton's steps from several focal lengths.

    OpenCV's own fisheye.calibrate stops with an error from most starts, in OpenCV 5 from all.
    """
    best, least = None, math.inf
    for share in _FISHEYE_FOCALS:
        focal = share * max(size)
        values = np.array((focal, focal, 0.5 * (size[0] - 1), 0.5 * (size[1] - 1), *[0.0] * 4))
        poses = [_fisheye(size, values).pose(view) for view in views]
        if not np.isfinite(poses).all():  # A view that no pose explains with this focal length
            continue
        values, poses, squares = adjust(
            lambda number, at, pose: _fisheye(size, at).equations(views[number], pose),
            values,
            poses,
            TUNING.outlying_corner,
        )
        if squares < least:
            best, least = replace(_fisheye(size, values), poses=poses), squares
    if best is None:
        raise CalibrationError('no equidistant camera fits the views')
    return best


def _fisheye(size: tuple[int, int], values: Array) -> _Fit:
    """By fx, fy, cx, cy and the coefficients."""
    fx, fy, cx, cy, *d = values.tolist()
    k = (fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0)
    return _Fit(CameraModel(*size, k, tuple(d), EQUIDISTANT), len(d))


def _rms_residuals(
    views: Sequence[BoardView], size: tuple[int, int], name: str, fitted: Sequence[BoardView]
) -> Array:
    """(n,), the rms residuals of views (px) from a lens fitted to some; infinite if none fits."""
    try:
        fit = _fit(fitted, size, _LENSES[name])
    except CalibrationError:
        return np.full(len(views), np.inf)
    return np.array([_rms(fit.residuals(view, fit.pose(view))) for view in views])


def _clean(
    views: Sequence[BoardView], size: tuple[int, int], names: Sequence[str]
) -> NDArray[np.bool_]:
    """Which views are not blurred or wrong, by their residuals from the lens that fits most."""
    used = np.ones(len(views), np.bool_)
    for _ in range(2):
        chosen = list(compress(views, used))
        rms = min((_rms_residuals(views, size, name, chosen) for name in names), key=np.median)
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
    views, folds = views[: TUNING.most_kept_back], TUNING.folds
    errors: dict[str, list[Array]] = {name: [] for name in names}
    for fold in range(folds):
        rest = [view for number, view in enumerate(views) if number % folds != fold]
        for name in names:
            errors[name].append(_rms_residuals(views[fold::folds], size, name, rest))
    return {name: _rms(np.concatenate(found)) for name, found in errors.items()}


def _refuse_untold(fit: _Fit, deviations: Array, rms: float) -> None:
    """Say why the views do not determine the focal length, if they do not."""
    focal = fit.camera.k[0], fit.camera.k[4]
    if min(focal) <= 0.0:
        raise CalibrationError('the views do not determine the focal length')
    share = max(deviations[0] / focal[0], deviations[1] / focal[1])
    if share < TUNING.most_focal_error:
        return
    why = 'the board has to be tilted by 20 to 45 degrees against the image, in several directions'
    if rms > TUNING.most_rms:
        why = f'they leave residuals of {rms:.3g} px rms, {TOO_MUCH}'
    raise CalibrationError(
        f'the views do not determine the focal length (standard deviation {100 * share:.2g} %): '
        f'{why}'
    )


def _rms(residuals: Array) -> float:
    with np.errstate(invalid='ignore', over='ignore'):
        value = math.sqrt(float(np.mean(residuals * residuals)))
    return value if math.isfinite(value) else math.inf
