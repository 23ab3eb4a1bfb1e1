"""Where the horizon is, by attitude or in the image, and the image turned until it is level."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.approach.tuning import HORIZON
from mvuav_ros.vision.camera import CameraModel
from mvuav_ros.vision.frames import OPTICAL_FROM_BODY, Attitude, from_rpy
from mvuav_ros.vision.runway.normal_form import NormalForm


@dataclass(frozen=True)
class HorizonLine:
    """A straight horizon on an image: y = row + (x - middle column) tan(slope).

    Attributes:
        row: where it crosses the middle column, px.
        slope: rad, right end down positive; the camera's roll is its negative. Beyond a quarter
            turn the sky is below: the camera is upside down.
        sigma: rad, standard deviation of the slope; 0 where none is stated.
    """

    row: float
    slope: float
    sigma: float = 0.0


def mount_matrix(rpy_deg: tuple[float, float, float]) -> NDArray[np.float64]:
    """Body axes from the camera's own (x forward, y left, z up), turned about fixed axes."""
    return from_rpy(*map(math.radians, rpy_deg))


def is_mounted_upside_down(mount: NDArray[np.float64]) -> bool:
    """Whether a camera on `mount_matrix` sees the ground above the sky from a level body."""
    return bool(mount[2, 2] < 0.0)


def is_upside_down(attitude: Attitude, mount: NDArray[np.float64]) -> bool:
    """Whether a camera on `mount_matrix` would see sky where the ground is: a wrong attitude."""
    down = (OPTICAL_FROM_BODY @ (mount.T @ attitude.up))[1]
    off = -down if is_mounted_upside_down(mount) else down
    return bool(attitude.valid and off > HORIZON.min_upside_down)


def horizon_from(
    attitude: Attitude, camera: CameraModel, mount: NDArray[np.float64]
) -> HorizonLine | None:
    """The horizon that a calibrated camera sees, which `mount_matrix` has put on the body.

    None where the camera looks steeply up or down, or the attitude is none.
    """
    up = OPTICAL_FROM_BODY @ (mount.T @ attitude.up)
    return _seen_by(camera, up, attitude.sigma) if attitude.valid else None


def _seen_by(camera: CameraModel, up: NDArray[np.float64], sigma: float) -> HorizonLine | None:
    """The horizon where it is nearest to the camera's axis, of the way up in the optical frame.

    There radial distortion does not turn it, as it does beside. Tangential distortion does: the
    slope is that without a lens, as the guidance takes it.
    """
    axis = np.array([0.0, 0.0, 1.0])
    level = axis - (axis @ up) * up
    across, down, _ = camera.matrix @ np.cross(level, up)
    ahead = level[None]
    if level[2] < math.cos(HORIZON.max_pitch) ** 2 or across == 0 or not camera.shows(ahead).all():
        return None
    x, y = camera.project(ahead)[0]
    row = y + down / across * (0.5 * (camera.width - 1) - x)
    slope = math.atan(down / across)
    if across < 0:
        slope -= math.copysign(math.pi, slope)
    return HorizonLine(float(row), slope, sigma)


Box = tuple[int, int, int, int]
"""First column and row of a part of an image, and column and row after the last ones."""


@dataclass(frozen=True)
class Derotation:
    """A turn of the working image about its middle."""

    width: int  # of the working image, px
    height: int  # likewise
    factor: int  # px of the frame per px of the working image
    slope: float  # rad, of the horizon on the frame, right end down positive

    @property
    def centre(self) -> tuple[float, float]:
        """About which it is turned, px of the working image."""
        return 0.5 * (self.width - 1), 0.5 * (self.height - 1)

    def turned(self, pixels: NDArray[Any], box: Box | None = None) -> NDArray[Any]:
        """The working image, or a box of it, with a level horizon."""
        left, top, right, bottom = box or (0, 0, self.width, self.height)
        if self.slope == 0.0:
            return pixels[top:bottom, left:right]
        matrix = cv2.getRotationMatrix2D(self.centre, math.degrees(self.slope), 1.0)
        matrix[:, 2] -= left, top
        size = (right - left, bottom - top)
        return np.asarray(cv2.warpAffine(pixels, matrix, size, borderMode=cv2.BORDER_REPLICATE))

    def row_of(self, horizon_row: float) -> float:
        """The level horizon's row, of the row where the slanted one crosses the middle column."""
        _, middle = self.centre
        return middle + (horizon_row - middle) * math.cos(self.slope)

    def to_frame(self, x: Any, y: Any) -> tuple[Any, Any]:
        """Points on the frame, of points on the levelled working image."""
        centre_x, centre_y = self.centre
        cos, sin = self.factor * math.cos(self.slope), self.factor * math.sin(self.slope)
        first_x = self.factor * (centre_x + 0.5) - 0.5 - cos * centre_x + sin * centre_y
        first_y = self.factor * (centre_y + 0.5) - 0.5 - sin * centre_x - cos * centre_y
        return cos * x - sin * y + first_x, sin * x + cos * y + first_y

    def to_working(self, x: Any, y: Any) -> tuple[Any, Any]:
        """The same on the working image as it was."""
        on_x, on_y = self.to_frame(x, y)
        return (on_x + 0.5) / self.factor - 0.5, (on_y + 0.5) / self.factor - 0.5


def line_through(x1: float, y1: float, x2: float, y2: float) -> NormalForm:
    """The line through two points."""
    theta = math.atan2(x2 - x1, -(y2 - y1))
    return NormalForm(x1 * math.cos(theta) + y1 * math.sin(theta), theta).normalised()


def turn_edge(p: Any, slope: Any, row: Any, old: Derotation, new: Derotation) -> tuple[Any, Any]:
    """Edges x = p + slope (y - row) of one level, described on another one."""
    angle = new.slope - old.slope
    if angle == 0.0:
        return p, slope
    cos, sin = math.cos(angle), math.sin(angle)
    centre_x, centre_y = new.centre
    dx, dy = p - centre_x, row - centre_y
    x, y = centre_x + cos * dx + sin * dy, centre_y - sin * dx + cos * dy
    across, down = cos * slope + sin, cos - sin * slope
    turned = across / down
    return x + turned * (row - y), turned


def turn_strips(strips: NDArray[np.float64], old: Derotation, new: Derotation) -> Any:
    """Strips, (n, 6), of one derotation described on another one; NaN where they are none there."""
    if old.slope == new.slope:
        return strips
    x, y, *slopes, far, near = strips.T
    edges = [turn_edge(x + slope * near, slope, y + near, old, new) for slope in slopes]
    (first, left), (second, right) = edges
    left, right = (slope * np.where(right - left > 0.02, 1.0, math.nan) for slope in (left, right))
    depth = (second - first) / (right - left)
    x, y = first - left * depth, y + near - depth
    return np.stack([x, y, left, right, depth * far / near, depth], axis=1)


def vertex(values: NDArray[Any], index: int) -> float:
    """Where the parabola through a maximum and its neighbours has its vertex, from the maximum."""
    if not 0 < index < values.size - 1:
        return 0.0
    before, at, after = (float(value) for value in values[index - 1 : index + 2])
    bend = before - 2 * at + after
    return 0.5 * (before - after) / bend if bend < 0 else 0.0


class HorizonFinder:
    """Finds the horizon on images of one size, and follows it from frame to frame."""

    def __init__(self, height: int, width: int, *, upside_down: bool = False) -> None:
        """The sky is above it, or below it in images of a camera that is mounted upside down."""
        self._upside_down = upside_down
        self._last: HorizonLine | None = None
        self._frames = 0
        across, self._down = width / HORIZON.width, height / HORIZON.height
        count = int(HORIZON.max_roll_deg / HORIZON.slope_step_deg)
        self._slopes = np.radians(np.arange(-count, count + 1) * HORIZON.slope_step_deg)
        columns = (np.arange(HORIZON.width) - 0.5 * (HORIZON.width - 1)) * across
        # Rows by which each column is moved for each slope.
        self._shift = np.rint(np.tan(self._slopes)[:, None] * columns / self._down).astype(np.intp)
        self._pad = int(np.abs(self._shift).max())

    def find(self, pixels: NDArray[Any], camera: CameraModel | None = None) -> HorizonLine | None:
        """On a working image of grey levels, or colours blue first; None without one.

        With the calibration of such images, a horizon that its lens bends is found as well as a
        straight one: as `horizon_from` has it.
        """
        # Of land and sky, blue differs most.
        blue = pixels if pixels.ndim == 2 else cv2.extractChannel(pixels, 0)
        if camera is None:
            return self._follow(blue)
        replicate = cv2.BORDER_REPLICATE
        blue = cv2.remap(blue, *_straightening(camera), cv2.INTER_LINEAR, borderMode=replicate)
        line = self._follow(blue)
        if line is None:
            return None
        tangent = math.tan(line.slope)
        up = np.array([tangent, -1.0, line.row - tangent * 0.5 * (camera.width - 1)])
        up = math.copysign(1.0, math.cos(line.slope)) * (up @ camera.matrix)
        return _seen_by(camera, up / np.linalg.norm(up), line.sigma)

    def _follow(self, blue: NDArray[Any]) -> HorizonLine | None:
        if not self._upside_down:
            return self._follow_upright(blue)
        line = self._follow_upright(np.asarray(cv2.rotate(blue, cv2.ROTATE_180)))
        if line is None:
            return None
        return HorizonLine(len(blue) - 1 - line.row, line.slope + math.pi)

    def _follow_upright(self, blue: NDArray[Any]) -> HorizonLine | None:
        last = None if self._frames % HORIZON.full_period == 0 else self._last
        self._frames += 1
        self._last, agreeing = (last, 0.0) if last is None else _refined(last, blue)
        if agreeing <= HORIZON.min_agreement:
            self._last = self._search(blue)
            if self._last is not None:
                # The first fit is drawn towards the coarse line.
                self._last = _refined(_refined(self._last, blue)[0], blue)[0]
        return self._last

    def _search(self, blue: NDArray[Any]) -> HorizonLine | None:
        size = HORIZON.width, HORIZON.height
        small = cv2.resize(blue, size, interpolation=cv2.INTER_AREA)
        # Of steps alike, the upper one: sky is above all land.
        lower = HORIZON.row_cost * np.arange(HORIZON.height, dtype=np.float32)
        steps = _steps(small) - lower[:, None]
        padded = np.zeros((HORIZON.width, HORIZON.height + 2 * self._pad), np.float32)
        padded[:, self._pad : self._pad + HORIZON.height] = steps.T
        moved = np.lib.stride_tricks.sliding_window_view(padded, HORIZON.height, axis=1)
        sums = moved[np.arange(HORIZON.width), self._shift + self._pad].mean(axis=1)
        best, row = (int(index) for index in np.unravel_index(int(sums.argmax()), sums.shape))
        if not _is_below_sky(small, row + self._shift[best], float(sums[best, row])):
            return None
        step = math.radians(HORIZON.slope_step_deg)
        exact_row = row + vertex(sums[best], row)
        return HorizonLine(
            (exact_row + 0.5) * self._down - 0.5,
            float(self._slopes[best] + step * vertex(sums[:, row], best)),
        )


@lru_cache(maxsize=1)
def _straightening(camera: CameraModel) -> tuple[Any, Any]:
    """Maps to an image that the same camera without distortion would see."""
    rows, columns = np.mgrid[: camera.height, : camera.width]
    pixels = np.stack((columns.ravel(), rows.ravel()), axis=1)
    flat = (pixels - camera.matrix[:2, 2]) / camera.matrix.diagonal()[:2]
    x, y = camera.seen_at(flat).astype(np.float32).T.reshape(2, *rows.shape)
    return cv2.convertMaps(x, y, cv2.CV_16SC2)


def _steps(blue: NDArray[Any]) -> NDArray[np.float32]:
    """How much brighter it is above each place than below, capped."""
    rows = HORIZON.step_rows
    sums = cv2.boxFilter(blue, cv2.CV_32F, (1, rows), normalize=False)
    # The boundary between two rows counts half to each.
    between = np.clip((sums[:-rows] - sums[rows:]) / rows, 0, HORIZON.max_step)
    between = between[rows // 2 : len(between) - rows // 2]
    steps = np.zeros(blue.shape, np.float32)
    steps[rows:-rows] = 0.5 * (between[:-1] + between[1:])
    return steps


def _is_below_sky(blue: NDArray[Any], line: NDArray[np.intp], strength: float) -> bool:
    """Whether it looks like sky above a line, not like treetops or walls, or a road.

    The line has a row in each column of the small image; its strength is the mean step across it.
    """
    below = np.arange(HORIZON.height)[:, None] - line
    near = ((below < -1) & (below > -HORIZON.sky_rows))[:, 1:]
    above, land = below < 0, (below > 0) & (below <= HORIZON.sky_rows)
    # Of what nothing can be seen, nobody knows that it is sky.
    in_view = near.sum() >= HORIZON.min_sky_rows * near.shape[1] and land.any()
    if strength <= HORIZON.min_strength or not in_view:
        return False
    edges = float(np.percentile(cv2.absdiff(blue[:, 1:], blue[:, :-1])[near], 90))
    contrast = float(blue[above].mean()) - float(blue[land].mean())
    return edges < HORIZON.max_edges * strength and contrast > HORIZON.min_contrast


def _refined(horizon: HorizonLine, blue: NDArray[Any]) -> tuple[HorizonLine, float]:
    """Fit a line, known to a few px, anew through the steepest step of every few columns.

    Returns the line, and the share of columns whose steps lie on it.
    """
    height, width = blue.shape
    columns = np.arange(HORIZON.column_step // 2, width, HORIZON.column_step)
    away = columns - 0.5 * (width - 1)
    expected = np.rint(horizon.row + math.tan(horizon.slope) * away).astype(np.intp)
    reach = HORIZON.reach
    inside = (expected >= reach + 2) & (expected < height - reach - 2)
    if np.count_nonzero(inside) < HORIZON.min_columns:
        return horizon, 0.0
    first, away = expected[inside] - reach, away[inside]
    values = blue[first[:, None] + np.arange(-2, 2 * reach + 3), columns[inside, None]]
    values = values.astype(np.float32)
    steps = values[:, :-4] + values[:, 1:-3] - values[:, 3:-1] - values[:, 4:]
    np.maximum(steps, 0.0, out=steps)
    # Of two steps, sky to hills and hills to land, the nearer one to where all columns agree.
    steps *= 1.0 - (np.arange(-reach, reach + 1) / (reach + 1.0)) ** 2
    best = steps.argmax(axis=1)
    number = np.arange(best.size)
    before, after = np.maximum(best - 1, 0), np.minimum(best + 1, 2 * reach)
    around = steps[number, before], steps[number, best], steps[number, after]
    bend = around[0] - 2 * around[1] + around[2]
    vertex = np.where(bend < 0, 0.5 * (around[0] - around[2]) / np.minimum(bend, -1e-6), 0.0)
    places = first + best + np.minimum(np.maximum(vertex, -0.5), 0.5)
    weights = around[1].astype(np.float64)
    tangent, row = math.tan(horizon.slope), horizon.row
    for limit in (3.0, 1.5, 1.0):
        error = places - row - tangent * away
        weight = weights / (1.0 + (error / limit) ** 2) ** 2
        # Of one column alone no line follows.
        if np.count_nonzero(weight) < 2:
            return horizon, 0.0
        total = weight.sum()
        mean_away, mean_place = (weight * away).sum() / total, (weight * places).sum() / total
        weighted = weight * (away - mean_away)
        tangent = (weighted * places).sum() / (weighted * away).sum()
        row = mean_place - tangent * mean_away
    on_line = (np.abs(places - row - tangent * away) < 1.5) & (weights > 2 * HORIZON.min_strength)
    return HorizonLine(float(row), math.atan(tangent)), float(on_line.mean())
