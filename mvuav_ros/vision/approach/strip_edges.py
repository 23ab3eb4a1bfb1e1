"""Where exactly a strip's two edges are on the frame, near where they are expected."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.approach.attitude import Derotation
from mvuav_ros.vision.approach.evidence import brightness_of, in_common, opponent_channels
from mvuav_ros.vision.approach.tuning import EDGES, SHOULDERS, TRACK
from mvuav_ros.vision.point_operations import Pixels

Strip = NDArray[np.float64]
"""(6,) on the levelled working image: the vanishing point's x and y, the columns by which the left
and the right edge move to the right per row, and the rows from it to the far and the near end."""
Strips = NDArray[np.float64]
"""(n, 6), likewise."""


class LevelledFrame(NamedTuple):
    """A frame, (height, width) or (height, width, 3), addressed by its levelled working image."""

    image: Pixels
    level: Derotation

    def at(
        self, columns: NDArray[Any], rows: NDArray[Any]
    ) -> tuple[NDArray[Any], NDArray[np.bool_]]:
        """The frame at places (2, count, places) of the levelled working image, interpolated.

        Returns:
            The pixels, (2 count, places) or (2 count, places, 3); and which are on the frame.
        """
        on_x, on_y = self.level.to_frame(columns, rows)
        flat = (-1, columns.shape[-1])
        # Fixed-point maps: with others, OpenCV 5 rounds as the arrays happen to lie in memory.
        places, parts = cv2.convertMaps(
            on_x.reshape(flat).astype(np.float32),
            on_y.reshape(flat).astype(np.float32),
            cv2.CV_16SC2,
        )
        border = cv2.BORDER_REPLICATE
        pixels = cv2.remap(self.image, places, parts, cv2.INTER_LINEAR, borderMode=border)
        height, width = self.image.shape[:2]
        inside = (on_x > 0) & (on_x < width - 1) & (on_y > 0) & (on_y < height - 1)
        return np.asarray(pixels), inside


@dataclass(frozen=True, eq=False)
class EdgePoints:
    """Points of one edge on the levelled working image."""

    rows: NDArray[np.float64]  # (n,) px
    columns: NDArray[np.float64]  # (n,) px
    weights: NDArray[np.float64]  # (n,) 0 to 1
    support: float  # share of the rows searched that have a step there, 0 to 1
    # px, standard deviations with which all points err alike at the far and at the near end
    doubt: tuple[float, ...] = (0.0, 0.0)
    outside: tuple[float, ...] = (0.0, 0.0)  # px, about which they lie outside of it, likewise


Edges = tuple[EdgePoints, EdgePoints]
"""The left and the right one."""


_INWARDS = np.array([[1.0], [-1.0]])
"""Columns to the right per px from the land to the pavement, of the left and of the right edge."""


@dataclass(frozen=True, eq=False)
class EdgeSamples:
    """The frame's pixels across both edges."""

    # (2 count, places) or (2 count, places, 3): rows of the left, then of the right edge
    pixels: NDArray[Any]
    expected: NDArray[Any]  # (2, count) columns of the edges, px of the levelled working image
    rows: NDArray[Any]  # (count,) likewise
    across: NDArray[Any]  # (places,) px inwards from the expected column, from the land on
    inside: NDArray[np.bool_]  # (2, count, places - base) the middle of a step is on the frame
    base: int  # samples over which a step is measured, even

    def steps(self, channels: NDArray[Any]) -> NDArray[Any]:
        """(..., 2, count, places - base) rise of channels (..., 2 count, places) inwards.

        It is 0 where it is not on the frame.
        """
        rise = channels[..., self.base :] - channels[..., : -self.base]
        shape = (*rise.shape[:-2], 2, self.rows.size, rise.shape[-1])
        return np.asarray(rise.reshape(shape) * self.inside)

    def profile(self, channels: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
        """What channels (..., 2 count, places) have in common along the edges.

        Returns:
            Means over the rows, (..., 2, places); and means of the land and of the pavement,
            (..., 2), farthest from either edge: lines beside it do not count.
        """
        shape = (*channels.shape[:-2], 2, self.rows.size, self.across.size)
        along = channels.reshape(shape).mean(axis=-2)
        outer = max(1, self.across.size // EDGES.region)
        return along, along[..., :outer].mean(axis=-1), along[..., -outer:].mean(axis=-1)

    def fit(self, steps: NDArray[Any], size: float) -> Edges:
        """Points of both edges, of (2, count, places - base) steps from 0 to a whole one's size.

        The straight line with the most steps is chosen, then the steps' own places near it.
        """
        base = self.base
        _, count, places = steps.shape
        lines, samples, worth = _straight_lines(count, places)
        votes = steps.reshape(2, -1).take(samples, axis=1).sum(axis=2) * worth
        if not self.inside.all():
            # What is in view of a line speaks for the rest of it.
            seen = self.inside.reshape(2, -1).take(samples, axis=1).sum(axis=2)
            votes *= count / np.maximum(seen, EDGES.min_seen * count)
        best = votes.argmax(axis=1)
        near_line = lines[best][:, :, None] + np.arange(-base // 2 - 1, base // 2 + 2)
        valid = (near_line >= 0) & (near_line < places)
        near_line = np.clip(near_line, 0, places - 1)
        local = np.take_along_axis(steps, near_line, axis=2) * valid
        total = local.sum(axis=2)
        across = self.across[base // 2 :].take(near_line)
        inwards = (local * across).sum(axis=2) / np.maximum(total, 1e-6)
        columns = self.expected + _INWARDS * inwards
        # A step of the contrast's size is seen by all samples around it.
        weights = np.clip(total / (base * size), 0.0, 1.0)
        weights *= weights > EDGES.min_step_share
        # Where there are steps everywhere, the best line is not worth much.
        rank = int(EDGES.usual_rank * worth.size)
        usual = np.partition(votes, rank, axis=1)[:, rank]
        support = np.clip((votes.max(axis=1) - usual) / (count * size), 0.0, 1.0)
        left, right = (
            EdgePoints(self.rows, *points)
            for points in zip(columns, weights, support.tolist(), strict=True)
        )
        return left, right


@lru_cache(maxsize=64)
def _straight_lines(
    count: int, places: int
) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.float64]]:
    """All n straight lines through samples across an edge.

    Returns:
        (n, count) their places in each row, the same among all samples, and (n,) factors of votes.
    """
    ends = np.arange(0, places, 2)
    far, near = (v.ravel() for v in np.meshgrid(ends, ends, indexing='ij'))
    along = np.linspace(0.0, 1.0, count)
    at = np.rint(far[:, None] + (near - far)[:, None] * along).astype(np.intp)
    middle = 0.5 * (places - 1)
    # Of equal lines the expected one.
    away = (np.abs(far - middle) + np.abs(near - middle)) / places
    return at, at + np.arange(count) * places, 1.0 - 0.3 * away


def sample_edges(
    frame: LevelledFrame, strip: Strip, reach: float = EDGES.reach, least: float = 0.0
) -> EdgeSamples:
    """Take the pixels across both edges of a strip from the frame.

    So many of its widths from it, within limits in px, but for the least: the farther the coarser.
    """
    _, _, left, right, far, near = strip.tolist()
    count = int(np.clip((near - far) * frame.level.factor, 6, EDGES.max_rows))
    rows, expected, _ = rows_of(strip, (np.arange(count) + 0.5) / count)
    width = (right - left) * near
    reach = float(np.clip(reach * width, EDGES.min_reach, EDGES.max_reach))
    steps = round(reach / EDGES.sample)
    sample = EDGES.sample * max(1.0, least * width / reach)
    across = np.arange(-steps, steps + 1) * sample
    columns = expected[:, :, None] + _INWARDS[:, :, None] * across
    pixels, inside = frame.at(columns, rows[:, None])
    # JPEG halves the resolution of colour; and where there is room, soft edges are whole steps.
    base = max(2, int(np.clip(width / EDGES.widths_per_step, 2, 4) / sample))
    half = base // 2
    return EdgeSamples(pixels, expected, rows, across, inside[:, :, half:-half], 2 * half)


def rows_of(
    strip: Strip, along: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """A strip's edges in n rows, from 0, the far end, to 1.

    Returns:
        The rows (n,), the columns of the left and of the right edge (2, n), and the width, at
        least 2 px, towards outside of each of them (2, n): negative at the left one.
    """
    x, y, left, right, far, near = (float(value) for value in strip)
    depth = far + along * (near - far)
    width = np.maximum((right - left) * depth, 2.0)
    edges = x + np.array([[left], [right]]) * depth
    return y + depth, edges, np.array([[-1.0], [1.0]]) * width


class EdgeLook:
    """What the step across a runway's edges is like, learnt from frame to frame."""

    def __init__(self, *, wide: bool = True, painted: bool = False) -> None:
        """Those of a ``wide`` strip may be farther from it than its lines are apart.

        Edges that are ``painted`` are darker inside, whatever else they are.
        """
        self._wide, self._painted = wide, painted
        self._contrast = np.zeros(3)
        self._striped = False  # in the newest frame
        self._frames = 0

    @property
    def size(self) -> float:
        """Of the contrast, grey levels."""
        return float(np.linalg.norm(self._contrast))

    @property
    def coloured(self) -> bool:
        """Their colours alone distinguish them: the edge is the pavement's, not a line's."""
        return float(np.linalg.norm(self._contrast[1:])) > EDGES.colour_contrast

    def find(self, frame: LevelledFrame, strip: Strip, *, far_off: bool = False) -> Edges:
        """Measure both edges of a strip, and learn what they look like.

        They may be far off if it was found on a coarse image.
        """
        striped = EDGES.stripes_reach if self._striped else 0.0
        samples = sample_edges(frame, strip, least=EDGES.far_reach if far_off else striped)
        if self._painted:
            channels = brightness_of(samples.pixels)[None]
            steps = np.minimum(samples.steps(channels), 0.0)
        else:
            channels = np.stack(opponent_channels(samples.pixels))
            steps = samples.steps(channels)
        profile = samples.profile(channels) if self._wide else None
        self._striped, doubt = False, (0.0, 0.0)
        self._learn(profile[2] - profile[1] if profile else _strongest(steps))
        contrast = self._contrast[: len(channels)].copy()
        colour = float(np.linalg.norm(contrast[1:]))
        if self.coloured or colour > max(EDGES.clear_contrast, abs(float(contrast[0]))):
            # White stripes along an edge have the pavement's colour, not its brightness.
            contrast[0] = 0.0
        elif profile and (paint := _paint(*(each[0] for each in profile))):
            # A stripe goes on to the inside.
            self._striped = True
            steps = samples.steps(np.maximum.accumulate(channels[:1], axis=2))
            contrast = np.array([paint])
            doubt = _blur_doubt(profile[0][0], profile[1][0], samples.across, frame.level.factor)
        size = float(np.linalg.norm(contrast))
        direction = contrast / max(size, 1e-6)
        size = max(size, EDGES.min_contrast)
        whole = np.clip(np.tensordot(direction, steps, axes=1), 0.0, size)
        left, right = samples.fit(whole, size)
        return replace(left, doubt=doubt), replace(right, doubt=doubt)

    def _learn(self, rise: NDArray[Any]) -> None:
        """Take what the edges have in common of the rise (channels, 2) inwards, a mean of rows."""
        left, right = rise.T
        common = 0.5 * (left + right) if self._painted else in_common(left, right)
        contrast = np.zeros(3)
        contrast[: common.size] = common
        if np.linalg.norm(contrast) < EDGES.min_step_share * self.size:
            # An edge that is not there does not show what it looks like.
            return
        self._frames += 1
        share = max(EDGES.memory, 1.0 / self._frames)
        self._contrast += share * (contrast - self._contrast)


def _strongest(steps: NDArray[Any]) -> NDArray[Any]:
    """(channels, 2) mean of the strongest step near where either edge is expected."""
    middle = steps.shape[3] // 2
    average = steps.mean(axis=2)[:, :, max(0, middle - 3) : middle + 4]
    strongest = np.linalg.norm(average, axis=0).argmax(axis=1)
    return np.asarray(average[:, (0, 1), strongest])


def _paint(along: NDArray[Any], land: NDArray[Any], pavement: NDArray[Any]) -> float:
    """By how many grey levels stripes of an `EdgeSamples.profile` are brighter than the land, or 0.

    They are brighter than the pavement as well: its border with them is no edge.
    """
    brightest = along.max(axis=1)
    clear = (brightest - np.maximum(land, pavement)).min()
    least = max(EDGES.clear_contrast, EDGES.paint_share * float(np.abs(pavement - land).max()))
    return float((brightest - land).min()) if clear > least else 0.0


def _blur_doubt(
    along: NDArray[Any], land: NDArray[Any], across: NDArray[Any], factor: int
) -> tuple[float, float]:
    """Px by which defocus moves the outer sides of stripes, narrow far away, at both ends.

    It shows in how far they rise, (2, places) across the edges, over how steeply. The working image
    is so many times smaller than the frame.
    """
    steepest = np.maximum(np.diff(along).max(axis=1), 1e-3) / (across[1] - across[0])
    blur = float(((along.max(axis=1) - land) / steepest).mean())
    far = EDGES.blur_share * max(0.0, blur - EDGES.usual_blur / factor)
    return far, far / 3.0


def shows_shoulders(frame: LevelledFrame, strip: Strip) -> bool | None:
    """Whether another edge runs along a strip's on both sides, outside of it.

    It must do so for more than half of the runway's length, with something even in between.

    Returns:
        None if too little beside the runway is on the frame, or it is too narrow.
    """
    rows, edges, outwards = rows_of(strip, np.linspace(SHOULDERS.first_row, 1.0, SHOULDERS.rows))
    across = np.arange(-SHOULDERS.inside, SHOULDERS.beyond, SHOULDERS.step)
    columns = edges[:, :, None] + outwards[:, :, None] * across
    pixels, inside = frame.at(columns, rows[:, None])
    seen = np.asarray(inside.all(axis=(0, 2)))
    if 2 * np.count_nonzero(seen) < SHOULDERS.rows:
        return None
    window = max(2, round(SHOULDERS.window / (float(np.median(outwards[1])) * SHOULDERS.step)))
    if window >= across.size // 2:
        return None
    channels = opponent_channels(pixels)
    unit = max(float(channels[0].mean()), 1.0)
    steps = np.stack([_steps(channel, window, seen) for channel in channels]) / unit
    sizes = np.linalg.norm(steps, axis=0)
    place = across[:-window] + 0.5 * window * SHOULDERS.step
    clearness = min(_clearness(size, place, window * SHOULDERS.step) for size in sizes)
    return clearness >= SHOULDERS.min_clearness


def _steps(
    channel: NDArray[np.float32], window: int, seen: NDArray[np.bool_]
) -> NDArray[np.floating[Any]]:
    """(2, places) median over the rows of the rise towards outside."""
    smooth = cv2.blur(channel, (window, 1))
    rise = (smooth[:, window:] - smooth[:, :-window]).reshape(2, SHOULDERS.rows, -1)
    return np.asarray(np.median(rise[:, seen], axis=1))


def _clearness(size: NDArray[np.floating[Any]], place: NDArray[np.float64], first: float) -> float:
    """By how much a step beyond the edge's own stands out from what is between the two."""
    near = np.nonzero(np.abs(place) <= first)[0]
    own = int(near[size[near].argmax()])
    beyond = size[own:]
    clear = beyond - np.minimum.accumulate(beyond)
    # Texture of the land beside a step that is plain to see is no other place for the edge.
    least = max(SHOULDERS.min_step, SHOULDERS.min_step_share * float(beyond[0]))
    elsewhere = (place[own:] - place[own] > TRACK.tolerance_share) & (beyond >= least)
    return float(np.where(elsewhere, clear, 0.0).max())
