"""Several possible runways followed at a time, until it is clear which is the one."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import islice, zip_longest
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mvuav_ros.vision.approach.appearance import Scene
from mvuav_ros.vision.approach.attitude import Derotation, turn_strips
from mvuav_ros.vision.approach.candidates import (
    NO_CANDIDATES,
    Candidates,
    LevelledImage,
    find_candidates,
)
from mvuav_ros.vision.approach.edges import LevelledFrame
from mvuav_ros.vision.approach.ground_motion import Overlaid, Registration
from mvuav_ros.vision.approach.probability import Report, confidence_weights, log_odds_of
from mvuav_ros.vision.approach.search import fan_jobs
from mvuav_ros.vision.approach.track import RunwayTrack, View
from mvuav_ros.vision.approach.tuning import SEARCH, TRACKER


class SearchRange(NamedTuple):
    """Rows between which vanishing points lie on the working image levelled by a slope, rad."""

    slope: float
    first: float
    last: float


_Chunk = tuple[SearchRange, int, int, list[float]]
"""What is searched in one frame: range, level, depth, and rows."""


def _chunks(where: SearchRange) -> Iterator[_Chunk]:
    for level in range(SEARCH.levels):
        for depth, rows in fan_jobs(where.first / 2**level, where.last / 2**level, level):
            for start in range(0, len(rows), TRACKER.chunk):
                yield where, level, depth, rows[start : start + TRACKER.chunk]


def _by_turns(ranges: list[list[_Chunk]]) -> Iterator[_Chunk]:
    """One chunk of each range after the other."""
    for together in zip_longest(*ranges):
        yield from (chunk for chunk in together if chunk is not None)


class RunwayTracker:
    """Finds and follows the runway on the levelled working images of one size."""

    def __init__(self) -> None:
        self.tracks: list[RunwayTrack] = []
        self.best: RunwayTrack | None = None
        self._level: Derotation | None = None
        self._attitude = False
        self._scene: Scene | None = None
        self._registration = Registration()
        self._overlaid = Overlaid()
        self._frame = 0
        self._job = self._rounds = 0

    def step(
        self,
        frame: LevelledFrame,
        pixels: NDArray[Any],
        ranges: list[SearchRange],
        horizon: tuple[float, float] | None,
        *,
        attitude: bool = False,
    ) -> RunwayTrack | None:
        """The likeliest track in the next frame, if there is one.

        Args:
            frame: the next one.
            pixels: its working image.
            ranges: hypotheses of where the horizon is; the first has the frame's slope.
            horizon: row of the vanishing point and its standard deviation, if known, px.
            attitude: whether that comes from an attitude sensor.
        """
        if self._frame % TRACKER.scene_frames == 0:
            self._scene = None
        self._registration.take(pixels)
        self._overlaid.take(self._registration.gray)
        level = frame.level
        working = LevelledImage(pixels, level, self._scene, self._overlaid.mask)
        view = View(frame, working, horizon, self._registration)
        for track in self.tracks:
            if self._level is not None:
                track.turn(self._level, level)
            period = TRACKER.best_period if track is self.best else TRACKER.others_period
            track.step(view, period)
        self._level, self._attitude = level, attitude
        self.tracks = [
            track
            for track in self.tracks
            if not track.lost
            and track.log_odds > TRACKER.min_odds
            and working.share_hidden(track.strip()) < TRACKER.max_hidden
        ]
        self._merge()
        certain = self.best is not None and self.best.log_odds > 0
        period = (
            TRACKER.period_certain
            if certain
            else TRACKER.period_first
            if self._rounds < TRACKER.first_rounds
            else TRACKER.period_later
        )
        if self._frame % period == 0:
            self._start(self._search(view, ranges), view)
        self._frame += 1
        if working.used:
            self._scene = working.whole_scene
        self._choose()
        return self.best

    @property
    def unchanged(self) -> int:
        """Frames before the newest that were the same."""
        return self._registration.unchanged

    @property
    def report(self) -> Report | None:
        """What tells whether the best track is right."""
        best = self.best
        if best is None:
            return None
        rivals = sum(
            math.exp(min(track.log_odds - best.log_odds, 5.0))
            for track in self.tracks
            if track is not best
        )
        return Report(
            best.log_odds,
            best.agreement,
            best.moved,
            self._attitude,
            rivals,
            best.distinct,
            best.other_edges,
            best.shoulder_lines,
        )

    @property
    def confidence(self) -> float:
        """Probability that the best track is the runway, and where it is reported."""
        report = self.report
        return 0.0 if report is None else confidence_weights().confidence(report)

    def _search(self, view: View, ranges: list[SearchRange]) -> Candidates:
        """The likeliest range at once; after that the next few rows on one level at one depth."""
        if self._frame == 0:
            where = ranges[0]
            image = view.working.at_slope(where.slope)
            found = find_candidates(image, where.first, where.last)
        else:
            chunks = list(_by_turns([list(_chunks(where)) for where in ranges]))
            if not chunks:
                return NO_CANDIDATES
            self._rounds, number = divmod(self._job, len(chunks))
            where, level, depth, rows = chunks[number]
            self._job += 1
            image = view.working.at_slope(where.slope)
            strips = np.concatenate([image.search(level, depth, row) for row in rows])
            found = image.weigh(strips, level, TRACKER.max_weighed)
        turned = turn_strips(found.strips, image.level, view.working.level)
        return found._replace(strips=turned)

    def _start(self, found: Candidates, view: View) -> None:
        """Give the likeliest candidates to the tracks that they belong to, or follow them anew."""
        if not len(found.strips):
            return
        odds = log_odds_of(found.features)
        fresh: list[RunwayTrack] = []
        for index in islice(np.argsort(-odds, kind='stable'), TRACKER.max_taken):
            if odds[index] < max(
                TRACKER.min_start_odds, float(odds.max()) - TRACKER.max_below_best
            ):
                break
            self._take(found.strips[index], float(odds[index]), fresh)
        for track in fresh:
            track.step(view, 1)
        self.tracks = [track for track in self.tracks if not track.lost]

    def _take(self, strip: NDArray[np.float64], odds: float, fresh: list[RunwayTrack]) -> None:
        for track in self.tracks:
            if track.covers(strip):
                track.add(strip)
                return
        track = RunwayTrack(strip, odds)
        if self._room_for(track):
            self.tracks.append(track)
            fresh.append(track)

    def _room_for(self, track: RunwayTrack) -> bool:
        """Whether it may be followed, for which the worst one may have to go."""
        if len(self.tracks) < TRACKER.max_tracks:
            return True
        worst = min((t for t in self.tracks if t is not self.best), key=lambda t: t.log_odds)
        if worst.log_odds > track.log_odds:
            return False
        self.tracks.remove(worst)
        return True

    def _merge(self) -> None:
        """Of tracks that have become the same one keep the one shown, or the better."""
        kept: list[RunwayTrack] = []
        for track in sorted(self.tracks, key=lambda t: (t is not self.best, -t.log_odds)):
            if not any(other.covers(track.strip()) for other in kept):
                kept.append(track)
        self.tracks = kept

    def _choose(self) -> None:
        if self.best not in self.tracks:
            self.best = None
        for track in self.tracks:
            if self.best is None or track.log_odds > self.best.log_odds + TRACKER.switch_margin:
                self.best = track
