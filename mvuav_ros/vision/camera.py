"""The camera's calibration as the vision library uses it."""

from __future__ import annotations

import math
import operator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from mvuav_ros.vision.frames import read_only

Array = NDArray[np.float64]

EQUIDISTANT = 'equidistant'
COEFFICIENTS: dict[str, tuple[int, ...]] = {
    'plumb_bob': (0, 4, 5, 8, 12, 14),
    'rational_polynomial': (0, 4, 5, 8, 12, 14),
    EQUIDISTANT: (0, 4),
    '': (0, 4, 5, 8, 12, 14),
}
"""How many each of sensor_msgs/CameraInfo's models has, in OpenCV's order."""

_NOWHERE = (0.0, 0.0, 0.0)
_WIDEST_TURN = math.radians(89.0)
"""Rad off the axis: what a fisheye sees farther out has no place on an image plane."""
_MAX_SKEW = 0.5
"""px: what OpenCV leaves out then moves a light by less than a principal point is known to."""
_undistort: Any = getattr(cv2, 'undistortPointsIter', cv2.undistortPoints)
"""OpenCV 4 has another name for the one that goes on after five steps."""
_SETTLED = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-6)
"""Steps at most, and px: five leave 1 px in the corners of a lens of 80 degrees."""


class CalibrationError(ValueError):
    """A calibration that cannot be used, with the reason."""


@dataclass(frozen=True, init=False)
class CameraModel:
    """A camera with a lens, as in sensor_msgs/CameraInfo, for images as they are.

    What OpenCV gives is taken as it is: ``k`` as a 3 x 3 array, ``d`` in any shape, or None.
    `binned` and `cropped` give the calibration of smaller images of the same camera.

    Attributes:
        width: of the images that it was calibrated with, px.
        height: of these images, px.
        k: the camera matrix, nine numbers, row-major, px.
        d: OpenCV's distortion coefficients: 0, 4, 5, 8, 12 or 14 numbers; ``equidistant``: 0 or 4.
        distortion_model: ``plumb_bob``, ``rational_polynomial``, ``equidistant`` (OpenCV's
            fisheye model: k1 to k4 in the angle off the axis) or empty.
        r: the rectification, nine numbers; empty: none is known.
        p: the projection of rectified images, twelve numbers, px; empty: none is known.
        is_rectified: the images are rectified: ``p`` holds for them, without distortion, and
            poses are those of the turned camera that ``r`` and ``p`` make of this one.

    Raises:
        CalibrationError: a matrix has another number of elements, or something is no number.
            Whether the numbers can be used, `check` says.

    Examples:
        >>> import numpy as np
        >>> from mvuav_ros import CameraModel
        >>> k = np.array([[600, 0, 320], [0, 600, 240], [0, 0, 1]])
        >>> camera = CameraModel(640, 480, k, d=np.zeros((5, 1)))
        >>> camera.check(640, 480)
        >>> camera.project([(0.5, 0.0, 10.0)]).round(1).tolist()
        [[350.0, 240.0]]
        >>> camera.check(320, 240)
        Traceback (most recent call last):
        mvuav_ros.vision.camera.CalibrationError: camera_info is for 640 x 480 px, the images are \
320 x 240 px
        >>> camera.binned(2, 2).check(320, 240)
        >>> CameraModel(640, 480, k=(600, 600))
        Traceback (most recent call last):
        mvuav_ros.vision.camera.CalibrationError: the camera matrix needs 3 x 3 numbers, not 2
    """

    width: int
    height: int
    k: tuple[float, ...]
    d: tuple[float, ...] = ()
    distortion_model: str = 'plumb_bob'
    r: tuple[float, ...] = ()
    p: tuple[float, ...] = ()
    is_rectified: bool = False

    def __init__(
        self,
        width: int,
        height: int,
        k: ArrayLike,
        d: ArrayLike | None = (),
        distortion_model: str = 'plumb_bob',
        r: ArrayLike | None = (),
        p: ArrayLike | None = (),
        is_rectified: bool = False,
    ) -> None:
        # A dataclass's own would take nothing but the tuples that it holds.
        vars(self).update(
            width=operator.index(width),
            height=operator.index(height),
            k=_numbers(k, 'camera matrix', '3 x 3', (9,)),
            d=_numbers(d, 'distortion'),
            distortion_model=distortion_model,
            r=_numbers(r, 'rectification matrix', '3 x 3', (0, 9)),
            p=_numbers(p, 'projection matrix', '3 x 4', (0, 12)),
            is_rectified=is_rectified,
        )

    @staticmethod
    def given(camera: CameraModel) -> CameraModel:
        """What a program gives; a `TypeError` where it is none."""
        if not isinstance(camera, CameraModel):
            kind = type(camera).__name__
            raise TypeError(f'camera must be a CameraModel (see load_calibration), not {kind}')
        return camera

    @cached_property
    def matrix(self) -> Array:
        """What holds for the images: K, or of rectified ones the first three columns of P; px."""
        if not self.is_rectified:
            return read_only(np.array(self.k).reshape(3, 3))
        return read_only(np.array(self.p or np.zeros(12)).reshape(3, 4)[:, :3].copy())

    @cached_property
    def distortion(self) -> Array:
        """Distortion coefficients of the images, (n,); zeros without distortion."""
        zeros = (0.0,) * (4 if self.is_fisheye else 5)
        return read_only(np.array(zeros if self.is_rectified else self.d or zeros))

    @cached_property
    def is_straight(self) -> bool:
        """Whether straight lines are straight in the images."""
        return not self.is_fisheye and not self.distortion.any()

    @property
    def is_fisheye(self) -> bool:
        """Whether images are seen through OpenCV's fisheye model."""
        return self.distortion_model == EQUIDISTANT and not self.is_rectified

    def rectified(self) -> CameraModel:
        """The same for images that were rectified with it."""
        return self if self.is_rectified else replace(self, is_rectified=True)

    def cropped(self, x: int, y: int, width: int, height: int) -> CameraModel:
        """The calibration of a part of the images: CameraInfo's ``roi``, px.

        Of a part that reaches beyond them only what is inside counts: images of all of it, whose
        calibration is no longer that of whole ones, do not `check`.
        """
        width, height = min(width, self.width - x), min(height, self.height - y)
        k, p = (_moved(matrix, x, y) for matrix in (self.k, self.p))
        return replace(self, width=width, height=height, k=k, p=p)

    def binned(self, x: int, y: int) -> CameraModel:
        """The calibration of images in which ``x`` by ``y`` pixels are one: CameraInfo's binning.

        The centre of the first pixel is (0, 0) before and after, so that of x pixels is at
        (x - 1) / 2 before it becomes 0.
        """
        first = 0.5 * (x - 1), 0.5 * (y - 1)
        k, p = (_moved(matrix, *first, x, y) for matrix in (self.k, self.p))
        return replace(self, width=self.width // x, height=self.height // y, k=k, p=p)

    def check(self, width: int, height: int) -> None:
        """Make sure that images of that size (px) can be measured with this calibration.

        Raises:
            CalibrationError: it is all zeros (uncalibrated), of another size, with skew or
                transposed, or of a lens model that is not known.
        """
        if objection := self.objection(width, height):
            raise CalibrationError(objection)

    def objection(self, width: int, height: int) -> str:
        """What `check` has against images of that size, in words; empty where it has nothing."""
        if self._flaw or (self.width, self.height) == (width, height):
            return self._flaw
        turned = ' (a quarter turn: turn the images, or calibrate with the camera held like that)'
        return (
            f'camera_info is for {self.width} x {self.height} px, the images are {width} x '
            f'{height} px{turned if (self.height, self.width) == (width, height) else ""}'
        )

    @cached_property
    def _flaw(self) -> str:
        """Why it is of no use for images of any size; empty if it can be used."""
        if self.distortion_model not in COEFFICIENTS:
            known = ', '.join(filter(None, COEFFICIENTS))
            return f'distortion model {self.distortion_model!r} is not one of {known}'
        if not np.isfinite((*self.k, *self.d, *self.p)).all():
            return 'camera_info contains values that are not finite'
        if self.is_rectified and not (self.p and self.p[0] > 0 and self.p[5] > 0):
            return 'camera_info has no projection matrix P, which rectified images need'
        if self.matrix[0, 0] <= 0 or self.matrix[1, 1] <= 0:
            lacks = 'has no focal lengths above 0' if any(self.k) else 'is all zeros'
            return f'camera_info {lacks}: the camera is not calibrated'
        if self.width <= 0 or self.height <= 0:
            return 'camera_info is of no pixels: is its region of interest within its images?'
        if np.abs(self.matrix[(0, 1, 2, 2), (1, 0, 0, 1)]).max() > _MAX_SKEW:
            return (
                'the camera matrix must be fx, 0, cx, 0, fy, cy, 0, 0, 1, without skew; '
                'MATLAB has it transposed'
            )
        if len(self.d) not in COEFFICIENTS[self.distortion_model]:
            *few, most = map(str, COEFFICIENTS[self.distortion_model])
            return (
                f'{self.distortion_model or "a lens"} has {", ".join(few)} or {most} distortion '
                f'coefficients, not {len(self.d)}'
            )
        return ''

    def undistort(self, pixels: ArrayLike) -> Array:
        """Where the rays of pixels meet the plane one ahead: (n, 2) px to (n, 2), x / z and y / z.

        What a fisheye sees 89° and more off the axis is put at 89°.
        """
        points = np.ascontiguousarray(pixels, np.float64).reshape(-1, 1, 2)
        if not len(points):
            return np.empty((0, 2))
        matrix = self.matrix
        if self.is_straight:
            flat = (points.reshape(-1, 2) - matrix[:2, 2]) / (matrix[0, 0], matrix[1, 1])
            return np.asarray(flat)
        if not self.is_fisheye:
            found = _undistort(points, matrix, self.distortion, R=None, P=None, criteria=_SETTLED)
            return np.asarray(found, np.float64).reshape(-1, 2)
        return self._undistort_fisheye(points.reshape(-1, 2))

    def reaches(self, pixels: ArrayLike) -> NDArray[np.bool_]:
        """Which pixels (n, 2) have a ray: beyond where the lens model turns back there is none."""
        away = (np.asarray(pixels) - self.matrix[:2, 2]) / (self.matrix[0, 0], self.matrix[1, 1])
        return np.asarray(np.hypot(*away.T) < self._farthest)

    @cached_property
    def _farthest(self) -> float:
        """Focal lengths from the principal point to where `widest` is seen."""
        if math.isinf(self.widest):
            return math.inf
        seen = self.project([(self.widest, 0.0, 1.0)])[0] - self.matrix[:2, 2]
        return float(seen[0] / self.matrix[0, 0])

    def seen_at(self, flat: Array) -> Array:
        """Pixels (n, 2) of rays x / z and y / z (n, 2): those beyond `widest` are put there."""
        ahead = np.maximum(1.0, np.hypot(*flat.T) / self.widest)
        return self.project(np.column_stack((flat, ahead)))

    def _undistort_fisheye(self, pixels: Array) -> Array:
        """Newton's method on theta_d = theta (1 + k1 theta² + ... + k4 theta⁸).

        OpenCV's own gives up on a part of the points beyond about 80°.
        """
        matrix = self.matrix
        bent = (pixels - matrix[:2, 2]).T / np.array([(matrix[0, 0],), (matrix[1, 1],)])
        wanted = np.hypot(*bent)
        turn = np.minimum(wanted, _WIDEST_TURN)
        powers = np.array((3, 5, 7, 9))[:, None]
        d = self.distortion[:, None]
        for _ in range(20):
            error = turn + (d * turn**powers).sum(axis=0) - wanted
            slope = 1.0 + (d * powers * turn ** (powers - 1)).sum(axis=0)
            turn, before = np.clip(turn - error / np.maximum(slope, 0.1), 0.0, _WIDEST_TURN), turn
            if np.abs(turn - before).max() < 1e-13:
                break
        scale = np.where(wanted > 1e-12, np.tan(turn) / np.maximum(wanted, 1e-12), 1.0)
        return np.asarray((bent * scale).T)

    def project(
        self, points: ArrayLike, rvec: ArrayLike = _NOWHERE, tvec: ArrayLike = _NOWHERE
    ) -> Array:
        """Where points are seen: (n, 3) m, moved by ``rvec`` (rad) and ``tvec`` (m); (n, 2) px."""
        return self.project_with_jacobians(points, rvec, tvec)[0]

    def project_with_jacobians(
        self, points: ArrayLike, rvec: ArrayLike, tvec: ArrayLike
    ) -> tuple[Array, Array, Array]:
        """`project`, and its derivatives.

        They are (2n, 6) by ``rvec`` and ``tvec``, and (2n, 4 + k) by fx, fy, cx, cy and the k
        coefficients.
        """
        given = np.ascontiguousarray(points, np.float64).reshape(-1, 1, 3)
        count = 4 + len(self.distortion)
        if not len(given):
            return np.empty((0, 2)), np.empty((0, 6)), np.empty((0, count))
        project: Any = cv2.fisheye.projectPoints if self.is_fisheye else cv2.projectPoints
        turn, place = np.asarray(rvec, np.float64), np.asarray(tvec, np.float64)
        seen, slopes = project(given, turn, place, self.matrix, self.distortion)
        pose, camera = (8, 0) if self.is_fisheye else (0, 6)
        by_pose, by_camera = slopes[:, pose : pose + 6], slopes[:, camera : camera + count]
        return seen.reshape(-1, 2), by_pose, by_camera

    @cached_property
    def widest(self) -> float:
        """Tangent of the angle off the axis where the lens model turns back, or infinite.

        Of a fisheye it is at most that of 89°.
        """
        d = np.append(self.distortion, np.zeros(8))
        if self.is_fisheye:
            slope = np.append(d[3::-1] * (9, 7, 5, 3), 1.0)
        else:
            # Of r a(r²) / b(r²); tangential distortion is small.
            a, b = (np.append(d[kept], 1.0) for kept in ([4, 1, 0], [7, 6, 5]))
            turned: Array = np.polysub(np.polymul(np.polyder(a), b), np.polymul(a, np.polyder(b)))
            slope = np.polymul(np.polyadd(np.polymul(a, b), np.append(2.0 * turned, 0.0)), b)
        roots = np.roots(slope)
        least = math.sqrt(min(roots[np.isreal(roots) & (roots.real > 0)].real, default=math.inf))
        return math.tan(min(least, _WIDEST_TURN)) if self.is_fisheye else least

    def shows(self, places: Array) -> NDArray[np.bool_]:
        """Which of some places (n, 3), m, are ahead, and not as far aside as `widest`."""
        return np.asarray(np.hypot(*places[:, :2].T) / self.widest < places[:, 2])


def _numbers(given: Any, name: str, shape: str = '', counts: tuple[int, ...] = ()) -> Any:
    """Plain numbers, row-major, of a sequence or an array of any shape."""
    is_plain = type(given) is tuple and all(type(value) is float for value in given)
    try:
        numbers = given if is_plain else np.asarray(() if given is None else given, np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise CalibrationError(f'the {name} holds what is no number: {error}') from error
    count = len(given) if is_plain else numbers.size
    if counts and count not in counts:
        raise CalibrationError(f'the {name} needs {shape} numbers, not {count}')
    plain = given if is_plain else numbers.ravel().tolist()
    # One NaN for all, so that a calibration that comes again equals the one before.
    return tuple(math.nan if math.isnan(value) else value for value in plain)


def _moved(
    matrix: tuple[float, ...], x: float, y: float, across: int = 1, down: int = 1
) -> tuple[float, ...]:
    """K or P of images that begin at a pixel, and are so many times smaller."""
    moved = np.reshape(matrix, (3, -1))
    moved[:2, 2:3] -= (x,), (y,)
    return tuple((moved / ((across,), (down,), (1,))).ravel().tolist())
