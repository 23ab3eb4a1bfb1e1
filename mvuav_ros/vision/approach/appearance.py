"""What a strip looks like in numbers, row by row and as a whole: its evidence and its ends."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.approach.edges import Strips
from mvuav_ros.vision.approach.evidence import UNIT, EvidenceMap
from mvuav_ros.vision.approach.numeric import best_run, in_common
from mvuav_ros.vision.approach.tuning import APPEARANCE, SEARCH

WEIGHTS = np.array(SEARCH.weights, np.float32)
Numbers = NDArray[np.floating[Any]]


@dataclass(frozen=True, eq=False)
class Profile:
    """Strips row by row; arrays are (n, rows) unless said.

    Attributes:
        strips: (n, 6), with the ends that were found.
        rows: of the map.
        depth: rows below the vanishing point.
        left: column of the left edge.
        right: column of the right edge.
        visible: both edges are in the image.
        parts: (n, rows, 4) what both edges have in common, in textures, with the strip's sign.
        total: their weighted sum, limited.
        inside: rows from the far to the near end.
        run: (n,) sum of `total` above the bias over the logarithm of depth.
        last: (n,) index of the near end's row.
        apart: (n,) logarithm of the near end's depth by the left edge over that by the right.
        balance: (n,) fainter over stronger edge.
    """

    strips: Strips
    rows: NDArray[np.intp]
    depth: Numbers
    left: Numbers
    right: Numbers
    visible: NDArray[np.bool_]
    parts: Numbers
    total: Numbers
    inside: NDArray[np.bool_]
    run: Numbers
    last: NDArray[np.intp]
    apart: Numbers
    balance: Numbers

    def mean(self, values: Any) -> Numbers:
        """(n,) mean over the strip's rows."""
        count = np.maximum(self.inside.sum(axis=1), 1)
        result: Numbers = (values * self.inside).sum(axis=1) / count
        return result


def profile(image: EvidenceMap, strips: Strips) -> Profile:
    """Measure strips row by row, on the level where near ends are 10 to 40 px deep, and find ends.

    Their near ends say which rows the strips are known by.
    """
    x, y, left_slope, right_slope, _, expected = strips.T
    rows = np.rint(y[:, None] + np.arange(1, APPEARANCE.rows + 1)).astype(np.intp)
    depth = rows - y[:, None]
    left, right = (x[:, None] + slope[:, None] * depth for slope in (left_slope, right_slope))
    lefts, in_left = image.at(rows, left)
    rights, in_right = image.at(rows, right)
    visible = in_left & in_right
    one, other = lefts.astype(np.float32) / UNIT, rights.astype(np.float32) / UNIT
    other[..., :3] *= -1
    common = in_common(one, other)
    known = (depth > SEARCH.first_row * expected[:, None]) & (depth <= expected[:, None])
    sign = np.where((common * known[..., None]).sum(axis=1) >= 0, 1.0, -1.0)[:, None]
    parts = common * sign
    total = np.minimum(parts @ WEIGHTS, APPEARANCE.max_gain)
    used = visible & (depth >= APPEARANCE.first_depth) & (right - left >= APPEARANCE.min_width)
    used &= depth <= 1.9 * expected[:, None]
    worth = used / np.maximum(depth, 2.0)
    run, first, last = best_run((total - SEARCH.row_bias) * worth, APPEARANCE.slack)
    number = np.arange(len(strips))
    last = np.maximum(last - 1, first)
    found = strips.copy()
    found[:, 4], found[:, 5] = depth[number, first], depth[number, last] + 0.5
    index = np.arange(APPEARANCE.rows)
    inside = used & (index >= first[:, None]) & (index <= last[:, None])
    single = [np.minimum((each * sign) @ WEIGHTS, APPEARANCE.max_gain) for each in (one, other)]
    ends = [best_run((each - SEARCH.row_bias) * worth, APPEARANCE.slack)[2] for each in single]
    near = [depth[number, np.maximum(end - 1, 0)] for end in ends]
    apart = np.log(np.maximum(near[0], 1.0) / np.maximum(near[1], 1.0))
    means = [(each * inside).sum(axis=1) for each in single]
    balance = np.minimum(*means) / np.maximum(np.maximum(*means), 1e-6)
    return Profile(
        found, rows, depth, left, right, visible, parts, total, inside, run, last, apart, balance
    )


_MIRROR = np.array([-1, -1, -1, 1], np.float32)
_SCALES = np.array([1.35, 1.7, 2.2, 3.0, 0.35, 0.5, 0.7])
"""Widths of strips around and within a strip that are compared with it, of its width."""
_SIDE = np.array([1.0, 2.0])
"""Of half its width: how much wider on one side."""


FEATURES = (
    'run', 'total', 'length', 'paint', 'brightness', 'colour', 'support', 'below', 'above',
    'open_end', 'width_ratio', 'offset', 'width', 'region', 'weaker_side', 'near_end',
    'near_end_beside', 'sky', 'sky_texture', 'skyline', 'dark', 'dark_inside', 'aspect', 'aside',
    'greyness', 'brighter', 'apart', 'balance', 'roughness', 'room_below', 'wider', 'narrower',
    'wider_on_one_side', 'depth',
)  # fmt: skip
"""Names of the columns of `describe`."""


@dataclass(frozen=True)
class Scene:
    """What the whole image is like, for features that compare with it.

    Attributes:
        width: of the levelled working image, px of the map.
        darkest: 10th percentile of brightness, grey levels.
        brightest: 95th percentile.
        skyline: row of the lower end of the sky in each column, px of the map.
        first_column: of the map on the whole image.
    """

    width: float
    darkest: float
    brightest: float
    skyline: NDArray[np.float64]
    first_column: float = 0.0


def describe(
    image: EvidenceMap, strips: Strips, scene: Scene, level: int
) -> tuple[NDArray[np.float64], Strips]:
    """Features of strips on a level's map; NaN where the image does not show them.

    Returns:
        (n, features) in the order of `FEATURES`, and the strips with the ends that were found.
    """
    measured = profile(image, strips)
    values = (
        _of_the_run(image, measured)
        | _of_the_neighbours(image, measured)
        | _of_the_shape(measured, scene, level)
        | _of_the_surface(image, measured, scene)
        | _of_the_near_end(image, measured)
        | _of_the_sky(image, measured, scene)
    )
    table = np.stack([np.asarray(values[name], np.float64) for name in FEATURES], axis=1)
    return table, measured.strips


def _of_the_run(image: EvidenceMap, of: Profile) -> dict[str, Numbers]:
    near, far = of.strips[:, 5], of.strips[:, 4]
    below, room = _below(image, of)
    return {
        'run': of.run,
        'total': of.mean(of.total),
        'length': np.log(np.maximum(near, 1) / np.maximum(far, 1)),
        'paint': of.mean(of.parts[..., 3]),
        'brightness': of.mean(of.parts[..., 0]),
        'colour': of.mean(of.parts[..., 1] + of.parts[..., 2]),
        'support': of.mean(of.total > SEARCH.row_bias),
        'below': below,
        'room_below': room,
        'above': _above(image, of.strips),
        'apart': np.minimum(np.abs(of.apart), 1.5),
        'balance': np.clip(of.balance, 0, 1),
    }


def _sampled(
    image: EvidenceMap, of: Profile, first: Numbers, second: Numbers, depth: Numbers
) -> tuple[Numbers, NDArray[np.bool_]]:
    """Evidence that pairs of edges of (n, pairs) slopes have in common at (n, rows) depths.

    Returns:
        That, and where it is known: (n, pairs, rows).
    """
    x, y = of.strips[:, 0, None, None], of.strips[:, 1, None]
    rows = np.rint(y + depth).astype(np.intp)[:, None, :]
    slopes = np.concatenate([first, second], axis=1)[:, :, None]
    evidence, inside = image.at(rows, x + slopes * depth[:, None, :])
    values = evidence.astype(np.float32) / UNIT
    count = first.shape[1]
    left, right = values[:, :count], values[:, count:] * _MIRROR
    common = in_common(left, right)
    known = inside[:, :count] & inside[:, count:]
    return np.minimum(np.abs(common) @ WEIGHTS, APPEARANCE.max_gain), known


def _below(image: EvidenceMap, of: Profile) -> tuple[Numbers, Numbers]:
    """Evidence along the edges beyond the near end, and how far down that can be seen.

    A road goes on there as a runway does not; where nothing can be seen nobody knows.
    """
    left, right, near = of.strips[:, 2:3], of.strips[:, 3:4], of.strips[:, 5:6]
    share = np.geomspace(1.12, 2.6, 12)
    found, seen = (each[:, 0] for each in _sampled(image, of, left, right, near * share + 1.0))
    count = seen.sum(axis=1)
    mean: Numbers = (found * seen).sum(axis=1) / np.maximum(count, 1)
    return mean, count / share.size


def _of_the_neighbours(image: EvidenceMap, of: Profile) -> dict[str, Numbers]:
    """Evidence of wider and narrower strips along the same rows.

    A streak of rubber has the runway around it, half a runway has its other half beside it.
    """
    left, right, far, near = (of.strips[:, column : column + 1] for column in (2, 3, 4, 5))
    depth = far + (near - far) * np.linspace(0.15, 0.95, 9)
    middle, half = 0.5 * (left + right), 0.5 * (right - left)
    first = np.concatenate([middle - _SCALES * half, left - _SIDE * half, left + 0 * _SIDE], axis=1)
    second = np.concatenate(
        [middle + _SCALES * half, right + 0 * _SIDE, right + _SIDE * half], axis=1
    )
    means = _sampled(image, of, first, second, depth)[0].mean(axis=2)
    return {
        'wider': means[:, :4].max(axis=1),
        'narrower': means[:, 4:7].max(axis=1),
        'wider_on_one_side': means[:, 7:].max(axis=1),
    }


def _above(image: EvidenceMap, strips: Strips) -> Numbers:
    """Evidence along the edges beyond the vanishing point, where no runway goes on."""
    x, y, left, right, _, near = strips.T
    up = -np.arange(2, 16)
    rows = np.rint(y[:, None] + up).astype(np.intp)
    one, in_one = image.at(rows, x[:, None] + left[:, None] * up)
    other, in_other = image.at(rows, x[:, None] + right[:, None] * up)
    strength = np.maximum(
        np.abs(one.astype(np.float32)) @ WEIGHTS, np.abs(other.astype(np.float32)) @ WEIGHTS
    )
    counted = (-up <= np.maximum(0.5 * near, 4)[:, None]) & in_one & in_other
    strength = np.minimum(strength / UNIT, APPEARANCE.max_gain) * counted
    result: Numbers = strength.sum(axis=1) / np.maximum(counted.sum(axis=1), 1)
    return np.where(y < APPEARANCE.min_sky_row, np.nan, result)


def _of_the_shape(of: Profile, scene: Scene, level: int) -> dict[str, Numbers]:
    x, _, left, right, far, near = of.strips.T
    ratio = np.maximum(right - left, 0.05)
    width = ratio * near
    number = np.arange(len(near))
    beyond = np.minimum(of.last + 1, APPEARANCE.rows - 1)
    return {
        'open_end': (~of.visible[number, beyond]).astype(float),
        'width_ratio': np.log(ratio),
        'offset': np.abs(left + right) / 2 / np.maximum(ratio, 0.1),
        'width': np.log(np.maximum(width, 1)) + level * np.log(2),
        'depth': np.log(np.maximum(near, 1)) + level * np.log(2),
        'aspect': np.log(width / np.maximum(near - far, 1)),
        'aside': np.abs((x + scene.first_column) / scene.width - 0.5) * 2,
    }


def _of_the_surface(image: EvidenceMap, of: Profile, scene: Scene) -> dict[str, Numbers]:
    number = np.arange(len(of.strips))[:, None]
    count = of.inside.sum(axis=1)
    first = of.last - np.maximum(count - 1, 0)
    share = np.linspace(0, 1, 8) * (of.last - first)[:, None] + first[:, None]
    row = np.clip(np.rint(share).astype(np.intp), 0, APPEARANCE.rows - 1)
    rows, left, right = of.rows[number, row], of.left[number, row], of.right[number, row]
    width = np.maximum(right - left, 1)
    inside, _ = image.means(rows, left + 0.15 * width, right - 0.15 * width)
    before, seen_left = image.means(rows, left - 0.8 * width - 1, left - 0.15 * width - 1)
    after, seen_right = image.means(rows, right + 0.15 * width + 1, right + 0.8 * width + 1)
    texture = _texture(image, rows, (left + right) / 2)
    one, other = (inside - before) * seen_left / texture, (inside - after) * seen_right / texture
    common = in_common(one, other)
    sides = [_length(each.mean(axis=2)) for each in (one, other)]
    spread = max(scene.brightest - scene.darkest, 0.0) + 1
    beside = np.minimum(before[0].mean(axis=1), after[0].mean(axis=1))
    middle = inside[0].mean(axis=1)
    return {
        'region': np.minimum(_length(common.mean(axis=2)), 8),
        'weaker_side': np.minimum(np.minimum(*sides), 8),
        'dark': np.clip((beside - scene.darkest) / spread, 0, 1),
        'dark_inside': np.clip((middle - scene.darkest) / spread, 0, 1),
        'greyness': _greyness(inside, before, after),
        'brighter': np.clip((middle - 0.5 * (before[0] + after[0]).mean(axis=1)) / 10, -4, 4),
        'roughness': np.log(texture.mean(axis=1)),
    }


def _greyness(inside: Numbers, before: Numbers, after: Numbers) -> Numbers:
    """By how much less colourful the strip is than either side, in tens of grey levels."""
    if len(inside) == 1:
        return np.zeros(inside.shape[1])
    colours = [np.hypot(each[1], each[2]).mean(axis=1) for each in (inside, before, after)]
    less: Numbers = np.minimum(colours[1], colours[2]) - colours[0]
    return np.clip(less, -30, 30) / 10


def _of_the_near_end(image: EvidenceMap, of: Profile) -> dict[str, Numbers]:
    x, y, left, right, _, near = of.strips.T
    # Inside the strip, and beside it to the left and to the right.
    begin, end = np.array([0.1, -0.8, 1.2]), np.array([0.9, -0.2, 1.8])

    def band(first: float, last: float) -> Numbers:
        """(channels, n, 3) means over three rows."""
        depth = near[:, None] + np.linspace(first, last, 3)
        start = (x[:, None] + left[:, None] * depth)[:, :, None]
        width = np.maximum((right - left)[:, None] * depth, 1)[:, :, None]
        rows = np.rint(y[:, None] + depth).astype(np.intp)[:, :, None]
        means = image.means(rows, start + begin * width, start + end * width)[0]
        result: Numbers = means.mean(axis=2)
        return result

    rows = np.rint(y + near).astype(np.intp)
    texture = _texture(image, rows, x + (left + right) / 2 * near)
    steps = _length((band(-3.2, -0.2) - band(1.2, 3.5)) / texture[:, None]).T
    return {
        'near_end': np.minimum(steps[0], 8),
        'near_end_beside': np.clip(steps[0] - np.maximum(steps[1], steps[2]), -8, 8),
    }


def _of_the_sky(image: EvidenceMap, of: Profile, scene: Scene) -> dict[str, Numbers]:
    x, y, near = of.strips[:, 0], of.strips[:, 1], of.strips[:, 5]

    def band(first: float, last: float) -> Numbers:
        rows = np.rint(y[:, None] + np.linspace(first, last, 4)).astype(np.intp)
        centre = np.broadcast_to(x[:, None], rows.shape)
        result: Numbers = image.means(rows, centre - 20, centre + 20)[0][0].mean(axis=1)
        return result

    rows = np.rint(y).astype(np.intp)
    column = np.clip(np.rint(x).astype(np.intp), 0, scene.skyline.size - 1)
    above, below = _texture(image, rows - 8, x) - 1.0, _texture(image, rows + 8, x) - 1.0
    values = {
        'sky': np.clip((band(-12, -4) - band(3, 12)) / 40, -3, 3),
        'sky_texture': np.log(above / below),
        'skyline': np.clip((y - scene.skyline[column]) / np.maximum(near, 5), -3, 3),
    }
    return {
        name: np.where(y < APPEARANCE.min_sky_row, np.nan, value) for name, value in values.items()
    }


def _texture(image: EvidenceMap, rows: Any, columns: Any) -> Numbers:
    row = np.clip(rows, 0, image.height - 1)
    column = np.clip(np.rint(columns).astype(np.intp), 0, image.width - 1)
    result: Numbers = image.texture[row, column] + 1.5
    return result


def _length(values: Numbers) -> Numbers:
    """Of vectors of channels, which come first."""
    result: Numbers = np.sqrt((values**2).sum(axis=0))
    return result
