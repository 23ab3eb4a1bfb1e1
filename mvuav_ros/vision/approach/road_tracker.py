"""Roads' lanes and pipelines followed, several strips at a time until it is clear which is it."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.approach.edges import Edges, LevelledFrame, Strip, sample_edges
from mvuav_ros.vision.approach.evidence import Table, row_sums
from mvuav_ros.vision.approach.ground_motion import Registration
from mvuav_ros.vision.approach.road import (
    EdgeProfile,
    Features,
    Search,
    Target,
    features_of,
    find_lanes,
    score_strips,
)
from mvuav_ros.vision.approach.strips import FollowedStrip
from mvuav_ros.vision.approach.tracker import Sight, StripTracker
from mvuav_ros.vision.approach.tuning import ROAD

_NOTHING = 1e-6


class View(NamedTuple):
    """A frame as the tracks see it.

    Attributes:
        frame: the frame itself.
        table: row sums of the levelled working image's features.
        horizon_row: of the levelled working image, px, if it is seen.
        look: of the target, on this land.
        registration: of the working images.
    """

    frame: LevelledFrame
    table: Table
    horizon_row: float | None
    look: EdgeProfile
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
        support = math.sqrt(left * right) if view.look.painted else 0.5 * (left + right)
        shape.move_reference(strip[1] + 0.7 * self.near + 0.3 * self.far)
        row = view.horizon_row
        shape.update(edges, None if row is None else (row, ROAD.horizon_sigma))
        strip = self.strip()
        if not self._plausible(strip, view.table):
            self.give_up()
            return
        scores = score_strips(view.table, strip[None, :4], view.look)
        sharp = min(max((support - target.least_support) / ROAD.support_range, 0.0), 1.0)
        credible = self._credibility(strip[1], row, view.table.shape[1])
        score = float(scores.score[0]) * sharp * credible
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

    def _credibility(self, y: float, horizon_row: float | None, height: int) -> float:
        """1 for what a strip on the ground must look like, down to 0."""
        off = 0.0
        if horizon_row is not None:
            off = max(0.0, abs(y - horizon_row) / ROAD.max_off_horizon - 1.0)
        reached = (y + self.near) / height
        return math.exp(-0.5 * off**2) * min(
            max((reached - ROAD.high_end) / (ROAD.low_end - ROAD.high_end), 0.0), 1.0
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
        self._look = target.look
        self._search: Search | None = None
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
        if row is not None:
            self._adapt(features[:, max(0, int(row) - first_row) :])
        view = View(frame, table, row, self._look, self._registration)
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

    def _adapt(self, land: Features) -> None:
        """Weigh and limit contrasts by what the land ahead looks like."""
        look = self.target.look
        if look.painted or not land.size:
            return
        land = land[:, ::2]
        texture = [float(cv2.absdiff(x, cv2.blur(x, (ROAD.texture_reach, 1))).mean()) for x in land]
        # Where land is colourful, brightness alone makes no strip of pavement.
        share = min(
            max(
                (float(land[1].mean()) - ROAD.grey_land) / (ROAD.colourful_land - ROAD.grey_land),
                0.0,
            ),
            1.0,
        )
        brightness = look.brightness * (1.0 - 0.5 * share)
        floor = ROAD.floor_per_texture * math.hypot(brightness * texture[0], texture[1])
        floor = min(max(floor, ROAD.min_floor), look.floor)
        self._look = replace(look, brightness=brightness, floor=floor)

    def _start(self, view: View) -> None:
        """Follow the best candidates that are not followed yet."""
        if self._look.painted:
            candidates = find_lanes(view.table, self.target)
        elif view.horizon_row is not None:
            self._search = self._search or Search(self.target.look, *view.frame.level.size)
            candidates = self._search.find(view.table, self._look, view.horizon_row)
        else:
            return
        if not len(candidates):
            return
        scores = score_strips(view.table, candidates, self._look)
        for index in np.argsort(-scores.score)[: ROAD.max_started]:
            score = float(scores.score[index])
            if score < self.target.start_score:
                return
            strip = np.array([*candidates[index], scores.far[index], scores.near[index]])
            if not any(track.covers(strip) for track in self.tracks):
                self._admit(RoadTrack(self.target, strip, score, scores.contrast[index]))
