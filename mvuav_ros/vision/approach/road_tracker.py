"""Roads' lanes and pipelines followed, several strips at a time until it is clear which is it."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.approach.attitude import Derotation
from mvuav_ros.vision.approach.edges import Edges, LevelledFrame, Strip, sample_edges
from mvuav_ros.vision.approach.evidence import Table, row_sums
from mvuav_ros.vision.approach.road import (
    PLAIN,
    Colours,
    EdgeProfile,
    Features,
    Search,
    Target,
    features_of,
    find_lanes,
    score_strips,
    white_of,
)
from mvuav_ros.vision.approach.strips import FollowedStrip
from mvuav_ros.vision.approach.tuning import ROAD


class View(NamedTuple):
    """A frame as the tracks see it.

    Attributes:
        frame: the frame itself.
        table: row sums of the levelled working image's features.
        horizon_row: of the levelled working image, px, if it is seen.
        look: of the target, on this land.
        colours: with which the features were made.
    """

    frame: LevelledFrame
    table: Table
    horizon_row: float | None
    look: EdgeProfile
    colours: Colours


class Track(FollowedStrip):
    """A strip, what it looks like, and how well it has done.

    Attributes:
        contrast: (channels,) inside minus outside.
        quality: strip score times the support of the edges, averaged over the last frames.
        merit: the same, less for what is unusual.
        evidence: sum of merit above the target's ``start_score``, limited.
    """

    MOST_MISSES = 10

    def __init__(self, target: Target, strip: Strip, contrast: NDArray[np.float64]) -> None:
        super().__init__(strip)
        self.target = target
        self.contrast = contrast
        self.quality = self.merit = self.evidence = 0.0

    @property
    def width(self) -> float:
        """Of the near end, px of the levelled working image."""
        left, right = self.shape.slopes
        return (right - left) * self.near

    def same_as(self, other: Track) -> bool:
        """Whether both are the same strip on the ground."""
        width = min(self.width, other.width)
        (middle, row), (its_middle, its_row) = self._near_end(), other._near_end()
        return (
            abs(middle - its_middle) < 0.4 * width
            and max(self.width, other.width) < 1.5 * width
            and abs(row - its_row) < 0.5 * width + 4
        )

    def _near_end(self) -> tuple[float, float]:
        x, y, left, right, _, near = (float(value) for value in self.strip())
        return x + 0.5 * (left + right) * near, y + near

    def step(self, view: View) -> None:
        """Follow it into the next frame."""
        self.age += 1
        shape, target = self.shape, self.target
        shape.predict()
        strip = self.strip()
        if not np.isfinite(strip).all():
            self.give_up()
            return
        edges = find_edges(view.frame, strip, self.contrast, target.look.brightness, view.colours)
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
        self.merit = self.quality * self._likelihood()
        seen = score > 0.5 * target.keep_score and sharp > ROAD.min_sharp
        self.points = edges if seen else None
        self.misses = 0 if seen else self.misses + 1
        if seen:
            self.contrast = self.contrast + ROAD.memory * (scores.contrast[0] - self.contrast)
            self.follow_ends(float(scores.far[0]), float(scores.near[0]))
            self.open_end = bool(scores.open_end[0])

    def weigh(self, *, steady: bool) -> None:
        """Let the newest frame speak for or against the track; in a turn only against it."""
        change = self.merit - self.target.start_score
        if steady or change < 0:
            self.evidence = min(max(self.evidence + change, 0.0), ROAD.certain)

    @property
    def believed(self) -> bool:
        """Enough frames have spoken for it."""
        return self.evidence >= ROAD.convincing and self.age >= ROAD.min_age

    @property
    def certain(self) -> bool:
        """So many frames have spoken for it that more would not count."""
        return self.evidence >= ROAD.certain

    @property
    def confidence(self) -> float:
        """0 to 1: one half where it is just believed, less while it is not seen."""
        return self.quality / (self.quality + 1.0) * ROAD.fades**self.misses

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

    def _likelihood(self) -> float:
        """1 for the usual offsets and widths, less beyond."""
        left, right = self.shape.slopes
        target, width = self.target, max(right - left, 1e-6)
        aside = max(0.0, abs(left + right) / 2 / width - target.usual_offset)
        narrow, usual = target.usual_widths
        wide = max(0.0, math.log(width / usual), math.log(narrow / width)) / ROAD.width_spread
        return math.exp(-0.5 * ((aside / target.offset_spread) ** 2 + wide**2))


def find_edges(
    frame: LevelledFrame,
    strip: Strip,
    contrast: NDArray[np.float64],
    brightness: float,
    colours: Colours = PLAIN,
) -> Edges:
    """Measure the edges of a strip whose inside has a contrast (channels,) to its outside.

    ``brightness`` is its weight against colourfulness; the contrast was measured with ``colours``.
    """
    sampled = sample_edges(frame, strip)
    weights = np.array([brightness, 1.0])
    weighted = contrast * weights
    size = float(np.hypot(*weighted))
    direction = weighted * weights / max(size, 1e-6)

    def steps_of(smoothing: int) -> NDArray[Any]:
        features = features_of(sampled.pixels, colours, smoothing)
        profile = direction[0] * features[0] + direction[1] * features[1]
        clipped: NDArray[Any] = np.clip(sampled.steps(profile), 0.0, size)
        return clipped

    # Noise of colour hides the line, smoothing it moves the steps: each for what it leaves alone.
    return sampled.fit(steps_of(1), steps_of(ROAD.colour_smoothing), size)


class Tracker:
    """Finds and follows the target on the levelled working images of one size."""

    def __init__(self, target: Target, height: int, width: int) -> None:
        self.target = target
        self._look = target.look
        self._colours = PLAIN
        self._search = Search(target.look, height, width)
        self.tracks: list[Track] = []
        self.best: Track | None = None
        self._level: Derotation | None = None
        self._horizon_row: float | None = None
        self._table: Table | None = None
        self._frame = 0

    def step(
        self, frame: LevelledFrame, pixels: NDArray[np.uint8], horizon_row: float | None
    ) -> Track | None:
        """The confirmed track in the next frame, if there is one.

        Args:
            frame: the next one.
            pixels: its working image.
            horizon_row: of the levelled working image, px, if it is seen.
        """
        first_row, level = 0, frame.level
        if horizon_row is not None:
            # Nothing is looked for in the sky.
            first_row = min(
                max(0, int(horizon_row) - ROAD.rows_above_horizon), level.height - ROAD.min_land
            )
        colours = self._colours_of(pixels)
        features = features_of(level.turned(pixels, first_row), colours)
        self._table = table = row_sums(features, first_row, self._table)
        if horizon_row is not None:
            self._adapt(features[:, max(0, int(horizon_row) - first_row) :])
        view = View(frame, table, horizon_row, self._look, colours)
        self._follow(view)
        self._frame += 1
        certain = self.best is not None and self.best.certain
        if (
            self.best is None
            or self._frame % (ROAD.period_certain if certain else ROAD.period_believed) == 0
        ):
            self._start(view)
        self._choose()
        return self.best

    def _follow(self, view: View) -> None:
        """Take all tracks into the next frame, and drop those that are lost or hopeless."""
        level, row = view.frame.level, view.horizon_row
        old, self._level = self._level, level
        steady = old is not None and _steady(old.slope, level.slope)
        lift = 0.0
        if row is not None and self._horizon_row is not None:
            lift = row - self._horizon_row
        self._horizon_row = row
        for track in self.tracks:
            if old is not None:
                track.turn(old, level)
            if abs(lift) > ROAD.min_lift:
                track.shape.reference += lift
            track.step(view)
            track.weigh(steady=steady)
        hopeless = ROAD.min_merit * self.target.start_score
        self.tracks = [
            track
            for track in self.tracks
            if not track.lost
            and (track is self.best or track.age < ROAD.trial_frames or track.merit > hopeless)
        ]
        self._merge()

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
        # Haze and weak colours fade land and runway alike, and so the land's texture too.
        weak = ROAD.colour_per_brightness * texture[0] / max(texture[1] / self._colours.gain, 1e-3)
        gain = min(max(weak, 1.0), ROAD.max_colour_gain)
        self._colours = replace(self._colours, gain=self._blend(self._colours.gain, gain))

    def _colours_of(self, pixels: NDArray[np.uint8]) -> Colours:
        if not self._look.painted:
            blue, green, red = map(self._blend, self._colours.white, white_of(pixels))
            self._colours = replace(self._colours, white=(blue, green, red))
        return self._colours

    def _blend(self, old: float, new: float) -> float:
        """What colours are like does not change fast; the first image counts alone."""
        return new if self._frame == 0 else old + ROAD.colour_memory * (new - old)

    def _merge(self) -> None:
        """Of tracks that have become the same one keep the believed one, or the better."""
        kept: list[Track] = []
        ranked = sorted(self.tracks, key=lambda t: (t is not self.best, -t.merit * min(t.age, 10)))
        for track in ranked:
            if not any(track.same_as(other) for other in kept):
                kept.append(track)
        self.tracks = kept

    def _start(self, view: View) -> None:
        if self._look.painted:
            candidates = find_lanes(view.table, self.target)
        elif view.horizon_row is not None:
            candidates = self._search.find(view.table, self._look, view.horizon_row)
        else:
            return
        if not len(candidates):
            return
        scores = score_strips(view.table, candidates, self._look)
        for index in np.argsort(-scores.score)[:3]:
            score = float(scores.score[index])
            if score < self.target.start_score:
                return
            strip = np.array([*candidates[index], scores.far[index], scores.near[index]])
            track = Track(self.target, strip, scores.contrast[index])
            if any(track.same_as(other) for other in self.tracks):
                continue
            if len(self.tracks) >= ROAD.max_tracks:
                worst = min((t for t in self.tracks if t is not self.best), key=lambda t: t.quality)
                if worst.merit > 0.6 * score or worst.age < 5:
                    continue
                self.tracks.remove(worst)
            self.tracks.append(track)

    def _choose(self) -> None:
        target = self.target
        best = self.best
        if best is not None and (best not in self.tracks or best.quality < target.keep_score):
            best = None
        for track in self.tracks:
            if track is best or not track.believed or track.merit < target.start_score:
                continue
            # What is unusual weighs against what is new, not against what has long been followed.
            if best is None or track.merit > ROAD.switch_ratio * (
                best.quality if best.certain else best.merit
            ):
                best = track
        self.best = best


def _steady(old: float, new: float) -> bool:
    """Whether the horizon's slopes, rad, are those of an aircraft that flies to a runway."""
    return abs(new) < ROAD.max_bank and abs(new - old) < ROAD.max_roll
