"""Roads' lanes and pipelines: what they look like, where they may be, and how they are followed.

Several strips are followed at a time until it is clear which of them is it. A strip is compared
with both sides; the edges of a lane are painted lines.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.approach.appearance import best_run
from mvuav_ros.vision.approach.evidence import OPPONENT, Table, grey_levels, in_common, row_sums
from mvuav_ros.vision.approach.ground_motion import Registration
from mvuav_ros.vision.approach.strip_edges import Edges, LevelledFrame, Strip, sample_edges
from mvuav_ros.vision.approach.strip_tracker import Sight, StripTracker
from mvuav_ros.vision.approach.strips import FollowedStrip
from mvuav_ros.vision.approach.tuning import ROAD


@dataclass(frozen=True)
class EdgeProfile:
    """What distinguishes the strip from the land beside it.

    Lengths are in widths of the strip.

    Attributes:
        gap: from an edge to where the outside begins.
        least_gap: the same, px.
        inset: from an edge to where the inside begins.
        inside: of the inside that is compared with each side.
        flank: of the outside that is compared on each side.
        brightness: weight of brightness against colourfulness.
        floor: grey levels; contrast of a row that speaks neither for nor against a strip.
        painted: the edges are bright lines, not the borders of a surface.
    """

    gap: float = 0.08
    least_gap: float = 0.4
    inset: float = 0.1
    inside: float = 0.3
    flank: float = 0.6
    brightness: float = 0.6
    floor: float = 7.0
    painted: bool = False


@dataclass(frozen=True)
class Target:
    """The differences between the things that are straight strips on the ground.

    Widths are in camera heights above the ground, which is what the image shows: the strip's
    edges move apart by that many pixels per pixel below the horizon, at any focal length.

    Attributes:
        look: how it differs from the land. Painted lines are looked for everywhere: the camera is
            taken to be level, its horizon where they meet. Other strips are looked for below the
            horizon.
        narrowest: width over height of a lane.
        widest: greatest width over height of a shape that is followed.
        farthest_aside: most offset of a shape that is followed.
        least_support: of the edges, 0 to 1, below which a shape counts as not seen.
        start_score: quality above which a frame speaks for a shape.
        keep_score: quality below which a shape is no longer believed.
    """

    look: EdgeProfile
    narrowest: float
    widest: float
    farthest_aside: float
    least_support: float
    start_score: float
    keep_score: float


_LANE = Target(
    look=EdgeProfile(
        gap=-0.008, least_gap=-9.0, inset=0.05, inside=0.45, flank=0.03, floor=5.0, painted=True
    ),
    narrowest=1.12,
    widest=9.0,
    farthest_aside=0.5,
    least_support=0.3,
    start_score=0.5,
    keep_score=0.3,
)
_PIPELINE = Target(
    look=EdgeProfile(),
    narrowest=0.03,
    widest=2.0,
    farthest_aside=6.0,
    least_support=0.15,
    start_score=1.0,
    keep_score=0.8,
)
TARGETS = {'road': _LANE, 'pipeline': _PIPELINE}

Features = NDArray[np.float32]
"""(2, rows, columns) brightness and colourfulness, grey levels."""
CHANNELS = 2


def features_of(pixels: NDArray[Any]) -> Features:
    """Brightness and colourfulness of pixels (rows, columns) or (rows, columns, 3), blue first.

    Pavement is greyer than what grows beside it, whether it is darker or brighter; and what is as
    colourful as its surroundings, such as one field beside another, does not stand out.
    """
    levels = grey_levels(pixels)
    if pixels.ndim == 2:
        return np.stack([levels, np.zeros_like(levels)])
    brightness, blue_yellow, red_green = cv2.split(cv2.transform(levels, OPPONENT))
    # cv2.magnitude rounds as the arrays happen to lie in memory; results must repeat.
    blue_yellow *= blue_yellow
    red_green *= red_green
    blue_yellow += red_green
    return np.stack([brightness, np.sqrt(blue_yellow, out=blue_yellow)])


Shapes = NDArray[np.float64]
"""(n, 4): vanishing point's x and y, and the columns by which the left and the right edge move to
the right per row below it; px on the levelled working image."""


@dataclass(frozen=True, eq=False)
class StripScores:
    """What `score_strips` says of n shapes.

    Attributes:
        score: (n,) sum over the depth of the strip, log scale, of contrast above the floor, in
            units of the floor; 0 where there is none.
        far: (n,) first row of the strip, px below the vanishing point.
        near: (n,) row after its last one, px below the vanishing point.
        contrast: (n, channels) mean of inside minus outside, grey levels.
        open_end: (n,) the strip leaves the image there.
    """

    score: NDArray[np.floating[Any]]
    far: NDArray[np.floating[Any]]
    near: NDArray[np.floating[Any]]
    contrast: NDArray[np.floating[Any]]
    open_end: NDArray[np.bool_]


def bounds_of(left: Any, right: Any, look: EdgeProfile) -> tuple[Any, ...]:
    """Columns between which a strip's outside and inside are averaged, from left to right.

    Four stretches: beside the left edge outside and inside, beside the right edge inside and
    outside. What lies in the middle of a runway, from rubber to figures, does not count.
    """
    width = right - left
    gap = np.maximum(look.gap * width, look.least_gap)
    flank = np.clip(look.flank * width, ROAD.min_flank, ROAD.max_flank)
    inset = look.inset * width
    inside = look.inside * width
    return (
        left - gap - flank,
        left - gap,
        left + inset,
        left + inset + inside,
        right - inset - inside,
        right - inset,
        right + gap,
        right + gap + flank,
    )


def contrasts(
    sums: NDArray[Any], bounds: NDArray[Any], look: EdgeProfile
) -> tuple[NDArray[Any], NDArray[Any]]:
    """How a strip differs from both sides.

    Args:
        sums: (channels, 8, ...) row sums at the bounds.
        bounds: (8, ...) the bounds, already confined to the image.
        look: of the target.

    Returns:
        (channels, ...) what both sides have in common of inside minus outside, and (...) its
        size with the channels weighted. Of painted edges (2, ...) by how much the left and the
        right one are brighter than the inside, and their mean.
    """
    shares = bounds[1::2] - bounds[::2]
    means = (sums[:, 1::2] - sums[:, ::2]) / np.maximum(shares, 1e-3)
    left = means[:, 1] - means[:, 0]
    right = means[:, 2] - means[:, 3]
    if look.painted:
        sides = np.maximum(-np.stack([left[0], right[0]]), 0.0)
        np.minimum(sides, 2 * ROAD.ceiling * look.floor, out=sides)
        size = 0.5 * (sides[0] + sides[1])
        common = sides
    else:
        common = in_common(left, right)
        size = np.hypot(look.brightness * common[0], np.minimum(common[1], 0.0))
    return common, size * _seen(bounds)


def _seen(bounds: NDArray[Any]) -> NDArray[Any]:
    """Where enough of both sides and of the strip itself is in the image."""
    shares = bounds[1::2] - bounds[::2]
    seen: NDArray[Any] = (np.minimum(shares[0], shares[3]) > 0.5) & (
        np.minimum(shares[1], shares[2]) > 0.2
    )
    return seen


def score_strips(table: Table, shapes: Shapes, look: EdgeProfile) -> StripScores:
    """Measure shapes row by row, and find where along its depth each is a strip."""
    _, height, stride = table.shape
    columns = stride - 1
    rows = np.arange(max(0, int(np.ceil(shapes[:, 1].min() + ROAD.first_depth))), height)
    count = shapes.shape[0]
    if rows.size < 2:
        nothing = np.zeros(count)
        return StripScores(
            nothing, nothing, nothing, np.zeros((count, CHANNELS)), np.zeros(count, bool)
        )
    depth = (rows - shapes[:, 1:2]).astype(np.float32)
    start = shapes[:, 0:1].astype(np.float32)
    left = start + shapes[:, 2:3].astype(np.float32) * depth
    right = start + shapes[:, 3:4].astype(np.float32) * depth
    # Pixel x covers [x - 0.5, x + 0.5].
    bounds = np.stack(bounds_of(left, right, look))
    bounds += np.float32(0.5)
    np.clip(bounds, 0, columns, out=bounds)
    sums = _interpolate(table, rows, bounds)
    common, size = contrasts(sums, bounds, look)
    # What is hidden speaks neither for nor against.
    seen = _seen(bounds)
    visible = (depth >= ROAD.first_depth) & seen
    depth = np.maximum(depth, 1.0)
    worth = visible / depth
    gain = (np.minimum(size / look.floor, ROAD.ceiling) - 1.0) * worth
    score, first, last = best_run(gain)
    index = np.arange(rows.size)
    inside = (index >= first[:, None]) & (index < last[:, None])
    contrast = (common * inside).sum(axis=2).T / np.maximum(inside.sum(axis=1), 1)[:, None]
    if look.painted:
        score *= _balance(contrast[:, 0], contrast[:, 1])
        contrast = np.stack([-contrast.mean(axis=1), np.zeros(count)], axis=1)
    number = np.arange(count)
    far = depth[number, first]
    near = depth[number, np.maximum(last - 1, first)] + 1.0
    # Where the next row is hidden, nobody knows how far the strip goes on.
    beyond = np.minimum(last, rows.size - 1)
    open_end = (last >= rows.size - 1) | ~seen[number, beyond]
    return StripScores(score, far, near, contrast, open_end)


def _balance(left: NDArray[Any], right: NDArray[Any]) -> NDArray[Any]:
    """1 for two lines, be one of them dashed 1 : 2; less where one is faint beside the other."""
    larger = np.maximum(np.maximum(left, right), 1e-6)
    share: NDArray[Any] = np.minimum(left, right) / larger
    return np.clip((share - 0.03) / 0.22, 0.0, 1.0)


def _interpolate(table: Table, rows: NDArray[Any], bounds: NDArray[Any]) -> NDArray[Any]:
    """(channels, ..., r) row sums at r whole rows and (..., r) fractional columns."""
    channels, _, stride = table.shape
    whole = np.minimum(bounds.astype(np.int32), stride - 2)
    part = bounds - whole
    index = whole + (rows * stride).astype(np.int32)
    flat = table.reshape(channels, -1)
    below = flat.take(index, axis=1, mode='clip')
    index += 1
    above: NDArray[Any] = flat.take(index, axis=1, mode='clip')
    above -= below
    above *= part
    above += below
    return above


_OFFSETS = np.array((-3.0, -1.5, -1.2, -0.7, -0.3, 0.0, 0.3, 0.7, 1.2, 1.5, 3.0))
"""The camera's ways from the strip's middle, in widths, that are tried."""


class Band:
    """All strips of one width over height that end at about one depth below the horizon."""

    def __init__(
        self, look: EdgeProfile, depth: float, ratio: float, height: int, width: int
    ) -> None:
        """Lay out where to look on levelled images of that height and width.

        ``depth`` is the near end's below the horizon, px, ``ratio`` width over camera height.
        """
        self._width, self._height = ratio * depth, height
        self._slopes = np.stack([-(_OFFSETS + 0.5) * ratio, (0.5 - _OFFSETS) * ratio], axis=1)
        self._rows = np.unique(
            np.rint(np.geomspace(ROAD.taper * depth, depth, ROAD.samples))
        ).astype(int)
        step = max(1, min(8, int(self._width / 4)))
        beyond = int(ROAD.max_beyond * width)
        self._points = np.arange(-beyond, width + beyond, step)
        x = self._points[:, None, None]
        left, right = (x + slopes[:, None] * self._rows for slopes in self._slopes.T)
        bounds = np.stack(bounds_of(left, right, look))
        bounds = np.rint(np.clip(bounds + 0.5, 0, width)).astype(np.int32)
        self._bounds = bounds.astype(np.float32)
        self._index = bounds + (self._rows * (width + 1)).astype(np.int32)
        self._middles = self._points[:, None] + 0.5 * self._slopes.sum(axis=1) * depth
        self.size = self._index.size

    def find(self, table: Table, look: EdgeProfile, horizon_row: float) -> Shapes:
        """The best strips of this band whose vanishing points lie on a row, best first."""
        top = round(horizon_row)
        found: list[tuple[float, ...]] = []
        if top + self._rows[0] < 0 or top + self._rows[-1] >= self._height:
            return np.empty((0, 4))
        channels, _, stride = table.shape
        flat = table.reshape(channels, -1)
        sums = flat.take(self._index + np.int32(top * stride), axis=1, mode='clip')
        _, size = contrasts(sums, self._bounds, look)
        gain = np.minimum(size, ROAD.ceiling * look.floor).mean(axis=2)
        for _ in range(ROAD.max_of_band):
            point, number = np.unravel_index(int(gain.argmax()), gain.shape)
            if gain[point, number] <= look.floor:
                break
            found.append((self._points[point], horizon_row, *self._slopes[number]))
            # Strips whose near ends have nearly the same middle are the same strip.
            near = np.abs(self._middles - self._middles[point, number]) < 0.7 * self._width
            gain[near] = 0.0
        return np.array(found, np.float64).reshape(-1, 4)


class BandSearch:
    """Takes a share of the bands in each frame, so that no frame takes long."""

    def __init__(self, look: EdgeProfile, height: int, width: int) -> None:
        self._bands = [
            Band(look, float(depth), ratio, height, width)
            for depth in np.geomspace(10, 0.6 * height, 9)
            for ratio in ROAD.ratios
            if ROAD.narrowest <= ratio * depth <= 0.9 * width
        ]
        self._effort = ROAD.search_share * sum(band.size for band in self._bands)
        self._next = 0

    def find(self, table: Table, look: EdgeProfile, horizon_row: float) -> Shapes:
        """Candidates of the next bands' turn; after a few frames all had theirs."""
        effort = self._effort
        found = [np.empty((0, 4))]
        while effort > 0:
            band = self._bands[self._next]
            self._next = (self._next + 1) % len(self._bands)
            effort -= band.size
            found.append(band.find(table, look, horizon_row))
        return np.concatenate(found)


def find_lanes(table: Table, target: Target) -> Shapes:
    """Candidates from pairs of painted lines of plausible widths and offsets, strongest first."""
    height, width = table.shape[1], table.shape[2] - 1
    lines = _painted_lines(table)
    found: list[tuple[float, tuple[float, float, float, float]]] = []
    for place_left, left, votes_left in lines:
        for place_right, right, votes_right in lines:
            ratio = right - left
            if not target.narrowest < ratio < target.widest:
                continue
            if abs(left + right) / 2 / ratio > target.farthest_aside:
                continue
            # Places are columns on the lowest row.
            depth = (place_right - place_left) / ratio
            row = height - 1 - depth
            column = place_left - left * depth
            if ROAD.highest * height < row < ROAD.lowest * height and 0 <= column < width:
                found.append((min(votes_left, votes_right), (column, row, left, right)))
    found.sort(key=lambda entry: -entry[0])
    return np.array([shape for _, shape in found[: ROAD.max_lanes]]).reshape(-1, 4)


def _painted_lines(table: Table) -> list[tuple[float, float, float]]:
    """Column on the lowest row, columns per row, and votes of lines; strongest first."""
    brightness = table[0, :, 1:] - table[0, :, :-1]
    height = brightness.shape[0]
    top = int(ROAD.highest * height)
    mask = _paint(brightness[top:])
    found = cv2.HoughLinesWithAccumulator(mask, 1.0, math.radians(1.5), ROAD.min_votes)
    lines: list[tuple[float, float, float]] = []
    for rho, theta, votes in () if found is None else found.reshape(-1, 3)[:200]:
        cos, sin = math.cos(theta), math.sin(theta)
        if abs(sin) > ROAD.flattest * abs(cos):
            continue
        slope = -sin / cos
        place = rho / cos + slope * (height - 1 - top)
        if any(
            abs(place - p) < ROAD.same_place * (1 + abs(slope)) and abs(slope - s) < ROAD.same_slope
            for p, s, _ in lines
        ):
            continue
        lines.append((float(place), float(slope), float(votes)))
        if len(lines) == ROAD.max_lines:
            break
    return lines


def _paint(brightness: NDArray[np.float32]) -> NDArray[np.uint8]:
    """1 where a row has a narrow bright place."""
    mask = np.zeros(brightness.shape, np.uint8)
    inner = brightness[:, ROAD.paint_reach : -ROAD.paint_reach] - ROAD.paint_contrast
    bright = (inner > brightness[:, : -2 * ROAD.paint_reach]) & (
        inner > brightness[:, 2 * ROAD.paint_reach :]
    )
    mask[:, ROAD.paint_reach : -ROAD.paint_reach] = bright
    return mask


_NOTHING = 1e-6


class View(NamedTuple):
    """A frame as the tracks see it.

    Attributes:
        frame: the frame itself.
        table: row sums of the levelled working image's features.
        horizon_row: of the levelled working image, px, if it is seen.
        registration: of the working images.
    """

    frame: LevelledFrame
    table: Table
    horizon_row: float | None
    registration: Registration


class RoadTrack(FollowedStrip):
    """A strip, what it looks like, and how well it has done.

    Attributes:
        contrast: (channels,) inside minus outside.
        quality: strip score times the support of the edges, averaged over the last frames; the log
            odds are its logarithm.
        evidence: sum of quality above the target's ``start_score``, limited.
    """

    max_misses = 10

    def __init__(
        self, target: Target, strip: Strip, score: float, contrast: NDArray[np.float64]
    ) -> None:
        """Begin with a candidate and its score."""
        super().__init__(strip, math.log(score))
        self.target = target
        self.contrast = contrast
        self.quality = self.evidence = 0.0

    @property
    def showable(self) -> bool:
        """Enough frames have spoken for it, and the newest do as well."""
        believed = self.evidence >= ROAD.convincing and self.age >= ROAD.min_age
        return believed and self.quality >= self.target.start_score

    def covers(self, strip: Strip) -> bool:
        """Whether a strip is as wide and at the same place: lanes lie beside and within roads."""
        left, right = self.shape.slopes
        share = float(strip[3] - strip[2]) / max(right - left, 1e-6)
        return 1 / ROAD.max_wider < share < ROAD.max_wider and super().covers(strip)

    @property
    def confidence(self) -> float:
        """0 to 1: less while it is not seen."""
        return self.quality / (self.quality + 1.0) * ROAD.fades**self.misses

    def step(self, view: View) -> None:
        """Follow it into the next frame."""
        self.age += 1
        shape, target = self.shape, self.target
        shape.predict(*view.registration.shift(self.strip(), view.frame.level))
        strip = self.strip()
        if not np.isfinite(strip).all():
            self.give_up()
            return
        edges = find_edges(view.frame, strip, self.contrast, target.look.brightness)
        left, right = (edge.support for edge in edges)
        # A pipeline's edge may be hidden on one side.
        support = math.sqrt(left * right) if target.look.painted else 0.5 * (left + right)
        shape.move_reference(strip[1] + 0.7 * self.near + 0.3 * self.far)
        row = view.horizon_row
        shape.update(edges, None if row is None else (row, ROAD.horizon_sigma))
        strip = self.strip()
        if not self._plausible(strip, view.table):
            self.give_up()
            return
        scores = score_strips(view.table, strip[None, :4], target.look)
        sharp = min(max((support - target.least_support) / ROAD.support_range, 0.0), 1.0)
        # A strip under the camera goes on to the lower end of the image.
        reached = (strip[1] + self.near) / view.table.shape[1]
        low = (reached - ROAD.high_end) / (ROAD.low_end - ROAD.high_end)
        score = float(scores.score[0]) * sharp * min(max(low, 0.0), 1.0)
        self.quality += max(ROAD.memory, 1.0 / self.age) * (score - self.quality)
        self.log_odds = math.log(max(self.quality, _NOTHING))
        change = self.quality - target.start_score
        self.evidence = min(max(self.evidence + change, 0.0), ROAD.certain)
        seen = score > 0.5 * target.keep_score and sharp > ROAD.min_sharp
        self.points = edges if seen else None
        self.misses = 0 if seen else self.misses + 1
        if seen:
            self.contrast = self.contrast + ROAD.memory * (scores.contrast[0] - self.contrast)
            self.follow_ends(float(scores.far[0]), float(scores.near[0]))
            self.open_end = bool(scores.open_end[0])

    def _plausible(self, strip: Strip, table: Table) -> bool:
        if not np.isfinite(strip).all():
            return False
        x, y, left, right = (float(v) for v in strip[:4])
        width = right - left
        aside = abs(left + right) / 2 / max(width, 1e-6)
        height, columns = table.shape[1], table.shape[2] - 1
        return (
            0.03 < width < self.target.widest
            and aside < self.target.farthest_aside
            and -0.5 * columns < x < 1.5 * columns
            and -0.5 * height < y < height - 4
        )


def find_edges(
    frame: LevelledFrame, strip: Strip, contrast: NDArray[np.float64], brightness: float
) -> Edges:
    """Measure the edges of a strip whose inside has a contrast (channels,) to its outside.

    ``brightness`` is its weight against colourfulness.
    """
    sampled = sample_edges(frame, strip)
    weights = np.array([brightness, 1.0])
    weighted = contrast * weights
    size = float(np.hypot(*weighted))
    direction = weighted * weights / max(size, 1e-6)
    features = features_of(sampled.pixels)
    profile = direction[0] * features[0] + direction[1] * features[1]
    return sampled.fit(np.clip(sampled.steps(profile), 0.0, size), size)


class RoadTracker(StripTracker[RoadTrack]):
    """Finds and follows a lane or a pipeline on the levelled working images of one size."""

    def __init__(self, target: Target) -> None:
        super().__init__(ROAD.max_tracks, ROAD.switch_margin)
        self.target = target
        self.below_horizon = not target.look.painted
        self._search: BandSearch | None = None
        self._table: Table | None = None

    @property
    def confidence(self) -> float:
        """Of the best track."""
        return 0.0 if self.best is None else self.best.confidence

    def step(self, frame: LevelledFrame, pixels: NDArray[Any], sight: Sight) -> RoadTrack | None:
        """The track that is shown in the next frame, of which ``pixels`` are the working image."""
        self._registration.take(pixels)
        first_row, level, row = 0, frame.level, sight.row
        if row is not None:
            # Nothing is looked for in the sky.
            first_row = max(0, int(row) - ROAD.rows_above_horizon)
            first_row = min(first_row, level.height - ROAD.min_land)
        features = features_of(level.turned(pixels, (0, first_row, level.width, level.height)))
        self._table = table = row_sums(features, first_row, self._table)
        view = View(frame, table, row, self._registration)
        self._turn(level)
        for track in self.tracks:
            track.step(view)
        self.tracks = [track for track in self.tracks if self._promising(track)]
        self._merge()
        self._frame += 1
        if self.best is None or self._frame % ROAD.search_period == 0:
            self._start(view)
        if self.best is not None and self.best.quality < self.target.keep_score:
            self.best = None
        self._choose()
        return self.best

    def _promising(self, track: RoadTrack) -> bool:
        tried = track is not self.best and track.age >= ROAD.trial_frames
        hopeless = track.quality <= ROAD.min_quality * self.target.start_score
        return not (track.lost or (tried and hopeless))

    def _start(self, view: View) -> None:
        """Follow the best candidates that are not followed yet."""
        look = self.target.look
        if look.painted:
            candidates = find_lanes(view.table, self.target)
        elif view.horizon_row is not None:
            self._search = self._search or BandSearch(look, *view.frame.level.size)
            candidates = self._search.find(view.table, look, view.horizon_row)
        else:
            return
        if not len(candidates):
            return
        scores = score_strips(view.table, candidates, look)
        for index in np.argsort(-scores.score)[: ROAD.max_started]:
            score = float(scores.score[index])
            if score < self.target.start_score:
                return
            strip = np.array([*candidates[index], scores.far[index], scores.near[index]])
            if not any(track.covers(strip) for track in self.tracks):
                self._admit(RoadTrack(self.target, strip, score, scores.contrast[index]))
