"""Several strips followed at a time, until it is clear which is the one."""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.approach.channels import Table, row_sums
from mvuav_ros.vision.approach.derotation import Derotation
from mvuav_ros.vision.approach.edges import LevelledFrame
from mvuav_ros.vision.approach.road.features import PLAIN, Colours, Features, features_of, white_of
from mvuav_ros.vision.approach.road.lane_markings import find_lanes
from mvuav_ros.vision.approach.road.search import Search
from mvuav_ros.vision.approach.road.strip import score_strips
from mvuav_ros.vision.approach.road.targets import Target
from mvuav_ros.vision.approach.road.track import Track, View

_MOST_TRACKS = 4
_MOST_BANK, _MOST_ROLL = math.radians(10.0), math.radians(0.5)
"""Rad, and rad per frame, up to which flight is steady."""
_SWITCH = 1.3
_OFTEN, _SELDOM = 3, 6
"""Frames from one search to the next while a track is believed."""
_LEAST_LIFT = 1.5
"""Px of the working image: less may be the horizon's noise."""
_GREY, _COLOURFUL = 8.0, 20.0
_TEXTURE = 15
"""Px over which land is compared with itself."""
_FLOOR_PER_TEXTURE, _LEAST_FLOOR = 2.1, 3.0
_COLOUR_PER_BRIGHTNESS, _MOST_COLOUR_GAIN, _COLOUR_MEMORY = 0.36, 3.0, 0.1
"""Texture of colourfulness over that of brightness in fine weather; weaker colours are amplified
to that, but not until they are noise."""
_LEAST_LAND = 8
_ABOVE_HORIZON = 24
_TRIAL, _HOPELESS = 12, 0.5
"""Frames after which a track of less than that share of `Target.start_score` is given up."""


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
            first_row = min(max(0, int(horizon_row) - _ABOVE_HORIZON), level.height - _LEAST_LAND)
        colours = self._colours_of(pixels)
        features = features_of(level.turned(pixels, first_row), colours)
        self._table = table = row_sums(features, first_row, self._table)
        if horizon_row is not None:
            self._adapt(features[:, max(0, int(horizon_row) - first_row) :])
        view = View(frame, table, horizon_row, self._look, colours)
        self._follow(view)
        self._frame += 1
        certain = self.best is not None and self.best.certain
        if self.best is None or self._frame % (_SELDOM if certain else _OFTEN) == 0:
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
            if abs(lift) > _LEAST_LIFT:
                track.shape.reference += lift
            track.step(view)
            track.weigh(steady=steady)
        hopeless = _HOPELESS * self.target.start_score
        self.tracks = [
            track
            for track in self.tracks
            if not track.lost
            and (track is self.best or track.age < _TRIAL or track.merit > hopeless)
        ]
        self._merge()

    def _adapt(self, land: Features) -> None:
        """Weigh and limit contrasts by what the land ahead looks like."""
        look = self.target.look
        if look.painted or not land.size:
            return
        land = land[:, ::2]
        texture = [float(cv2.absdiff(x, cv2.blur(x, (_TEXTURE, 1))).mean()) for x in land]
        # Where land is colourful, brightness alone makes no strip of pavement.
        share = min(max((float(land[1].mean()) - _GREY) / (_COLOURFUL - _GREY), 0.0), 1.0)
        brightness = look.brightness * (1.0 - 0.5 * share)
        floor = _FLOOR_PER_TEXTURE * math.hypot(brightness * texture[0], texture[1])
        floor = min(max(floor, _LEAST_FLOOR), look.floor)
        self._look = replace(look, brightness=brightness, floor=floor)
        # Haze and weak colours fade land and runway alike, and so the land's texture too.
        weak = _COLOUR_PER_BRIGHTNESS * texture[0] / max(texture[1] / self._colours.gain, 1e-3)
        gain = min(max(weak, 1.0), _MOST_COLOUR_GAIN)
        self._colours = replace(self._colours, gain=self._blend(self._colours.gain, gain))

    def _colours_of(self, pixels: NDArray[np.uint8]) -> Colours:
        if not self._look.painted:
            blue, green, red = map(self._blend, self._colours.white, white_of(pixels))
            self._colours = replace(self._colours, white=(blue, green, red))
        return self._colours

    def _blend(self, old: float, new: float) -> float:
        """What colours are like does not change fast; the first image counts alone."""
        return new if self._frame == 0 else old + _COLOUR_MEMORY * (new - old)

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
            if len(self.tracks) >= _MOST_TRACKS:
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
            if best is None or track.merit > _SWITCH * (
                best.quality if best.certain else best.merit
            ):
                best = track
        self.best = best


def _steady(old: float, new: float) -> bool:
    """Whether the horizon's slopes, rad, are those of an aircraft that flies to a runway."""
    return abs(new) < _MOST_BANK and abs(new - old) < _MOST_ROLL
