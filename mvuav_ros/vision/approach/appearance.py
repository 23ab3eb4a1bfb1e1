"""What a strip looks like in numbers, row by row and as a whole: its evidence and its ends."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.approach.evidence import UNIT, EvidenceMap, in_common
from mvuav_ros.vision.approach.strip_edges import Strips
from mvuav_ros.vision.approach.tuning import SEARCH

WEIGHTS = np.array(SEARCH.weights, np.float32)
_INDEX = np.arange(SEARCH.profile_rows)
_ROWS = _INDEX + 1
"""Below the vanishing point."""
Numbers = NDArray[np.floating[Any]]


@dataclass(frozen=True, eq=False)
class Profile:
    """Strips row by row; arrays are (n, rows) unless said."""

    strips: Strips  # (n, 6), with the ends that were found
    rows: NDArray[np.intp]  # of the map
    edges: Numbers  # (2, n, rows) columns of the left and of the right edge
    visible: NDArray[np.bool_]  # both edges are in the image
    # (n, rows, 4) what both edges have in common, in textures, with the strip's sign
    parts: Numbers
    total: Numbers  # their weighted sum, limited
    inside: NDArray[np.bool_]  # rows from the far to the near end
    run: Numbers  # (n,) sum of ``total`` above the bias over the logarithm of depth
    last: NDArray[np.intp]  # (n,) index of the near end's row

    def mean(self, values: Any) -> Numbers:
        """(n,) mean over the strip's rows."""
        count = np.maximum(self.inside.sum(axis=1), 1)
        return np.asarray((values * self.inside).sum(axis=1) / count)


def best_run(
    gain: NDArray[Any], slack: float = 0.0
) -> tuple[NDArray[Any], NDArray[np.intp], NDArray[np.intp]]:
    """The run of columns with the largest sum in each row.

    Args:
        gain: (n, columns) what each column adds.
        slack: sums that differ by no more begin equally well; the shortest such run is taken.

    Returns:
        Arrays (n,): the sum, the first column, and the one after the last.

    Examples:
        >>> best_run(np.array([[-1.0, 2.0, 3.0, -4.0]]))
        (array([5.]), array([1]), array([3]))
    """
    count, columns = gain.shape
    total = np.zeros((count, columns + 1))
    np.cumsum(gain, axis=1, out=total[:, 1:])
    lowest = np.minimum.accumulate(total, axis=1)
    rise = total - lowest
    last = rise.argmax(axis=1)
    number = np.arange(count)
    # The last place before the end at which the total was that low.
    least = lowest[number, last][:, None] + slack
    at_lowest = (total <= least) & (np.arange(columns + 1) <= last[:, None])
    first = columns - at_lowest[:, ::-1].argmax(axis=1)
    return rise[number, last], np.minimum(first, columns - 1), last


def profile(image: EvidenceMap, strips: Strips) -> Profile:
    """Measure strips row by row, on the level where near ends are 10 to 40 px deep, and find ends.

    Their near ends say which rows the strips are known by.
    """
    x, y, expected = (strips[:, column, None] for column in (0, 1, 5))
    rows = np.rint(y + _ROWS).astype(np.intp)
    depth = rows - y
    edges = x + strips.T[2:4, :, None] * depth
    common, visible = image.in_common(rows, edges)
    known = (depth > SEARCH.first_row * expected) & (depth <= expected)
    # Each channel has the sign that it has on most of the rows.
    sign = np.where((common * known[..., None]).sum(axis=1) >= 0, 1.0, -1.0)[:, None]
    parts = common * sign
    total = np.minimum(parts @ WEIGHTS, SEARCH.max_gain)
    used = visible & (depth >= SEARCH.first_depth)
    used &= (edges[1] - edges[0] >= SEARCH.min_row_width) & (depth <= 1.9 * expected)
    gain = (total - SEARCH.row_bias) * (used / np.maximum(depth, 2.0))
    run, first, end = best_run(gain, SEARCH.slack)
    last = np.maximum(end - 1, first)
    number = np.arange(len(strips))
    strips = strips.copy()
    strips[:, 4], strips[:, 5] = depth[number, first], depth[number, last] + 0.5
    inside = used & (first[:, None] <= _INDEX) & (last[:, None] >= _INDEX)
    return Profile(strips, rows, edges, visible, parts, total, inside, run, last)


_BELOW = np.geomspace(1.12, 2.6, 12)
"""Near ends' depths, at which it is looked whether the edges go on."""
_ALONG = np.linspace(0.15, 0.95, 9)
"""Between the far and the near end, where neighbours are compared."""
_UP = np.arange(2, 16)
"""Px above the vanishing point, where no runway goes on."""
_WIDER = np.array([[0.5, 1.0, 0.0, 0.0], [0.0, 0.0, 0.5, 1.0]])
"""Widths by which strips that are compared with one begin farther left, and end farther right."""


FEATURES = (
    'run', 'total', 'length', 'paint', 'brightness', 'colour', 'support', 'below', 'above',
    'open_end', 'offset', 'width', 'region', 'near_end_beside', 'sky', 'sky_texture',
    'dark_inside', 'aspect', 'aside', 'greyness', 'roughness', 'room_below',
    'wider_on_one_side', 'depth', 'meets_above',
)  # fmt: skip
"""Names of the columns of `describe`."""


@dataclass(frozen=True)
class Scene:
    """What the whole working image is like, for features that compare with it."""

    width: float  # px
    darkest: float  # 10th percentile of brightness, grey levels
    brightest: float  # 95th percentile


def describe(
    image: EvidenceMap, strips: Strips, scene: Scene, level: int, first_column: int = 0
) -> tuple[NDArray[np.float64], Strips]:
    """Features of strips on a map of a part of a level; NaN where the image does not show them.

    Returns:
        (n, features) in the order of `FEATURES`, and the strips with the ends that were found.
    """
    measured = profile(image, strips)
    values = (
        _of_the_run(image, measured)
        | _of_the_shape(measured, scene, level, first_column)
        | _of_the_surface(image, measured, scene)
        | _of_the_near_end(image, measured)
        | _of_the_sky(image, measured)
    )
    table = np.array([values[name] for name in FEATURES], np.float64)
    return np.ascontiguousarray(table.T), measured.strips


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
        'wider_on_one_side': _wider_on_one_side(image, of),
    }


def _sampled(
    image: EvidenceMap, of: Profile, slopes: Numbers, depth: Numbers
) -> tuple[Numbers, NDArray[np.bool_]]:
    """(n, pairs, rows) what edges of (2, n, pairs) slopes have in common, and where it is known."""
    x, y = of.strips[:, 0, None, None], of.strips[:, 1, None]
    rows = np.rint(y + depth).astype(np.intp)[:, None, :]
    common, inside = image.in_common(rows, x + slopes[..., None] * depth[:, None, :])
    return np.minimum(np.abs(common) @ WEIGHTS, SEARCH.max_gain), inside


def _below(image: EvidenceMap, of: Profile) -> tuple[Numbers, Numbers]:
    """Evidence along the edges beyond the near end, and how far down that can be seen.

    A road goes on there as a runway does not; where nothing can be seen nobody knows.
    """
    depth = of.strips[:, 5:6] * _BELOW + 1.0
    found, seen = (each[:, 0] for each in _sampled(image, of, of.strips.T[2:4, :, None], depth))
    count = seen.sum(axis=1)
    mean: Numbers = (found * seen).sum(axis=1) / np.maximum(count, 1)
    return mean, count / _BELOW.size


def _wider_on_one_side(image: EvidenceMap, of: Profile) -> Numbers:
    """Evidence of strips along the same rows that are wider: half a runway has its other half."""
    left, right, far, near = (of.strips[:, column : column + 1] for column in (2, 3, 4, 5))
    slopes = np.stack([left, right]) + (right - left) * (_WIDER * [[-1], [1]])[:, None]
    found = _sampled(image, of, slopes, far + (near - far) * _ALONG)[0]
    return np.asarray(found.mean(axis=2).max(axis=1))


def _above(image: EvidenceMap, strips: Strips) -> Numbers:
    """Evidence along the edges beyond the vanishing point, where no runway goes on."""
    y, near = strips[:, 1], strips[:, 5]
    rows = np.rint(y[:, None] - _UP).astype(np.intp)
    found, inside = image.at(rows, strips[:, 0:1] - strips.T[2:4, :, None] * _UP)
    strength = (np.abs(found.astype(np.float32)) @ WEIGHTS).max(axis=0)
    counted = (np.maximum(0.5 * near, 4)[:, None] >= _UP) & inside[0] & inside[1]
    strength = np.minimum(strength * np.float32(1 / UNIT), SEARCH.max_gain) * counted
    result: Numbers = strength.sum(axis=1) / np.maximum(counted.sum(axis=1), 1)
    return np.where(y < SEARCH.min_sky_row, np.nan, result)


def _of_the_shape(of: Profile, scene: Scene, level: int, first_column: int) -> dict[str, Numbers]:
    x, _, left, right, far, near = of.strips.T
    ratio = np.maximum(right - left, 0.05)
    width = ratio * near
    number = np.arange(len(near))
    beyond = np.minimum(of.last + 1, SEARCH.profile_rows - 1)
    return {
        'open_end': (~of.visible[number, beyond]).astype(float),
        'offset': np.abs(left + right) / 2 / np.maximum(ratio, 0.1),
        'width': np.log(np.maximum(width, 1)) + level * np.log(2),
        'depth': np.log(np.maximum(near, 1)) + level * np.log(2),
        'aspect': np.log(width / np.maximum(near - far, 1)),
        'aside': np.abs((x + first_column) * 2**level / scene.width - 0.5) * 2,
    }


def _of_the_surface(image: EvidenceMap, of: Profile, scene: Scene) -> dict[str, Numbers]:
    number = np.arange(len(of.strips))[:, None]
    first = of.last - np.maximum(of.inside.sum(axis=1) - 1, 0)
    share = np.linspace(0, 1, 8) * (of.last - first)[:, None] + first[:, None]
    row = np.clip(np.rint(share).astype(np.intp), 0, SEARCH.profile_rows - 1)
    rows = of.rows[number, row]
    left, right = of.edges[:, number, row]
    width = np.maximum(right - left, 1)
    near, wide = 0.15 * width, 0.8 * width
    means, seen = image.means(
        rows,
        np.stack([left + near, left - wide - 1, right + near + 1]),
        np.stack([right - near, left - near - 1, right + wide + 1]),
    )
    inside, before, after = means[:, 0], means[:, 1], means[:, 2]
    texture = _texture(image, rows, (left + right) / 2)
    one, other = (inside - before) * seen[1] / texture, (inside - after) * seen[2] / texture
    middle = inside[0].mean(axis=1) - scene.darkest
    spread = max(scene.brightest - scene.darkest, 0.0) + 1
    return {
        'region': np.minimum(np.linalg.norm(in_common(one, other).mean(axis=2), axis=0), 8),
        'dark_inside': np.clip(middle / spread, 0, 1),
        'greyness': _greyness(inside, before, after),
        'roughness': np.log(texture.mean(axis=1)),
    }


def _greyness(inside: Numbers, before: Numbers, after: Numbers) -> Numbers:
    """By how much less colourful the strip is than either side, in tens of grey levels."""
    if len(inside) == 1:
        return np.zeros(inside.shape[1])
    colours = [np.hypot(each[1], each[2]).mean(axis=1) for each in (inside, before, after)]
    less: Numbers = np.minimum(colours[1], colours[2]) - colours[0]
    return np.clip(less, -30, 30) / 10


_INTO = np.linspace(-3.2, -0.2, 3)
"""Rows within a strip, below its near end."""
_PAST = np.linspace(1.2, 3.5, 3)
"""Rows beyond its near end."""
_BEGIN, _END = np.array([0.1, -0.8, 1.2]), np.array([0.9, -0.2, 1.8])
"""Widths from the left edge: inside the strip, and beside it to the left and to the right."""


def _of_the_near_end(image: EvidenceMap, of: Profile) -> dict[str, Numbers]:
    x, y, left, right, _, near = of.strips.T
    depth = near[:, None] + np.concatenate([_INTO, _PAST])
    start = (x[:, None] + left[:, None] * depth)[:, :, None]
    width = np.maximum((right - left)[:, None] * depth, 1)[:, :, None]
    rows = np.rint(y[:, None] + depth).astype(np.intp)[:, :, None]
    means, _ = image.means(rows, start + _BEGIN * width, start + _END * width)
    into, past = means[:, :, :3].mean(axis=2), means[:, :, 3:].mean(axis=2)
    texture = _texture(image, np.rint(y + near).astype(np.intp), x + (left + right) / 2 * near)
    steps = np.linalg.norm((into - past) / texture[:, None], axis=0).T
    return {'near_end_beside': np.clip(steps[0] - np.maximum(steps[1], steps[2]), -8, 8)}


_BANDS = np.concatenate([np.linspace(-12, -4, 4), np.linspace(3, 12, 4)])
"""Rows of the sky above a vanishing point, and of the land below it."""


def _of_the_sky(image: EvidenceMap, of: Profile) -> dict[str, Numbers]:
    x, y = of.strips[:, 0], of.strips[:, 1]
    rows = np.rint(y[:, None] + _BANDS).astype(np.intp)
    means, _ = image.means(rows, x[:, None] - 20, x[:, None] + 20)
    above, below = means[0, :, :4].mean(axis=1), means[0, :, 4:].mean(axis=1)
    row = np.rint(y).astype(np.intp)
    rough_above, rough_below = _texture(image, np.stack([row - 8, row + 8]), x) - 1.0
    hidden = y < SEARCH.min_sky_row
    return {
        'meets_above': hidden.astype(float),
        'sky': np.where(hidden, np.nan, np.clip((above - below) / 40, -3, 3)),
        'sky_texture': np.where(hidden, np.nan, np.log(rough_above / rough_below)),
    }


def _texture(image: EvidenceMap, rows: Any, columns: Any) -> Numbers:
    row = np.clip(rows, 0, image.height - 1)
    column = np.clip(np.rint(columns).astype(np.intp), 0, image.width - 1)
    return np.asarray(image.texture[row, column] + 1.5)
