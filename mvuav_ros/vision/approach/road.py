"""Lanes between painted lines, and pipelines: where they may be, and how they are followed."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import chain, product
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.approach.appearance import best_run
from mvuav_ros.vision.approach.evidence import opponent_channels
from mvuav_ros.vision.approach.search import LevelledImage
from mvuav_ros.vision.approach.sight import Sight
from mvuav_ros.vision.approach.strip_edges import EdgeLook, Edges, LevelledFrame, Strip, Strips
from mvuav_ros.vision.approach.strip_tracker import StripTracker
from mvuav_ros.vision.approach.strips import FollowedStrip
from mvuav_ros.vision.approach.track import View
from mvuav_ros.vision.approach.tuning import ROAD


@dataclass(frozen=True)
class Target:
    """The differences between the things that are straight strips on the ground: a lane's.

    Widths are in camera heights above the ground, which is what the image shows: the strip's
    edges move apart by that many pixels per pixel below the horizon, at any focal length.
    """

    # The edges are bright lines, not the borders of a surface. Painted lines are looked for
    # everywhere: the camera is taken to be level, its horizon where they meet.
    painted: bool = True
    floor: float = 5.0  # grey levels: contrast of a row that speaks neither for nor against a strip
    narrowest: float = 1.12  # width over height
    widest: float = 9.0  # likewise
    farthest_aside: float = 0.5  # most offset, in widths
    least_support: float = 0.3  # of the edges, 0 to 1, below which a shape counts as not seen
    start_score: float = 0.5  # quality above which a frame speaks for a shape
    keep_score: float = 0.3  # quality below which a shape is no longer believed
    # Power of the narrower's width by which it is preferred: within a road with lines along both
    # sides a lane lies between one of them and the line in the middle.
    narrow_odds: float = 1.2


_PIPELINE = Target(
    painted=False,
    floor=7.0,
    narrowest=0.03,
    widest=2.0,
    farthest_aside=6.0,
    least_support=0.15,
    start_score=1.0,
    keep_score=0.8,
    narrow_odds=0.0,
)
TARGETS = {'road': Target(), 'pipeline': _PIPELINE}

Line = tuple[float, float, float]
"""Column on the lowest row, columns per row, and votes."""


def find_strips(pixels: NDArray[Any], target: Target, row: float | None) -> Strips:
    """Pairs of lines on a levelled working image that may be the target's edges, strongest first.

    They meet on the horizon's row, if that is known.
    """
    height, width = pixels.shape[:2]
    top = int(ROAD.highest * height) if row is None else int(max(row + ROAD.first_depth, 0.0))
    top = min(top, height - ROAD.min_land)
    found: list[tuple[float, tuple[float, ...]]] = []
    pairs = (product(*sides) for sides in _sides(pixels[top:], target.painted))
    for (left_end, left, votes), (right_end, right, its_votes) in chain.from_iterable(pairs):
        if row is None:
            depth = (right_end - left_end) / max(right - left, 1e-3)
            if not 1.0 - ROAD.lowest < depth / height < 1.0 - ROAD.highest:
                continue
            x = left_end - left * depth
        else:
            # Slopes are too rough to say where narrow strips' edges meet.
            depth = height - 1 - row
            x, other = left_end - left * depth, right_end - right * depth
            if abs(x - other) > ROAD.meeting_reach:
                continue
            x = 0.5 * (x + other)
        slopes = (left_end - x) / depth, (right_end - x) / depth
        if 0 <= x < width and _possible(*slopes, target):
            strip = (x, height - 1 - depth, *slopes, ROAD.first_depth, depth)
            found.append((min(votes, its_votes), strip))
    found.sort(key=lambda entry: -entry[0])
    return np.array([strip for _, strip in found[: ROAD.max_strips]]).reshape(-1, 6)


def _possible(left: float, right: float, target: Target) -> bool:
    ratio = right - left
    aside = 0.5 * abs(left + right)
    return target.narrowest < ratio < target.widest and aside < target.farthest_aside * ratio


def _sides(pixels: NDArray[Any], painted: bool) -> list[tuple[list[Line], list[Line]]]:
    """Lines that may be left and right edges: along paint, or along steps of opposite signs."""
    channels = np.stack(opponent_channels(pixels))
    if painted:
        reach = ROAD.paint_reach
        brightness = channels[0]
        beside = np.maximum(brightness[:, : -2 * reach], brightness[:, 2 * reach :])
        lines = _lines(brightness[:, reach:-reach] - ROAD.paint_contrast > beside, reach)
        return [(lines, lines)]
    smooth = np.stack([cv2.blur(channel, (3, 3)) for channel in channels])
    steps = smooth[:, :, 4:] - smooth[:, :, :-4]
    most = np.abs(steps).argmax(axis=0)
    step = np.take_along_axis(steps, most[None], axis=0)[0]
    size = np.abs(step)
    peak = size[:, 1:-1] >= np.maximum(size[:, :-2], size[:, 2:])
    peak &= size[:, 1:-1] > np.percentile(size[::3], ROAD.usual_steps)
    rises, falls = (_lines(peak & (sign * step[:, 1:-1] > 0), 3) for sign in (1, -1))
    # A pipeline may be darker or brighter than the land.
    return [(rises, falls), (falls, rises)]


def _lines(marked: NDArray[np.bool_], margin: int) -> list[Line]:
    """Straight lines through places marked in an image but for its sides, strongest first."""
    mask = np.pad(marked.astype(np.uint8), ((0, 0), (margin, margin)))
    found = cv2.HoughLinesWithAccumulator(mask, 1.0, math.radians(1.5), ROAD.min_votes)
    lines: list[Line] = []
    for rho, theta, votes in () if found is None else found.reshape(-1, 3)[:200].tolist():
        cos, sin = math.cos(theta), math.sin(theta)
        if abs(sin) > ROAD.flattest * abs(cos):
            continue
        slope = -sin / cos
        place = rho / cos + slope * (mask.shape[0] - 1)
        if any(
            abs(place - p) < ROAD.same_place * (1 + abs(slope)) and abs(slope - s) < ROAD.same_slope
            for p, s, _ in lines
        ):
            continue
        lines.append((place, slope, votes))
        if len(lines) == ROAD.max_lines:
            break
    return lines


class RoadTrack(FollowedStrip):
    """A strip that goes on to the lower end of the image, and how well it has done."""

    max_misses = 10

    def __init__(self, target: Target, strip: Strip) -> None:
        super().__init__(strip)
        self.target = target
        # Contrast of both edges over the logarithm of depth, times their support, averaged over
        # the last frames.
        self.quality = 0.0
        self.evidence = 0.0  # sum of quality above the target's ``start_score``, limited
        self._look = EdgeLook(wide=False, painted=target.painted)

    @property
    def rank(self) -> float:
        """Log odds with which it stands against other tracks."""
        left, right = self.shape.slopes
        narrow = self.target.narrow_odds * math.log(max(right - left, 1e-6))
        return math.log(max(self.quality, 1e-6)) - narrow

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
        height, width = view.working.size
        strip = self.strip()
        x, y, left, right, far, _ = strip
        within = -0.5 * width < x < 1.5 * width and -0.5 * height < y < height - ROAD.min_land
        if not (within and _possible(left, right, self.target)):
            self.give_up()
            return
        strip[4:] = max(ROAD.farther * far, ROAD.first_depth), height - 0.5 - y
        edges = self._look.find(view.frame, strip)
        score, sharp = self._score(edges, strip)
        self.shape.move_reference(y + 0.3 * strip[4] + 0.7 * strip[5])
        self.shape.update(edges, view.sight.meeting)
        self.quality += max(ROAD.memory, 1.0 / self.age) * (score - self.quality)
        change = self.quality - self.target.start_score
        self.evidence = min(max(self.evidence + change, 0.0), ROAD.certain)
        seen = score > 0.5 * self.target.keep_score and sharp > ROAD.min_sharp
        self.points = edges if seen else None
        self.misses = 0 if seen else self.misses + 1

    def _score(self, edges: Edges, strip: Strip) -> tuple[float, float]:
        """Of the newest frame; and of it the edges' support alone, 0 to 1."""
        one, other = edges
        depth = one.rows - strip[1]
        strength = 0.5 * (one.weights + other.weights) * self._look.size / self.target.floor
        worth = (depth[1] - depth[0]) / depth
        gain = (np.minimum(strength, ROAD.ceiling) - 1.0) * worth
        run, first, last = (found.item() for found in best_run(gain[None]))
        support = math.sqrt(one.support * other.support)
        sharp = min(max((support - self.target.least_support) / ROAD.support_range, 0.0), 1.0)
        if sharp > ROAD.min_sharp:
            self.follow_ends(float(one.rows[first]), float(one.rows[min(last, depth.size) - 1]))
        return run * sharp, sharp


class RoadTracker(StripTracker[RoadTrack]):
    """Finds and follows a lane or a pipeline on the levelled working images of one size."""

    def __init__(self, target: Target) -> None:
        super().__init__(ROAD.max_tracks, ROAD.switch_margin)
        self.target = target
        self.below_horizon = not target.painted

    def step(self, frame: LevelledFrame, pixels: NDArray[Any], sight: Sight) -> RoadTrack | None:
        """The track that is shown in the next frame, of which ``pixels`` are the working image."""
        if not self._move(frame.level, pixels):
            return self.best
        horizon = None if sight.row is None else (sight.row, ROAD.horizon_sigma)
        working = LevelledImage(pixels, frame.level)
        view = View(frame, working, sight._replace(meeting=horizon), self.registration)
        for track in self.tracks:
            track.step(view)
        self.tracks = [track for track in self.tracks if not track.lost]
        self._merge()
        self._frame += 1
        searched = self.best is None or self._frame % ROAD.search_period == 0
        if searched and (self.target.painted or sight.row is not None):
            self._start(find_strips(frame.level.turned(pixels), self.target, sight.row), view)
        if self.best is not None and self.best.quality < self.target.keep_score:
            self.best = None
        self._choose()
        return self.best

    def _start(self, found: Strips, view: View) -> None:
        fresh: list[RoadTrack] = []
        for strip in found:
            if len(fresh) == ROAD.max_started:
                break
            if not any(track.covers(strip) for track in (*self.tracks, *fresh)):
                fresh.append(RoadTrack(self.target, strip))
                fresh[-1].step(view)
        for track in sorted(fresh, key=lambda track: -track.quality):
            if track.quality >= self.target.start_score:
                self._admit(track)
